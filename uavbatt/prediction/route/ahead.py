"""The way still to be flown, as pieces with time, airspeed and climb: the rest of the route, or the way home.

A piece is the movement of a leg or the wait at its end. Its time is planned, corrected by the legs flown so far; its
airspeed is that of the movement through the wind.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.navigation import FARTHEST_HOME_M, Mode, Navigation, ReturnSettings
from uavbatt.prediction.route.legs import Leg, Phase, Point, legs_table
from uavbatt.prediction.route.path import ENDLESS_S, returned
from uavbatt.prediction.route.pieces import LegTiming, Pieces, joined
from uavbatt.prediction.route.progress import Progress, here_at, is_over_home, overdue
from uavbatt.prediction.route.track import WayBack, way_back
from uavbatt.prediction.route.way_home import RETURN_SPEEDS_MS, landing, possible_returns, return_reason, way_home
from uavbatt.records import NAN

STRAIGHT = 0.9  # share of the speed towards home: within 26 degrees of the way home
LEAST_TIMING_SD = 0.02
FARTHEST_HOVER_MS = 2.0  # a return that moves faster has finished its climb
LEAST_SINKING_MS = 0.2
HomeFrom = Callable[[Point], tuple[Leg, ...]]
RETURNS = (Mode.RETURN, Mode.RETURN_BY_TRACK)


class Ahead(NamedTuple):
    """Ahead holds the pieces to come in order; `begin` is where the aircraft is now."""

    begin: Point
    pieces: Pieces
    lands: bool = True

    @property
    def touchdown_s(self) -> float:
        """Return the seconds until touchdown; NaN where the aircraft waits without end."""
        return float(self.pieces.length_s.sum()) if self.lands else NAN

    @property
    def timing_sd(self) -> float:
        """Return the relative standard deviation of the time of all pieces together."""
        total_s, sd_s = float(self.pieces.length_s.sum()), float(self.pieces.length_sd_s.sum())
        return math.hypot(LEAST_TIMING_SD, sd_s / total_s if total_s > 0.0 else 0.0)

    def points(self, times_s: Array) -> list[Point]:
        """Return where the aircraft is after each of `times_s` [s]."""
        ends_s = np.concatenate([[0.0], self.pieces.ends_s])
        places = np.concatenate([[self.begin], self.pieces.end])
        columns = (np.interp(times_s, ends_s, column).tolist() for column in places.T)
        return [Point(*place) for place in zip(*columns, strict=True)]


def ahead(progress: Progress, navigation: Navigation, time_s: float) -> Ahead | str:
    """Return the way that the autopilot will fly from here, or the reason why it is not known."""
    if navigation.mode in RETURNS:
        return _return_now(progress, navigation, time_s)
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
    if not progress.is_on_path:
        return "the autopilot has not said where on its mission it is"
    if late := overdue(progress, time_s, navigation):
        return late
    way = way_of(progress)
    here = here_at(time_s, navigation)
    if here is None and navigation.position is not None:
        return "the position is stale"
    rest = _rest_by_plan(way, progress, time_s) if here is None else _rest_from(way, progress, here, time_s)
    begin = here or progress.path.legs[progress.at].begin
    return Ahead(begin, rest, progress.path.lands and float(rest.length_s.sum()) < ENDLESS_S)


def is_returning(progress: Progress, navigation: Navigation) -> bool:
    """Return True if the aircraft flies home or lands already, by its mode or by the item of its mission."""
    if navigation.mode is Mode.MISSION and progress.is_on_path:
        if progress.leg.phase is Phase.LANDING:
            return all(leg.phase is not Phase.TAKE_OFF for leg in progress.path.legs[progress.at :])
        return progress.leg.phase is Phase.HOME
    return navigation.mode in (*RETURNS, Mode.LAND)


def way_of(progress: Progress) -> LegTiming:
    """Return timing, wind and way of climbing for the legs to come, as learned from the legs flown so far."""
    known = progress.lessons
    return LegTiming(known.short, known.long, known.wind, known.climbs_first, known.wind_sd_ms)


def why_no_home(progress: Progress, navigation: Navigation, time_s: float) -> str:
    """Return why the way home from here is not known; empty if it is known."""
    if navigation.home is None:
        return "home is not known"
    here = here_at(time_s, navigation)
    if here is None:
        return "the position is not known" if navigation.position is None else "the position is stale"
    if (distance_m := math.hypot(here.north_m, here.east_m)) > FARTHEST_HOME_M:
        return f"home lies {distance_m / 1000.0:.0f} km away"
    if navigation.mode is not Mode.RETURN_BY_TRACK:
        return return_reason(navigation.mission, navigation.settings)
    if _track_home(progress, navigation) is None and not _heads_home(here, navigation):
        return "the aircraft returns along its own track, which is not known from take-off on"
    return ""


def home_now(progress: Progress, navigation: Navigation, time_s: float) -> Ahead | str:
    """Return the way home from where the aircraft is, or the reason why it is not known."""
    here, reason = here_at(time_s, navigation), why_no_home(progress, navigation, time_s)
    if here is None or reason:
        return reason
    legs = legs_table(_legs_home(here, progress, navigation))
    return Ahead(here, way_of(progress).pieces(legs, is_flying=navigation.mode in RETURNS))


def _return_now(progress: Progress, navigation: Navigation, time_s: float) -> Ahead | str:
    """Return the rest of the present return to home; one that ends in the air has no touchdown."""
    home = home_now(progress, navigation, time_s)
    if isinstance(home, str) or not navigation.settings.return_final_m > 0.0:
        return home
    flown = returned(list(_legs_home(home.begin, progress, navigation)), navigation.settings)
    pieces = way_of(progress).pieces(flown.table, is_flying=True)
    return Ahead(home.begin, pieces, flown.lands) if flown.legs else home


def homes_from(progress: Progress, navigation: Navigation) -> tuple[HomeFrom, ...]:
    """Return functions that give the legs home from any place at which the aircraft turns: of each possible way.

    There are several if no return has begun, and the vehicle has not stated its height or speed.
    """
    if navigation.mode not in RETURNS:
        return ways_home(navigation.settings)
    back = _track_home(progress, navigation)
    if back is not None:
        return (partial(back.legs, settings=navigation.settings),)
    return (partial(way_home, settings=_of_present_return(navigation)),)


def ways_home(settings: ReturnSettings) -> tuple[HomeFrom, ...]:
    """Return the straight ways home of all returns that are possible."""
    return tuple(partial(way_home, settings=possible) for possible in possible_returns(settings))


def _legs_home(here: Point, progress: Progress, navigation: Navigation) -> tuple[Leg, ...]:
    """Return the legs home from here; a straight return has begun already if the mode says so."""
    if navigation.mode not in RETURNS:
        return way_home(here, navigation.settings)
    back = _track_home(progress, navigation)
    return _begun(here, navigation) if back is None else back.legs(here, navigation.settings)


def _track_home(progress: Progress, navigation: Navigation) -> WayBack | None:
    """Return the way back along the own track in a return that follows it; None elsewhere, and if it is not known."""
    return way_back(progress.track.places) if navigation.mode is Mode.RETURN_BY_TRACK else None


def _heads_home(here: Point, navigation: Navigation) -> bool:
    """Return True if the aircraft flies straight towards home, or is there: the rest of its track is then a line."""
    distance_m, position = math.hypot(here.north_m, here.east_m), navigation.position
    if position is None or is_over_home(navigation):
        return True
    speed_ms = math.hypot(position.north_ms, position.east_ms)
    homeward_ms = -(position.north_ms * here.north_m + position.east_ms * here.east_m) / distance_m
    return speed_ms > FARTHEST_HOVER_MS and homeward_ms > STRAIGHT * speed_ms


def _begun(here: Point, navigation: Navigation) -> tuple[Leg, ...]:
    """Return the rest of the present return; its climb is over once the aircraft nears home, or is over home.

    Over home it waits until it descends; when this wait began is not known.
    """
    position = navigation.position
    if is_over_home(navigation) and (position is None or not position.up_ms > -LEAST_SINKING_MS):
        return landing(here, navigation.settings, -1)
    return way_home(here, _of_present_return(navigation))


def _of_present_return(navigation: Navigation) -> ReturnSettings:
    """Return the settings of a return that has begun, for what is left of it: once it moves, its climb is over."""
    position, settings = navigation.position, replace(navigation.settings, return_climb_min_m=NAN)
    speed_ms = math.hypot(position.north_ms, position.east_ms) if position is not None else 0.0
    if speed_ms > FARTHEST_HOVER_MS:
        return replace(_with_speed(settings, speed_ms), return_height_m=0.0)
    return replace(settings, return_height_m=0.0) if is_over_home(navigation) else settings


def _with_speed(settings: ReturnSettings, speed_ms: float) -> ReturnSettings:
    """Return the settings with the speed of the present return, which is seen [m/s], if the vehicle states none."""
    if math.isfinite(settings.return_ms) or math.isfinite(settings.cruise_ms):
        return settings
    return replace(settings, return_ms=max(speed_ms, RETURN_SPEEDS_MS[0]))  # it may only begin to move


def _rest_by_plan(way: LegTiming, progress: Progress, time_s: float) -> Pieces:
    """Return the rest of the route by the clock, for an aircraft whose position is not known."""
    table, item = progress.path.table, progress.item
    present = way.pieces(table.of(item))
    flown_s = max(time_s - progress.leg_since_s, 0.0)
    left_s = np.minimum(present.length_s, present.ends_s - flown_s)
    rest = present._replace(length_s=left_s).of(left_s > 0.0)
    return joined(rest, way.pieces(table.of(slice(item.stop, None))))


def _rest_from(way: LegTiming, progress: Progress, here: Point, time_s: float) -> Pieces:
    """Return the rest of the route from the position of the aircraft."""
    later = progress.path.table.of(slice(progress.at + progress.behind + 1, None))
    return way.pieces(legs_table([_present(progress, here, time_s)]).followed_by(later), is_flying=True)


def _present(progress: Progress, here: Point, time_s: float) -> Leg:
    """Return what is left of the leg that is flown."""
    leg = progress.leg
    if leg.circle_m > 0.0:  # the position does not tell how many turns are left
        flown = (time_s - progress.behind_s) / progress.lessons.expected_s(leg)
        return leg._replace(run_m=leg.run_m * min(max(1.0 - flown, 0.0), 1.0))
    if math.isfinite(progress.arrived_s):
        return _waiting(leg, time_s - progress.arrived_s)
    return _shortened(leg, here)


def _waiting(leg: Leg, waited_s: float) -> Leg:
    """Return what is left of the wait at a leg's end."""
    return leg._replace(begin=leg.end, run_m=0.0, hold_s=max(leg.hold_s - waited_s, 0.0))


def _shortened(leg: Leg, here: Point) -> Leg:
    """Return the leg from here on."""
    straight_m = math.dist(leg.begin[:2], leg.end[:2])
    return leg._replace(begin=here, run_m=math.dist(here[:2], leg.end[:2]) * max(leg.run_m / max(straight_m, 1.0), 1.0))
