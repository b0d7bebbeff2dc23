"""Legs as pieces of flight: where the aircraft turns and speeds up, and that nothing else of the way changes."""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from route_rig import HOME, POWERS, SETTINGS, mission, to

from uavbatt.battery.powers import TURN_S, power, terms
from uavbatt.navigation import METRES_PER_DEGREE, Action, MissionItem, Mode, Navigation, Position
from uavbatt.prediction.route.ahead import Ahead, ahead, home_now
from uavbatt.prediction.route.flight_lessons import UNTOLD_WIND_SD_MS, WIND_SD_MS
from uavbatt.prediction.route.legs import Point
from uavbatt.prediction.route.load import (
    RouteLoad,
    airspeed_bends,
    airspeed_slopes,
    factors,
    fast_shares,
    wind_errors_ms,
)
from uavbatt.prediction.route.path import path
from uavbatt.prediction.route.pieces import LegTiming, Pieces
from uavbatt.prediction.route.progress import Progress
from uavbatt.records import Z90

SPEED_MS = 8.0
FAST = replace(SETTINGS, cruise_ms=SPEED_MS)
OUT_AND_BACK = mission(to(1, 500.0, 0.0, 30.0), to(2, 0.0, 0.0, 30.0))


def pieces(*places_m: tuple[float, float], hold_s: float = 0.0) -> Pieces:
    """The pieces of a way at one height from home along these places north and east."""
    items = [to(k, north_m, east_m, 30.0, hold_s=hold_s) for k, (north_m, east_m) in enumerate(places_m, start=1)]
    found = LegTiming().pieces(path(mission(*items), HOME, FAST).table)
    return found.of(found.seq <= len(places_m))


def speeding_up(found: Pieces, seq: int) -> bool:
    return bool((found.gained_ms[found.seq == seq] > 0.0).any())


def most_W(found: Pieces) -> float:
    return float(RouteLoad(Ahead(Point(0.0, 0.0, 0.0), found), POWERS, 1.0, 0.0).piece_W.max())


def test_an_aircraft_speeds_up_after_a_sharp_corner_and_flies_through_a_gentle_one() -> None:
    """The power as it speeds up ends flights: one flight's last minute was 133 s too long without it."""
    found = pieces((0.0, 500.0), (100.0, 1000.0), (600.0, 900.0))
    assert [speeding_up(found, seq) for seq in (1, 2, 3)] == [True, False, True]
    assert speeding_up(pieces((0.0, 500.0), (0.0, 1000.0), hold_s=5.0), 2)


def test_speeding_up_is_the_first_seconds_of_a_leg_and_ends_nowhere_else() -> None:
    found = pieces((0.0, 500.0))
    level = found.of((found.seq == 1) & (found.length_s > 0.0))
    first = int(np.flatnonzero(level.gained_ms > 0.0)[0])
    assert level.length_s[first] == TURN_S
    assert level.gained_ms[first] == pytest.approx(SPEED_MS, rel=0.15)
    share = TURN_S / (TURN_S + level.length_s[first + 1])
    assert level.end[first, 1] == pytest.approx(500.0 * share, abs=1.0)
    assert level.end[first + 1, 1] == pytest.approx(500.0, abs=0.5)


def test_a_climb_at_once_is_shorter_and_steeper_and_ends_at_the_same_height() -> None:
    """Inspections ended 50 s before their forecast: as a leg began, they climbed with 270 W instead of 223 W."""
    table = path(mission(to(1, 0.0, 100.0, 30.0), to(2, 0.0, 300.0, 50.0)), HOME, FAST).table
    along, at_once = (LegTiming(climbs_first=first).pieces(table) for first in (False, True))
    assert at_once.climb_ms[at_once.seq == 2].max() == pytest.approx(2.5)  # SETTINGS.climb_ms
    assert along.climb_ms[along.seq == 2].max() < 1.0
    for found in (along, at_once):
        second = found.seq == 2
        assert found.climb_ms[second] @ found.length_s[second] == pytest.approx(20.0)
        assert tuple(found.end[second][-1]) == pytest.approx((0.0, 300.0, 50.0))
    assert at_once.length_s.sum() == pytest.approx(along.length_s.sum())
    assert most_W(at_once.of(at_once.seq == 2)) > 1.1 * most_W(along.of(along.seq == 2))


def test_it_asks_more_than_a_hover_and_more_than_the_flight_after_it() -> None:
    found = pieces((0.0, 500.0))
    load = RouteLoad(Ahead(Point(0.0, 0.0, 0.0), found), POWERS, 1.1, 0.05)
    first = int(np.flatnonzero(found.gained_ms > 0.0)[0])
    assert load.piece_W[first] > 1.1 * POWERS.hover_W > load.piece_W[first + 1]


