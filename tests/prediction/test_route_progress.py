"""Where an aircraft is on its route, and what its legs teach: only what was flown as planned tells of the plan."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from route_rig import HOME, POWERS, SETTINGS, mission, to

from uavbatt.battery.powers import UNKNOWN, Powers, beyond_learned, power, terms
from uavbatt.navigation import (
    METRES_PER_DEGREE,
    Action,
    Home,
    MissionItem,
    Mode,
    Navigation,
    Position,
    ReturnSettings,
    Wind,
)
from uavbatt.prediction.route.ahead import Ahead, ahead
from uavbatt.prediction.route.flight_lessons import FlightLessons
from uavbatt.prediction.route.progress import Progress
from uavbatt.simulate.route import route_flight, watts_of

LEG_M, SPEED_MS, HEIGHT_M = 500.0, 5.0, 30.0
LINE = mission(*(to(k, LEG_M * k, 0.0, HEIGHT_M) for k in range(1, 5)))
MOVED = Home(HOME.lat_deg - 300.0 / METRES_PER_DEGREE, HOME.lon_deg, HOME.alt_m)


def seen(time_s: float, north_m: float, north_ms: float, **other: object) -> Navigation:
    """What is known of an aircraft so far north of home."""
    position = Position(time_s, HOME.lat_deg + north_m / METRES_PER_DEGREE, HOME.lon_deg, HEIGHT_M, north_ms, 0.0, 0.0)
    known = Navigation(
        mode=Mode.MISSION,
        mission=LINE,
        current=1,
        current_since_s=0.0,
        current_heard_s=time_s,
        home=HOME,
        settings=SETTINGS,
        position=position,
    )
    return replace(known, **other)  # type: ignore[arg-type]


def flown(pause_s: float = 0.0, moved_at_s: float = math.inf) -> Iterator[tuple[float, Navigation]]:
    """An aircraft on the LINE; 700 m north a pilot holds it for a while, and at some time somebody moves its home."""
    north_m, time_s, item, since_s, left_s = 0.0, 0.0, 1, 0.0, pause_s
    while item < 4:
        holds = north_m >= 700.0 and left_s > 0.0
        left_s, north_m = (left_s - 1.0, north_m) if holds else (left_s, north_m + SPEED_MS)
        if north_m >= LEG_M * item:
            item, since_s = item + 1, time_s
        known = seen(time_s, north_m, 0.0 if holds else SPEED_MS, current=item, current_since_s=since_s)
        home = MOVED if time_s >= moved_at_s else HOME
        yield time_s, replace(known, mode=Mode.HOLD if holds else Mode.MISSION, home=home)
        time_s += 1.0


def stretch(pause_s: float = 0.0, moved_at_s: float = math.inf) -> float:
    progress = Progress()
    for time_s, known in flown(pause_s, moved_at_s):
        progress = progress.after(time_s, known)
    return progress.lessons.long.factors[0]


def test_legs_that_are_flown_as_planned_stretch_nothing() -> None:
    assert stretch() == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("pause_s", [25.0, 40.0, 260.0])
def test_a_pause_of_the_pilot_teaches_nothing_of_the_speed(pause_s: float) -> None:
    """25 s in a hold were taken for legs that last 9 % longer; after 260 s the route was overdue to its next item."""
    assert stretch(pause_s) == pytest.approx(stretch(), abs=0.02)


@pytest.mark.parametrize("moved_at_s", [30.0, 97.0, 150.0, 195.0])
def test_a_home_that_is_moved_in_flight_teaches_nothing_of_the_speed(moved_at_s: float) -> None:
    """A leg's time was held against a plan from elsewhere: 0.75 to 1.27 of it, and home was nearer than it is."""
    assert stretch(moved_at_s=moved_at_s) == pytest.approx(stretch(), abs=0.02)


