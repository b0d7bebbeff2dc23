"""The feed `battery`: a battery component of its own, with BATTERY_STATUS under an id that no autopilot battery uses.

It has the vehicle's system id, component 180, and sends HEARTBEAT (MAV_TYPE_BATTERY) at 1 Hz. Ids are taken from 8
downwards (ground stations list 0..8) once the autopilot's own ids are known; if the autopilot uses an id later, ours
changes. It goes to ground-station endpoints only.
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
LISTEN_S = 3.0  # the autopilot sends its batteries one after the other


class BatteryFeed:
    """BatteryFeed makes the frames of the battery component: HEARTBEAT each second, BATTERY_STATUS at `rate_Hz`."""

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
        """Return our id for the autopilot's battery `instance`; None if all ids are in use."""
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
    """Return MAV_BATTERY_CHARGE_STATE by the time left at worst; UNDEFINED if no time is known.

    A ground station colours its battery symbol by it. It is sent to ground stations only, so that it never starts the
    battery failsafe of PX4 or ArduPilot.
    """
    if not math.isfinite(shown.at_worst_s):
        return UNDEFINED
    return next((state for below_s, state in CHARGE_STATES if shown.at_worst_s <= below_s), GOOD)
