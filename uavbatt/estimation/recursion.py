"""The filter's recursion over a window of rows: pure functions from one state of the filter to the next.

    between blocks   soc falls by the charge drawn
    block closed     predict over the block's mean current, condition on its mean voltage (and temperature if there is
                     one): ν = z - h(x⁻), S = H P⁻ Hᵀ + R, NIS = νᵀ S⁻¹ ν; then weigh the members by their ν

A reading that is far off (NIS above GATE) is not thrown away but believed less. `compiled.filter` is the same recursion
compiled; a test holds the two equal to 1e-9.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from uavbatt.battery import state_space as b
from uavbatt.battery.capacity_prior import Capacities
from uavbatt.battery.model import Array
from uavbatt.battery.pack import c_rate, true_current, true_voltage
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import SIZE, Belief, X
from uavbatt.estimation import kalman, noise
from uavbatt.estimation.block import BLOCK_S, Block, is_complete
from uavbatt.estimation.innovation import NOTHING, Innovation, Tangent, tangent, within_block
from uavbatt.estimation.kalman import Condition, Measurement, jacobian
from uavbatt.estimation.meter import Meter, MeterNoise, Scatter, meter_after, meter_noise, scatter_after
from uavbatt.estimation.summary import BeliefSummary, summary
from uavbatt.records import Sample

GATE = 16.0
# Limit of the NIS above which a reading is believed less: 1.7 standard deviations. With 2, the last seconds of a flight
# are known later. With 1, four fifths of the readings of a noisy sensor were above it, and a generic battery was too
# sure of its capacity: it was 2.1 sds off where the mean NIS was above 0.6, and 0.7 where it was below 0.3.
WITHIN_NOISE = 3.0
FULL_SOC_SD = 0.01
LEAST_WEIGHT = 1e-5
ROOM_TEMP_C = 22.0


class FilterState(NamedTuple):
    """FilterState holds the state of the filter between two rows."""

    belief: Belief  # as after the last block
    summary: BeliefSummary  # of that belief
    time_s: float  # of the last row
    current_A: float  # of the last row
    block_A: float  # mean of the last block
    tangent: Tangent  # of the model at the last block, for the rows of the open one
    block: Block  # the open block
    air: noise.Air
    load: noise.LastLoad = noise.LastLoad()
    meter: Meter = Meter()
    scatter: Scatter = Scatter()


class Reading(NamedTuple):
    """Reading holds a closed block, by how much its current has grown since the last one [A], and its meter's noise."""

    block: Block
    step_A: float
    of_meter: MeterNoise


class FilteredRow(NamedTuple):
    """FilteredRow holds the belief after one row, its summary, and the row against the model.

    The rows of a block share the belief after the last block. It is None before the first complete row.
    """

    belief: Belief | None
    summary: BeliefSummary
    innovation: Innovation


Window = Callable[[Pack, FilterState, Sequence[Sample]], tuple[list[FilteredRow], FilterState]]
NOT_BEGUN = FilteredRow(None, BeliefSummary(), NOTHING)


def start(pack: Pack, sample: Sample, ambient_C: float, members: Capacities) -> tuple[FilterState, FilteredRow]:
    """Start the filter at a row with voltage and current: from the rested voltage, or wide from one under load.

    ambient_C : given ambient temperature [°C], NaN where nobody gave one; members : the capacities to weigh.
    """
    current_A = float(true_current(pack.installation, sample.current_A, sample.voltage_V))
    temp_C, temp_sd_K = sample.temp_C - pack.installation.offset_K, pack.spread.temperature_sd_K
    if not math.isfinite(temp_C):
        temp_C, temp_sd_K = ambient_C, 3.0
    if not math.isfinite(temp_C):
        temp_C, temp_sd_K = ROOM_TEMP_C, noise.UNKNOWN_TEMP_SD_K
    rate = float(c_rate(pack.installation, current_A))
    cell_V = float(true_voltage(pack.installation, sample.voltage_V, current_A)) / pack.installation.cells
    first = noise.first_state(pack, cell_V, temp_C, rate)
    x = np.zeros((members.log_scale.size, SIZE))
    x[:, : X.SENSOR + 1] = first.state
    x[:, X.SOC] = first.mean[0] + float(pack.installation.start_soc_shift)
    x[:, X.BIAS], x[:, X.LOG_CAPACITY] = first.mean[1], members.log_scale
    x[:, X.LOG_RESISTANCE] = members.log_resistance
    P = noise.start_covariances(pack, first.state, first.covariance, temp_sd_K, members)
    is_stated = math.isfinite(ambient_C)
    air = noise.first_air(ambient_C if is_stated else temp_C, is_stated)
    belief = Belief(x, P, np.log(members.weight), air.ambient_C)
    state = state_at(pack, belief, sample.time_s, current_A, air)
    shown = within_block(state.tangent, sample.voltage_V, current_A, 0.0)
    return state, FilteredRow(belief, state.summary, shown)


