"""The filter's steps for one member, compiled: predict over a block, update by its means, settle after a load.

Model and noise are the functions that `estimation.recursion` calls. A component that scales the model's parameters
unpacks them anew at its difference points; the others share the records of the mean.
"""

from __future__ import annotations

import numpy as np

from uavbatt.battery import equations as eq
from uavbatt.battery import model
from uavbatt.battery import state_space as b
from uavbatt.battery.model import Array, State
from uavbatt.battery.pack import c_rate
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import SIZE, X
from uavbatt.compiled.jit import compiled, compiled_numbers, laid_in, share
from uavbatt.compiled.kalman import PER_NUDGES, joseph, predicted_covariance, projected
from uavbatt.estimation import noise
from uavbatt.estimation.kalman import NUDGE
from uavbatt.estimation.meter import MeterNoise
from uavbatt.estimation.recursion import FULL_SOC_SD, GATE

share(noise)


@laid_in
def unpack_beside(pack: Pack, now: b.Unpacked, at: Array, j: int) -> b.Unpacked:
    """Return the model's records for `at`, which differs in component `j` from the vector whose records are `now`."""
    if j == X.LOG_RESISTANCE or j == X.LOG_CAPACITY or j == X.REACTION:
        return b.unpack(pack, at)
    state = State(at[X.SOC], at[X.POLARISATION], at[X.DIFFUSION], at[X.CORE], at[X.SENSOR])
    return b.Unpacked(now.cell, now.installation, state)


@compiled_numbers
def moved(pack: Pack, now: b.Unpacked, at: Array, j: int, mean_A: float, ambient_C: float, over: model.Stride) -> State:
    """Return the state of `unpack_beside` after a stride under the pack current `mean_A` [A]."""
    cell, installation, state = unpack_beside(pack, now, at, j)
    return model.advance_by(cell, state, c_rate(installation, mean_A), ambient_C, over)


@compiled_numbers
def shown_V(pack: Pack, now: b.Unpacked, at: Array, j: int, current_A: float) -> float:
    """Return the voltage [V] that is reported of `unpack_beside` under the pack current `current_A` [A]."""
    found: float = b.reported_voltage(pack, unpack_beside(pack, now, at, j), at[X.BIAS], current_A)
    return found


@compiled
def predict(pack: Pack, x: Array, P: Array, mean_A: float, ambient_C: float, dt_s: float) -> None:
    """Carry mean and covariance over `dt_s` [s] in place, as `kalman.predict` does by `state_space.transition`.

    The discrepancy decays on its own, and three components stay: no difference quotient is needed for these.
    """
    over, now, at, F = model.stride(pack.cell, dt_s), b.unpack(pack, x), x.copy(), np.zeros((SIZE, SIZE))
    for j in range(SIZE):
        if j == X.BIAS:
            continue
        at[j] = x[j] + NUDGE[j]
        plus = moved(pack, now, at, j, mean_A, ambient_C, over)
        at[j] = x[j] - NUDGE[j]
        minus = moved(pack, now, at, j, mean_A, ambient_C, over)
        at[j] = x[j]
        for i in range(X.SENSOR + 1):
            F[i, j] = (plus[i] - minus[i]) * PER_NUDGES[j]
    F[X.LOG_RESISTANCE, X.LOG_RESISTANCE] = F[X.LOG_CAPACITY, X.LOG_CAPACITY] = F[X.REACTION, X.REACTION] = 1.0
    F[X.BIAS, X.BIAS] = eq.decay(dt_s, pack.spread.bias_tau_s)
    q = noise.process_variances(pack, x, c_rate(pack.installation, mean_A), dt_s)
    later = moved(pack, now, x, X.SOC, mean_A, ambient_C, over)
    for i in range(X.SENSOR + 1):
        x[i] = later[i]
    x[X.BIAS] *= F[X.BIAS, X.BIAS]
    spread = predicted_covariance(F, P)
    for i in range(SIZE):
        for j in range(SIZE):
            P[i, j] = spread[i, j]
        P[i, i] += q[i]


@compiled
def observe(pack: Pack, x: Array, current_A: float, H: Array) -> float:
    """Write the derivatives of the reported voltage by each component of `x` into `H` [9]; returns the voltage [V].

    The voltage does not depend on the temperature of the sensor.
    """
    now, at = b.unpack(pack, x), x.copy()
    for j in range(SIZE):
        if j == X.SENSOR:
            continue
        at[j] = x[j] + NUDGE[j]
        plus_V = shown_V(pack, now, at, j, current_A)
        at[j] = x[j] - NUDGE[j]
        minus_V = shown_V(pack, now, at, j, current_A)
        at[j] = x[j]
        H[j] = (plus_V - minus_V) * PER_NUDGES[j]
    return shown_V(pack, now, x, X.SOC, current_A)


@compiled
def update(
    pack: Pack,
    x: Array,
    P: Array,
    voltage_V: float,
    current_A: float,
    temp_C: float,
    step_A: float,
    of_meter: MeterNoise,
) -> tuple[float, float, float, float, float]:
    """Update mean and covariance by the means of a block, in place, as `recursion._update` does.

    Returns the innovation [V], its variance [V²], NIS, the expected voltage [V], and by how much the block is warmer
    than expected [K], NaN without a temperature.
    """
    size = 2 if np.isfinite(temp_C) else 1
    H, R, y = np.zeros((size, SIZE)), np.zeros((size, size)), np.empty(size)
    expected_V = observe(pack, x, current_A, H[0])
    y[0] = voltage_V - expected_V
    R[0, 0] = max(noise.reading_variance(pack, x, current_A, step_A), of_meter.least_V2) + of_meter.more_V2
    if size == 2:
        H[1, X.SENSOR] = 1.0
        y[1] = temp_C - (x[X.SENSOR] + pack.installation.offset_K)
        R[1, 1] = pack.spread.temperature_sd_K**2
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
    joseph(x, P, PHt, S, H, R, y)
    at_most_full(x, P)
    for i in range(SIZE):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])
    return y[0], variance_V2, nis, expected_V, y[1] if size == 2 else np.nan


@compiled
def at_most_full(x: Array, P: Array) -> None:
    """Constrain the charge of one member to 1, in place, by a pseudo-measurement, as `recursion._at_most_full`."""
    if x[X.SOC] <= 1.0:
        return
    full, sure, short = np.zeros((1, SIZE)), np.zeros((1, 1)), np.zeros(1)
    full[0, X.SOC], sure[0, 0], short[0] = 1.0, FULL_SOC_SD**2, 1.0 - x[X.SOC]
    PHt, S = projected(P, full)
    S[0, 0] += sure[0, 0]
    joseph(x, P, PHt, S, full, sure, short)


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
