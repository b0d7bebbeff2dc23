"""PX4's battery library: a straight line in voltage, fused with counted charge, over a 50 s mean current.

Per call, with dt the step [s], V, I of the pack, N cells, C capacity, v per cell:

    I > 0:  recursive least squares for theta = [OCV, R] (below), R_cell = max(theta_1/N, 0)
    v_f   = LP(1 s) of V/N + R_cell I                        (first order, a = dt/(dt + tau))
    SoC_v = clamp((v_f - V_EMPTY)/(V_CHARGED - V_EMPTY), 0, 1)
    SoC   = (1 - w) SoC + w SoC_v, w = 0.03 (1 - SoC_v);  SoC -= dQ/C;  SoC <= 1 - Q/C
    I_avg = LP(50 s) of max(I, 0) while armed, from BAT_AVRG_CURRENT
    t     = SoC C / I_avg

In the first 2 s after connection (V >= 2.1 V) filters and regression are reset and SoC = SoC_v.

RLS with lambda = 0.95, x = [1, -I]: e = V - x theta, gain = P x/(lambda + x'P x), theta += gain e,
P = (P - gain x'P)/lambda, accepted only if it makes the Frobenius norm of P smaller; otherwise
theta_0 = V + theta_1 I and the rest stays.

**Rate.** w is per call, not per second, and the analogue driver calls at about 100 Hz; slower telemetry is
therefore cut into steps of at most 10 ms with V and I held at the newest row. `step_s=inf` calls once a row.
On rows many seconds apart the regression then sees polarisation as resistance and finds up to three times its
starting value, which lifts SoC_v; `r_internal=0.005`, that starting value, is the kinder reading there.

Source: PX4-Autopilot src/lib/battery/battery.cpp and module.yaml, pull requests 23205 and 17828; equations only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from peers.columns import FloatArray, armed
from uavbatt.records import Sample

FORGETTING = 0.95
CONNECTED_V = 2.1
SETTLE_S = 2.0
R_CELL_START = 0.005  # ohm
LP_VOLTAGE_S, LP_CURRENT_S, LP_LONGEST_STEP_S = 1.0, 50.0, 2.0
FUSION = 0.03
LEAST_CURRENT_A = 1e-6


@dataclass(frozen=True, slots=True)
class Parameters:
    """Parameters holds PX4's BATn_V_EMPTY, BATn_V_CHARGED, BATn_R_INTERNAL and BAT_AVRG_CURRENT.

    v_empty_V, v_charged_V : of a cell [V]; r_internal : of a cell [ohm]; below 0 it is estimated (RLS)
    """

    v_empty_V: float = 3.6
    v_charged_V: float = 4.05
    r_internal: float = -1.0
    average_current_A: float = 15.0


@dataclass(slots=True)
class Rls:
    """Rls holds theta = (OCV [V], R [ohm]) of the pack and its symmetric covariance (p00, p01, p11)."""

    ocv_V: float
    r: float
    p00: float
    p01: float
    p11: float

    @classmethod
    def reset(cls, voltage_V: float, cells: int) -> Rls:
        """Return the state during the first 2 s of a connection."""
        return cls(voltage_V, R_CELL_START * cells, 1.5 * cells, 0.0, 0.1 * cells)

    def norm(self) -> float:
        """Return the Frobenius norm of P."""
        return math.sqrt(self.p00**2 + 2.0 * self.p01**2 + self.p11**2)

    def update(self, voltage_V: float, current_A: float) -> bool:
        """Take one sample; return False if it was rejected."""
        x1 = -current_A
        px0, px1 = self.p00 + self.p01 * x1, self.p01 + self.p11 * x1
        scale = FORGETTING + px0 + x1 * px1
        p00, p01, p11 = (
            (self.p00 - px0 * px0 / scale) / FORGETTING,
            (self.p01 - px0 * px1 / scale) / FORGETTING,
            (self.p11 - px1 * px1 / scale) / FORGETTING,
        )
        if p00**2 + 2.0 * p01**2 + p11**2 >= self.p00**2 + 2.0 * self.p01**2 + self.p11**2:
            self.ocv_V = voltage_V + self.r * current_A
            return False
        error_V = voltage_V - (self.ocv_V + x1 * self.r)
        self.ocv_V += px0 / scale * error_V
        self.r += px1 / scale * error_V
        self.p00, self.p01, self.p11 = p00, p01, p11
        return True


@dataclass(slots=True)
class Battery:
    """Battery holds the library's state between calls; `capacity_Ah` <= 0 or NaN means unknown."""

    capacity_Ah: float
    cells: int
    parameters: Parameters = field(default_factory=Parameters)
    connected_s: float = -1.0  # < 0: not connected
    rls: Rls | None = None
    cell_V: float = 0.0
    step_Ah: float = 0.0
    drawn_Ah: float = 0.0
    soc: float = math.nan
    average_A: float = math.nan

    def call(self, step_s: float, voltage_V: float, current_A: float, flying: bool) -> None:
        """Run one pass of the library; an unknown current is NaN."""
        known = math.isfinite(current_A)
        self._connect(step_s, voltage_V, current_A if known else 0.0)
        if known and step_s > 0.0:
            self.step_Ah = current_A * step_s / 3600.0  # kept while the current is unknown, as there
            self.drawn_Ah += self.step_Ah
        v_soc = self._voltage_soc(step_s, voltage_V, current_A if known else 0.0)
        if self.capacity_Ah > 0.0 and self.connected_s > SETTLE_S:
            weight = FUSION * (1.0 - v_soc)
            fused = (1.0 - weight) * self.soc + weight * v_soc
            fused = max(fused - self.step_Ah / self.capacity_Ah, 0.0)
            self.soc = min(fused, max(1.0 - self.drawn_Ah / self.capacity_Ah, 0.0))
        else:
            self.soc = v_soc
        self._average(step_s, current_A if known else 0.0, flying)

    def remaining_s(self) -> float:
        """Return the time left [s]; NaN without a capacity."""
        if not self.capacity_Ah > 0.0:
            return math.nan
        return self.soc * self.capacity_Ah / self.average_A * 3600.0

    def _connect(self, step_s: float, voltage_V: float, current_A: float) -> None:
        if voltage_V < CONNECTED_V:
            self.connected_s = -1.0
            return
        self.connected_s = 0.0 if self.connected_s < 0.0 else self.connected_s + step_s
        if self.connected_s <= SETTLE_S:
            self.rls = Rls.reset(voltage_V, self.cells)
            self.cell_V = voltage_V / self.cells + R_CELL_START * current_A

    def _voltage_soc(self, step_s: float, voltage_V: float, current_A: float) -> float:
        """Return SoC_v of the sag-compensated, filtered cell voltage."""
        if self.rls is None:
            self.rls = Rls.reset(4.2 * self.cells, self.cells)
        rest_V = voltage_V / self.cells
        if current_A > LEAST_CURRENT_A:
            self.rls.update(voltage_V, current_A)
            fixed = self.parameters.r_internal
            r_cell = fixed if fixed >= 0.0 else max(self.rls.r / self.cells, 0.0)
            rest_V += r_cell * current_A
        short_s = min(step_s, LP_LONGEST_STEP_S)
        self.cell_V += short_s / (short_s + LP_VOLTAGE_S) * (rest_V - self.cell_V)
        span_V = self.parameters.v_charged_V - self.parameters.v_empty_V
        return min(max((self.cell_V - self.parameters.v_empty_V) / span_V, 0.0), 1.0)

    def _average(self, step_s: float, current_A: float, flying: bool) -> None:
        if not self.average_A > LEAST_CURRENT_A:  # NaN at the start
            self.average_A = self.parameters.average_current_A
        if flying:
            short_s = min(step_s, LP_LONGEST_STEP_S)
            gain = short_s / (short_s + LP_CURRENT_S)
            self.average_A += gain * (max(current_A, 0.0) - self.average_A)


def predict(
    samples: Sequence[Sample],
    capacity_Ah: float,
    cells: int,
    *,
    usable_Ah: float | None = None,
    parameters: Parameters | None = None,
    step_s: float = 0.01,
) -> FloatArray:
    """Return the time left [s] at every sample; NaN until the battery has been connected for 2 s.

    capacity_Ah : BATn_CAPACITY; usable_Ah : what a calibrated pilot writes there instead
    step_s : longest step of the library [s]; a row without voltage repeats nothing and is passed over
    """
    battery = Battery(capacity_Ah if usable_Ah is None else usable_Ah, cells, parameters or Parameters())
    remaining_s = np.full(len(samples), math.nan)
    flying = armed(samples)
    last_s = samples[0].time_s if samples else 0.0
    for row, sample in enumerate(samples):
        if not math.isfinite(sample.voltage_V):
            continue
        gap_s = sample.time_s - last_s
        last_s = sample.time_s
        steps = max(math.ceil(gap_s / step_s - 1e-9), 1)
        for _ in range(steps):
            battery.call(gap_s / steps, sample.voltage_V, sample.current_A, bool(flying[row]))
        if battery.connected_s > SETTLE_S:
            remaining_s[row] = battery.remaining_s()
    return remaining_s
