"""The monitor checks whether readings and belief still fit each other; it is a value that is replaced at each row.

A filter finds an explanation for any data. The monitor compares this explanation with what is possible. It looks for a
discrepancy far outside its prior, for innovations that stay too large, for a pack that holds much less than stated, and
for a sensor that is stuck. Each case has its words: `doubts` make an `ok` estimate `converging`, `refusal` makes it
`refused`, and `remarks` are warnings only.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import compress
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import SOC_GRID
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import Belief, X
from uavbatt.estimation.sensor_faults import SensorFaults
from uavbatt.estimation.sensor_row import SensorRow
from uavbatt.notice import Kind, Notice
from uavbatt.records import Estimate, Sample, Status

FAR_SDS, LOST_SDS = 3.0, 5.0
FAR_REACTION_V = 0.09  # per cell, in both directions; a pack that has lost a sixth of its charge has 0.05
NIS_TAU_S, NIS_LIMIT, NIS_AFTER_S = 60.0, 5.0, 60.0
SHORTEST_NIS_S, LONGEST_NIS_S = 2.0, 30.0  # time that one value counts for: the first value, and one after a gap
LARGEST_NIS = 25.0  # limit of a single row, so that one outlier does not count as a misfit of a minute
SMALL_PACK, FAR_SMALLER, FAR_LARGER = 0.9, 0.7, 1.25  # shares of the stated capacity
SURE_SDS = 1.5
FAR_MORE_OHMS = 3.5  # times the resistance of a new pack of the stated size: packs in use reach three
SETTLED_SHARE = 0.2  # largest sd of the capacity, relative: beyond, the time left is known to a factor of two

UNFITTING = Notice("voltage and current have not fitted this battery for a minute", Kind.UNFITTING)
FAR_OFF = Notice(
    "the voltage is far off what this battery file expects: another make or kind, a sensor or less charge than counted",
    Kind.FAR_OFF,
)
SMALL = Notice("this pack holds less than stated: aged or smaller, or a current sensor that reads low", Kind.SMALL_PACK)
LARGE = Notice("this pack holds more than stated: a larger one, or a current sensor that reads high", Kind.LARGE_PACK)
MANY_OHMS = Notice("this pack has the resistance of a far smaller one than stated, or a bad contact", Kind.MANY_OHMS)


class Innovations(NamedTuple):
    """Innovations holds the mean of the normalised innovation squared over about a minute.

    high_since_s : the time since which it is too large [s], NaN while it is not; time_s : time of the last block [s].
    """

    mean: float = 0.0
    high_since_s: float = math.nan
    time_s: float = math.nan

    def after(self, time_s: float, nis: float) -> Innovations:
        """Return the mean with one more block of rows, which counts for the time since the last one."""
        passed_s = time_s - self.time_s if math.isfinite(self.time_s) else SHORTEST_NIS_S
        keep = math.exp(-min(max(passed_s, 0.0), LONGEST_NIS_S) / NIS_TAU_S)
        mean = keep * self.mean + (1.0 - keep) * min(nis, LARGEST_NIS)
        if mean <= NIS_LIMIT:
            return Innovations(mean, math.nan, time_s)
        return Innovations(mean, self.high_since_s if math.isfinite(self.high_since_s) else time_s, time_s)


class PackVerdict(NamedTuple):
    """PackVerdict holds the doubts, remarks and refusal about the pack itself, by the belief after the last block."""

    doubts: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    refusal: str = ""
    is_settled: bool = False  # the capacity of a pack that differs from the statement has become known well enough

    def after(self, estimate: Estimate, belief: Belief, pack: Pack) -> PackVerdict:
        """Return the verdict after one more block, its estimate and the belief that it led to."""
        capacity, capacity_sd = estimate.capacity_scale, estimate.capacity_scale_sd
        least, most = capacity - SURE_SDS * capacity_sd, capacity + SURE_SDS * capacity_sd
        least_ohms = (1.0 + estimate.wear) * math.exp(-SURE_SDS * estimate.wear_sd)
        is_small, is_ohmic = most < FAR_SMALLER, least_ohms > FAR_MORE_OHMS  # more than wear can explain
        is_known = self.is_settled or capacity_sd < SETTLED_SHARE * capacity
        off_sds = discrepancy_sds(belief, pack)
        reaction_V = float(belief.weights @ belief.means[:, X.REACTION])
        is_off = abs(off_sds) > FAR_SDS or abs(reaction_V) > FAR_REACTION_V
        is_lost = off_sds < -LOST_SDS  # too much voltage for the charge is harmless
        doubted = {FAR_OFF: is_off, SMALL: is_small, LARGE: least > FAR_LARGER, MANY_OHMS: is_ohmic}
        refused = {FAR_OFF: is_lost, SMALL: is_small and not is_known, MANY_OHMS: is_ohmic and not is_known}
        return PackVerdict(
            doubts=tuple(compress(doubted, doubted.values())),
            remarks=(SMALL,) if FAR_SMALLER <= most < SMALL_PACK else (),
            refusal=next(compress(refused, refused.values()), ""),
            is_settled=(is_small or is_ohmic) and is_known,
        )


class Monitor(NamedTuple):
    """Monitor holds the readings seen so far, and the doubts and refusal that follow from them and from the belief."""

    sensors: SensorFaults = SensorFaults()
    innovations: Innovations = Innovations()
    pack: PackVerdict = PackVerdict()
    doubts: tuple[str, ...] = ()
    refusal: str = ""

    def after(self, sample: Sample, estimate: Estimate, belief: Belief | None, pack: Pack) -> Monitor:
        """Return the monitor after one more row, its estimate and the belief that it led to."""
        time_s, volts, amps = sample.time_s, sample.voltage_V, sample.current_A
        if belief is None or not (math.isfinite(volts) and math.isfinite(amps)) or time_s < self.sensors.changes.time_s:
            return self
        cells, capacity_Ah = float(pack.installation.cells), float(pack.installation.present_capacity_Ah)
        row = SensorRow(time_s, volts, amps, estimate.predicted_voltage_V, cells, capacity_Ah, sample.armed)
        sensors, innovations, verdict = self.sensors.after(row), self.innovations, self.pack
        if math.isfinite(estimate.nis):  # a block is closed: the belief is another one
            innovations = innovations.after(time_s, estimate.nis)
            verdict = verdict.after(estimate, belief, pack)
        unfitting = (UNFITTING,) if time_s - innovations.high_since_s >= NIS_AFTER_S else ()
        doubts = (*sensors.doubts, *unfitting, *verdict.doubts)
        return Monitor(sensors, innovations, verdict, doubts, next(iter(sensors.refusals), verdict.refusal))

    def of_next_pack(self) -> Monitor:
        """Return the monitor of the pack that follows."""
        return Monitor(self.sensors.of_next_pack())

    def judged(self, estimate: Estimate) -> Estimate:
        """Return the estimate with the monitor's doubts: refused or converging, with the words that say why."""
        if not (self.refusal or self.doubts or self.pack.remarks):
            return estimate
        status, reason = estimate.status, estimate.reason
        if self.refusal and status is not Status.REFUSED:
            status, reason = Status.REFUSED, self.refusal
        elif self.doubts and status is Status.OK:
            status, reason = Status.CONVERGING, self.doubts[0]
        refusals = (self.refusal,) if self.refusal and self.refusal not in self.doubts else ()
        warnings = (*estimate.warnings, *refusals, *self.doubts, *self.pack.remarks)
        return replace(estimate, status=status, reason=reason, warnings=warnings)


def discrepancy_sds(belief: Belief, pack: Pack) -> float:
    """Return the believed error of the model's voltage in standard deviations of its prior at the believed charge."""
    mean_V, soc = belief.weights @ belief.means[:, [X.BIAS, X.SOC]]
    return float(mean_V) / math.hypot(pack.spread.bias_sd_V, float(np.interp(soc, SOC_GRID, pack.spread.ocv_sd_V)))
