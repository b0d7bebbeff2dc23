"""Values that the filter, its look-ahead and its compiled twin share, beside the model and the noise."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.battery.state_space import SIZE, C, mixed_covariance
from uavbatt.records import Sample

# Steps of the difference quotients: far above rounding, far below any curvature of the model.
NUDGE = np.array([1e-4, 1e-4, 1e-4, 1e-2, 1e-2, 1e-4, 1e-4, 1e-4])
GATE = 16.0
BLOCK_S = 2.0
FULL_SOC_SD = 0.01
EVIDENCE_SHARE, LEAST_WEIGHT = 0.1, 1e-5


class Block(NamedTuple):
    """Rows that are taken in together: fast telemetry is averaged to BLOCK_S before the filter sees it.

    The row-to-row noise of a current sensor, multiplied by the resistance, would look like a voltage that does not
    answer the current: a resistance too small. Means over two seconds leave little of it, and cost less.
    """

    rows: int = 0
    duration_s: float = 0.0
    charge_As: float = 0.0
    sum_V: float = 0.0
    sum_A: float = 0.0
    sum_C: float = 0.0
    temps: int = 0

    def after(self, sample: Sample, current_A: float, dt_s: float, previous_A: float) -> Block:
        """The block with one more row, `dt_s` after a row of `previous_A` (trapezium rule)."""
        has_temp = math.isfinite(sample.temp_C)
        return Block(
            self.rows + 1,
            self.duration_s + dt_s,
            self.charge_As + 0.5 * (previous_A + current_A) * dt_s,
            self.sum_V + sample.voltage_V,
            self.sum_A + current_A,
            self.sum_C + (sample.temp_C if has_temp else 0.0),
            self.temps + has_temp,
        )

    @property
    def voltage_V(self) -> float:
        """Mean voltage [V]."""
        return self.sum_V / self.rows

    @property
    def current_A(self) -> float:
        """Mean of the rows' currents [A]."""
        return self.sum_A / self.rows

    @property
    def temp_C(self) -> float:
        """Mean temperature [°C], NaN when no row had one."""
        return self.sum_C / self.temps if self.temps else math.nan


class Begun(NamedTuple):
    """Where the filter stands between two rows: time and current of the last, mean current of the last block."""

    time_s: float
    current_A: float
    block_A: float
    is_first: bool  # the belief comes from the row that follows
    block: Array  # the open `Block`


class Moments(NamedTuple):
    """A sum of Gaussians, where filterpy's filters are not needed: means, covariances, ln of the weights."""

    x: Array  # [members, 8]
    P: Array  # [members, 8, 8]
    log_weight: Array  # [members]

    @property
    def weight(self) -> Array:
        """Weights [members]; their sum is 1."""
        return np.asarray(np.exp(self.log_weight))


def jacobian(function: Callable[[Array], Array], x: Array) -> tuple[Array, Array]:
    """(∂f/∂x [members, n, 8], f(x) [members, n]) by central differences, all columns in one call of `function`."""
    nudges = np.diag(NUDGE)
    points = np.concatenate([x[:, None], x[:, None] + nudges, x[:, None] - nudges], axis=1)
    members, count, _ = points.shape
    values = function(points.reshape(members * count, SIZE).T).T.reshape(members, count, -1)
    plus, minus = values[:, 1 : SIZE + 1], values[:, SIZE + 1 :]
    return np.swapaxes((plus - minus) / (2.0 * NUDGE)[:, None], 1, 2), values[:, 0].copy()


def conditioned(x: Array, P: Array, innovation: Array, observation: Array, noise_R: Array) -> tuple[Array, Array]:
    """Means and covariances after a measurement, with Joseph's form: `ExtendedKalmanFilter.update` of filterpy.

    Said once more here because importing filterpy takes longer than all the updates of a replay. innovation
    [members, n], observation [members, n, 8], noise_R [members, n, n].
    """
    PHt = P @ np.swapaxes(observation, 1, 2)
    gain = PHt @ np.linalg.inv(observation @ PHt + noise_R)
    keep = np.eye(SIZE) - gain @ observation
    spread = keep @ P @ np.swapaxes(keep, 1, 2) + gain @ noise_R @ np.swapaxes(gain, 1, 2)
    return x + (gain @ innovation[:, :, None])[:, :, 0], spread


