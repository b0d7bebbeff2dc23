"""The state-of-charge filter: an extended Kalman filter (filterpy) on the battery model.

    predict   x⁻ = f(x, I, dt)           P⁻ = F P Fᵀ + Q       f: belief.transition, exact for any step
    update    ν = z - h(x⁻), S = H P⁻ Hᵀ + R, NIS = νᵀ S⁻¹ ν   z: pack voltage, and the temperature if there is one

The Jacobians F and H are central differences, taken in one batched call of the same model functions, so that no
equation is written twice. A reading that is far off (NIS above GATE) is not thrown away but believed less.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from uavbatt.battery import belief as b
from uavbatt.battery import model
from uavbatt.battery.belief import SIZE, Belief, C
from uavbatt.battery.build import Pack
from uavbatt.battery.model import Array
from uavbatt.battery.pack import c_rate, true_current
from uavbatt.estimation import noise
from uavbatt.estimation.skew import Skew
from uavbatt.records import NAN, Estimate, Sample, Status

# Steps of the difference quotients: far above rounding, far below any curvature of the model.
NUDGE = np.array([1e-4, 1e-4, 1e-4, 1e-2, 1e-2, 1e-4, 1e-4, 1e-4])
GATE = 16.0
BLOCK_S = 2.0
CONVERGED_SOC_SD = 0.06
REFUSED_SOC_SD = 0.20
ROOM_TEMP_C = 22.0
FULL_SOC_SD = 0.01


@dataclass(frozen=True, slots=True)
class Block:
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
        return self.sum_C / self.temps if self.temps else NAN


class SocFilter:
    """Samples in, estimates out; holds the belief between them. One instance follows one battery."""

    def __init__(self, pack: Pack, *, ambient_C: float = NAN) -> None:
        self.pack = pack
        self.given_ambient_C = ambient_C
        self._kalman: ExtendedKalmanFilter | None = None
        self._time_s = NAN
        self._current_A = self._block_A = NAN
        self._block = Block()
        self._ambient_C = ambient_C
        self._skew = Skew(float(pack.installation.delay_s))

    @property
    def belief(self) -> Belief | None:
        """Mean and covariance after the last sample; None before the first usable one."""
        if self._kalman is None:
            return None
        return Belief(self._time_s, self._kalman.x.copy(), self._kalman.P.copy(), self._ambient_C)

    def restore(self, belief: Belief, current_A: float = 0.0) -> None:
        """Go on from a belief (a saved one, after a restart), at which the pack's current was `current_A`."""
        self._begin(belief.mean.copy(), belief.covariance.copy(), belief.time_s, belief.ambient_C)
        self._current_A = self._block_A = current_A
        self._block = Block()

    def step(self, sample: Sample) -> Estimate:
        """Take one sample in; a sample without voltage or current moves nothing and says so."""
        if not math.isfinite(sample.voltage_V) or not math.isfinite(sample.current_A):
            missing = "voltage" if not math.isfinite(sample.voltage_V) else "current"
            return self._estimate(sample, NAN, NAN, NAN, refusal=f"no {missing} in this row")
        paired = self._skew.paired(sample)
        estimate = self._taken(paired)
        if paired is sample:
            return estimate
        power_W = sample.voltage_V * sample.current_A
        return replace(estimate, voltage_V=sample.voltage_V, current_A=sample.current_A, power_W=power_W)

    def _taken(self, sample: Sample) -> Estimate:
        """A sample whose voltage and current are of the same instant."""
        current_A = float(true_current(self.pack.installation, sample.current_A, sample.voltage_V))
        if self._kalman is None:
            self._start(sample, current_A)
            return self._update(sample, Block().after(sample, current_A, 0.0, current_A), step_A=0.0)
        dt_s = sample.time_s - self._time_s
        if dt_s < 0.0:
            return self._estimate(sample, NAN, NAN, NAN, refusal="time went backwards")
        if dt_s > BLOCK_S and self._block.duration_s > 0.0:
            self._close(sample)  # rows before a gap belong to the time before it
        self._block = self._block.after(sample, current_A, dt_s, self._current_A)
        self._time_s, self._current_A = sample.time_s, current_A
        block = self._block
        if block.duration_s < BLOCK_S:
            return self._between(sample, current_A, block)
        return self._close(sample)

    def _close(self, sample: Sample) -> Estimate:
        """Take the rows of the block in."""
        block, self._block = self._block, Block()
        self._predict(block.charge_As / block.duration_s, block.duration_s)
        step_A, self._block_A = block.current_A - self._block_A, block.current_A
        return self._update(sample, block, step_A)

    def _begin(self, mean: Array, covariance: Array, time_s: float, ambient_C: float) -> None:
        kalman = ExtendedKalmanFilter(dim_x=SIZE, dim_z=2)
        kalman.x, kalman.P = mean, covariance
        self._kalman, self._time_s, self._ambient_C = kalman, time_s, ambient_C

    def _start(self, sample: Sample, current_A: float) -> None:
        """First belief: from the rested voltage, or wide from the voltage under load."""
        pack = self.pack
        temp_C, temp_sd_K = sample.temp_C - pack.installation.offset_K, pack.temperature_sd_K
        if not math.isfinite(temp_C):
            temp_C, temp_sd_K = self.given_ambient_C, 3.0
        if not math.isfinite(temp_C):
            temp_C, temp_sd_K = ROOM_TEMP_C, noise.UNKNOWN_TEMP_SD_K
        ambient_C = self.given_ambient_C if math.isfinite(self.given_ambient_C) else temp_C
        rate = float(c_rate(pack.installation, current_A))
        cell_V = (sample.voltage_V - pack.installation.offset_V) / pack.installation.gain_V / pack.installation.cells
        state, soc_sd = noise.first_state(pack, cell_V, temp_C, rate)
        mean = np.zeros(SIZE)
        mean[: C.SENSOR + 1] = state
        mean[C.SOC] += float(pack.installation.start_soc_shift)
        covariance = noise.start_covariance(pack, state, soc_sd, temp_sd_K)
        self._begin(mean, covariance, sample.time_s, ambient_C)
        self._current_A = self._block_A = current_A
        self._block = Block()

    def _predict(self, mean_A: float, dt_s: float) -> None:
        """Carry the belief over dt under the mean current."""
        assert self._kalman is not None
        kalman = self._kalman
        kalman.F, moved = _jacobian(lambda x: b.transition(self.pack, x, mean_A, self._ambient_C, dt_s), kalman.x)
        rate = float(c_rate(self.pack.installation, mean_A))
        kalman.Q = np.diag(noise.process_variances(self.pack, kalman.x, rate, dt_s))
        kalman.P = kalman.F @ kalman.P @ kalman.F.T + kalman.Q
        kalman.x = moved

    def _update(self, sample: Sample, block: Block, step_A: float) -> Estimate:
        """Condition the belief on the means of a block of rows."""
        assert self._kalman is not None
        kalman, pack = self._kalman, self.pack
        current_A, temp_C = block.current_A, block.temp_C
        has_temp = math.isfinite(temp_C)

        def reading(x: Array) -> Array:
            volts = b.voltage(pack, x, current_A)
            warmth = x[C.SENSOR] + pack.installation.offset_K
            return np.stack([volts, warmth]) if has_temp else np.stack([volts])

        observation, expected = _jacobian(reading, kalman.x)
        measured = np.array([block.voltage_V, temp_C] if has_temp else [block.voltage_V])
        innovation = measured - expected
        variances = [noise.reading_variance(pack, kalman.x, current_A, step_A)]
        if has_temp:
            variances.append(pack.temperature_sd_K**2)
        noise_R = np.diag(variances)
        spread = observation @ kalman.P @ observation.T + noise_R
        nis = float(innovation @ np.linalg.solve(spread, innovation))
        if nis > GATE:  # believe it less, so that its normalised innovation is GATE
            noise_R = noise_R + spread * (nis / GATE - 1.0)
        kalman.update(measured, lambda x: observation, lambda x: expected, R=noise_R)
        self._keep_soc_possible()
        kalman.P = 0.5 * (kalman.P + kalman.P.T)
        return self._estimate(sample, float(innovation[0]), nis, float(expected[0]))

    def _between(self, sample: Sample, current_A: float, block: Block) -> Estimate:
        """Within a block: the last belief, less the charge drawn since."""
        assert self._kalman is not None
        x = self._kalman.x.copy()
        capacity_As = 3600.0 * self.pack.installation.present_capacity_Ah * math.exp(x[C.LOG_CAPACITY])
        x[C.SOC] -= block.charge_As / capacity_As
        expected_V = float(b.voltage(self.pack, x, current_A))
        return self._estimate(sample, sample.voltage_V - expected_V, NAN, expected_V, soc=float(x[C.SOC]))

    def _keep_soc_possible(self) -> None:
        """A cell is never more than full: told to the filter as a reading, so that what is correlated follows."""
        assert self._kalman is not None
        kalman = self._kalman
        excess = float(kalman.x[C.SOC]) - 1.0
        if excess > 0.0:
            row = np.zeros((1, SIZE))
            row[0, C.SOC] = 1.0
            kalman.update(np.array([-excess]), lambda x: row, lambda x: np.zeros(1), R=np.eye(1) * FULL_SOC_SD**2)

    def _estimate(
        self,
        sample: Sample,
        innovation_V: float,
        nis: float,
        predicted_V: float,
        refusal: str = "",
        soc: float = NAN,
    ) -> Estimate:
        mean = self._kalman.x if self._kalman is not None else np.full(SIZE, NAN)
        covariance = self._kalman.P if self._kalman is not None else np.full((SIZE, SIZE), NAN)
        sd = np.sqrt(np.diag(covariance))
        soc_sd, resistance, capacity = float(sd[C.SOC]), float(mean[C.LOG_RESISTANCE]), float(mean[C.LOG_CAPACITY])
        shared = covariance[C.LOG_RESISTANCE, C.LOG_CAPACITY]
        status, reason = Status.OK, ""
        if refusal or self._kalman is None:
            status, reason = Status.REFUSED, refusal or "no usable sample yet"
        elif soc_sd > REFUSED_SOC_SD:
            status, reason = Status.REFUSED, f"state of charge known only to ±{soc_sd:.0%}"
        elif soc_sd > CONVERGED_SOC_SD:
            status, reason = Status.CONVERGING, f"state of charge known only to ±{soc_sd:.0%}"
        return Estimate(
            time_s=sample.time_s,
            soc=float(np.clip(soc if math.isfinite(soc) else mean[C.SOC], 0.0, 1.0)),
            soc_sd=soc_sd,
            voltage_V=sample.voltage_V,
            current_A=sample.current_A,
            temp_C=sample.temp_C,
            power_W=sample.voltage_V * sample.current_A,
            innovation_V=innovation_V,
            nis=nis,
            status=status,
            reason=reason,
            predicted_voltage_V=predicted_V,
            core_temp_C=float(mean[C.CORE]),
            resistance_scale=math.exp(resistance),
            capacity_scale=math.exp(capacity),
            resistance_scale_sd=math.exp(resistance) * float(sd[C.LOG_RESISTANCE]),
            capacity_scale_sd=math.exp(capacity) * float(sd[C.LOG_CAPACITY]),
            wear=math.expm1(resistance - capacity),
            wear_sd=math.sqrt(max(sd[C.LOG_RESISTANCE] ** 2 + sd[C.LOG_CAPACITY] ** 2 - 2.0 * shared, 0.0)),
        )


def _jacobian(function: Callable[[Array], Array], x: Array) -> tuple[Array, Array]:
    """(∂f/∂x, f(x)) by central differences, all columns in one call of `function`."""
    nudges = np.diag(NUDGE)
    columns = np.concatenate([x[:, None], x[:, None] + nudges, x[:, None] - nudges], axis=1)
    values = function(columns)
    plus, minus = values[:, 1 : SIZE + 1], values[:, SIZE + 1 :]
    return (plus - minus) / (2.0 * NUDGE), values[:, 0].copy()
