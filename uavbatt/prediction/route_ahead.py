"""The way still to be flown, as pieces of time with airspeed and climb: the rest of the route, or the way home.

A piece is a leg's movement or the wait at its end. The times are those of the plan, corrected by what the legs flown so
far have told; the airspeed is that of the movement through the wind.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.navigation import Mode, Navigation, ReturnSettings
from uavbatt.prediction.route_path import ENDLESS_S, Leg, Phase, Point, landing, way_home
from uavbatt.prediction.route_progress import (
    ARRIVED_M,
    OVER_HOME_M,
    SHORT_LEG_S,
    Progress,
    Timing,
    here_at,
    overdue,
)

NAN = math.nan
LEAST_TIMING_SD = 0.02
FARTHEST_HOVER_MS = 2.0  # moving faster than this, a return is past its climb


class Piece(NamedTuple):
    """Some seconds of one kind of flight, and where they end."""

    length_s: float
    airspeed_ms: float
    climb_ms: float
    taking_off: bool
    landing: bool
    seq: int
    end: Point
    length_sd_s: float


class Ahead(NamedTuple):
    """The pieces to come in order; `begin` is where the aircraft is now."""

    begin: Point
    pieces: tuple[Piece, ...]
    lands: bool = True

    @property
    def ends_s(self) -> Array:
        """Return when each piece ends [s] from now."""
        return np.cumsum([piece.length_s for piece in self.pieces])

    @property
    def touchdown_s(self) -> float:
        """Seconds until touchdown; NaN where it waits without end."""
        return sum(piece.length_s for piece in self.pieces) if self.lands else NAN

    @property
    def timing_sd(self) -> float:
        """Relative standard deviation of all these times together."""
        total_s = sum(piece.length_s for piece in self.pieces)
        sd_s = sum(piece.length_sd_s for piece in self.pieces)
        return math.hypot(LEAST_TIMING_SD, sd_s / total_s if total_s > 0.0 else 0.0)

    def point(self, time_s: float) -> Point:
        """Return where the aircraft is after `time_s` [s]."""
        ends_s = np.concatenate([[0.0], self.ends_s])
        places = np.array([self.begin, *(piece.end for piece in self.pieces)])
        return Point(*(float(np.interp(time_s, ends_s, column)) for column in places.T))

    def until(self, time_s: float) -> tuple[Piece, ...]:
        """The pieces of the next `time_s` [s], the last one cut."""
        kept, left_s = [], time_s
        for piece in self.pieces:
            if left_s <= 0.0:
                break
            kept.append(piece._replace(length_s=min(piece.length_s, left_s)))
            left_s -= piece.length_s
        return tuple(kept)


class Way(NamedTuple):
    """The means that turn legs into pieces: the timing of short and long legs, and the velocity of the air [m/s]."""

    short: Timing = Timing()
    long: Timing = Timing()
    wind: tuple[float, float] = (0.0, 0.0)

    def pieces(self, legs: Iterable[Leg]) -> tuple[Piece, ...]:
        """All of them in order."""
        return tuple(piece for leg in legs for piece in self._of(leg) if piece.length_s > 0.0)

    def _of(self, leg: Leg) -> tuple[Piece, Piece]:
        moving_s, sd_s = self.time_s(leg)
        is_landing = leg.phase is Phase.LANDING
        moved = Piece(
            moving_s,
            self._airspeed_ms(leg, moving_s),
            leg.rise_m / moving_s if moving_s > 0.0 else 0.0,
            leg.phase is Phase.TAKE_OFF,
            is_landing,
            leg.seq,
            leg.end,
            sd_s,
        )
        return moved, Piece(leg.hold_s, math.hypot(*self.wind), 0.0, False, is_landing, leg.seq, leg.end, 0.0)

    def time_s(self, leg: Leg) -> tuple[float, float]:
        """Return how long the movement takes, and its sd [s]."""
        planned_s, speed_ms = leg.moving_s, leg.fastest_ms
        if not planned_s > 0.0:
            return 0.0, 0.0
        timing = self.short if planned_s < SHORT_LEG_S else self.long
        stretch, speeding = timing.factors
        moving_s = max(stretch * planned_s + speeding * speed_ms, 0.5 * planned_s)
        return moving_s, timing.sd(planned_s, speed_ms)

    def _airspeed_ms(self, leg: Leg, moving_s: float) -> float:
        """Speed through the air; on a curve the wind comes from everywhere."""
        if not moving_s > 0.0:
            return math.hypot(*self.wind)
        north_m, east_m = leg.end.north_m - leg.begin.north_m, leg.end.east_m - leg.begin.east_m
        if leg.run_m > 1.5 * math.hypot(north_m, east_m):
            return math.hypot(leg.run_m / moving_s, *self.wind)
        return math.hypot(north_m / moving_s - self.wind[0], east_m / moving_s - self.wind[1])


def ahead(progress: Progress, navigation: Navigation, time_s: float) -> Ahead | str:
    """Return what the autopilot will fly from here, or why nobody knows it."""
    if navigation.mode in (Mode.RETURN, Mode.RETURN_BY_TRACK):
        return home_now(progress, navigation, time_s)
    if navigation.mode is not Mode.MISSION:
        return f"the mode is {navigation.mode.value}: the route says nothing"
    if navigation.transferring:
        return "a mission is being transferred"
    if navigation.mission is None:
        return "no mission is known"
    if navigation.home is None:
        return "home is not known"
    if progress.path.reason:
        return progress.path.reason
    if not 0 <= progress.at < len(progress.path.legs):
        return "the autopilot has not said where on its mission it is"
    if late := overdue(progress, time_s, navigation):
        return late
    way = way_of(progress)
    here = here_at(time_s, navigation)
    if here is None and navigation.position is not None:
        return "the position is stale"
    rest = _rest_by_plan(way, progress, time_s) if here is None else _rest_from(way, progress, here, time_s)
    begin = here or progress.path.legs[progress.at].begin
    return Ahead(begin, rest, progress.path.lands and sum(p.length_s for p in rest) < ENDLESS_S)


def way_of(progress: Progress) -> Way:
    """Return how legs will be flown, by those flown so far."""
    return Way(progress.short, progress.long, progress.wind)


def home_now(progress: Progress, navigation: Navigation, time_s: float) -> Ahead | str:
    """Return the way home from where the aircraft is, or why it is not known."""
    if navigation.home is None:
        return "home is not known"
    here = here_at(time_s, navigation)
    if here is None:
        return "the position is not known" if navigation.position is None else "the position is stale"
    if navigation.settings.return_reason:
        return navigation.settings.return_reason
    legs = way_home(here, navigation.settings)
    if navigation.mode in (Mode.RETURN, Mode.RETURN_BY_TRACK):
        legs = _begun(here, navigation)
    return Ahead(here, way_of(progress).pieces(legs))


def _begun(here: Point, navigation: Navigation) -> tuple[Leg, ...]:
    """The rest of a return that is being flown: its climb is behind it when it moves on."""
    position, settings = navigation.position, navigation.settings
    if math.hypot(here.north_m, here.east_m) < OVER_HOME_M:
        return landing(here, settings, -1)
    moves = position is not None and math.hypot(position.north_ms, position.east_ms) > FARTHEST_HOVER_MS
    climbed = replace(settings, return_height_m=0.0) if moves else settings
    return way_home(here, replace(climbed, return_climb_min_m=NAN))


def home_from(way: Way, flown: Ahead, time_s: float, settings: ReturnSettings) -> Ahead:
    """Return the way home after flying on for `time_s` [s], those seconds included."""
    turning = flown.point(time_s)
    return Ahead(flown.begin, (*flown.until(time_s), *way.pieces(way_home(turning, settings))))


def _rest_by_plan(way: Way, progress: Progress, time_s: float) -> tuple[Piece, ...]:
    """The rest of the route where only the autopilot's progress is known: the present leg by the clock."""
    legs = progress.path.legs[progress.at :]
    flown_s = max(time_s - progress.leg_since_s, 0.0)
    rest = []
    for piece in way.pieces(legs[:1]):
        left_s = piece.length_s - flown_s
        flown_s = max(-left_s, 0.0)
        if left_s > 0.0:
            rest.append(piece._replace(length_s=left_s))
    return (*rest, *way.pieces(legs[1:]))


