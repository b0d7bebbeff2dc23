"""The track flown since take-off, and the way home back along it, as ArduPilot's SMART_RTL returns.

The autopilot keeps places at least 2 m apart from arming on, leaves out those on a straight line and those of loops (it
shortens where the track comes within 2 m of itself), and flies the rest back at the speed of the route, to 2 m above
the place where it armed. While it returns it keeps no places. Source: AP_SmartRTL of ArduPilot.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.model import Array
from uavbatt.navigation import Home, ReturnSettings
from uavbatt.prediction.route.legs import Leg, Phase, Point
from uavbatt.prediction.route.pieces import Column, keeps_speed
from uavbatt.prediction.route.way_home import landing, speeds_of

APART_M = 2.0  # SRTL_ACCURACY
STRAIGHT_M = 1.0  # places so near a straight line are left out
STEEPER_RAD = 0.1  # change of the climb angle within one leg
MOST_PLACES, MOST_CORNERS = 1000, 300  # SRTL_POINTS: with more corners the autopilot has given up
ON_GROUND_M = 1.0
LONGEST_GAP_S, FARTHEST_GAP_M = 10.0, 20.0  # places that are missing for longer, and farther apart, end the track
FARTHEST_STEP_M = 1000.0  # a position farther from the last one is none
BEGINS_AT_HOME_M = 15.0
ABOVE_START_M = 2.0


class Track(NamedTuple):
    """Track holds the places flown since take-off [m], the last at `time_s`; it is a value, replaced by `after`."""

    places: tuple[Point, ...] = ()
    time_s: float = math.nan
    home: Home | None = None  # around which the places are told
    is_back: bool = False  # the aircraft flies back along it: no places are kept

    def after(self, time_s: float, here: Point, home: Home, is_back: bool) -> Track:
        """Return the track with one more place at `time_s` [s]; `is_back` while the aircraft returns along it."""
        if here.height_m < ON_GROUND_M or home != self.home or self._is_broken(time_s, here):
            return Track((here,), time_s, home)
        if is_back:
            return self._replace(time_s=time_s, is_back=True)
        if math.dist(here, self.places[-1]) < APART_M:
            return self._replace(time_s=time_s, is_back=False)
        return Track((*self._before(here), here), time_s, home)

    def _is_broken(self, time_s: float, here: Point) -> bool:
        """Return True if it is not known how the aircraft came here: after a silence, or a jump of its position."""
        if self.is_back or not self.places:
            return not self.places
        farthest_m = FARTHEST_GAP_M if time_s - self.time_s > LONGEST_GAP_S else FARTHEST_STEP_M
        return math.dist(here, self.places[-1]) > farthest_m

    def _before(self, here: Point) -> tuple[Point, ...]:
        """Return the places before the next one; none if they are too many even without loops and straight parts."""
        if self.is_back:  # what was flown back is gone
            return self.places[: _part_at(np.array(self.places), here) + 1]
        if len(self.places) < MOST_PLACES:
            return self.places
        corners = _corners(np.array(self.places))
        if len(corners) > MOST_CORNERS:
            corners = _corners(_without_loops(_dense(self.places)))
        return _points(corners) if len(corners) <= MOST_CORNERS else ()


class WayBack(NamedTuple):
    """WayBack holds the corners of the track without its loops, from take-off on [corners, 3]."""

    corners: Array

    def legs(self, here: Point, settings: ReturnSettings) -> tuple[Leg, ...]:
        """Return the legs from a place on the track, or near it, back to touchdown at its beginning."""
        corners = np.vstack([here, self.corners[_part_at(self.corners, here) :: -1]])
        corners[-1, 2] = min(ABOVE_START_M, here.height_m)
        parts, points = np.diff(corners, axis=0), _points(corners)
        ends = np.flatnonzero(~_is_through(parts)) + 1
        flown = [
            Leg(-1, Phase.HOME, points[k], points[n], float(np.hypot(*parts[k:n, :2].T).sum()), *speeds_of(settings))
            for k, n in pairwise((0, *ends, len(parts)))
        ]
        return tuple(leg for leg in (*flown, *landing(points[-1], settings, -1)) if leg.moving_s > 0.0)


@lru_cache(maxsize=2)
def way_back(places: tuple[Point, ...]) -> WayBack | None:
    """Return the way back along a track; None if the track does not begin at home, so that its beginning is unknown."""
    if not places or math.hypot(*places[0][:2]) > BEGINS_AT_HOME_M:
        return None
    return WayBack(_corners(_without_loops(_dense(places))))


def _points(places: Array) -> tuple[Point, ...]:
    return tuple(Point(*place) for place in places.tolist())


def _dense(places: tuple[Point, ...]) -> Array:
    """Return places on the track at most APART_M apart [places, 3]."""
    corners = np.array(places)
    along_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at_m = np.linspace(0.0, along_m[-1], math.ceil(along_m[-1] / APART_M) + 1)
    return np.stack([np.interp(at_m, along_m, column) for column in corners.T], axis=1)


def _without_loops(dense: Array) -> Array:
    """Return the places of a track that goes on, from each place, at its last pass within APART_M."""
    last_pass, kept = _last_passes(dense).tolist(), [0]
    while kept[-1] < len(dense) - 1:
        kept.append(max(kept[-1] + 1, last_pass[kept[-1]]))
    return dense[kept]


def _last_passes(dense: Array) -> NDArray[np.int64]:
    """Return for each place the last one within APART_M, of the last places in the 27 cells of that size around it.

    A track of an hour has ten thousand places: all their distances from each other took seconds.
    """
    cells = np.floor(dense / APART_M).astype(np.int64)
    cells -= cells.min(axis=0) - 1
    size = cells.max(axis=0) + 2
    key = np.ravel_multi_index(tuple(cells.T), tuple(size))
    order = np.argsort(key, kind="stable")
    last = np.arange(len(dense))
    for shift in product((-1, 0, 1), repeat=3):
        there = np.ravel_multi_index(tuple((cells + shift).T), tuple(size))
        found = order[np.searchsorted(key, there, side="right", sorter=order) - 1]  # the last place in that cell
        is_near = (key[found] == there) & (np.linalg.norm(dense[found] - dense, axis=1) <= APART_M)
        last = np.where(is_near, np.maximum(last, found), last)
    return last


def _corners(places: Array) -> Array:
    """Return the corners of a track [places, 3]: no place lies far from the lines between them (Douglas-Peucker)."""
    kept, open_parts = {0, len(places) - 1}, [(0, len(places) - 1)]
    while open_parts:
        first, last = open_parts.pop()
        if last - first < 2:
            continue
        off_m = _off_line_m(places[first + 1 : last], places[first], places[last])
        farthest = int(np.argmax(off_m))
        if off_m[farthest] > STRAIGHT_M:
            middle = first + 1 + farthest
            kept.add(middle)
            open_parts += [(first, middle), (middle, last)]
    return places[sorted(kept)]


def _is_through(parts: Array) -> Column:
    """Return True for each corner between the parts of a track [parts, 3] that is flown through, as on a curve."""
    north_m, east_m, up_m = parts.T
    steeper_rad = np.abs(np.diff(np.arctan2(up_m, np.hypot(north_m, east_m))))
    return np.asarray(keeps_speed(north_m, east_m) & (steeper_rad < STEEPER_RAD))


def _part_at(corners: Array, here: Point) -> int:
    """Return the index of the part of a line through corners [corners, 3] that is nearest to a place."""
    return int(np.argmin(_off_line_m(np.array(here), corners[:-1], corners[1:]))) if len(corners) > 1 else 0


def _off_line_m(places: Array, begin: Array, end: Array) -> Array:
    """Return the distance [m] of each place from its straight part of a track; either may be one or many [..., 3]."""
    along, from_begin = end - begin, places - begin
    share = np.clip((from_begin * along).sum(axis=-1) / np.maximum((along**2).sum(axis=-1), 1e-9), 0.0, 1.0)
    return np.asarray(np.linalg.norm(from_begin - share[..., None] * along, axis=-1))
