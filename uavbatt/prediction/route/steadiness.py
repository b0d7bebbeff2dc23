"""Steady flight: the rows in which the aircraft keeps its velocity, so that its power is not that of a turn."""

from __future__ import annotations

import math
from typing import NamedTuple

from uavbatt.navigation import Position, offset_m

COMPARED_S = 1.0
STEADY_MS = 0.3  # change of the velocity in COMPARED_S: of a hover in gusts
# Where the receiver is noisy or the air rough, half of the changes are larger: then twice their median counts, but
# never so much as in a corner.
TIMES_USUAL, CORNER_MS, USUAL_STEP_MS = 2.0, 1.0, 0.01
AGREEING_MS = 4.0  # between the velocity told and that of two positions


class Steadiness(NamedTuple):
    """Steadiness compares each position with one COMPARED_S before; usual_ms is the median of the changes so far."""

    compared: Position | None = None  # with which the next positions are compared
    usual_ms: float = 0.0
    is_steady: bool = True

    def after(self, now: Position | None) -> Steadiness:
        """Return the value after one more position, None while none is known."""
        before = self.compared
        if before is None or now is None:
            return Steadiness(now, self.usual_ms, now is None)
        since_s = now.time_s - before.time_s
        change_ms = _change_ms(before, now) / max(since_s / COMPARED_S, 1.0)
        is_kept = change_ms <= max(STEADY_MS, min(TIMES_USUAL * self.usual_ms, CORNER_MS))
        is_steady = is_kept and _velocity_agrees(before, now, since_s)
        if 0.0 <= since_s < COMPARED_S:
            return self._replace(is_steady=is_steady)
        usual_ms = self.usual_ms
        if math.isfinite(change_ms):
            usual_ms = max(usual_ms + math.copysign(USUAL_STEP_MS, change_ms - usual_ms), 0.0)
        return Steadiness(now, usual_ms, is_steady)


def _change_ms(before: Position, now: Position) -> float:
    """Return the size of the change of the velocity [m/s]."""
    return math.dist((before.north_ms, before.east_ms, before.up_ms), (now.north_ms, now.east_ms, now.up_ms))


def _velocity_agrees(before: Position, now: Position, since_s: float) -> bool:
    """Return True unless the two positions deny the velocity, which is a fault of the receiver."""
    north_m, east_m = offset_m(before, now.lat_deg, now.lon_deg)
    denied_m = math.hypot(north_m - now.north_ms * since_s, east_m - now.east_ms * since_s)
    return denied_m <= AGREEING_MS * max(since_s, COMPARED_S)
