"""An item of several legs is followed to its end: a return, a landing, turns; by the place, or else by the clock."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
from route_rig import HOME, SETTINGS, mission, to

from uavbatt.navigation import METRES_PER_DEGREE, Action, MissionItem, Mode, Navigation, Position, ReturnSettings, Wind
from uavbatt.prediction.route.ahead import Ahead, ahead
from uavbatt.prediction.route.item import is_behind, is_there
from uavbatt.prediction.route.legs import Leg, Phase, Point
from uavbatt.prediction.route.progress import Progress
from uavbatt.simulate.route import RouteFlight, route_flight

UP = MissionItem(1, Action.TAKEOFF, alt_m=20.0)
FAR = to(2, 600.0, 0.0, 20.0)
RETURN = MissionItem(3, Action.RETURN)
WAITS_30_S = MissionItem(3, Action.DELAY, hold_s=30.0)
WAITS = replace(SETTINGS, return_hold_s=60.0)
ROUND_S = 2.0 * math.pi * 40.0 / 5.0

Place = Callable[[float], Position | None]


def touchdowns(
    flight: RouteFlight, settings: ReturnSettings = SETTINGS, place: Place | None = None
) -> list[tuple[float, float]]:
    """Return what the forecast of each fifth second says of touchdown, and the truth [s]."""
    progress, said = Progress(), list[tuple[float, float]]()
    place = place or flight.position
    current, since_s = 1, 0.0
    for row in flight.flown(flight.lands_s).rows:
        time_s = row.position.time_s
        current, since_s = (current, since_s) if row.seq == current else (row.seq, time_s)
        now = Navigation(
            time_s=time_s,
            mode=Mode.MISSION,
            mission=flight.mission,
            current=current,
            current_since_s=since_s,
            current_heard_s=time_s,
            home=HOME,
            settings=settings,
            position=place(time_s),
        )
        progress = progress.after(time_s, now)
        if time_s % 5.0 == 0.0:
            found = ahead(progress, now, time_s)
            assert isinstance(found, Ahead), found
            said.append((time_s + found.touchdown_s, flight.lands_s))
    return said


def flight_of(*items: MissionItem, settings: ReturnSettings = SETTINGS) -> RouteFlight:
    return route_flight(mission(*items), HOME, Wind(0.0, 0.0), 0.0, settings)


@pytest.mark.parametrize(
    ("items", "settings"),
    [
        ((UP, FAR, RETURN), SETTINGS),
        ((UP, FAR, RETURN), WAITS),
        ((UP, FAR, to(3, 0.0, 0.0, 20.0, action=Action.LAND)), SETTINGS),
        ((UP, to(2, 600.0, 0.0, 70.0), to(3, 600.0, 400.0, 0.0, action=Action.LAND)), SETTINGS),
        ((UP, to(2, 300.0, 0.0, 20.0, action=Action.LOITER_TURNS, turns=4.0, radius_m=40.0), FAR, RETURN), SETTINGS),
        ((UP, to(2, 0.0, 300.0, 20.0, action=Action.LOITER_TURNS, turns=4.0, radius_m=40.0), RETURN), SETTINGS),
        ((UP, to(2, 600.0, 0.0, 60.0, action=Action.LOITER_TO_HEIGHT), to(3, 900.0, 0.0, 60.0), RETURN), SETTINGS),
        ((UP, replace(FAR, action=Action.LAND), WAITS_30_S, UP, to(5, 900.0, 0.0, 20.0), RETURN), SETTINGS),
        ((UP, replace(FAR, action=Action.PLACE), to(3, 900.0, 0.0, 20.0), RETURN), SETTINGS),
    ],
    ids=[
        "return",
        "return that waits",
        "landing at home",
        "landing elsewhere",
        "turns",
        "turns to the east",
        "height",
        "delivery",
        "payload",
    ],
)
def test_touchdown_stays_where_it_is_along_an_item_of_several_legs(
    items: tuple[MissionItem, ...], settings: ReturnSettings
) -> None:
    flight = flight_of(*(replace(item, seq=k) for k, item in enumerate(items, start=1)), settings=settings)
    for place in (None, lambda _: None):  # by the place, and by the clock
        for said_s, true_s in touchdowns(flight, settings, place):
            assert said_s == pytest.approx(true_s, abs=12.0 + 0.03 * true_s)


@pytest.mark.parametrize("ground_m", [-8.0, 8.0])
def test_a_payload_is_set_down_on_ground_that_is_not_level_with_home(ground_m: float) -> None:
    flight = flight_of(UP, replace(FAR, action=Action.PLACE), to(3, 900.0, 0.0, 20.0), replace(RETURN, seq=4))

    def on_hill(time_s: float) -> Position:
        here, above = flight.position(time_s), flight.legs[1].end.height_m
        is_placing = flight.begins_s[2] <= time_s < flight.begins_s[5]
        return replace(here, height_m=ground_m + here.height_m * (above - ground_m) / above) if is_placing else here

    for said_s, true_s in touchdowns(flight, SETTINGS, on_hill):
        assert said_s == pytest.approx(true_s, abs=30.0 + 0.03 * true_s)


@pytest.mark.parametrize("height_m", [24.0, 60.0])
def test_a_return_whose_climb_ends_elsewhere_is_followed(height_m: float) -> None:
    """The vehicle returns at another height than anybody knows of."""
    flight = flight_of(UP, FAR, RETURN, settings=replace(WAITS, return_height_m=height_m))
    for said_s, true_s in touchdowns(flight, WAITS):
        assert said_s == pytest.approx(true_s, abs=35.0)


@pytest.mark.parametrize("away_m", [8.0, 40.0], ids=["gust", "leap"])
def test_a_wait_goes_on_where_the_place_is_off_for_a_moment(away_m: float) -> None:
    """The autopilot does not begin its wait anew: a wait of 40 minutes was begun anew at each gust."""
    flight = flight_of(UP, replace(FAR, hold_s=900.0), RETURN)

    def blown(time_s: float) -> Position:
        here = flight.position(time_s)
        return replace(here, lat_deg=here.lat_deg + away_m * (time_s % 60.0 < 2.0) / METRES_PER_DEGREE)

    for said_s, true_s in touchdowns(flight, SETTINGS, blown):
        assert said_s == pytest.approx(true_s, abs=12.0 + 0.03 * true_s)


def test_a_wait_counts_where_the_height_has_drifted() -> None:
    flight = flight_of(UP, replace(FAR, hold_s=900.0), RETURN)

    def drifted(time_s: float) -> Position:
        here = flight.position(time_s)
        return replace(here, height_m=here.height_m + 9.0 * (time_s > 60.0))

    for said_s, true_s in touchdowns(flight, SETTINGS, drifted):
        assert said_s == pytest.approx(true_s, abs=25.0 + 0.03 * true_s)


def test_turns_are_flown_around_their_circle() -> None:
    """A simulated aircraft stays on the circle, at the speed of the leg once it is gained."""
    circle = to(2, 300.0, 0.0, 20.0, action=Action.LOITER_TURNS, turns=4.0, radius_m=40.0)
    flight = flight_of(UP, circle, replace(RETURN, seq=3))
    for since_s in (3.0, 0.3 * ROUND_S, 2.8 * ROUND_S):
        here = flight.position(flight.begins_s[2] + since_s)
        north_m = (here.lat_deg - HOME.lat_deg) * METRES_PER_DEGREE - 300.0
        east_m = (here.lon_deg - HOME.lon_deg) * METRES_PER_DEGREE * math.cos(math.radians(HOME.lat_deg))
        assert math.hypot(north_m, east_m) == pytest.approx(40.0, abs=0.1)
        assert here.airspeed_ms == pytest.approx(5.0)
        assert north_m * here.north_ms + east_m * here.east_ms == pytest.approx(0.0, abs=0.5)


# --- one leg at a time -------------------------------------------------------------------------------------------

HIGH = Point(0.0, 0.0, 40.0)
OVER = Point(100.0, 0.0, 40.0)
THERE = Leg(2, Phase.ROUTE, HIGH, OVER, 100.0, 5.0, 2.5, 1.5, hold_s=30.0)
DOWN = Leg(2, Phase.LANDING, OVER, Point(100.0, 0.0, 10.0), 0.0, 1.0, 2.5, 1.5)


def moving(north_ms: float = 0.0, up_ms: float = 0.0) -> Position:
    return Position(0.0, HOME.lat_deg, HOME.lon_deg, 40.0, north_ms, 0.0, up_ms)


@pytest.mark.parametrize(
    ("leg", "here", "speed_ms", "is_arrived"),
    [
        (THERE, Point(97.0, 0.0, 38.0), 5.0, True),
        (THERE, Point(100.0, 0.0, 50.0), 0.3, True),  # it stands there: its height has drifted
        (THERE, Point(100.0, 0.0, 50.0), 3.0, False),
        (THERE, Point(100.0, 0.0, 60.0), 0.3, False),
        (THERE._replace(hold_s=0.0), Point(100.0, 0.0, 50.0), 0.3, False),
        (THERE._replace(phase=Phase.HOME), Point(97.0, 0.0, 90.0), 5.0, True),  # over home, at any height
        (THERE._replace(phase=Phase.HOME), Point(94.0, 0.0, 40.0), 5.0, False),
        (DOWN, Point(100.0, 0.0, 10.0), 0.0, False),
        (THERE._replace(circle_m=40.0), OVER, 0.0, False),
    ],
)
def test_where_a_leg_has_its_end(leg: Leg, here: Point, speed_ms: float, is_arrived: bool) -> None:
    assert is_there(leg, here, moving(speed_ms)) is is_arrived


@pytest.mark.parametrize(
    ("leg", "following", "here", "position", "waited_s", "is_over"),
    [
        (THERE, DOWN, OVER, moving(), 29.0, False),
        (THERE, DOWN, OVER, moving(), 30.0, True),
        (THERE, DOWN, Point(100.0, 0.0, 35.0), moving(up_ms=-1.5), 3.0, True),  # it descends already
        (THERE, DOWN, Point(100.0, 0.0, 35.0), None, 3.0, True),
        (THERE, DOWN, Point(100.0, 0.0, 35.0), moving(up_ms=0.0), 3.0, False),  # it waits at another height
        (THERE, DOWN, Point(80.0, 0.0, 35.0), moving(up_ms=-1.5), 3.0, False),
        (THERE, DOWN, Point(100.0, 0.0, 37.0), moving(up_ms=-1.5), 3.0, False),
        (THERE, THERE, Point(100.0, 0.0, 35.0), moving(up_ms=-1.5), 3.0, False),
        (DOWN, DOWN, Point(100.0, 0.0, 10.4), moving(up_ms=-1.5), math.nan, True),
        (DOWN, DOWN, Point(100.0, 0.0, 11.0), moving(up_ms=-1.5), math.nan, False),
    ],
)
def test_when_a_leg_is_over(
    leg: Leg, following: Leg, here: Point, position: Position | None, waited_s: float, is_over: bool
) -> None:
    assert is_behind(leg, following, here, position, waited_s) is is_over


@pytest.mark.parametrize(
    ("north_m", "height_m", "position", "is_on_it"),
    [
        (60.0, 40.0, moving(0.0), True),
        (60.0, 46.0, moving(0.0), False),  # it still climbs
        (52.0, 40.0, moving(0.0), False),  # 48 m from the centre of a circle of 40 m
        (60.0, 40.0, moving(2.0), False),  # it still nears the centre
        (60.0, 40.0, None, True),
    ],
)
def test_when_a_circle_is_reached(north_m: float, height_m: float, position: Position | None, is_on_it: bool) -> None:
    circle = Leg(2, Phase.ROUTE, Point(60.0, 0.0, 40.0), OVER, 500.0, 5.0, 2.5, 1.5, circle_m=40.0)
    to_it = THERE._replace(end=circle.begin, hold_s=0.0)
    assert is_behind(to_it, circle, Point(north_m, 0.0, height_m), position, 0.0) is is_on_it
