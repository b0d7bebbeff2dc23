"""The part of a forecast about a route: the end of the route, the way home, the turn-back."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.battery.powers import UNKNOWN, Powers
from uavbatt.navigation import UNSTATED, Mode, Navigation
from uavbatt.prediction.load.library import LearnedLoad, UnknownAircraft
from uavbatt.prediction.load.scenarios import ConstantLoad, Load, LoggedLoad, RecentMean
from uavbatt.prediction.route.ahead import Ahead, HomeFrom, ahead, home_now, is_returning, why_no_home
from uavbatt.prediction.route.load import SCENARIOS, RouteLoad, factors
from uavbatt.prediction.route.path import ENDLESS_S
from uavbatt.prediction.route.pieces import LegTiming, waiting
from uavbatt.prediction.route.progress import Progress
from uavbatt.prediction.route.turn_back import Turning, fly_home, turn_back_times, turn_instants
from uavbatt.prediction.route.way_home import return_assumed
from uavbatt.prediction.simulation import sampling
from uavbatt.prediction.simulation.draws import Flying
from uavbatt.prediction.simulation.long_steps import charge_at, edges_through, fly_draws
from uavbatt.records import IN_TIME, Route

NAMES = {
    LearnedLoad: "learned",
    UnknownAircraft: "unknown",
    RecentMean: "recent",
    LoggedLoad: "log",
    ConstantLoad: "stated",
}
HORIZON_SHARE = 1.3  # of the time at the typical power; no draw turns back later
# Route and way home cost as much work as the end itself. They are worked out anew after this share of the time at the
# typical power, but not within 4 s and at least every 10 s; in between the last answer counts down.
WAYS_SHARE, SHORTEST_WAYS_S, LONGEST_WAYS_S = 1.0 / 150.0, 3.9, 9.9
HOME_OF_MISSION = "home assumed where the autopilot's mission has it: the vehicle has not told its home"
STILL_AIR = "still air assumed: the vehicle has not told its wind"
UNTOLD_POWER = "nothing has been flown yet that tells the power of this aircraft"


class ToCome(NamedTuple):
    """ToCome holds the expected load, by the route if it is known, and what is known of route and way home."""

    load: Load
    name: str
    reason: str  # why the route is not used
    route: Ahead | None
    home_reason: str  # why the way home is not known; empty if it is known
    is_returning: bool = False
    assumed: str = ""  # what the mission does not say


class RouteQuestion(NamedTuple):
    """RouteQuestion holds the route and the way home of one forecast, before its samples are simulated."""

    load: str
    reason: str
    route_s: Array | None  # touchdown of each draw
    route_soc: Array | None
    turning: Turning | None  # None if the way home is not known
    is_returning: bool = False
    assumed: str = ""


class WaysState(NamedTuple):
    """WaysState holds the time at which route and way home were last worked out [s], and what was known then."""

    time_s: float = math.nan
    about: tuple[object, ...] = ()

    def is_due(self, now: WaysState, typical_s: float) -> bool:
        """Return True if it is time to ask again, `typical_s` [s] before the end; at once if something new is known."""
        period_s = min(max(WAYS_SHARE * typical_s, SHORTEST_WAYS_S), LONGEST_WAYS_S)
        return now.about != self.about or not 0.0 <= now.time_s - self.time_s < period_s


def powers_of(load: Load) -> Powers:
    """Return the powers of a load: its vehicle's, else those of an unknown aircraft."""
    return load.powers if isinstance(load, LearnedLoad | UnknownAircraft) else UNKNOWN


def with_usual(navigation: Navigation, load: Load, progress: Progress) -> Navigation:
    """Return the navigation with the speeds of the vehicle file, or seen in flight, where the vehicle states none."""
    usual = load.usual if isinstance(load, LearnedLoad) else UNSTATED
    if progress.seen_ms > 0.0:
        usual = replace(usual, seen_ms=progress.seen_ms)
    return navigation if usual is UNSTATED else navigation.with_usual(usual)


def to_come(load: Load, progress: Progress, navigation: Navigation, time_s: float) -> ToCome:
    """Return the load to come: the route's, if the route is known and the user has not stated another load."""
    returning = is_returning(progress, navigation)
    name, powers, known = NAMES.get(type(load), "learned"), powers_of(load), progress.lessons
    level, level_sd = known.power.level(powers)
    route: Ahead | str = ahead(progress, navigation, time_s)
    home_reason = why_no_home(progress, navigation, time_s)
    if not math.isfinite(level):
        route = route if isinstance(route, str) else UNTOLD_POWER
        home_reason = home_reason or UNTOLD_POWER
    assumed = [
        HOME_OF_MISSION if navigation.home is not None and navigation.home.is_of_mission else "",
        "" if returning else return_assumed(navigation.settings),
        "" if known.is_wind_told else STILL_AIR,
    ]
    if isinstance(route, str):
        return ToCome(load, name, route, None, home_reason, returning, "" if home_reason else _joined(assumed))
    if isinstance(load, LearnedLoad | UnknownAircraft):
        load, name = RouteLoad(route, powers, level, level_sd, known.excess_beyond(powers)), "route"
    lands = progress.path.assumed if navigation.mode is Mode.MISSION else ""
    return ToCome(load, name, "", route, home_reason, returning, _joined([lands, *assumed]))