def state_at(pack: Pack, belief: Belief, time_s: float, current_A: float, air: noise.Air) -> FilterState:
    """Return the state of a filter that begins with a belief, after a row at `time_s` [s] under `current_A` [A]."""
    known, at = summary(belief, pack.spread.empty_soc_sd), tangent(pack, belief, current_A)
    return FilterState(belief, known, time_s, current_A, current_A, at, Block(), air)


def filter_window(
    pack: Pack, state: FilterState, samples: Sequence[Sample], condition: Condition = kalman.condition
) -> tuple[list[FilteredRow], FilterState]:
    """Take a window of rows in, one after the other.

    condition : how a measurement is taken in; filterpy's in flight (`kalman.filterpy_condition`).
    Returns the filter after each row, and the state after the last.
    """
    rows: list[FilteredRow] = []
    for sample in samples:
        state, shown = _take(pack, state, sample, condition)
        rows.append(FilteredRow(state.belief, state.summary, shown))
    return rows, state


def flight_window() -> Window:
    """Return the recursion over rows as it runs in flight: filterpy takes the measurements in."""
    return partial(filter_window, condition=kalman.filterpy_condition())


def _take(pack: Pack, state: FilterState, sample: Sample, condition: Condition) -> tuple[FilterState, Innovation]:
    """Return the state after one row, and the row's innovation.

    A row without voltage or current, or one that goes back in time, changes nothing and has no innovation.
    """
    dt_s = sample.time_s - state.time_s
    if not is_complete(sample) or dt_s < 0.0:
        return state, NOTHING
    current_A = float(true_current(pack.installation, sample.current_A, sample.voltage_V))
    if dt_s > BLOCK_S and state.block.duration_s > 0.0:
        state, _ = _close(pack, state, condition)  # rows before a gap belong to the time before it
    block = state.block.after(sample, current_A, dt_s, state.current_A)
    meter = meter_after(state.meter, sample.voltage_V, dt_s)
    state = state._replace(time_s=sample.time_s, current_A=current_A, block=block, meter=meter)
    if block.duration_s < BLOCK_S:
        return state, within_block(state.tangent, sample.voltage_V, current_A, block.charge_As)
    return _close(pack, state, condition)


def _close(pack: Pack, state: FilterState, condition: Condition) -> tuple[FilterState, Innovation]:
    """Close the open block: predict over its time, then condition on its means."""
    block, at = state.block, state.belief
    mean_A, dt_s = block.charge_As / block.duration_s, block.duration_s
    rate = float(c_rate(pack.installation, mean_A))
    load = noise.load_after(state.load, rate, dt_s)
    is_settling = noise.is_settling(load)
    x, P = _settled(pack, at, dt_s) if is_settling else (at.means, at.covariances)
    process_Q = noise.process_variances(pack, x.T, rate, dt_s).T
    x, P = kalman.predict(lambda x: b.transition(pack, x, mean_A, at.ambient_C, dt_s), x, P, process_Q)
    predicted, step_A = Belief(x, P, at.log_weights, at.ambient_C), block.current_A - state.block_A
    reading = Reading(block, step_A, meter_noise(state.meter, state.scatter, dt_s, pack.installation.cells))
    belief, shown, air = _update(pack, predicted, state.air, reading, condition, weighs=not is_settling)
    after = state_at(pack, belief, state.time_s, state.current_A, air)
    scatter = scatter_after(state.scatter, shown.innovation_V)
    return after._replace(block_A=block.current_A, load=load, meter=state.meter, scatter=scatter), shown


def _settled(pack: Pack, at: Belief, dt_s: float) -> tuple[Array, Array]:
    """Return means and covariances with the discrepancy on its way, for `dt_s` [s], to what it is in a pack at rest."""
    keep, x, P = math.exp(-dt_s / noise.SETTLING_S), at.means.copy(), at.covariances.copy()
    x[:, X.BIAS] *= keep
    P[:, X.BIAS, :] *= keep
    P[:, :, X.BIAS] *= keep
    P[:, X.BIAS, X.BIAS] += (1.0 - keep**2) * noise.rested_variance(pack, x[:, X.SOC])
    return x, P