def test_the_clock_of_an_item_begins_anew_with_another_mission() -> None:
    """Item 1 waited for 400 s; item 1 of the mission uploaded then was "overdue", and no route was used for it."""
    waiting = mission(to(1, 0.0, 0.0, HEIGHT_M, hold_s=600.0), to(2, LEG_M, 0.0, HEIGHT_M))
    progress = Progress()
    for k in range(400):
        progress = progress.after(float(k), seen(float(k), 0.0, 0.0, mission=waiting))
    uploaded = seen(400.0, 0.0, SPEED_MS, mission=mission(to(1, 150.0, 0.0, HEIGHT_M), to(2, LEG_M, 0.0, HEIGHT_M)))
    rest = ahead(progress.after(400.0, uploaded), uploaded, 400.0)
    assert isinstance(rest, Ahead)
    assert rest.touchdown_s < 600.0


def taught(speed_ms: float, ratio: float, powers: Powers = POWERS) -> FlightLessons:
    """The lessons of 200 s at an airspeed at which the aircraft asks `ratio` times the power of its law."""
    asked_W = ratio * float(power(powers, terms(speed_ms, 0.0, 0.0, 0.0, powers.induced_ms)))
    progress = Progress()
    for k in range(200):
        progress = progress.after(float(k), seen(float(k), speed_ms * k, speed_ms), asked_W, powers)
    return progress.lessons


def test_an_airspeed_beyond_the_learned_ones_teaches_the_power_there_and_not_the_level() -> None:
    """Legs at 18 m/s, of an aircraft known up to 12 m/s, made the level 1.3: the survey after them asked too much."""
    assert POWERS.fastest_ms is not None and 10.0 < POWERS.fastest_ms < 20.0
    slow, fast = taught(10.0, 1.3), taught(20.0, 1.3)
    assert slow.power.level(POWERS)[0] == pytest.approx(1.26, abs=0.04)
    assert slow.excess_beyond(POWERS) == 0.0
    assert fast.power.level(POWERS)[0] == 1.0
    at_20_ms = float(beyond_learned(POWERS, np.array(20.0)))
    assert math.exp(fast.excess_beyond(POWERS) * at_20_ms) == pytest.approx(1.3, abs=0.04)


def test_a_velocity_that_the_places_deny_teaches_nothing() -> None:
    """Three seconds a minute of 15 m/s too much made an alarm come 90 s later than it did without them."""
    asked_W = float(power(POWERS, terms(5.0, 0.0, 0.0, 0.0, POWERS.induced_ms)))
    progress, told = Progress(), Progress()
    for k in range(200):
        right = seen(float(k), 5.0 * k, 5.0)
        progress = progress.after(float(k), right if k % 20 > 3 else seen(float(k), 5.0 * k, 20.0), asked_W, POWERS)
        told = told.after(float(k), right, asked_W, POWERS)
    assert progress.lessons.excess_beyond(POWERS) == 0.0
    assert progress.lessons.power.level(POWERS)[0] == pytest.approx(told.lessons.power.level(POWERS)[0], abs=0.01)


def test_an_unknown_aircraft_that_flies_fast_at_once_has_a_level() -> None:
    level, _ = taught(20.0, 150.0, UNKNOWN).power.level(UNKNOWN)  # its hover power is 1 W
    assert 100.0 < level < 200.0


def test_a_dropout_of_the_current_hardly_moves_the_power_beyond_the_learned_airspeeds() -> None:
    """A reading of 10 mW in ten seconds counts as a tenth of the modelled power: ln of it has no lower limit."""
    known, columns = taught(20.0, 1.3), terms(20.0, 0.0, 0.0, 0.0, POWERS.induced_ms)
    dropped = known.with_power(POWERS, 20.0, columns, 0.01, 10.0)
    at_20_ms = float(beyond_learned(POWERS, np.array(20.0)))
    assert math.exp(dropped.excess_beyond(POWERS) * at_20_ms) == pytest.approx(1.15, abs=0.04)


def test_a_little_beyond_the_learned_airspeeds_the_wind_explains_the_power_as_well() -> None:
    """An error of 5 % there is an error of the wind by 1 m/s, and says nothing of twice the airspeed."""
    excess, beyond = taught(15.5, 1.05).excess_beyond(POWERS), float(beyond_learned(POWERS, np.array(15.5)))
    assert 0.0 < excess < 0.25 * math.log(1.05) / beyond