def weighed(log_weight: Array, innovation_V: Array, variance_V2: Array) -> Array:
    """ln of the members' weights after each has been surprised by `innovation_V` of variance `variance_V2` [members].

    One yardstick for all, the harmonic mean of the variances by weight: a member that holds its readings for less noisy
    would otherwise win by that alone, since all of them believe readings less than their noise deserves. Within the
    noise neighbouring readings have the same error, so that each counts by EVIDENCE_SHARE; what is beyond it counts
    whole, since no slow error of the model looks like the knee of an emptying pack. No weight falls below LEAST_WEIGHT:
    who was wrong all along may be right about the knee.
    """
    yardstick_V2 = 1.0 / np.sum(np.exp(log_weight) / variance_V2)
    surprise = np.minimum(innovation_V**2 / yardstick_V2, GATE)
    evidence = EVIDENCE_SHARE * np.minimum(surprise, 1.0) + np.maximum(surprise - 1.0, 0.0)
    raised = log_weight - 0.5 * (evidence - np.min(evidence))
    weight = np.exp(raised - np.max(raised))
    weight = weight / np.sum(weight)
    found: Array = np.log(LEAST_WEIGHT + (1.0 - LEAST_WEIGHT * weight.size) * weight)
    return found


class Standing(NamedTuple):
    """All that a filter carries from row to row."""

    moments: Moments | None
    time_s: float
    current_A: float
    block_A: float
    block: Block
    ambient_C: float


class Shown(NamedTuple):
    """What a row shows: innovation [V], its NIS (NaN within a block), expected voltage [V], soc."""

    innovation_V: float
    nis: float
    expected_V: float
    soc: float


NOTHING = Shown(math.nan, math.nan, math.nan, math.nan)


class Postponed(NamedTuple):
    """A row whose expected voltage is worked out later, with those of other rows; x [members, 8]."""

    x: Array
    weight: Array
    current_A: float
    voltage_V: float


def is_complete(sample: Sample) -> bool:
    """Whether the row can move the belief."""
    return math.isfinite(sample.voltage_V) and math.isfinite(sample.current_A)


class Summary(NamedTuple):
    """What estimates say of a belief: the same for all rows between two updates."""

    x: Array
    soc: float
    soc_sd: float
    core_temp_C: float
    resistance_scale: float
    resistance_scale_sd: float
    capacity_scale: float
    capacity_scale_sd: float
    wear: float
    wear_sd: float


NO_SUMMARY = Summary(np.full(SIZE, math.nan), *(math.nan,) * 9)


def no_warnings(sample: Sample, known: Summary) -> tuple[str, ...]:
    """For those who do not ask."""
    return ()


def summary(at: Moments) -> Summary:
    """Mean and spread of what is told of a belief."""
    weight = at.weight
    x, covariance = weight @ at.x, mixed_covariance(at.x, at.P, weight)
    sd = np.sqrt(np.diag(covariance))
    resistance, capacity = float(x[C.LOG_RESISTANCE]), float(x[C.LOG_CAPACITY])
    shared = covariance[C.LOG_RESISTANCE, C.LOG_CAPACITY]
    return Summary(
        x=at.x,
        soc=float(x[C.SOC]),
        soc_sd=float(sd[C.SOC]),
        core_temp_C=float(x[C.CORE]),
        resistance_scale=math.exp(resistance),
        resistance_scale_sd=math.exp(resistance) * float(sd[C.LOG_RESISTANCE]),
        capacity_scale=math.exp(capacity),
        capacity_scale_sd=math.exp(capacity) * float(sd[C.LOG_CAPACITY]),
        wear=math.expm1(resistance - capacity),
        wear_sd=math.sqrt(max(sd[C.LOG_RESISTANCE] ** 2 + sd[C.LOG_CAPACITY] ** 2 - 2.0 * shared, 0.0)),
    )
