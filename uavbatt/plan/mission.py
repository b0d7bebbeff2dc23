"""Does the mission fit? The charge at each leg's end and at touchdown, before take-off, over ambient temperature.

The same load and the same draws as in flight: the legs at their planned speeds, the vehicle's `[powers]` with their
spreads, the battery file's spreads for a rested pack.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.model import Array
from uavbatt.battery.pack import most_energy_Wh
from uavbatt.battery.powers import Powers
from uavbatt.battery.remembered import with_reaction
from uavbatt.battery.scaling import Pack
from uavbatt.battery.sizing.pack_size import PackSize, sized
from uavbatt.battery.state_space import Belief
from uavbatt.errors import UsageError
from uavbatt.navigation import Home, Mission, ReturnSettings, Wind
from uavbatt.plan.endurance import TABLE_C, TakeOff, range_remark, rested, unseen_temperature_sd
from uavbatt.plan.words import leg_words
from uavbatt.prediction.batch import end_times
from uavbatt.prediction.route import forecast as route_forecast
from uavbatt.prediction.route.ahead import Ahead, ways_home
from uavbatt.prediction.route.forecast import ToCome
from uavbatt.prediction.route.legs import Point, left_at, legs_table
from uavbatt.prediction.route.load import RouteLoad
from uavbatt.prediction.route.path import Path, path
from uavbatt.prediction.route.pieces import Column, LegTiming
from uavbatt.prediction.route.way_home import return_assumed, return_reason, way_home
from uavbatt.prediction.simulation import sampling
from uavbatt.prediction.simulation.draws import Flying
from uavbatt.prediction.simulation.long_steps import edges_through, fly_draws
from uavbatt.records import IN_TIME, Route

STEPS = 400  # half of them until touchdown
BEYOND = 1.5  # longest hovers of a full pack: how long the hover at home is looked at
MOST_HOVERS = 2.0  # a longer route is not simulated: it does not fit
LEVELS = (0.05, 0.5, 0.95)
NOT_REACHED = 0.5  # no charge is shown where more of the draws have ended before
MOST_DECIMALS = 3  # of a risk in percent
FASTEST_USUAL_MS = 22.0  # through the air; small multirotors end at 15 to 25 m/s


@dataclass(frozen=True)
class PlannedMission:
    """PlannedMission holds a mission, its home, the speeds, the power law of the aircraft, and the wind."""

    mission: Mission
    home: Home
    settings: ReturnSettings
    powers: Powers
    wind: Wind

    @cached_property
    def path(self) -> Path:
        """Return its legs from take-off to touchdown."""
        return path(self.mission, self.home, self.settings)

    def ahead(self) -> tuple[Ahead, LegTiming, Column]:
        """Return its pieces, how they were made, and the index of the leg of each.

        Raises UsageError when it is not understood or has no end.
        """
        found = self.path
        if found.reason or not found.lands:
            raise UsageError(
                f"{self.mission.source}: {found.reason or 'it loiters without end, and its landing time is not known'}"
            )
        way = LegTiming(wind=(self.wind.north_ms, self.wind.east_ms))
        pieces, leg_of = way.pieces_with_leg(found.table)
        flown = Ahead(Point(0.0, 0.0, 0.0), pieces)
        if not flown.touchdown_s > 0.0:
            raise UsageError(f"{self.mission.source}: the mission flies nowhere: expected a take-off or a waypoint")
        return flown, way, leg_of


@dataclass(frozen=True, slots=True)
class LegEnd:
    """LegEnd tells where and when [s from take-off] a leg ends, and the charge then; NaN if most flights end before."""

    item: int  # -1 on the way home
    what: str  # what is flown, in words
    end_s: float
    place: Point
    soc: float
    soc_lo: float
    soc_hi: float


@dataclass(frozen=True, slots=True)
class RouteFit:
    """RouteFit tells whether the mission fits at one ambient temperature; `spare_s` [s] is the hover left then.

    The charge at touchdown is NaN where most flights end before it.
    """

    ambient_C: float
    route: Route
    spare_s: float
    spare_lo_s: float
    spare_hi_s: float
    remark: str = ""

    @property
    def fits(self) -> bool:
        """Return True if the end of flight comes after touchdown with 95 % probability."""
        return self.route.risk <= IN_TIME

    @property
    def risk_text(self) -> str:
        """Return the risk in percent, with decimals only if a whole number hides on which side of IN_TIME it is."""
        texts = [f"{self.route.risk:.{decimals}%}" for decimals in range(MOST_DECIMALS + 1)]
        return next((text for text in texts if (float(text[:-1]) <= 100.0 * IN_TIME) is self.fits), texts[-1])

    @property
    def no_way_home(self) -> str:
        """Return a warning if no turn, however early, leads home with 95 % on this battery; empty otherwise."""
        is_hopeless = self.route.must_turn_back_now
        return "However early it turns, it is not home with 95 %: do not take off" if is_hopeless else ""


@dataclass(frozen=True, slots=True)
class MissionPlan:
    """MissionPlan holds the pack, the mission, and the result at the planned temperature and at others."""

    resolved: PackSize
    planned: PlannedMission
    start_soc: float
    here: RouteFit
    legs: tuple[LegEnd, ...]
    turning: Point | None  # where the latest safe turn-back is
    rows: tuple[RouteFit, ...]
    warnings: tuple[str, ...]


def make_route_plan(
    battery: BatteryFile, resolved: PackSize, planned: PlannedMission, take_off: TakeOff
) -> MissionPlan:
    """Return the plan of a mission. Raises UsageError for one that is not understood or has no end."""
    ambient_C, start_soc, reserve_soc, remembered = take_off
    ahead, way, leg_of = planned.ahead()
    pack = with_reaction(sized(battery, resolved), remembered)

    def fit(at_C: float) -> tuple[RouteFit, Flying, Array]:
        belief = rested(pack, start_soc, at_C, remembered, unseen_temperature_sd(battery, at_C))
        return _fit(battery, pack, planned, (ahead, way), belief, reserve_soc)

    here, flying, end_s = fit(ambient_C)
    rows = tuple(fit(at_C)[0] for at_C in TABLE_C)
    turn_s = here.route.turn_back_lo_s
    remarks = (
        resolved.uncertified, _powers_remark(planned.powers), _speeds_remark(planned),
        return_assumed(planned.settings), _air_remark(ahead), _home_remark(planned), planned.path.assumed,
    )  # fmt: skip
    warnings = (*filter(None, remarks), *resolved.notices)
    turning = ahead.points(np.array([turn_s]))[0] if math.isfinite(turn_s) else None
    # The legs end at the planned times; touchdown counts early and late ones.
    legs = _leg_ends(planned.path, ahead, leg_of, flying, end_s)
    touchdown = replace(legs[-1], soc=here.route.soc, soc_lo=here.route.soc_lo, soc_hi=here.route.soc_hi)
    return MissionPlan(resolved, planned, start_soc, here, (*legs[:-1], touchdown), turning, rows, warnings)


def _fit(
    battery: BatteryFile,
    pack: Pack,
    planned: PlannedMission,
    flown: tuple[Ahead, LegTiming],
    belief: Belief,
    reserve_soc: float,
) -> tuple[RouteFit, Flying, Array]:
    """Return the mission at one temperature, the samples of its simulation, and when each of them ends [s]."""
    (ahead, way), ambient_C = flown, belief.ambient_C
    load = RouteLoad(ahead, planned.powers, 1.0, planned.powers.level_sd)
    longest_s = _longest_hover_s(pack, planned.powers)
    looked_s = min(ahead.touchdown_s, MOST_HOVERS * longest_s)
    dt_s = np.repeat([looked_s, BEYOND * longest_s], STEPS // 2) / (STEPS // 2)
    scenarios = load.scenarios_over(dt_s)
    scenario = sampling.assigned(scenarios.weight)
    x, power_W = sampling.samples(belief), scenarios.power_W[:, scenario]
    flying = Flying(pack, x, power_W, ambient_C, dt_s, reserve_soc)
    elsewhere = return_reason(planned.mission, planned.settings)
    here = legs_table(way_home(ahead.begin, planned.settings))
    home = RouteLoad(Ahead(ahead.begin, way.pieces(here)), planned.powers, 1.0, load.level_sd)
    known, homes_from = ToCome(load, "route", "", ahead, elsewhere), ways_home(planned.settings)
    end_s = np.minimum(end_times(flying, enough=1.0).end_s, dt_s.sum())
    turns_by_s = looked_s if looked_s == ahead.touchdown_s else float(end_s.max())
    asked = route_forecast.fly_ways(known, None if elsewhere else home, flying, scenario, way, homes_from, turns_by_s)
    route = _with_charge_shown(route_forecast.route_answer(asked, end_s))
    assert asked.route_s is not None
    spare = np.quantile(np.maximum(end_s - asked.route_s, 0.0), LEVELS)
    spare_lo_s, spare_s, spare_hi_s = map(float, spare)
    found = RouteFit(ambient_C, route, spare_s, spare_lo_s, spare_hi_s, range_remark(battery, ambient_C))
    return found, flying, end_s


def _with_charge_shown(route: Route) -> Route:
    """Return the route with a charge at touchdown that a pack can have; NaN if most flights end before touchdown."""
    lo, middle, hi = _shown((route.soc_lo, route.soc, route.soc_hi), route.risk)
    return replace(route, soc=middle, soc_lo=lo, soc_hi=hi)


def _shown(charge: Iterable[float], ended: float) -> tuple[float, ...]:
    """Return the quantiles of a charge, within 0 to 1; NaN if too large a share `ended` of the draws ends before."""
    return tuple(math.nan if ended > NOT_REACHED else min(max(float(soc), 0.0), 1.0) for soc in charge)


def _longest_hover_s(pack: Pack, powers: Powers) -> float:
    """Return how long a full pack would hover [s], an upper estimate."""
    return float(most_energy_Wh(pack.installation) * 3600.0 / powers.hover_W)


def _leg_ends(way: Path, ahead: Ahead, leg_of: Column, flying: Flying, end_s: Array) -> tuple[LegEnd, ...]:
    """Return when and with what charge each leg ends: a wait belongs to the leg before it.

    leg_of : the index of the leg of each piece
    """
    last = np.append(np.flatnonzero(np.diff(leg_of)), leg_of.size - 1)
    ends_s: Array = ahead.pieces.ends_s[last]
    seen_s = np.minimum(ends_s, np.max(end_s))  # nobody flies later
    edges_s = edges_through(seen_s)
    passed = fly_draws(flying, edges_s).of(np.searchsorted(edges_s, seen_s))
    soc = np.quantile(passed.state.soc, LEVELS, axis=1)
    ended = (end_s < ends_s[:, None]).mean(axis=1)
    legs = [way.legs[index] for index in leg_of[last]]
    return tuple(
        LegEnd(leg.seq, leg_words(leg), float(leg_s), left_at(leg), *_shown(charge, float(before)))
        for leg, leg_s, charge, before in zip(legs, ends_s, soc[[1, 0, 2]].T, ended, strict=True)
    )


def _powers_remark(powers: Powers) -> str:
    """Return a warning if only the hover of the aircraft is known; else empty."""
    if powers.flights:
        return ""
    return f"only the hover of {powers.hover_W:g} W is stated: other powers as of usual multirotors; give --vehicle"


def _air_remark(ahead: Ahead) -> str:
    """Return a warning of legs that need more airspeed than multirotors have; empty without such a leg."""
    fastest_ms = float(np.max(ahead.pieces.airspeed_ms))
    if fastest_ms <= FASTEST_USUAL_MS:
        return ""
    return f"a leg asks {fastest_ms:.0f} m/s through the air, with this wind: few multirotors fly so fast"


def _home_remark(planned: PlannedMission) -> str:
    """Return a warning if the mission lands and the way home from it is not known; else empty."""
    elsewhere = return_reason(planned.mission, planned.settings)
    return f"no turn-back: {elsewhere}" if elsewhere else ""


def _speeds_remark(planned: PlannedMission) -> str:
    settings = planned.settings
    unknown = {
        "cruise": settings.cruise_ms, "climb": settings.climb_ms, "descent": settings.descent_ms,
        "landing": settings.land_ms,
    }  # fmt: skip
    missing = [name for name, value in unknown.items() if not math.isfinite(value)]
    maker = "PX4" if settings.is_px4 else "ArduCopter"
    return f"{maker}'s defaults are used for {', '.join(missing)}" if missing else ""
