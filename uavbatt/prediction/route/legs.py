"""A leg is a straight way at planned speeds, and a wait at its end; one at a time, or many as columns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array

POINTS_OF_TURN = 36  # of a circle on a map


class Phase(IntEnum):
    """A Phase names the part of a flight to which a leg belongs."""

    TAKE_OFF = 0
    ROUTE = 1
    HOME = 2
    LANDING = 3


class Point(NamedTuple):
    """A Point is a place in metres north and east of home, and above it."""

    north_m: float
    east_m: float
    height_m: float


class Leg(NamedTuple):
    """A Leg is a straight way from one point to another with its speed limits, and the wait at its end."""

    seq: int  # number of the mission item; -1 on the way home
    phase: Phase
    begin: Point
    end: Point
    run_m: float  # horizontal length, along the curve if it is one
    speed_ms: float
    climb_ms: float
    descent_ms: float
    hold_s: float = 0.0
    circle_m: float = 0.0  # radius of a circle around `end` from `begin` on; 0 if the leg is straight
    moves_load: bool = False  # a payload may be taken up or set down at its end

    @property
    def rise_m(self) -> float:
        """Return the height gained, negative in a descent [m]."""
        return self.end.height_m - self.begin.height_m

    @property
    def moving_s(self) -> float:
        """Return the time of the movement at the planned speeds [s]."""
        return max(self.run_m / self.speed_ms, self.vertical_s)

    @property
    def vertical_s(self) -> float:
        """Return the time of the height change alone at the planned climb or descent rate [s]."""
        rise_m = self.rise_m
        return rise_m / self.climb_ms if rise_m > 0.0 else -rise_m / self.descent_ms

    @property
    def fastest_ms(self) -> float:
        """Return the speed that has to be gained and lost again: the larger of horizontal and vertical speed [m/s]."""
        moving_s = self.moving_s
        return max(self.run_m, abs(self.rise_m)) / moving_s if moving_s > 0.0 else 0.0


def edge(centre: Point, radius_m: float, seen_from: Point) -> Point:
    """Return the point of a circle that is nearest to a place, at the height of the circle."""
    angle = math.atan2(seen_from.east_m - centre.east_m, seen_from.north_m - centre.north_m)
    return _at_angle(centre, radius_m, angle)


def on_circle(leg: Leg, share: float) -> Point:
    """Return the place on a leg of turns after a share of it; the turns are clockwise, seen from above."""
    begin = math.atan2(leg.begin.east_m - leg.end.east_m, leg.begin.north_m - leg.end.north_m)
    return _at_angle(leg.end, leg.circle_m, begin + share * leg.run_m / leg.circle_m)


def left_at(leg: Leg) -> Point:
    """Return where the aircraft leaves a leg: its end, or the point of its circle where the turns end."""
    return on_circle(leg, 1.0) if leg.circle_m > 0.0 else leg.end


def way_points(legs: Sequence[Leg]) -> list[Point]:
    """Return the points of these legs in order, with which a map draws them; a circle is drawn once and a part."""
    points = [legs[0].begin] if legs else []
    for leg in legs:
        points += _around(leg) if leg.circle_m > 0.0 else [leg.end]
    return points


def _around(circle: Leg) -> list[Point]:
    """Return points on a circle up to the place where its turns end."""
    turns = circle.run_m / (2.0 * math.pi * circle.circle_m)
    drawn = min(turns, 1.0 + turns % 1.0)  # more turns would only be drawn over the first one
    count = max(math.ceil(POINTS_OF_TURN * drawn), 1)
    return [on_circle(circle, drawn / turns * k / count) for k in range(1, count + 1)]


def _at_angle(centre: Point, radius_m: float, angle: float) -> Point:
    """Return the point of a circle at an angle from north, clockwise [rad]."""
    north_m, east_m = radius_m * math.cos(angle), radius_m * math.sin(angle)
    return Point(centre.north_m + north_m, centre.east_m + east_m, centre.height_m)


class LegsTable(NamedTuple):
    """LegsTable holds legs as columns [legs], with the properties of `Leg`."""

    seq: Array
    phase: Array
    north_m: Array  # from begin to end
    east_m: Array
    rise_m: Array
    end: Array  # [legs, 3]
    run_m: Array
    hold_s: Array
    vertical_s: Array
    moving_s: Array
    fastest_ms: Array

    def of(self, which: slice) -> LegsTable:
        """Return only the legs `which`."""
        return LegsTable(*(column[which] for column in self))

    def followed_by(self, later: LegsTable) -> LegsTable:
        """Return these legs and then those of `later`."""
        return LegsTable(*map(np.concatenate, zip(self, later, strict=True)))


def legs_table(legs: Sequence[Leg]) -> LegsTable:
    """Return legs as columns."""
    raw = np.array([(*leg[:2], *leg.begin, *leg.end, *leg[4:9]) for leg in legs], float).reshape(-1, 13)
    moved, end = raw[:, 5:8] - raw[:, 2:5], raw[:, 5:8]
    run_m, speed_ms, climb_ms, descent_ms, hold_s = raw[:, 8:].T
    north_m, east_m, rise_m = moved.T
    vertical_s = np.where(rise_m > 0.0, rise_m / climb_ms, -rise_m / descent_ms)
    moving_s = np.maximum(run_m / speed_ms, vertical_s)
    with np.errstate(invalid="ignore", divide="ignore"):
        fastest_ms = np.where(moving_s > 0.0, np.maximum(run_m, np.abs(rise_m)) / moving_s, 0.0)
    seq, phase = raw[:, :2].T
    return LegsTable(seq, phase, north_m, east_m, rise_m, end, run_m, hold_s, vertical_s, moving_s, fastest_ms)
