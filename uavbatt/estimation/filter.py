"""The state-of-charge filter: an extended Kalman filter (filterpy) on the battery model.

    predict   x⁻ = f(x, I, dt)           P⁻ = F P Fᵀ + Q       f: belief.transition, exact for any step
    update    ν = z - h(x⁻), S = H P⁻ Hᵀ + R, NIS = νᵀ S⁻¹ ν   z: pack voltage, and the temperature if there is one

The Jacobians F and H are central differences, taken in one batched call of the same model functions, so that no
equation is written twice. A reading that is far off (NIS above GATE) is not thrown away but believed less.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from uavbatt.battery import state_space as b
from uavbatt.battery.capacity_prior import Capacities, known_capacity
from uavbatt.battery.model import Array
from uavbatt.battery.pack import c_rate, true_current
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import SIZE, Belief, C
from uavbatt.estimation import ahead, noise
from uavbatt.estimation.ahead import Row
from uavbatt.estimation.recursion import (
    BLOCK_S,
    FULL_SOC_SD,
    GATE,
    NO_SUMMARY,
    NOTHING,
    Block,
    Moments,
    Postponed,
    Shown,
    Standing,
    Summary,
    conditioned,
    is_complete,
    jacobian,
    no_warnings,
    summary,
    weighed,
)
from uavbatt.estimation.time_alignment import Skew
from uavbatt.records import NAN, Estimate, Sample, Status

if TYPE_CHECKING:
    from filterpy.kalman import ExtendedKalmanFilter

CONVERGED_SOC_SD = 0.10
REFUSED_SOC_SD = 0.25
ROOM_TEMP_C = 22.0


class SocFilter:
    """Samples in, estimates out; holds the belief between them. One instance follows one battery.

    The belief is a sum of Gaussians, one for each capacity that the pack may have (`battery.service`): each is an
    extended Kalman filter of its own, and the readings weigh them. Without `capacities` there is one.
    """

    def __init__(self, pack: Pack, *, ambient_C: float = NAN, capacities: Capacities | None = None) -> None:
        self.pack = pack
        self.given_ambient_C = ambient_C
        self._capacities = capacities or known_capacity(pack)
        self._kalman: list[ExtendedKalmanFilter] = []
        self._at: Moments | None = None
        self._time_s = NAN
        self._current_A = self._block_A = NAN
        self._block = Block()
        self._ambient_C = ambient_C
        self._skew = Skew(float(pack.installation.delay_s))
        self._ahead: deque[Row] = deque()
        self._summary = NO_SUMMARY
        self._after = self.standing
        self.postponed: list[Postponed] | None = None  # what rows should show, when many are worked out at once

    @property
    def belief(self) -> Belief | None:
        """What is believed after the last sample; None before the first usable one."""
        if self._at is None:
            return None
        return Belief(self._time_s, self._at.x, self._at.P, self._at.weight, self._ambient_C)

    def restore(self, belief: Belief, current_A: float = 0.0) -> None:
        """Go on from a belief (a saved one, after a restart), at which the pack's current was `current_A`."""
        at = Moments(belief.means, belief.covariances, np.log(belief.weights))
        self._begin(at, belief.time_s, belief.ambient_C)
        self._current_A = self._block_A = current_A
        self._block = Block()

    def step(self, sample: Sample, warn: Callable[[Sample, Summary], tuple[str, ...]] = no_warnings) -> Estimate:
        """Take one sample in; a sample without voltage or current moves nothing and says so.

        `warn` says what a reader must know beside the estimate.
        """
        if self._ahead:
            if self._ahead[0].sample is not sample:
                raise RuntimeError("a filter that has looked ahead must be given the rows that it has seen")
            return self._estimate(sample, self._looked_up().shown, warn)
        paired = self._skew.paired(sample) if is_complete(sample) else sample
        return self._estimate(sample, self.take(paired), warn)

    def look_ahead(self, samples: Sequence[Sample]) -> None:
        """Work many rows out in one go; the next steps must be these samples, and the pack must stay as it is."""
        if self._skew.delay_s == 0.0 and not self._ahead and samples:
            before = self.standing
            self._ahead = deque(ahead.rows(self, samples))
            self._after, self.standing = self.standing, before

    def _looked_up(self) -> Row:
        row = self._ahead.popleft()
        self._at, self._time_s, self._ambient_C = row.moments, row.time_s, self._after.ambient_C
        if not self._ahead:
            self.standing = self._after
        return row

    @property
    def standing(self) -> Standing:
        """Where the filter stands, as a value."""
        return Standing(self._at, self._time_s, self._current_A, self._block_A, self._block, self._ambient_C)

    @standing.setter
    def standing(self, at: Standing) -> None:
        self._at, self._time_s, self._current_A, self._block_A = at[:4]
        self._block, self._ambient_C = at.block, at.ambient_C

    def take(self, sample: Sample) -> Shown:
        """A sample whose voltage and current are of the same instant; what it shows."""
        if not is_complete(sample):
            return NOTHING
        if self._at is None:
            return self._first(sample)
        current_A = float(true_current(self.pack.installation, sample.current_A, sample.voltage_V))
        dt_s = sample.time_s - self._time_s
        if dt_s < 0.0:
            return NOTHING
        if dt_s > BLOCK_S and self._block.duration_s > 0.0:
            self._close()  # rows before a gap belong to the time before it
        self._block = self._block.after(sample, current_A, dt_s, self._current_A)
        self._time_s, self._current_A = sample.time_s, current_A
        if self._block.duration_s < BLOCK_S:
            return self._between(sample, current_A)
        return self._close()

    def _first(self, sample: Sample) -> Shown:
        """The first row: the belief has its voltage in it already."""
        current_A = self.start(sample)
        assert self._at is not None
        expected_V = float(self._at.weight @ b.voltage(self.pack, self._at.x.T, current_A))
        soc = float(self._at.weight @ self._at.x[:, C.SOC])
        return Shown(sample.voltage_V - expected_V, NAN, expected_V, soc)

    def _close(self) -> Shown:
        """Take the rows of the block in."""
        block, self._block = self._block, Block()
        self._predict(block.charge_As / block.duration_s, block.duration_s)
        step_A, self._block_A = block.current_A - self._block_A, block.current_A
        return self._update(block, step_A)

    def _begin(self, at: Moments, time_s: float, ambient_C: float) -> None:
        self._at, self._time_s, self._ambient_C = at, time_s, ambient_C

    def _moments(self) -> Moments:
        assert self._at is not None
        return self._at

    def _condition(self, at: Moments, innovation: Array, observation: Array, noise_R: Array) -> Moments:
        """Take a measurement in: filterpy's work, but for rows that are worked out ahead."""
        if self.postponed is not None:
            return Moments(*conditioned(at.x, at.P, innovation, observation, noise_R), at.log_weight)
        x, P = at.x.copy(), at.P.copy()
        for member, kalman in enumerate(self._filterpy(len(x))):
            kalman.x, kalman.P = x[member], P[member]
            row = observation[member]
            kalman.update(innovation[member], lambda x, row=row: row, lambda x: 0.0, R=noise_R[member])
            x[member], P[member] = kalman.x, kalman.P
        return Moments(x, P, at.log_weight)

    def _filterpy(self, members: int) -> list[ExtendedKalmanFilter]:
        """filterpy's filters, which are loaded here: rows that are worked out ahead do not need them."""
        if len(self._kalman) < members:
            from filterpy.kalman import ExtendedKalmanFilter

            self._kalman = [ExtendedKalmanFilter(dim_x=SIZE, dim_z=2) for _ in range(members)]
        return self._kalman[:members]

    def start(self, sample: Sample) -> float:
        """First belief: from the rested voltage, or wide from the voltage under load. Returns the true current [A]."""
        pack = self.pack
        current_A = float(true_current(pack.installation, sample.current_A, sample.voltage_V))
        temp_C, temp_sd_K = sample.temp_C - pack.installation.offset_K, pack.temperature_sd_K
        if not math.isfinite(temp_C):
            temp_C, temp_sd_K = self.given_ambient_C, 3.0
        if not math.isfinite(temp_C):
            temp_C, temp_sd_K = ROOM_TEMP_C, noise.UNKNOWN_TEMP_SD_K
        ambient_C = self.given_ambient_C if math.isfinite(self.given_ambient_C) else temp_C
        rate = float(c_rate(pack.installation, current_A))
        cell_V = (sample.voltage_V - pack.installation.offset_V) / pack.installation.gain_V / pack.installation.cells
        first = noise.first_state(pack, cell_V, temp_C, rate)
        members = self._capacities
        x = np.zeros((members.log_scale.size, SIZE))
        x[:, : C.SENSOR + 1] = first.state
        x[:, C.SOC] = first.mean[0] + float(pack.installation.start_soc_shift)
        x[:, C.BIAS], x[:, C.LOG_CAPACITY] = first.mean[1], members.log_scale
        x[:, C.LOG_RESISTANCE] = members.log_resistance
        P = noise.start_covariances(first.state, first.covariance, temp_sd_K, members)
        self._begin(Moments(x, P, np.log(members.weight)), sample.time_s, ambient_C)
        self._current_A = self._block_A = current_A
        self._block = Block()
        return current_A

    def _predict(self, mean_A: float, dt_s: float) -> None:
        """Carry the belief over dt under the mean current."""
        at, pack = self._moments(), self.pack
        F, moved = jacobian(lambda x: b.transition(pack, x, mean_A, self._ambient_C, dt_s), at.x)
        rate, before = (float(c_rate(pack.installation, amps)) for amps in (mean_A, self._block_A))
        q = noise.process_variances(pack, at.x.T, rate, dt_s, before)
        spread = F @ at.P @ np.swapaxes(F, 1, 2) + q.T[..., None] * np.eye(SIZE)
        self._at = Moments(moved, spread, at.log_weight)

    def _update(self, block: Block, step_A: float) -> Shown:
        """Condition the belief on the means of a block of rows."""
        at, pack = self._moments(), self.pack
        current_A, temp_C = block.current_A, block.temp_C
        has_temp = math.isfinite(temp_C)

        def reading(x: Array) -> Array:
            volts = b.voltage(pack, x, current_A)
            warmth = x[C.SENSOR] + pack.installation.offset_K
            return np.stack([volts, warmth]) if has_temp else np.stack([volts])

        observation, expected = jacobian(reading, at.x)
        measured = np.array([block.voltage_V, temp_C] if has_temp else [block.voltage_V])
        innovation = measured - expected
        noise_R = np.zeros((len(at.x), measured.size, measured.size))
        noise_R[:, 0, 0] = noise.reading_variance(pack, at.x.T, current_A, step_A)
        if has_temp:
            noise_R[:, 1, 1] = pack.temperature_sd_K**2
        spread = observation @ at.P @ np.swapaxes(observation, 1, 2) + noise_R
        nis = np.sum(innovation * np.linalg.solve(spread, innovation[:, :, None])[:, :, 0], axis=1)
        # Far off (NIS above GATE): believe it less, so that its normalised innovation is GATE.
        doubted = noise_R + spread * np.maximum(nis / GATE - 1.0, 0.0)[:, None, None]
        after = self._kept_possible(self._condition(at, innovation, observation, doubted))
        P = 0.5 * (after.P + np.swapaxes(after.P, 1, 2))
        log_weight = weighed(at.log_weight, innovation[:, 0], spread[:, 0, 0])
        self._at = Moments(after.x, P, log_weight)
        weight, soc = at.weight, float(self._at.weight @ after.x[:, C.SOC])
        return Shown(float(weight @ innovation[:, 0]), float(weight @ nis), float(weight @ expected[:, 0]), soc)

    def _between(self, sample: Sample, current_A: float) -> Shown:
        """Within a block: the last belief, less the charge drawn since."""
        at = self._moments()
        x, weight = at.x.copy(), at.weight
        capacity_As = 3600.0 * self.pack.installation.present_capacity_Ah * np.exp(x[:, C.LOG_CAPACITY])
        x[:, C.SOC] -= self._block.charge_As / capacity_As
        soc = float(weight @ x[:, C.SOC])
        if self.postponed is not None:
            self.postponed.append(Postponed(x, weight, current_A, sample.voltage_V))
            return Shown(NAN, NAN, NAN, soc)
        expected_V = float(weight @ b.voltage(self.pack, x.T, current_A))
        return Shown(sample.voltage_V - expected_V, NAN, expected_V, soc)

    def _kept_possible(self, at: Moments) -> Moments:
        """A cell is never more than full: told to the filter as a reading, so that what is correlated follows."""
        over = at.x[:, C.SOC] > 1.0
        if not over.any():
            return at
        row = np.zeros((int(over.sum()), 1, SIZE))
        row[:, 0, C.SOC] = 1.0
        some = Moments(at.x[over], at.P[over], at.log_weight[over])
        noise_R = np.full((len(row), 1, 1), FULL_SOC_SD**2)
        told = self._condition(some, 1.0 - some.x[:, [C.SOC]], row, noise_R)
        x, P = at.x.copy(), at.P.copy()
        x[over], P[over] = told.x, told.P
        return Moments(x, P, at.log_weight)

    def _estimate(self, sample: Sample, shown: Shown, warn: Callable[[Sample, Summary], tuple[str, ...]]) -> Estimate:
        if self._at is not None and self._summary.x is not self._at.x:
            self._summary = summary(self._at)
        known = self._summary
        status, reason = Status.OK, ""
        if self._at is None or not math.isfinite(shown.soc):
            status, reason = Status.REFUSED, _why_nothing(sample)
        elif known.soc_sd > REFUSED_SOC_SD:
            status, reason = Status.REFUSED, known_only_to(known.soc_sd)
        elif known.soc_sd > CONVERGED_SOC_SD:
            status, reason = Status.CONVERGING, known_only_to(known.soc_sd)
        return Estimate(
            time_s=sample.time_s,
            soc=min(max(shown.soc if math.isfinite(shown.soc) else known.soc, 0.0), 1.0),
            soc_sd=known.soc_sd,
            voltage_V=sample.voltage_V,
            current_A=sample.current_A,
            temp_C=sample.temp_C,
            power_W=sample.voltage_V * sample.current_A,
            innovation_V=shown.innovation_V,
            nis=shown.nis,
            status=status,
            reason=reason,
            predicted_voltage_V=shown.expected_V,
            core_temp_C=known.core_temp_C,
            warnings=warn(sample, known),
            resistance_scale=known.resistance_scale,
            capacity_scale=known.capacity_scale,
            resistance_scale_sd=known.resistance_scale_sd,
            capacity_scale_sd=known.capacity_scale_sd,
            wear=known.wear,
            wear_sd=known.wear_sd,
        )


def known_only_to(soc_sd: float) -> str:
    """How little is known of the charge; beyond any charge that there is, the number would say nothing."""
    return f"state of charge known only to ±{soc_sd:.0%}" if soc_sd < 1.0 else "state of charge not known at all"


def _why_nothing(sample: Sample) -> str:
    """Why a row moved nothing."""
    if is_complete(sample):
        return "time went backwards"
    return "no voltage in this row" if not math.isfinite(sample.voltage_V) else "no current in this row"
