"""Positions that leap: a receiver that is lost for a moment must neither end a forecast nor raise an alarm."""

from __future__ import annotations

import math
from dataclasses import replace

from uavbatt.navigation import NAN, Position, offset_m

FASTEST_MS = 60.0  # no battery flies an aircraft faster for long
STEP_M = 50.0  # an estimator that corrects itself moves the place so far at once
LEAP_HOLDS_S = 5.0  # a leap that lasts so long is a correction, no fault: the old place was wrong
LONGEST_STEP_S = 2.0  # over which two positions give the velocity
# ArduPilot sent the vertical velocity with the wrong sign until 2018 (pull request 7672), others may still: the height
# has then moved REVERSED_M more against it than with it. Slower than LEAST_VERTICAL_MS it tells nothing.
LEAST_VERTICAL_MS, REVERSED_M, MOST_AGREED_M = 0.5, 5.0, 20.0


class PositionCheck:
    """PositionCheck tells a position that can be believed from one to which no aircraft can have flown."""

    def __init__(self) -> None:
        self._believed: Position | None = None
        self._elsewhere: Position | None = None  # the newest position of a leap that is not believed
        self._elsewhere_since_s = NAN
        self._tells_velocity = False
        self._agreed_m = 0.0  # how far the height has moved as the vertical velocity says, less against it

    def believed(self, place: Position) -> Position | None:
        """Return the position, with its velocity also where the log tells none; None if it is not believed yet."""
        last = self._believed
        if last is None or not _is_leap(last, place):
            self._elsewhere = None
        elif self._elsewhere is None or _is_leap(self._elsewhere, place):
            self._elsewhere, self._elsewhere_since_s = place, place.time_s
            return None
        elif place.time_s - self._elsewhere_since_s < LEAP_HOLDS_S:
            self._elsewhere = place
            return None
        else:
            last, self._elsewhere = None, None
        self._believed = place
        return self._with_velocity(place, last)

    def _with_velocity(self, place: Position, before: Position | None) -> Position:
        """Return the position with a possible velocity: the one that is told, else that of the two positions.

        Some autopilots tell none and send 0 in all directions, always. NaN where neither is possible.
        """
        told_ms = _speed_ms(place)
        self._tells_velocity |= told_ms > 0.0
        if told_ms <= FASTEST_MS and self._tells_velocity:
            self._compare_heights(place, before)
            return replace(place, up_ms=-place.up_ms) if self._agreed_m < -REVERSED_M else place
        if before is not None and 0.0 < (step_s := place.time_s - before.time_s) <= LONGEST_STEP_S:
            north_m, east_m = offset_m(before, place.lat_deg, place.lon_deg)
            up_ms = (place.height_m - before.height_m) / step_s
            moved = replace(place, north_ms=north_m / step_s, east_ms=east_m / step_s, up_ms=up_ms)
            if _speed_ms(moved) <= FASTEST_MS:
                return moved
        return place if told_ms == 0.0 else replace(place, north_ms=NAN, east_ms=NAN, up_ms=NAN)

    def _compare_heights(self, place: Position, before: Position | None) -> None:
        """Note if the height moves as the told vertical velocity says."""
        if before is None or not 0.0 < place.time_s - before.time_s <= LONGEST_STEP_S:
            return
        if abs(place.up_ms) >= LEAST_VERTICAL_MS:
            moved_m = math.copysign(1.0, place.up_ms) * (place.height_m - before.height_m)
            self._agreed_m = min(max(self._agreed_m + moved_m, -MOST_AGREED_M), MOST_AGREED_M)


def _is_leap(before: Position, now: Position) -> bool:
    """Return True if no aircraft flies from one place to the other in the time between; a clock set back is no leap."""
    moved_m = math.hypot(*offset_m(before, now.lat_deg, now.lon_deg), now.height_m - before.height_m)
    step_s = now.time_s - before.time_s
    return step_s >= 0.0 and moved_m > STEP_M + FASTEST_MS * step_s


def _speed_ms(place: Position) -> float:
    return math.hypot(place.north_ms, place.east_ms, place.up_ms)