def _update(
    pack: Pack, at: Belief, air: noise.Air, reading: Reading, condition: Condition, weighs: bool
) -> tuple[Belief, Innovation, noise.Air]:
    """Condition a belief on the means of a block.

    weighs : the block tells which member is right.
    Returns the belief, the block against the model, and the air by the block's temperature, if it has one.
    """
    block = reading.block
    measurement, expected_V = _measurement(pack, at.means, reading)
    innovation, observation, noise_R = measurement
    spread = observation @ at.covariances @ np.swapaxes(observation, 1, 2) + noise_R
    nis = np.sum(innovation * np.linalg.solve(spread, innovation[:, :, None])[:, :, 0], axis=1)
    # Far off (NIS above GATE): believe the reading less, so that its normalised innovation is GATE.
    doubted = noise_R + spread * np.maximum(nis / GATE - 1.0, 0.0)[:, None, None]
    x, P = condition(at.means, at.covariances, measurement._replace(noise_R=doubted))
    x, P = _at_most_full(x, P, condition)
    log_weights, weight = at.log_weights, at.weights
    if weighs:
        log_weights = weighed(log_weights, innovation[:, 0], spread[:, 0, 0], pack.spread.evidence_share)
    if math.isfinite(block.temp_C):
        air = noise.air_after(air, float(weight @ innovation[:, 1]), pack.spread.temperature_sd_K, block.duration_s)
    after = Belief(x, 0.5 * (P + np.swapaxes(P, 1, 2)), log_weights, air.ambient_C)
    soc = float(after.weights @ x[:, X.SOC])
    shown = Innovation(float(weight @ innovation[:, 0]), float(weight @ nis), float(weight @ expected_V), soc)
    return after, shown, air


def _measurement(pack: Pack, means: Array, reading: Reading) -> tuple[Measurement, Array]:
    """Return the means of a block (voltage, and temperature if it has one) as a measurement, and the voltage expected.

    means : of the members [members, 9]. The expected voltage [V] is that of each member.
    """
    block, step_A, of_meter = reading
    measured = np.array([block.voltage_V, block.temp_C])[: 2 if math.isfinite(block.temp_C) else 1]

    def readings(x: Array) -> Array:
        volts, warmth_C = b.voltage(pack, x, block.current_A), x[X.SENSOR] + pack.installation.offset_K
        return np.stack([volts, warmth_C][: measured.size])

    observation, expected = jacobian(readings, means)
    variances = np.empty((len(means), 2))
    expected_V2 = noise.reading_variance(pack, means.T, block.current_A, step_A)
    variances[:, 0] = np.maximum(expected_V2, of_meter.least_V2) + of_meter.more_V2
    variances[:, 1] = pack.spread.temperature_sd_K**2
    noise_R = variances[:, : measured.size, None] * np.eye(measured.size)
    return Measurement(measured - expected, observation, noise_R), expected[:, 0]


def _at_most_full(x: Array, P: Array, condition: Condition) -> tuple[Array, Array]:
    """Constrain the charge of every member to 1 by a pseudo-measurement with sd FULL_SOC_SD: correlations follow."""
    over = x[:, X.SOC] > 1.0
    if not over.any():
        return x, P
    row = np.zeros((int(over.sum()), 1, SIZE))
    row[:, 0, X.SOC] = 1.0
    full = Measurement(1.0 - x[over][:, [X.SOC]], row, np.full((len(row), 1, 1), FULL_SOC_SD**2))
    x, P = x.copy(), P.copy()
    x[over], P[over] = condition(x[over], P[over], full)
    return x, P


def weighed(log_weight: Array, innovation_V: Array, variance_V2: Array, evidence_share: float) -> Array:
    """Return ln of the members' weights after a reading whose innovation is `innovation_V` [V] for each member.

    variance_V2 : the variance of each innovation [V²], [members]. All are judged by one variance, the harmonic mean
    by weight: otherwise a member that expects less noise would win by that alone, since all members expect more noise
    than there is. An innovation whose NIS is within WITHIN_NOISE counts by `evidence_share`, which is less than 1 where
    the model's curve is that of other makes and stays wrong in one direction for minutes. What is beyond counts whole:
    no slow error of the model looks like the knee of an emptying pack. No weight falls below LEAST_WEIGHT: a member
    that was wrong so far may be right about the knee.
    """
    yardstick_V2 = 1.0 / np.sum(np.exp(log_weight) / variance_V2)
    surprise = np.minimum(innovation_V**2 / yardstick_V2, GATE)
    evidence = evidence_share * np.minimum(surprise, WITHIN_NOISE) + np.maximum(surprise - WITHIN_NOISE, 0.0)
    raised = log_weight - 0.5 * (evidence - np.min(evidence))
    weight = np.exp(raised - np.max(raised))
    weight = weight / np.sum(weight)
    found: Array = np.log(LEAST_WEIGHT + (1.0 - LEAST_WEIGHT * weight.size) * weight)
    return found
