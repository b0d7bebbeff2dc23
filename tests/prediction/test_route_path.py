"""The way of a mission as legs: frames, jumps, speeds, the way home, and what makes a route unknown."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from route_rig import HOME, SETTINGS, mission, to

from uavbatt.navigation import (
    METRES_PER_DEGREE,
    Action,
    Frame,
    Home,
    Mission,
    MissionItem,
    Mode,
    Navigation,
    ReturnSettings,
    SpeedKind,
    Wind,
)
from uavbatt.prediction.route.ahead import is_returning
from uavbatt.prediction.route.legs import Phase, Point, way_points
from uavbatt.prediction.route.path import path
from uavbatt.prediction.route.progress import Progress
from uavbatt.simulate.route import route_flight


def ends(*items: MissionItem) -> list[tuple[float, float, float]]:
    found = path(mission(*items), HOME, SETTINGS)
    assert not found.reason
    return [tuple(round(value, 1) for value in leg.end) for leg in found.legs if leg.phase is Phase.ROUTE]


def test_a_leg_lasts_as_long_as_its_slower_axis() -> None:
    legs = path(mission(to(1, 300.0, 400.0, 50.0), to(2, 300.0, 400.0, 20.0)), HOME, SETTINGS).legs
    assert legs[0].run_m == pytest.approx(500.0, abs=0.5)
    assert legs[0].moving_s == pytest.approx(100.0, abs=0.1)
    assert legs[1].moving_s == pytest.approx(30.0 / 1.5)


def test_legs_as_columns_say_what_each_leg_says() -> None:
    found = path(mission(to(1, 300.0, 400.0, 50.0, hold_s=7.0), to(2, 300.0, 400.0, 20.0)), HOME, SETTINGS)
    for k, leg in enumerate(found.legs):
        assert (found.table.seq[k], found.table.phase[k]) == (leg.seq, leg.phase)
        assert tuple(found.table.end[k]) == leg.end
        said = (found.table.run_m[k], found.table.rise_m[k], found.table.hold_s[k])
        assert said == pytest.approx((leg.run_m, leg.rise_m, leg.hold_s))
        assert (found.table.moving_s[k], found.table.fastest_ms[k]) == pytest.approx((leg.moving_s, leg.fastest_ms))


def test_heights_above_sea_and_above_home_are_the_same_place() -> None:
    assert ends(to(1, 100.0, 0.0, 40.0)) == ends(to(1, 100.0, 0.0, 440.0, frame=Frame.SEA))


def test_a_jump_is_the_same_route_as_its_items_written_out() -> None:
    jump = MissionItem(3, Action.JUMP, jump_to=1, repeats=2)
    there, back = (to(1, 100.0, 0.0, 40.0), to(2, 0.0, 100.0, 40.0))
    written = [replace(item, seq=seq) for seq, item in enumerate([there, back] * 3, start=1)]
    assert ends(there, back, jump) == ends(*written)


def test_a_jump_without_end_is_no_route() -> None:
    found = path(mission(to(1, 100.0, 0.0, 40.0), MissionItem(2, Action.JUMP, jump_to=1, repeats=-1)), HOME, SETTINGS)
    assert "jumps" in found.reason
    assert not found.legs


def test_speeds_change_where_an_item_says_so_and_come_back_without_one() -> None:
    faster = MissionItem(2, Action.SPEED, speed_ms=10.0, speed_kind=SpeedKind.GROUND)
    own = MissionItem(4, Action.SPEED)
    items = (to(1, 100.0, 0.0, 40.0), faster, to(3, 200.0, 0.0, 40.0), own, to(5, 300.0, 0.0, 40.0))
    assert [leg.speed_ms for leg in path(mission(*items), HOME, SETTINGS).legs[:3]] == [5.0, 10.0, 5.0]


@pytest.mark.parametrize("last", [Action.RETURN, Action.LAND, Action.WAYPOINT, Action.LOITER_TIME])
def test_a_flight_home_that_the_mission_does_not_ask_for_is_named(last: Action) -> None:
    """An ArduCopter waits at the last waypoint of such a mission; no number may look as if the way home was planned."""
    found = path(mission(to(1, 100.0, 0.0, 40.0), to(2, 200.0, 0.0, 40.0, action=last)), HOME, SETTINGS)
    assert found.legs[-1].end.height_m == 0.0
    assert ("flight home assumed" in found.assumed) is (last not in (Action.RETURN, Action.LAND))


def test_a_map_draws_turns_around_their_centre() -> None:
    """Two turns and a half end opposite of where they begin, and the aircraft never comes near the centre."""
    turns = to(2, 300.0, 0.0, 40.0, action=Action.LOITER_TURNS, turns=2.5, radius_m=50.0)
    legs = path(mission(to(1, 100.0, 0.0, 40.0), turns, to(3, 300.0, 400.0, 40.0)), HOME, SETTINGS).legs
    drawn = way_points(legs)
    from_centre_m = [math.dist(point[:2], (300.0, 0.0)) for point in drawn]
    assert min(from_centre_m) == pytest.approx(50.0, abs=0.1)
    round_m = [point for point, far_m in zip(drawn, from_centre_m, strict=True) if far_m < 51.0]
    assert max(point.east_m for point in round_m) == pytest.approx(50.0, abs=0.5)
    assert min(point.east_m for point in round_m) == pytest.approx(-50.0, abs=0.5)
    assert round_m[0][:2] == pytest.approx((250.0, 0.0), abs=0.1)
    assert round_m[-1][:2] == pytest.approx((350.0, 0.0), abs=0.1)
    assert drawn[0] == (0.0, 0.0, 0.0) and drawn[-1] == legs[-1].end


def test_a_mission_that_flies_on_after_landing_is_no_route() -> None:
    there, down = to(1, 100.0, 0.0, 40.0), to(2, 100.0, 0.0, 0.0, action=Action.LAND)
    waits, up = MissionItem(3, Action.DELAY, hold_s=60.0), MissionItem(4, Action.TAKEOFF, alt_m=40.0)
    far, px4 = to(5, 3000.0, 0.0, 40.0), replace(SETTINGS, is_px4=True)
    home = MissionItem(2, Action.RETURN)
    for landing, items, settings in ((down, (far,), SETTINGS), (down, (up, far), px4), (home, (up, far), SETTINGS)):
        found = path(mission(there, landing, waits, *items), HOME, settings)
        assert found.reason == "the mission flies on after landing at item 2" and not found.legs
        assert path(mission(there, landing, waits, MissionItem(4, Action.OTHER)), HOME, SETTINGS).lands


def test_a_mission_that_lands_does_not_ask_how_the_vehicle_returns() -> None:
    items = (to(1, 100.0, 0.0, 40.0), to(2, 200.0, 0.0, 0.0, action=Action.LAND))
    whole = path(mission(*items), HOME, SETTINGS)
    for other in (replace(SETTINGS, return_final_m=10.0), replace(SETTINGS, return_reason="it has rally points")):
        assert path(mission(*items), HOME, other) == whole and whole.lands


def test_a_mission_may_begin_with_an_item_that_moves_nothing() -> None:
    camera = MissionItem(1, Action.OTHER, command=203)
    assert ends(camera, to(2, 100.0, 0.0, 40.0)) == ends(to(2, 100.0, 0.0, 40.0))


def test_the_first_item_of_a_px4_is_flown_and_that_of_an_ardupilot_is_home() -> None:
    there = (to(0, 100.0, 0.0, 40.0), to(1, 200.0, 0.0, 40.0))
    of_px4, of_ardupilot = (path(Mission(there, "", "", has_home), HOME, SETTINGS) for has_home in (False, True))
    assert [leg.seq for leg in of_px4.legs if leg.phase is Phase.ROUTE] == [0, 1]
    assert [leg.seq for leg in of_ardupilot.legs if leg.phase is Phase.ROUTE] == [1]


def test_a_payload_is_set_down_on_the_ground_and_the_mission_flies_on() -> None:
    delivery = (to(1, 800.0, 0.0, 40.0), to(2, 900.0, 0.0, 40.0, action=Action.PLACE), to(3, 900.0, 500.0, 40.0))
    assert ends(*delivery)[1:5] == [(900.0, 0.0, h) for h in (40.0, 10.0, 0.0, 40.0)]
    found = path(mission(*delivery), HOME, SETTINGS)
    assert [leg.moves_load for leg in found.legs if leg.seq == 2] == [False, False, True, False]
    placed_s = sum(leg.moving_s + leg.hold_s for leg in found.legs if leg.seq == 2)
    assert placed_s == pytest.approx(100.0 / 5.0 + 30.0 / 1.5 + 10.0 / 0.5 + 3.0 + 40.0 / 2.5, abs=0.1)


def test_a_copter_changes_its_height_at_the_place_and_a_px4_on_the_way() -> None:
    items = (to(1, 100.0, 0.0, 40.0), to(2, 200.0, 0.0, 90.0, action=Action.LOITER_TO_HEIGHT))
    assert ends(*items)[1:3] == [(200.0, 0.0, 40.0), (200.0, 0.0, 90.0)]
    of_px4 = path(mission(*items), HOME, replace(SETTINGS, is_px4=True)).legs
    assert [tuple(leg.end) for leg in of_px4 if leg.seq == 2] == [pytest.approx((200.0, 0.0, 90.0), abs=0.1)]


@pytest.mark.parametrize("command", [211, 42600], ids=["gripper", "winch"])
def test_a_gripper_opens_where_the_item_before_it_ends(command: int) -> None:
    opens = MissionItem(2, Action.OTHER, command=command)
    found = path(mission(to(1, 100.0, 0.0, 40.0), opens, to(3, 200.0, 0.0, 40.0)), HOME, SETTINGS)
    assert [leg.seq for leg in found.legs if leg.moves_load] == [1]


def test_a_copter_that_lands_takes_off_again_and_flies_on() -> None:
    """A delivery by landing: the power flown with the payload counts for little from then on."""
    there, down = to(1, 800.0, 0.0, 40.0), to(2, 900.0, 0.0, 0.0, action=Action.LAND)
    waits, up = MissionItem(3, Action.DELAY, hold_s=20.0), MissionItem(4, Action.TAKEOFF, alt_m=50.0)
    found = path(mission(there, down, waits, up, MissionItem(5, Action.RETURN)), HOME, SETTINGS)
    assert found.lands and not found.reason
    heights_m = [leg.end.height_m for leg in found.legs if leg.seq in (2, 3, 4)]
    assert heights_m == [40.0, 10.0, 0.0, 0.0, 50.0]
    assert [leg.seq for leg in found.legs if leg.moves_load] == [2]
    assert sum(leg.hold_s for leg in found.legs) == 20.0
    now = Navigation(mode=Mode.MISSION)
    returns = [is_returning(Progress(path=found, at=at), now) for at in range(len(found.legs))]
    assert returns == [leg.seq == 5 for leg in found.legs]  # on the way down to deliver it may still turn back


def test_turns_without_a_radius_are_those_of_the_autopilots_own() -> None:
    """ArduCopter flies circles of CIRCLE_RADIUS (10 m) where the item says 0, and turns at CIRCLE_RATE (20 deg/s)."""
    turns = to(1, 100.0, 0.0, 40.0, action=Action.LOITER_TURNS, turns=3.0)
    own, said = (path(mission(replace(turns, radius_m=radius_m)), HOME, SETTINGS).legs for radius_m in (0.0, -10.0))
    assert own == said
    assert own[1].moving_s == pytest.approx(3.0 * 360.0 / 20.0)
    stated = path(mission(turns), HOME, replace(SETTINGS, circle_radius_m=30.0, circle_rate_deg_s=-6.0)).legs
    assert stated[1].circle_m == 30.0
    assert stated[1].moving_s == pytest.approx(3.0 * 360.0 / 6.0)


def test_a_circle_is_flown_with_half_of_the_acceleration_inwards_at_most() -> None:
    """ArduCopter bounds the speed on a circle so (v² / r ≤ a / 2); a PX4 does not."""
    turns = to(1, 200.0, 0.0, 40.0, action=Action.LOITER_TURNS, turns=1.0, radius_m=40.0)
    fast = replace(SETTINGS, cruise_ms=10.0)
    assert path(mission(turns), HOME, fast).legs[1].speed_ms == pytest.approx(math.sqrt(0.5 * 2.5 * 40.0))
    gentle = path(mission(turns), HOME, replace(fast, acceleration_ms2=1.0))
    assert gentle.legs[1].speed_ms == pytest.approx(math.sqrt(0.5 * 1.0 * 40.0))
    assert path(mission(turns), HOME, replace(fast, is_px4=True)).legs[1].speed_ms == 10.0


def test_turns_begin_at_the_near_edge_and_end_where_they_are_over() -> None:
    turns = to(1, 200.0, 0.0, 40.0, action=Action.LOITER_TURNS, turns=1.5, radius_m=40.0)
    legs = path(mission(turns, to(2, 240.0, 100.0, 40.0)), HOME, SETTINGS).legs
    assert legs[0].run_m == pytest.approx(160.0, abs=0.1)
    assert legs[2].begin == pytest.approx((240.0, 0.0, 40.0), abs=0.1)
    assert legs[2].run_m == pytest.approx(100.0, abs=0.1)


def test_a_take_off_goes_straight_up_and_only_a_px4_then_flies_to_its_place() -> None:
    up = to(1, 300.0, 0.0, 50.0, action=Action.TAKEOFF)
    copter, px4 = (path(mission(up), HOME, replace(SETTINGS, is_px4=is_px4)).legs for is_px4 in (False, True))
    assert copter[0] == px4[0]
    assert (copter[0].end, copter[0].run_m, copter[0].moving_s) == (Point(0.0, 0.0, 50.0), 0.0, 50.0 / 2.5)
    assert copter[1].phase is Phase.LANDING
    assert px4[1].phase is Phase.ROUTE and px4[1].run_m == pytest.approx(300.0, abs=0.1)


def test_a_mission_across_the_antimeridian_is_as_short_as_elsewhere() -> None:
    fiji = Home(-17.0, 179.999, 10.0)
    legs = path(mission(MissionItem(1, Action.WAYPOINT, -17.0, -179.999, 40.0)), fiji, SETTINGS).legs
    assert legs[0].run_m == pytest.approx(0.002 * METRES_PER_DEGREE * math.cos(math.radians(17.0)), rel=1e-6)
    flight = route_flight(mission(MissionItem(1, Action.WAYPOINT, -17.0, -179.999, 40.0)), fiji, Wind(0.0, 0.0), 0.0)
    assert flight.position(flight.begins_s[1]).lon_deg == pytest.approx(-179.999)


def test_a_mission_that_does_not_land_is_followed_by_the_way_home() -> None:
    legs = path(mission(to(1, 100.0, 0.0, 40.0)), HOME, SETTINGS).legs
    assert [leg.phase for leg in legs] == [Phase.ROUTE, Phase.HOME, Phase.LANDING, Phase.LANDING]
    assert legs[-1].end == Point(0.0, 0.0, 0.0)


def test_a_return_that_ends_in_the_air_is_no_landing() -> None:
    """RTL_ALT_FINAL above 0, or PX4's landing delay of -1: it waits above home, and nothing says when it lands."""
    waits = replace(SETTINGS, return_final_m=10.0)
    for items in ((to(1, 100.0, 0.0, 40.0),), (to(1, 100.0, 0.0, 40.0), MissionItem(2, Action.RETURN))):
        found = path(mission(*items), HOME, waits)
        assert not found.lands and not found.reason
        assert [leg.phase for leg in found.legs] == [Phase.ROUTE, Phase.HOME] and found.legs[-1].end[:2] == (0.0, 0.0)
        assert path(mission(*items), HOME, replace(SETTINGS, return_final_m=0.0)).lands


