"""The filter's recursion over a whole record, compiled: the twin of `SocFilter`, equal to it to rounding.

Model and noise are the functions that `SocFilter` calls; only the recursion itself (predict, update, blocks of rows)
stands here a second time, as loops over rows instead of calls of filterpy.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from uavbatt.battery import belief as b
from uavbatt.battery import equations as eq
from uavbatt.battery import model
from uavbatt.battery.belief import SIZE, C
from uavbatt.battery.build import Pack
from uavbatt.battery.compiled import compiled, share
from uavbatt.battery.model import Array
from uavbatt.battery.pack import c_rate, true_current
from uavbatt.estimation import noise
from uavbatt.estimation.recursion import BLOCK_S, FULL_SOC_SD, GATE, NUDGE, Begun

share(noise)
PER_NUDGES = 0.5 / NUDGE


@compiled
def carried(F: Array, P: Array) -> Array:
    """F P Fᵀ; what has no influence, most of F, is passed over."""
    half, out = np.zeros((SIZE, SIZE)), np.zeros((SIZE, SIZE))
    for i in range(SIZE):
        for k in range(SIZE):
            share = F[i, k]
            if share != 0.0:
                for j in range(SIZE):
                    half[i, j] += share * P[k, j]
    for j in range(SIZE):
        for k in range(SIZE):
            share = F[j, k]
            if share != 0.0:
                for i in range(SIZE):
                    out[j, i] += share * half[i, k]
    return out


@compiled
def projected(P: Array, H: Array) -> tuple[Array, Array]:
    """P Hᵀ, transposed [readings, 8], and H P Hᵀ."""
    n = H.shape[0]
    PHt, S = np.zeros((n, SIZE)), np.zeros((n, n))
    for m in range(n):
        for k in range(SIZE):
            if H[m, k] != 0.0:
                for j in range(SIZE):
                    PHt[m, j] += H[m, k] * P[k, j]
    for m in range(n):
        for other in range(n):
            for j in range(SIZE):
                S[m, other] += PHt[m, j] * H[other, j]
    return PHt, S


@compiled
def nudge(at: Array, x: Array, k: int) -> None:
    """Make of point k - 1 of a central difference point k: up and down in each component in turn, `x` itself last."""
    j = k // 2
    if k % 2:
        at[j] = x[j] - NUDGE[j]
        return
    if k > 0:
        at[j - 1] = x[j - 1]
    if j < SIZE:
        at[j] = x[j] + NUDGE[j]


@compiled
def predict(pack: Pack, x: Array, P: Array, mean_A: float, ambient_C: float, dt_s: float) -> tuple[Array, Array]:
    """Mean and covariance `dt_s` later, as `SocFilter._predict` by `belief.transition`."""
    columns, F, at = np.empty((2 * SIZE + 1, SIZE)), np.empty((SIZE, SIZE)), x.copy()
    stride, bias_kept = model.stride(pack.cell, dt_s), eq.kept(dt_s, pack.bias_tau_s)
    for k in range(2 * SIZE + 1):
        nudge(at, x, k)
        now = b.unpack(pack, at)
        later = model.advance_by(now.cell, now.state, c_rate(now.installation, mean_A), ambient_C, stride)
        columns[k, C.SOC], columns[k, C.POLARISATION], columns[k, C.DIFFUSION] = later[:3]
        columns[k, C.CORE], columns[k, C.SENSOR] = later.core_C, later.sensor_C
        columns[k, C.LOG_RESISTANCE], columns[k, C.LOG_CAPACITY] = at[C.LOG_RESISTANCE], at[C.LOG_CAPACITY]
        columns[k, C.BIAS] = eq.approach(at[C.BIAS], 0.0, bias_kept)
    for j in range(SIZE):
        for i in range(SIZE):
            F[i, j] = (columns[2 * j, i] - columns[2 * j + 1, i]) * PER_NUDGES[j]
    spread = carried(F, P)
    q = noise.process_variances(pack, x, c_rate(pack.installation, mean_A), dt_s)
    for j in range(SIZE):
        spread[j, j] += q[j]
    return columns[2 * SIZE], spread


@compiled
def joseph(x: Array, P: Array, PHt: Array, S: Array, H: Array, R: Array, y: Array) -> tuple[Array, Array]:
    """One measurement of at most two readings, S = H P Hᵀ + R, with Joseph's form of the covariance as in filterpy.

    (1 - K H) P (1 - K H)ᵀ + K R Kᵀ, but from the right to the left in vectors: K has two columns at most.
    """
    n = y.size
    K, later, kept = np.empty((n, SIZE)), x.copy(), P.copy()
    determinant = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0] if n == 2 else S[0, 0]
    for j in range(SIZE):
        if n == 2:
            K[0, j] = (PHt[0, j] * S[1, 1] - PHt[1, j] * S[1, 0]) / determinant
            K[1, j] = (PHt[1, j] * S[0, 0] - PHt[0, j] * S[0, 1]) / determinant
        else:
            K[0, j] = PHt[0, j] / determinant
    for m in range(n):
        for i in range(SIZE):
            later[i] += K[m, i] * y[m]
            for j in range(SIZE):
                kept[i, j] -= K[m, i] * PHt[m, j]
    across = np.zeros((n, SIZE))  # what K must take away once more: kept Hᵀ less K R
    for m in range(n):
        for i in range(SIZE):
            for j in range(SIZE):
                across[m, i] += kept[i, j] * H[m, j]
            for other in range(n):
                across[m, i] -= K[other, i] * R[other, m]
    for m in range(n):
        for i in range(SIZE):
            for j in range(SIZE):
                kept[i, j] -= across[m, i] * K[m, j]
    return later, kept


@compiled
def update(
    pack: Pack, x: Array, P: Array, voltage_V: float, current_A: float, temp_C: float, step_A: float
) -> tuple[Array, Array, float, float, float]:
    """Belief after the means of a block, innovation [V], its NIS, expected voltage, as `SocFilter._update`."""
    size = 2 if np.isfinite(temp_C) else 1
    H, R, y = np.zeros((size, SIZE)), np.zeros((size, size)), np.empty(size)
    volts, at = np.empty(2 * SIZE + 1), x.copy()
    for k in range(2 * SIZE + 1):
        nudge(at, x, k)
        volts[k] = b.reported_voltage(pack, b.unpack(pack, at), at[C.BIAS], current_A)
    expected_V = volts[2 * SIZE]
    for j in range(SIZE):
        H[0, j] = (volts[2 * j] - volts[2 * j + 1]) * PER_NUDGES[j]
    y[0] = voltage_V - expected_V
    R[0, 0] = noise.reading_variance(pack, x, current_A, step_A)
    if size == 2:
        H[1, C.SENSOR] = 1.0
        y[1] = temp_C - (x[C.SENSOR] + pack.installation.offset_K)
        R[1, 1] = pack.temperature_sd_K**2
    PHt, S = projected(P, H)
    for i in range(size):
        S[i, i] += R[i, i]
    nis = y[0] ** 2 / S[0, 0]
    if size == 2:
        nis = y[0] ** 2 * S[1, 1] - 2.0 * y[0] * y[1] * S[0, 1] + y[1] ** 2 * S[0, 0]
        nis /= S[0, 0] * S[1, 1] - S[0, 1] * S[0, 1]
    if nis > GATE:  # believe it less, so that its normalised innovation is GATE
        for i in range(size):
            for j in range(size):
                R[i, j] += S[i, j] * (nis / GATE - 1.0)
                S[i, j] *= nis / GATE
    later, spread = joseph(x, P, PHt, S, H, R, y)
    excess = later[C.SOC] - 1.0
    if excess > 0.0:
        full, sure, short = np.zeros((1, SIZE)), np.zeros((1, 1)), np.zeros(1)
        full[0, C.SOC], sure[0, 0], short[0] = 1.0, FULL_SOC_SD**2, -excess
        PHt, S = projected(spread, full)
        later, spread = joseph(later, spread, PHt, S + sure, full, sure, short)
    for i in range(SIZE):
        for j in range(i):
            spread[i, j] = spread[j, i] = 0.5 * (spread[i, j] + spread[j, i])
    return later, spread, y[0], nis, expected_V


@compiled
def close(
    pack: Pack, x: Array, P: Array, block: Array, block_A: float, ambient_C: float
) -> tuple[Array, Array, float, float, float, float]:
    """Take a block in, as `SocFilter._close`: what `update` returns, and the block's mean current."""
    if block[1] > 0.0:
        x, P = predict(pack, x, P, block[2] / block[1], ambient_C, block[1])
    mean_A, mean_C = block[4] / block[0], block[5] / block[6] if block[6] > 0.0 else np.nan
    x, P, innovation_V, nis, expected_V = update(pack, x, P, block[3] / block[0], mean_A, mean_C, mean_A - block_A)
    for i in range(block.size):
        block[i] = 0.0
    return x, P, innovation_V, nis, expected_V, mean_A