def homewards(load: Load, progress: Progress, navigation: Navigation, time_s: float) -> RouteLoad | None:
    """Return the way home from here with powers and level of the aircraft; None if one of them is not known."""
    powers = powers_of(load)
    level, level_sd = progress.lessons.power.level(powers)
    home = home_now(progress, navigation, time_s)
    if not isinstance(home, Ahead) or not math.isfinite(level):
        return None
    return RouteLoad(home, powers, level, level_sd, progress.lessons.excess_beyond(powers))


def ways_state(known: ToCome, navigation: Navigation, time_s: float) -> WaysState:
    """Return what is known of route and way home at a time [s]."""
    told = (known.name, known.reason, known.home_reason, known.is_returning)
    return WaysState(time_s, (*told, navigation.mode, navigation.mission, navigation.home))


def fly_ways(
    known: ToCome,
    home: RouteLoad | None,
    flying: Flying,
    scenario: Array,
    way: LegTiming,
    homes_from: Sequence[HomeFrom],
    typical_s: float,
) -> RouteQuestion:
    """Return the time and charge at the route's touchdown, and the draws at the instants at which they may turn home.

    The draws are simulated once, through all instants of turning, up to the last touchdown. `home` is the way home from
    here; None if it is not known. `scenario` is which scenario of the load each draw flies [draws]. The draws fly the
    possible ways home in turn.
    """
    asked = RouteQuestion(known.name, _reason(known), None, None, None, known.is_returning, known.assumed)
    scenario = scenario % SCENARIOS  # another load has other scenarios: the numbers only spread the draws
    turn_at_s, last_s = np.zeros(1), np.zeros(1)
    if known.route is not None and known.route.lands:
        stretch = factors(RouteLoad(known.route, UNKNOWN, 1.0, 0.0))[2][scenario]
        asked = asked._replace(route_s=known.route.touchdown_s * stretch)
        last_s = np.minimum(np.max(known.route.touchdown_s * stretch, keepdims=True), flying.dt_s.sum())
    if home is not None:
        here = home.ahead.begin  # without a route the aircraft is assumed to stay where it is
        flown = known.route or Ahead(here, waiting(here, ENDLESS_S), lands=False)
        turn_at_s = turn_instants(min(HORIZON_SHARE * typical_s, flown.touchdown_s if flown.lands else math.inf))
    if asked.route_s is None and home is None:
        return asked
    edges_s = edges_through(np.unique(np.concatenate([turn_at_s, last_s])))
    passed = fly_draws(flying, edges_s)
    if asked.route_s is not None:
        asked = asked._replace(route_soc=charge_at(passed, edges_s, asked.route_s))
    if home is not None:
        at_turn = passed.of(np.searchsorted(edges_s, turn_at_s))
        least_soc = sampling.least_soc(flying)
        turning = Turning(at_turn, turn_at_s, flown, home, scenario, way, homes_from, least_soc)
        asked = asked._replace(turning=turning)
    return asked


def _reason(known: ToCome) -> str:
    return _joined([known.reason, known.home_reason])


def _joined(words: list[str]) -> str:
    return "; ".join(dict.fromkeys(filter(None, words)))


def route_answer(asked: RouteQuestion, end_s: Array) -> Route:
    """Return what a forecast says of route, way home and turn-back, by the simulated ends of the flight [draws]."""
    said = Route(asked.load, reason=asked.reason, is_returning=asked.is_returning, assumed=asked.assumed)
    if asked.route_s is not None and asked.route_soc is not None:
        lo, middle, hi = map(float, np.quantile(asked.route_soc, (0.05, 0.5, 0.95)))
        risk, left_s = float(np.mean(end_s < asked.route_s)), float(np.median(asked.route_s))
        said = replace(said, left_s=left_s, soc=middle, soc_lo=lo, soc_hi=hi, risk=risk)
    if asked.turning is None:
        return said
    is_in_time = said.risk <= IN_TIME  # then the later instants, most of the work, are not needed
    turn = fly_home(asked.turning.now if is_in_time else asked.turning)
    home_soc_lo, home_soc = map(float, np.quantile(turn.home_soc, (0.05, 0.5)))
    said = replace(said, home_soc=home_soc, home_soc_lo=home_soc_lo)
    if is_in_time:
        return replace(said, reason=said.reason or "the route comes home in time")
    lo_s, middle_s, hi_s = map(float, np.quantile(turn_back_times(turn, end_s), (0.05, 0.5, 0.95)))
    return replace(said, turn_back_s=middle_s, turn_back_lo_s=lo_s, turn_back_hi_s=hi_s)