def test_a_link_that_joins_within_a_leg_teaches_nothing_of_the_speed() -> None:
    progress = Progress()
    for time_s, known in flown():
        if time_s >= 40.0:
            heard = known if known.current != 1 else replace(known, current_since_s=40.0)
            progress = progress.after(time_s, heard)
        if known.current == 2:
            break
    assert progress.lessons.long.factors == Progress().lessons.long.factors


@pytest.mark.parametrize("speed_ms", [3.0, 12.0])
def test_a_speed_that_nobody_states_is_seen_on_the_first_leg(speed_ms: float) -> None:
    """At 12 m/s the rest of a route was said to last more than twice as long as it did, whatever was flown of it."""
    progress, unstated = Progress(), replace(SETTINGS, cruise_ms=math.nan)
    for k in range(30):
        progress = progress.after(float(k), seen(float(k), speed_ms * k, speed_ms, settings=unstated))
    assert progress.seen_ms == speed_ms
    settings = replace(unstated, seen_ms=progress.seen_ms)
    now = seen(30.0, speed_ms * 30.0, speed_ms, settings=settings)
    rest = ahead(progress.after(30.0, now), now, 30.0)
    stated = seen(30.0, speed_ms * 30.0, speed_ms, settings=replace(SETTINGS, cruise_ms=speed_ms))
    known = ahead(Progress().after(30.0, stated), stated, 30.0)
    assert isinstance(rest, Ahead) and isinstance(known, Ahead)
    assert rest.touchdown_s == pytest.approx(known.touchdown_s)


def test_a_speed_that_somebody_states_is_not_learned() -> None:
    """An item of the mission, or the vehicle; nor is one seen in a turn, or while a pilot flies."""

    def seen_ms(**other: object) -> float:
        progress = Progress()
        for k in range(30):
            progress = progress.after(float(k), seen(float(k), 12.0 * k, 12.0, **other))
        return progress.seen_ms

    unstated = replace(SETTINGS, cruise_ms=math.nan)
    speed = MissionItem(1, Action.SPEED, speed_ms=12.0)
    by_item = mission(speed, *(to(k, LEG_M * k, 0.0, HEIGHT_M) for k in range(2, 5)))
    assert seen_ms(settings=unstated) == 12.0
    assert math.isnan(seen_ms())
    assert math.isnan(seen_ms(settings=unstated, mission=by_item, current=2))
    assert math.isnan(seen_ms(settings=unstated, mode=Mode.MANUAL))


def return_from(north_m: float, up_ms: float, settings: ReturnSettings) -> Ahead:
    now = seen(10.0, north_m, 0.0, mode=Mode.RETURN, settings=settings)
    assert now.position is not None
    now = replace(now, position=replace(now.position, up_ms=up_ms))
    found = ahead(Progress().after(10.0, now), now, 10.0)
    assert isinstance(found, Ahead)
    return found


def test_the_wait_over_home_counts_until_the_aircraft_sinks() -> None:
    waits = replace(SETTINGS, return_hold_s=60.0)
    over_home_s = return_from(5.0, 0.0, waits).touchdown_s
    assert over_home_s == pytest.approx(return_from(7.0, 0.0, waits).touchdown_s, abs=3.0)
    assert return_from(5.0, -1.5, waits).touchdown_s == pytest.approx(over_home_s - 60.0, abs=5.0)


def test_an_aircraft_that_returns_lands_over_home_and_not_on_the_way() -> None:
    """The power of a slow landing is not that of a descent, and no speed is learned from it."""
    for north_m, lands in ((3.0, True), (50.0, False)):
        moves = Progress().flown(10.0, seen(10.0, north_m, 0.0, mode=Mode.RETURN))
        assert moves is not None and moves.landing is lands


@pytest.mark.parametrize("mode", [Mode.MISSION, Mode.RETURN])
def test_a_return_that_ends_in_the_air_has_no_touchdown_in_any_mode(mode: Mode) -> None:
    settings = replace(SETTINGS, return_final_m=10.0)
    there = mission(to(1, LEG_M, 0.0, HEIGHT_M), MissionItem(2, Action.RETURN))
    now = seen(10.0, 300.0, -8.0, mode=mode, mission=there, current=2, settings=settings)
    found = ahead(Progress().after(10.0, now), now, 10.0)
    assert isinstance(found, Ahead)
    assert not found.lands and math.isnan(found.touchdown_s)


