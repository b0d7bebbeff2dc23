"""The filter's recursion over a window of rows, compiled: the twin of `estimation.recursion`, equal to it to rounding.

Model and noise are the functions that the recursion calls; only the recursion itself (predict, update, blocks of rows)
stands here a second time, as loops over rows and members instead of arrays of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from uavbatt.battery import equations as eq
from uavbatt.battery import model
from uavbatt.battery import state_space as b
from uavbatt.battery.model import Array
from uavbatt.battery.pack import c_rate, true_current
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import SIZE, X
from uavbatt.compiled.jit import as_numbers, compiled, share
from uavbatt.compiled.kalman import PER_NUDGES, finite_difference_step, joseph, predicted_covariance, projected
from uavbatt.estimation import noise, recursion
from uavbatt.estimation.block import BLOCK_S, Block
from uavbatt.estimation.kalman import Moments
from uavbatt.estimation.recursion import FULL_SOC_SD, GATE, FilteredRow, FilterState, Innovation, weighed
from uavbatt.records import Sample

share(noise)
share(recursion)


def most_moments(times_s: Array, at_s: float) -> int:
    """Return the largest number of moments that rows at these times [s] lead to, from a filter at `at_s` [s]."""
    known_s = np.append(times_s[np.isfinite(times_s)], at_s)
    return min(times_s.size, int(np.ptp(known_s) / BLOCK_S)) + 4


def filter_window(pack: Pack, state: FilterState, samples: Sequence[Sample]) -> tuple[list[FilteredRow], FilterState]:
    """Take a window of rows in, as `recursion.filter_window` does.

    Returns the filter after each row, and the state after the last.
    """
    if not samples:
        return [], state
    table = np.array([[s.time_s, s.voltage_V, s.current_A, s.temp_C] for s in samples]).T.copy()
    most = most_moments(table[0], state.time_s)
    beliefs, in_force, times_s, ambients_C, shown, (current_A, block_A, block, air, since_load_s) = run(
        as_numbers(pack),
        state.air,
        state.since_load_s,
        table,
        most,
        state.time_s,
        state.current_A,
        state.block_A,
        np.array(state.block, dtype=float),
        *state.moments,
    )
    moments = [state.moments, *(Moments(*one) for one in list(zip(*beliefs, strict=True))[1:])]
    rows = [
        FilteredRow(moments[k], time_s, ambient_C, Innovation(*row))
        for k, time_s, ambient_C, row in zip(
            in_force.tolist(), times_s.tolist(), ambients_C.tolist(), shown.tolist(), strict=True
        )
    ]
    open_block = Block(*block.tolist())
    air = noise.Air(*air)
    return rows, FilterState(moments[-1], rows[-1].time_s, current_A, block_A, open_block, air, since_load_s)


@compiled
def predict(pack: Pack, x: Array, P: Array, mean_A: float, ambient_C: float, dt_s: float) -> tuple[Array, Array]:
    """Return mean and covariance `dt_s` later, as `kalman.predict` does by `state_space.transition`."""
    columns, F, at = np.empty((2 * SIZE + 1, SIZE)), np.empty((SIZE, SIZE)), x.copy()
    stride, bias_kept = model.stride(pack.cell, dt_s), eq.decay(dt_s, pack.bias_tau_s)
    for k in range(2 * SIZE + 1):
        finite_difference_step(at, x, k)
        now = b.unpack(pack, at)
        later = model.advance_by(now.cell, now.state, c_rate(now.installation, mean_A), ambient_C, stride)
        columns[k, X.SOC], columns[k, X.POLARISATION], columns[k, X.DIFFUSION] = later[:3]
        columns[k, X.CORE], columns[k, X.SENSOR] = later.core_C, later.sensor_C
        columns[k, X.LOG_RESISTANCE], columns[k, X.LOG_CAPACITY] = at[X.LOG_RESISTANCE], at[X.LOG_CAPACITY]
        columns[k, X.BIAS], columns[k, X.REACTION] = eq.relax_to(at[X.BIAS], 0.0, bias_kept), at[X.REACTION]
    for j in range(SIZE):
        for i in range(SIZE):
            F[i, j] = (columns[2 * j, i] - columns[2 * j + 1, i]) * PER_NUDGES[j]
    spread = predicted_covariance(F, P)
    q = noise.process_variances(pack, x, c_rate(pack.installation, mean_A), dt_s)
    for j in range(SIZE):
        spread[j, j] += q[j]
    return columns[2 * SIZE], spread


@compiled
def update(
    pack: Pack, x: Array, P: Array, voltage_V: float, current_A: float, temp_C: float, step_A: float
) -> tuple[Array, Array, float, float, float, float, float]:
    """Update a belief by the means of a block, as `recursion._update` does.

    Returns the mean [9] and covariance [9, 9] after it, innovation [V], its variance [V²], NIS, the expected voltage
    [V], and by how much the block is warmer than expected [K], NaN without a temperature.
    """
    size = 2 if np.isfinite(temp_C) else 1
    H, R, y = np.zeros((size, SIZE)), np.zeros((size, size)), np.empty(size)
    volts, at = np.empty(2 * SIZE + 1), x.copy()
    for k in range(2 * SIZE + 1):
        finite_difference_step(at, x, k)
        volts[k] = b.reported_voltage(pack, b.unpack(pack, at), at[X.BIAS], current_A)
    expected_V = volts[2 * SIZE]
    for j in range(SIZE):
        H[0, j] = (volts[2 * j] - volts[2 * j + 1]) * PER_NUDGES[j]
    y[0] = voltage_V - expected_V
    R[0, 0] = noise.reading_variance(pack, x, current_A, step_A)
    if size == 2:
        H[1, X.SENSOR] = 1.0
        y[1] = temp_C - (x[X.SENSOR] + pack.installation.offset_K)
        R[1, 1] = pack.temperature_sd_K**2
    PHt, S = projected(P, H)
    for i in range(size):
        S[i, i] += R[i, i]
    variance_V2 = S[0, 0]
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
    excess = later[X.SOC] - 1.0
    if excess > 0.0:
        full, sure, short = np.zeros((1, SIZE)), np.zeros((1, 1)), np.zeros(1)
        full[0, X.SOC], sure[0, 0], short[0] = 1.0, FULL_SOC_SD**2, -excess
        PHt, S = projected(spread, full)
        later, spread = joseph(later, spread, PHt, S + sure, full, sure, short)
    for i in range(SIZE):
        for j in range(i):
            spread[i, j] = spread[j, i] = 0.5 * (spread[i, j] + spread[j, i])
    return later, spread, y[0], variance_V2, nis, expected_V, y[1] if size == 2 else np.nan


@compiled
def settle(pack: Pack, x: Array, P: Array, dt_s: float) -> None:
    """Move the discrepancy of one member, in place, towards what it is in a pack at rest, as `recursion._settled`."""
    keep = np.exp(-dt_s / noise.SETTLING_S)
    x[X.BIAS] *= keep
    for j in range(SIZE):
        P[X.BIAS, j] *= keep
    for j in range(SIZE):
        P[j, X.BIAS] *= keep
    P[X.BIAS, X.BIAS] += (1.0 - keep**2) * noise.rested_variance(pack, x[X.SOC])


@compiled
def put(mean: Array, covariance: Array, x: Array, P: Array) -> None:
    """Copy the moments `x` and `P` of one member; an assignment of arrays would take numba six seconds to compile."""
    for i in range(SIZE):
        mean[i] = x[i]
        for j in range(SIZE):
            covariance[i, j] = P[i, j]


@compiled
def put_all(means: Array, covariances: Array, log_weights: Array, x: Array, P: Array, log_weight: Array) -> None:
    """Copy the moments of all members."""
    for k in range(log_weight.size):
        put(means[k], covariances[k], x[k], P[k])
        log_weights[k] = log_weight[k]


@compiled
def close(
    pack: Pack, x: Array, P: Array, log_weight: Array, block: Array, block_A: float, air: noise.Air, since_load_s: float
) -> tuple[Array, float, float, float, float, noise.Air, float]:
    """Take a block in, as `recursion._close` does: it changes every member in place.

    Returns the new ln of the weights, then innovation, NIS and expected voltage by the old weights, the block's mean
    current, the air after it, and for how long the pack has rested since its last load [s].
    """
    mean_A, mean_C = block[4] / block[0], block[5] / block[6] if block[6] > 0.0 else np.nan
    weight, members = np.exp(log_weight), log_weight.size
    innovation_V, variance_V2 = np.empty(members), np.empty(members)
    shown_V, shown_nis, expected_V, warmer_K, dt_s = 0.0, 0.0, 0.0, 0.0, block[1]
    since_load_s = noise.since_load_after(since_load_s, c_rate(pack.installation, block[2] / dt_s), dt_s)
    is_settling = noise.is_settling(since_load_s)
    for k in range(members):
        if is_settling:
            settle(pack, x[k], P[k], dt_s)
        mean, spread = predict(pack, x[k].copy(), P[k].copy(), block[2] / dt_s, air.ambient_C, dt_s)
        step_A = mean_A - block_A
        mean, spread, innovation_V[k], variance_V2[k], nis, volts, off_K = update(
            pack, mean, spread, block[3] / block[0], mean_A, mean_C, step_A
        )
        shown_V, shown_nis = shown_V + weight[k] * innovation_V[k], shown_nis + weight[k] * nis
        expected_V, warmer_K = expected_V + weight[k] * volts, warmer_K + weight[k] * off_K
        put(x[k], P[k], mean, spread)
    for i in range(block.size):
        block[i] = 0.0
    if not is_settling:
        log_weight = weighed(log_weight, innovation_V, variance_V2, pack.evidence_share)
    if np.isfinite(warmer_K):
        air = noise.air_after(air, warmer_K, pack.temperature_sd_K, dt_s)
    return log_weight, shown_V, shown_nis, expected_V, mean_A, air, since_load_s


@compiled
def look(
    pack: Pack, x: Array, log_weight: Array, drawn_As: float, current_A: float, voltage_V: float, shown: Array
) -> None:
    """Write a row within a block against the model into `shown` [4], as an `Innovation`; its NIS stays NaN."""
    expected_V, soc = 0.0, 0.0
    for k in range(log_weight.size):
        weight, now = np.exp(log_weight[k]), b.unpack(pack, x[k])
        left = x[k, X.SOC] - drawn_As / (3600.0 * now.installation.present_capacity_Ah)
        between = b.Unpacked(now.cell, now.installation, now.state._replace(soc=left))
        expected_V += weight * b.reported_voltage(pack, between, x[k, X.BIAS], current_A)
        soc += weight * left
    shown[0], shown[2], shown[3] = voltage_V - expected_V, expected_V, soc


@compiled
def run(
    pack: Pack,
    air: noise.Air,
    since_load_s: float,
    rows: Array,
    most: int,
    at_s: float,
    before_A: float,
    block_A: float,
    block: Array,
    x: Array,
    P: Array,
    log_weight: Array,
) -> tuple[Any, ...]:
    """Take all rows [time, voltage, current, temperature; n] in, from a state of the filter (`FilterState`).

    most : the largest number of moments that the rows can give, the given one included. Returns the moments (means [m,
    members, 9], covariances and ln of the weights, the given one first), which of them is in force after each row, time
    of the last row taken in and ambient temperature at each row, what each row shows [n, 4] as `Innovation` has it, and
    the state after the last row: currents of the last row and block [A], the open block, the air.
    """
    n, last = rows.shape[1], 0
    means, covariances = np.empty((most, *x.shape)), np.empty((most, *P.shape))
    log_weights = np.empty((most, log_weight.size))
    in_force, times_s, ambients_C, shown = np.zeros(n, np.int64), np.empty(n), np.empty(n), np.full((n, 4), np.nan)
    x, P, block = x.copy(), P.copy(), block.copy()
    put_all(means[0], covariances[0], log_weights[0], x, P, log_weight)
    for k in range(n):
        time_s, voltage_V, metered_A, temp_C = rows[0, k], rows[1, k], rows[2, k], rows[3, k]
        in_force[k], times_s[k], ambients_C[k] = last, at_s, air.ambient_C
        dt_s = time_s - at_s
        if not (np.isfinite(voltage_V) and np.isfinite(metered_A)) or dt_s < 0.0:
            continue
        current_A = true_current(pack.installation, metered_A, voltage_V)
        if dt_s > BLOCK_S and block[1] > 0.0:  # rows before a gap belong to the time before it
            log_weight, _, _, _, block_A, air, since_load_s = close(
                pack, x, P, log_weight, block, block_A, air, since_load_s
            )
            ambients_C[k] = air.ambient_C
        block[0] += 1.0
        block[1] += dt_s
        block[2] += 0.5 * (before_A + current_A) * dt_s
        block[3] += voltage_V
        block[4] += current_A
        if np.isfinite(temp_C):
            block[5] += temp_C
            block[6] += 1.0
        at_s, before_A, times_s[k] = time_s, current_A, time_s
        if block[1] < BLOCK_S:
            look(pack, x, log_weight, block[2], current_A, voltage_V, shown[k])
            continue
        log_weight, shown[k, 0], shown[k, 1], shown[k, 2], block_A, air, since_load_s = close(
            pack, x, P, log_weight, block, block_A, air, since_load_s
        )
        ambients_C[k] = air.ambient_C
        shown[k, 3] = np.sum(np.exp(log_weight) * x[:, X.SOC])
        last += 1
        put_all(means[last], covariances[last], log_weights[last], x, P, log_weight)
        in_force[k] = last
    moments = (means[: last + 1], covariances[: last + 1], log_weights[: last + 1])
    return moments, in_force, times_s, ambients_C, shown, (before_A, block_A, block, air, since_load_s)