@compiled
def keep(means: Array, covariances: Array, k: int, x: Array, P: Array) -> None:
    """Write a belief down; element by element, which compiles in a fraction of the time of a slice."""
    for i in range(SIZE):
        means[k, i] = x[i]
        for j in range(SIZE):
            covariances[k, i, j] = P[i, j]


@compiled
def run(pack: Pack, ambient_C: float, rows: Array, begun: Begun, x: Array, P: Array) -> tuple[Any, ...]:
    """All rows [time, voltage, current, temperature; n] from a belief at the time and in the block of `begun`.

    Returns the beliefs (means [m, 8] and covariances, the given one first), which of them is in force after each row,
    what each row shows [n, 4] as `Shown` has it, and where that ends, as `Begun` has it.
    """
    n = rows.shape[1]
    means, covariances = np.empty((n + 2, SIZE)), np.empty((n + 2, SIZE, SIZE))
    in_force, shown, last = np.zeros(n, np.int64), np.empty((n, 4)), 0
    keep(means, covariances, 0, x, P)
    block, now = begun.block.copy(), b.unpack(pack, x)
    at_s, before_A, block_A, is_first = begun.time_s, begun.current_A, begun.block_A, begun.is_first
    for k in range(n):
        time_s, voltage_V, metered_A, temp_C = rows[0, k], rows[1, k], rows[2, k], rows[3, k]
        in_force[k] = last
        for j in range(4):
            shown[k, j] = np.nan
        dt_s = 0.0 if is_first else time_s - at_s
        if not (np.isfinite(voltage_V) and np.isfinite(metered_A)) or dt_s < 0.0:
            continue
        current_A = true_current(pack.installation, metered_A, voltage_V)
        if is_first:
            before_A = block_A = current_A
        closing = dt_s > BLOCK_S and block[1] > 0.0  # rows before a gap belong to the time before it
        while True:
            if not closing:
                block[0] += 1.0
                block[1] += dt_s
                block[2] += 0.5 * (before_A + current_A) * dt_s
                block[3] += voltage_V
                block[4] += current_A
                if np.isfinite(temp_C):
                    block[5] += temp_C
                    block[6] += 1.0
                at_s, before_A = time_s, current_A
                if block[1] < BLOCK_S and not is_first:
                    capacity_As = 3600.0 * now.installation.present_capacity_Ah
                    soc = x[C.SOC] - block[2] / capacity_As
                    between = b.Unpacked(now.cell, now.installation, now.state._replace(soc=soc))
                    expected_V = b.reported_voltage(pack, between, x[C.BIAS], current_A)
                    shown[k, 0], shown[k, 2], shown[k, 3] = voltage_V - expected_V, expected_V, soc
                    break
            x, P, innovation_V, nis, expected_V, block_A = close(pack, x, P, block, block_A, ambient_C)
            now = b.unpack(pack, x)
            if not closing:
                is_first, last = False, last + 1
                keep(means, covariances, last, x, P)
                in_force[k] = last
                shown[k, 0], shown[k, 1], shown[k, 2], shown[k, 3] = innovation_V, nis, expected_V, x[C.SOC]
                break
            closing = False
    return means[: last + 1], covariances[: last + 1], in_force, shown, (at_s, before_A, block_A, is_first, block)