def test_a_circle_begins_and_ends_across_the_way() -> None:
    """Its centre lies straight ahead, so that it was flown into, and out of, without turning."""
    turns = to(2, 0.0, 400.0, 30.0, action=Action.LOITER_TURNS, turns=3.0, radius_m=40.0)
    found = LegTiming().pieces(path(mission(to(1, 0.0, 300.0, 30.0), turns, to(3, 0.0, 900.0, 30.0)), HOME, FAST).table)
    assert int((found.gained_ms[found.seq == 2] > 0.0).sum()) == 1  # on the circle; the way to it goes straight on
    assert speeding_up(found, 3)


def test_on_a_circle_the_power_is_the_mean_over_head_wind_and_tail_wind() -> None:
    """With the root mean square of the airspeed it was 204 W where 220 W were flown: so an end came 7 s too late."""
    item = to(1, 0.0, 300.0, 30.0, action=Action.LOITER_TURNS, turns=5.0, radius_m=100.0)
    fast_turns = replace(SETTINGS, cruise_ms=5.0, circle_rate_deg_s=90.0, acceleration_ms2=10.0)
    found = LegTiming(wind=(6.0, 0.0)).pieces(path(mission(item), HOME, fast_turns).table)
    turns = found.of(found.length_s == found.length_s.max())
    circle_W = float(RouteLoad(Ahead(Point(0.0, 0.0, 0.0), turns), POWERS, 1.0, 0.0).piece_W[0])
    speed_ms = 2.0 * math.pi * 100.0 * 5.0 / float(turns.length_s[0])
    headings = [math.radians(heading) for heading in range(360)]
    air_ms = np.array([math.hypot(speed_ms * math.cos(a) - 6.0, speed_ms * math.sin(a)) for a in headings])
    flown_W = power(POWERS, terms(air_ms, 0.0, 0.0, 0.0, POWERS.induced_ms))
    assert circle_W == pytest.approx(float(flown_W.mean()), rel=0.005)
    assert circle_W > 1.02 * float(power(POWERS, terms(math.hypot(speed_ms, 6.0), 0.0, 0.0, 0.0, POWERS.induced_ms)))


def test_what_was_flown_beyond_the_learned_airspeeds_counts_there_alone() -> None:
    ahead_of = Ahead(Point(0.0, 0.0, 0.0), LegTiming(wind=(-12.0, 0.0)).pieces(path(OUT_AND_BACK, HOME, FAST).table))
    plain, excess = (RouteLoad(ahead_of, POWERS, 1.0, 0.0, excess).flown_W for excess in (0.0, 0.2))
    assert POWERS.fastest_ms is not None
    is_beyond = ahead_of.pieces.airspeed_ms > POWERS.fastest_ms
    assert is_beyond.any() and not is_beyond.all()
    assert (excess[is_beyond] > plain[is_beyond]).all()
    assert (excess[~is_beyond] == plain[~is_beyond]).all()


def flying(mode: Mode) -> Navigation:
    """An aircraft at its speed on the way to item 1, or home."""
    lat_deg = HOME.lat_deg + 200.0 / METRES_PER_DEGREE
    speed_ms = SPEED_MS if mode is Mode.MISSION else -SPEED_MS
    position = Position(0.0, lat_deg, HOME.lon_deg, 30.0, speed_ms, 0.0, 0.0)
    return Navigation(
        mode=mode, mission=mission(to(1, 1000.0, 0.0, 30.0)), current=1, current_since_s=0.0, current_heard_s=0.0,
        home=HOME, settings=FAST, position=position,
    )  # fmt: skip


@pytest.mark.parametrize("mode", [Mode.MISSION, Mode.RETURN])
def test_the_leg_that_is_flown_has_its_speed_already(mode: Mode) -> None:
    now = flying(mode)
    progress = Progress().after(0.0, now)
    rest = ahead(progress, now, 0.0) if mode is Mode.MISSION else home_now(progress, now, 0.0)
    assert isinstance(rest, Ahead)
    assert rest.pieces.gained_ms[0] == 0.0


def test_the_power_of_a_turn_tells_no_payload() -> None:
    """Surveys turn every half minute: their level was 2 % too high, and so was the power of the way home."""

    def level(turning_W: float) -> float:
        progress = Progress()
        for k in range(200):
            turns = k % 20 < 4
            position = Position(float(k), HOME.lat_deg, HOME.lon_deg, 30.0, 2.0 * (k % 20) if turns else 8.0, 0.0, 0.0)
            known = replace(flying(Mode.MANUAL), position=position)
            progress = progress.after(float(k), known, turning_W if turns else 160.0, POWERS)
        return progress.lessons.power.level(POWERS)[0]

    assert level(300.0) == pytest.approx(level(160.0), abs=1e-6)


def load_at(airspeed_ms: float, fastest_ms: float | None = None) -> RouteLoad:
    """The load of one piece at an airspeed; the law was learned up to another."""
    one = LegTiming(wind=(SPEED_MS - airspeed_ms, 0.0)).pieces(
        path(mission(to(1, 2000.0, 0.0, 30.0)), HOME, FAST).table
    )
    there = one.of(one.seq == 1).of(slice(-1, None))
    powers = msgspec.structs.replace(POWERS, fastest_ms=fastest_ms)
    return RouteLoad(ahead=Ahead(Point(0.0, 0.0, 30.0), there), powers=powers, level=1.0, level_sd=0.05)


