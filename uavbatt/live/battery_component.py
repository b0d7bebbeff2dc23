"""A battery component of its own: BATTERY_STATUS with our time, under an id that no autopilot battery uses.

System of the vehicle, component 180, HEARTBEAT MAV_TYPE_BATTERY at 1 Hz. Ids are taken from 8 downwards (ground
stations list 0..8) once the autopilot's own are known; a battery whose id the autopilot takes moves on.
Sent to ground-station endpoints only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from uavbatt.live.report import Display, Report
from uavbatt.mavlink.outgoing import Outgoing
from uavbatt.records import NAN, Status

HIGHEST_ID = 8
# MAV_BATTERY_CHARGE_STATE: undefined, ok, and low, critical, emergency below a time left [s].
UNDEFINED, GOOD = 0, 1
CHARGE_STATES = ((20.0, 4), (60.0, 3), (120.0, 2))
LISTEN_S = 3.0  # the autopilot names its batteries in turn


class BatteryFeed:
    """BatteryFeed makes HEARTBEAT each second and BATTERY_STATUS at `rate_Hz`, as of a battery component of its own."""

    def __init__(self, rate_Hz: float) -> None:
        self._period_s = 1.0 / rate_Hz
        self._next_s = self._beat_s = -math.inf
        self._since_s = NAN
        self._ids: dict[int, int] = {}

    def frames(self, now_s: float, reports: Sequence[Report], taken: set[int], out: Outgoing) -> list[bytes]:
        """Return the frames that are due; `taken` are the ids of the autopilot's batteries."""
        made = []
        if now_s >= self._beat_s:
            self._beat_s = now_s + 1.0
            made.append(out.heartbeat())
        if math.isnan(self._since_s) and reports:
            self._since_s = now_s
        if now_s < self._next_s or not now_s - self._since_s >= LISTEN_S:
            return made
        self._next_s = now_s + self._period_s
        for report in reports:
            battery_id = self._id(report.instance, taken)
            if battery_id is not None:
                made.append(_frame(report, now_s, battery_id, out))
        return made

    def _id(self, instance: int, taken: set[int]) -> int | None:
        """The id for the autopilot's battery `instance`; None when all are in use."""
        others = taken | {used for owner, used in self._ids.items() if owner != instance}
        held = self._ids.get(instance)
        if held is None or held in others:
            free = [i for i in range(HIGHEST_ID, -1, -1) if i not in others]
            self._ids.pop(instance, None)
            if not free:
                return None
            self._ids[instance] = free[0]
        return self._ids[instance]


def _frame(report: Report, now_s: float, battery_id: int, out: Outgoing) -> bytes:
    shown, row = report.at(now_s), report.estimate
    stale = shown.status is Status.STALE
    return out.battery(
        battery_id,
        voltage_V=NAN if stale else row.voltage_V,
        current_A=NAN if stale else row.current_A,
        temp_C=NAN if stale else row.temp_C,
        soc=shown.soc,
        remaining_s=shown.remaining_s,
        charge_state=charge_state(shown),
    )


def charge_state(shown: Display) -> int:
    """Return MAV_BATTERY_CHARGE_STATE by the time that the alarm goes by: a ground station colours its battery by it.

    UNDEFINED where no time is known. It goes to ground stations only: what PX4 or ArduPilot does when a battery is
    critical stays with their own monitors.
    """
    if not math.isfinite(shown.at_worst_s):
        return UNDEFINED
    return next((state for below_s, state in CHARGE_STATES if shown.at_worst_s <= below_s), GOOD)
