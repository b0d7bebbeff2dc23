"""Which places of its mission the aircraft has passed: one that passes none of them flies another mission."""

from __future__ import annotations

import math
from typing import NamedTuple

from uavbatt.prediction.route.legs import Leg, Phase, Point
from uavbatt.records import NAN

MISSED_M, MISSED_S = 50.0, 6.0  # an autopilot that flies to a place comes nearer, also between two rare positions
SURELY_MISSED, MOST_MISSED = 2, 4  # the pilot may skip one


class Passed(NamedTuple):
    """Passed remembers how near the aircraft came to the places of its mission; it is a value, replaced."""

    nearest_m: float = NAN  # to the end of the present item; NaN: not seen yet
    missed: int = 0  # items whose end it did not pass, less those that it passed since

    def at(self, last: Leg, here: Point) -> Passed:
        """Return the memory with one more position; `last` : last leg of the present item. It may take off anywhere."""
        if last.phase is Phase.TAKE_OFF:
            return self
        away_m = max(math.dist(here[:2], last.end[:2]) - last.circle_m, 0.0)
        return self if away_m >= self.nearest_m else self._replace(nearest_m=away_m)

    def over(self, last: Leg, here: Point | None) -> Passed:
        """Return the memory when the autopilot flies to another item; `last` : last leg of the item before."""
        if math.isnan(self.nearest_m):
            return self
        nearest_m = (self if here is None else self.at(last, here)).nearest_m
        is_missed = nearest_m > max(MISSED_M, MISSED_S * last.speed_ms)
        return Passed(missed=min(self.missed + 1, MOST_MISSED) if is_missed else max(self.missed - 1, 0))

    @property
    def is_another_mission(self) -> bool:
        """Return True if so many places were not passed that the aircraft must fly another mission."""
        return self.missed >= SURELY_MISSED