def spread_at(airspeed_ms: float, fastest_ms: float | None) -> float:
    """Relative sd between the scenarios of the power of a piece at an airspeed; the law was learned up to another."""
    powers_W = replace(load_at(airspeed_ms, fastest_ms), level_sd=0.0).steady(np.array([5.0])).power_W[0]
    return float(np.std(np.log(powers_W)))


def test_the_power_beyond_the_learned_airspeeds_is_known_less_and_less() -> None:
    """A vehicle learned below 12 m/s that came home at 20 m/s of air was told to turn 72 s too late."""
    within, near, far = (spread_at(v, fastest_ms=12.0) for v in (11.0, 15.0, 20.0))
    assert within == pytest.approx(POWERS.fast_sd, rel=0.02)
    assert 1.3 * within < near < far / 1.5
    assert spread_at(20.0, fastest_ms=20.0) == spread_at(20.0, fastest_ms=None) == pytest.approx(within)


def test_a_wind_that_is_not_known_exactly_counts_where_the_power_depends_on_the_airspeed() -> None:
    hover, fast = (float(airspeed_slopes(load_at(v))[0]) for v in (0.5, 15.0))
    assert abs(hover) < 0.02 < fast


def test_a_wind_that_nobody_tells_asks_the_power_of_the_airspeed_that_it_makes() -> None:
    """Two roads to one power: the straight line made a flight at 9 m/s against 6 m/s a sixth too cheap."""
    still, head_ms = load_at(9.0), Z90 * UNTOLD_WIND_SD_MS
    slope = airspeed_slopes(still)
    told, untold = (airspeed_bends(still, slope, sd_ms) for sd_ms in (WIND_SD_MS, UNTOLD_WIND_SD_MS))
    assert told == 0.0
    in_wind_W = still.flown_W * np.exp((slope + untold * head_ms) * head_ms)
    assert in_wind_W == pytest.approx(load_at(9.0 + head_ms).flown_W)


def test_steep_flight_counts_as_fast_flight() -> None:
    """Its power is as unsure: at 1.5 m/s of climb wholly, at half of that by half; a descent does not count."""
    level = load_at(3.0)
    at_climb = [
        replace(level, ahead=level.ahead._replace(pieces=level.ahead.pieces._replace(climb_ms=np.array([climb_ms]))))
        for climb_ms in (-3.0, 0.0, 0.75, 1.5, 3.0)
    ]
    assert [float(fast_shares(load)[0]) for load in at_climb] == pytest.approx([0.0, 0.0, 0.5, 1.0, 1.0])


def test_the_wind_is_drawn_beside_level_fast_flight_and_time() -> None:
    drawn = np.vstack([np.log(factors(load_at(15.0))), wind_errors_ms(WIND_SD_MS)])
    assert np.corrcoef(drawn) == pytest.approx(np.eye(4), abs=1e-9)
    assert drawn[3].std() == pytest.approx(WIND_SD_MS) and drawn[3].mean() == pytest.approx(0.0, abs=1e-9)


def on_item(found: MissionItem, north_m: float, time_s: float) -> Ahead:
    """What is ahead of an aircraft so far north of home, at a time, on the first item of a mission."""
    north = Position(time_s, HOME.lat_deg + north_m / METRES_PER_DEGREE, HOME.lon_deg, 30.0, SPEED_MS, 0.0, 0.0)
    now = replace(flying(Mode.MISSION), mission=mission(found), current_heard_s=time_s, position=north)
    progress = Progress()
    for at_s in (0.0, time_s):
        progress = progress.after(at_s, replace(now, position=replace(north, time_s=at_s)))
    said = ahead(progress, now, time_s)
    assert isinstance(said, Ahead), said
    return said


def first_item_s(found: Ahead) -> float:
    return float(found.pieces.length_s[found.pieces.seq == 1].sum())


@pytest.mark.parametrize("action", [Action.WAYPOINT, Action.SPLINE])
def test_the_rest_of_a_leg_is_as_long_as_what_lies_ahead_of_the_aircraft(action: Action) -> None:
    """The rest of a curve is longer than the line to its end, in the same ratio as the whole curve."""
    item = to(1, 1000.0, 0.0, 30.0, action=action)
    left_s = [first_item_s(on_item(item, north_m, 60.0)) for north_m in (200.0, 600.0, 800.0)]
    lengthened = 1.06 if action is Action.SPLINE else 1.0
    assert left_s[0] - left_s[1] == pytest.approx(lengthened * 1.03 * 400.0 / SPEED_MS, rel=0.01)
    assert left_s[1] - left_s[2] == pytest.approx(lengthened * 1.03 * 200.0 / SPEED_MS, rel=0.01)