@pytest.mark.parametrize(
    ("item", "words"),
    [
        (MissionItem(1, Action.UNKNOWN, command=9999), "9999"),
        (MissionItem(1, Action.UNKNOWN, reason="a transition of a VTOL"), "VTOL"),
        (to(1, 100.0, 0.0, 40.0, frame=Frame.TERRAIN), "terrain"),
        (to(1, 4e5, 0.0, 40.0), "400 km away at 40 m"),
        (to(1, 100.0, 0.0, 1e7), "1000"),
    ],
)
def test_what_is_not_understood_makes_the_route_unknown(item: MissionItem, words: str) -> None:
    found = path(mission(to(2, 50.0, 0.0, 40.0), item), HOME, SETTINGS)
    assert not found.legs
    assert "item 1" in found.reason
    assert words in found.reason


def test_a_height_above_the_sea_needs_that_of_home() -> None:
    found = path(mission(to(1, 100.0, 0.0, 440.0, frame=Frame.SEA)), replace(HOME, alt_m=math.nan), SETTINGS)
    assert "above the sea" in found.reason


@pytest.mark.parametrize(
    ("is_px4", "route_s", "home_s"),
    [
        (False, 500 / 5.0 + 60 / 2.5, 500 / 5.0 + (70 - 10) / 1.5 + 10 / 0.5),
        (True, 500 / 5.0 + 60 / 3.0, 500 / 5.0 + (70 - 5) / 1.5 + 5 / 0.7),
    ],
)
def test_what_the_vehicle_does_not_state_is_its_autopilots_default(is_px4: bool, route_s: float, home_s: float) -> None:
    """Up 60 m, along 500 m climbing 10 m, and home: the speeds are the defaults of the parameters."""
    take_off = MissionItem(1, Action.TAKEOFF, HOME.lat_deg, HOME.lon_deg, 60.0)
    back = MissionItem(3, Action.RETURN)
    found = path(mission(take_off, to(2, 500.0, 0.0, 70.0), back), HOME, ReturnSettings(is_px4=is_px4))
    assert sum(leg.moving_s for leg in found.legs if leg.seq < 3) == pytest.approx(route_s)
    assert sum(leg.moving_s for leg in found.legs if leg.seq == 3) == pytest.approx(home_s)


def test_a_place_without_a_latitude_or_without_a_longitude_is_where_the_aircraft_is() -> None:
    half = replace(to(2, 0.0, 400.0, 50.0), lat_deg=math.nan)
    assert path(mission(to(1, 300.0, 100.0, 50.0), half), HOME, SETTINGS).legs[1].run_m == 0.0