def climbed(rates_ms: tuple[float, float]) -> Progress:
    """An aircraft that flies 300 m and 20 m up: at the first rate until it is so high, on a second leg 20 m down."""
    legs = mission(to(1, 10.0, 0.0, 30.0), to(2, 310.0, 0.0, 50.0), to(3, 610.0, 0.0, 30.0))
    progress, height_m = Progress(), 30.0
    for k in range(120):
        north_m, item = 10.0 + SPEED_MS * k, 2 if k < 60 else 3
        height_m = min(height_m + rates_ms[0], 50.0) if item == 2 else max(height_m - rates_ms[1], 30.0)
        known = seen(float(k), north_m, SPEED_MS, mission=legs, current=item, current_since_s=0.0 if k < 60 else 60.0)
        assert known.position is not None
        progress = progress.after(float(k), replace(known, position=replace(known.position, height_m=height_m)))
    return progress


def test_an_aircraft_that_climbs_at_once_is_told_from_one_that_climbs_along_the_leg() -> None:
    assert climbed((2.5, 1.5)).lessons.climbs_first
    assert not climbed((20.0 / 60.0, 20.0 / 60.0)).lessons.climbs_first
    assert not Progress().lessons.climbs_first  # before anything was flown


def test_an_aircraft_takes_off_by_its_mode_or_by_its_item() -> None:
    line = mission(to(1, 0.0, 0.0, HEIGHT_M, action=Action.TAKEOFF), *(to(k, LEG_M * k, 0.0, HEIGHT_M) for k in (2, 3)))
    taking_off = {}
    for mode in (Mode.TAKEOFF, Mode.MANUAL, Mode.MISSION):
        for item in (1, 2):
            known = seen(1.0, 0.0, 0.0, mission=line, mode=mode, current=item)
            moves = Progress().after(1.0, known).flown(1.0, known)
            assert moves is not None
            taking_off[mode, item] = moves.taking_off
    assert {asked for asked, is_so in taking_off.items() if is_so} == {
        (Mode.TAKEOFF, 1), (Mode.TAKEOFF, 2), (Mode.MISSION, 1)
    }  # fmt: skip


@pytest.mark.parametrize(
    "items",
    [
        (to(2, 900.0, 0.0, HEIGHT_M, action=Action.PLACE), to(3, 2500.0, 0.0, HEIGHT_M)),
        (to(2, 900.0, 0.0, HEIGHT_M), MissionItem(3, Action.OTHER, command=211), to(4, 2500.0, 0.0, HEIGHT_M)),
    ],
    ids=["set down on the ground", "dropped by a gripper"],
)
def test_a_payload_that_the_mission_sets_down_is_forgotten_there(items: tuple[MissionItem, ...]) -> None:
    """The level was averaged over the flight: the way home of a delivery was told with the payload still aboard."""
    flight = route_flight(mission(to(1, 800.0, 0.0, HEIGHT_M), *items), HOME, Wind(0.0, 0.0), 0.0, SETTINGS)
    at = next(k for k, leg in enumerate(flight.legs) if leg.moves_load)
    released_s = flight.begins_s[at] + flight.motions[at].lasts_s
    progress, current, since_s = Progress(), 1, 0.0
    for row in flight.flown(released_s + 80.0).rows:
        time_s = row.position.time_s
        current, since_s = (current, since_s) if row.seq == current else (row.seq, time_s)
        now = seen(time_s, 0.0, 0.0, mission=flight.mission, position=row.position, current=current)
        power_W = flight.power_W(time_s, watts_of(180.0 if time_s > released_s else 240.0))
        progress = progress.after(time_s, replace(now, current_since_s=since_s), power_W, POWERS)
        if time_s == math.floor(released_s) - 20.0:
            assert progress.lessons.power.level(POWERS)[0] > 1.2
    assert progress.lessons.power.level(POWERS)[0] == pytest.approx(1.0, abs=0.12)