def _rest_from(way: Way, progress: Progress, here: Point, time_s: float) -> tuple[Piece, ...]:
    """The rest of the route from where the aircraft is."""
    legs = progress.path.legs[progress.at :]
    while len(legs) > 1 and legs[1].seq == legs[0].seq and _is_behind(legs[0], here):
        legs = legs[1:]  # an item of several legs, as a landing: the place tells which
    present, later = legs[0], way.pieces(legs[1:])
    if math.isfinite(progress.arrived_s) and present is progress.path.legs[progress.at]:
        waited_s = time_s - progress.arrived_s
        return (*way.pieces([_waiting(present, waited_s)]), *later)
    return (*way.pieces([_shortened(present, here)]), *later)


def _is_behind(leg: Leg, here: Point) -> bool:
    if leg.phase is Phase.LANDING:
        return here.height_m <= leg.end.height_m + 0.5
    return math.dist(here, leg.end) < ARRIVED_M and not leg.hold_s > 0.0


def _waiting(leg: Leg, waited_s: float) -> Leg:
    """Return what is left of the wait at a leg's end."""
    return leg._replace(begin=leg.end, run_m=0.0, hold_s=max(leg.hold_s - waited_s, 0.0))


def _shortened(leg: Leg, here: Point) -> Leg:
    """The leg from here on; a curve keeps its length until it is flown."""
    straight_m = math.dist(leg.begin[:2], leg.end[:2])
    if leg.run_m > 1.5 * straight_m:
        return leg
    return leg._replace(begin=here, run_m=math.dist(here[:2], leg.end[:2]) * max(leg.run_m / max(straight_m, 1.0), 1.0))
