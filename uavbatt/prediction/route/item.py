"""The legs of one mission item: a return, a landing and turns have several, but the autopilot reports only the item.

The position shows which leg is flown; on a circle, or without a position, the clock decides.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from uavbatt.navigation import Position
from uavbatt.prediction.route.legs import Leg, Phase, Point

ARRIVED_M = 4.0
STANDING_MS = 1.0  # an aircraft that stands within ASTRAY_M of a leg's end waits there: its height may have drifted
DOWN_M = 0.5
ASTRAY_M = 15.0  # a climb ends, and a descent begins, at most so far from the planned place
SINKING_MS = 0.2  # a slower fall is a wait at another height than planned
NEARING_MS = 1.0  # towards the centre: an aircraft that nears it is not on the circle yet


def item_end(legs: Sequence[Leg], at: int) -> int:
    """Return the index after the last leg of the item of leg `at`; items repeated at once count as one."""
    end = at + 1
    while end < len(legs) and legs[end].seq == legs[at].seq:
        end += 1
    return end


def is_there(leg: Leg, here: Point, position: Position | None) -> bool:
    """Return True if the aircraft is at the leg's end; False for a landing or a circle, which have no wait there."""
    if leg.phase is Phase.LANDING or leg.circle_m > 0.0:
        return False
    if leg.phase is Phase.HOME and leg.run_m > 0.0:
        return math.dist(here[:2], leg.end[:2]) < ARRIVED_M  # at any height
    away_m = math.dist(here, leg.end)
    return away_m < ARRIVED_M or (leg.hold_s > 0.0 and away_m < ASTRAY_M and _stands(position))


def _stands(position: Position | None) -> bool:
    return position is not None and math.hypot(position.north_ms, position.east_ms, position.up_ms) < STANDING_MS


def is_behind(leg: Leg, following: Leg, here: Point, position: Position | None, waited_s: float) -> bool:
    """Return True if a leg that is no circle is over and the next one of its item is flown.

    waited_s : time so far at the leg's end [s]; NaN if the aircraft is not there
    """
    if leg.phase is Phase.LANDING:
        return here.height_m <= leg.end.height_m + DOWN_M
    if following.circle_m > 0.0:
        return _is_on_circle(following, here, position)
    if leg.rise_m > 0.0 and not leg.run_m > 0.0:
        moved_on = math.dist(here[:2], following.end[:2]) < following.run_m - ASTRAY_M
        return moved_on or here.height_m > leg.end.height_m - ARRIVED_M
    return waited_s >= leg.hold_s or (following.phase is Phase.LANDING and _has_sunk(leg, here, position))


def _has_sunk(leg: Leg, here: Point, position: Position | None) -> bool:
    """Return True if the aircraft descends below the end of a leg."""
    is_below = here.height_m < leg.end.height_m - ARRIVED_M and math.dist(here[:2], leg.end[:2]) < ASTRAY_M
    return is_below and not (position is not None and position.up_ms > -SINKING_MS)


def _is_on_circle(circle: Leg, here: Point, position: Position | None) -> bool:
    """Return True if the aircraft is on its circle: it has reached its edge or centre, and nears it no more."""
    north_m, east_m = circle.end.north_m - here.north_m, circle.end.east_m - here.east_m
    centre_m = math.hypot(north_m, east_m)
    if centre_m > circle.circle_m + ARRIVED_M or abs(here.height_m - circle.end.height_m) > ARRIVED_M:
        return False
    if position is None or centre_m < ARRIVED_M:
        return True
    return not (north_m * position.north_ms + east_m * position.east_ms) / centre_m > NEARING_MS
