"""The batteries that carry the flight: those that gave its energy, or have the load now. One of them speaks for the
vehicle.

A camera's pack lasts for hours after the motors' pack is empty. So if the motors' pack falls silent, loses its current
or is refused, the time left is unknown: the camera's time must not be shown instead. The energy given since take-off
decides, as in a replay (`default_instance`), so that a battery whose telemetry is lost still counts. A battery that is
heard, not refused, and gives no current does not count: the pack that lifted an aeroplane rests while another flies it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from uavbatt.live.report import Report
from uavbatt.records import Status
from uavbatt.telemetry.builder import CARRYING

RESTING_SHARE, RESTING_AFTER_S = 0.02, 5.0  # share of the strongest; a dead current sensor is refused after 3 s
TAKES_OVER_AFTER_S = 3.0  # under the load of a carrier: a second pack was switched on, or the pack has another id


class EnergyGiven(NamedTuple):
    """EnergyGiven holds the energy that a battery gave since take-off [J], and the time of that [s]."""

    energy_J: float = 0.0
    time_s: float = 0.0


class Carriers:
    """Carriers remembers the energy of each battery since take-off, and since when a battery has a carrier's load."""

    def __init__(self) -> None:
        self._given: dict[int, EnergyGiven] = {}
        self._loaded_since_s: dict[int, float] = {}
        self._awake_s = -math.inf  # when a carrier was last lost or loaded

    def after(self, reports: Mapping[int, Report], now_s: float, is_armed: bool | None) -> frozenset[int]:
        """Return the numbers of the batteries that carry the flight; none on the ground, or before any gave energy.

        now_s : on the monotonic clock [s]; is_armed : the vehicle's armed flag, None if it is not known
        """
        fresh = [report for report in reports.values() if not report.is_stale(now_s)]
        if is_armed is not True and not any(math.isfinite(report.flying_since_s) for report in fresh):
            self._given, self._loaded_since_s = {}, {}
            return frozenset()
        for report in fresh:  # an estimate that begins anew in flight counts from 0: keep the larger energy
            now = EnergyGiven(report.flown_J, report.flown_s)
            self._given[report.instance] = max(self._given.get(report.instance, EnergyGiven()), now)
        most = max(self._given.values(), default=EnergyGiven())
        if not most.energy_J > 0.0:
            return frozenset()
        gave = {number for number, given in self._given.items() if given.energy_J >= CARRYING * most.energy_J}
        strongest_W = max((r.estimate.power_W for r in fresh if r.estimate.power_W > 0.0), default=0.0)
        resting = {r.instance for r in fresh if _is_resting(r, strongest_W)}
        if not gave <= resting:
            self._awake_s = now_s
        is_left = now_s - self._awake_s >= RESTING_AFTER_S  # all carriers rest: other batteries fly with less power
        self._look_at_load(fresh, now_s, CARRYING * (strongest_W if is_left else most.energy_J / most.time_s))
        loaded = {n for n, at_s in self._loaded_since_s.items() if now_s - at_s >= TAKES_OVER_AFTER_S}
        return frozenset(loaded - resting if is_left and loaded - resting else gave | loaded)

    def _look_at_load(self, fresh: list[Report], now_s: float, least_W: float) -> None:
        """Note which batteries have a carrier's load; an unknown load changes nothing."""
        for report in fresh:
            power_W = report.estimate.power_W
            if power_W >= least_W:
                self._loaded_since_s.setdefault(report.instance, now_s)
            elif power_W < least_W:
                self._loaded_since_s.pop(report.instance, None)


def _is_resting(report: Report, strongest_W: float) -> bool:
    """Return True if the battery is not refused, and gives next to nothing compared with the strongest [W]."""
    return report.estimate.status is not Status.REFUSED and report.estimate.power_W < RESTING_SHARE * strongest_W
