"""Mission items, flight modes and parameters of the way home: every spelling, and what is refused."""

from __future__ import annotations

import math

import pytest

from uavbatt.navigation import Action, Frame, MissionItem, Mode, SpeedKind
from uavbatt.telemetry.route import commands
from uavbatt.telemetry.route.builder import NavigationBuilder
from uavbatt.telemetry.route.commands import Fields, item_fields, mission, mission_item
from uavbatt.telemetry.route.modes import copter_mode, copter_mode_named, px4_mode, px4_state
from uavbatt.telemetry.route.settings import NAMES, names_to_ask, return_settings

NAN = math.nan
HOME = MissionItem(0, Action.WAYPOINT, 47.0, 8.0, 400.0, Frame.SEA, command=16)


def item(
    command: int, *parameters: float, lat: float = 47.0, lon: float = 8.0, alt: float = 50.0, frame: int = 3,
    px4: bool = False,
) -> MissionItem:  # fmt: skip
    four = (*parameters, 0.0, 0.0, 0.0, 0.0)[:4]
    return mission_item(Fields(1, frame, command, *four, lat, lon, alt), px4)


@pytest.mark.parametrize(
    ("found", "action", "known"),
    [
        (item(16, 7.0), Action.WAYPOINT, {"hold_s": 7.0, "alt_m": 50.0}),
        (item(82), Action.SPLINE, {"lat_deg": 47.0}),
        (item(17, 0, 0, -30), Action.LOITER_UNLIMITED, {"radius_m": 30.0}),
        (item(18, 2.5, 0, 20), Action.LOITER_TURNS, {"turns": 2.5, "radius_m": 20.0}),
        (item(19, 90), Action.LOITER_TIME, {"hold_s": 90.0}),
        (item(20), Action.RETURN, {}),
        (item(22), Action.TAKEOFF, {"alt_m": 50.0}),
        (item(93, 15), Action.DELAY, {"hold_s": 15.0}),
        (item(177, 3, -1), Action.JUMP, {"jump_to": 3, "repeats": -1}),
        (item(178, 1, 8), Action.SPEED, {"speed_ms": 8.0, "speed_kind": SpeedKind.GROUND}),
        (item(178, 0, 9), Action.SPEED, {"speed_kind": SpeedKind.AIR}),
        (item(178, 2, 3), Action.SPEED, {"speed_kind": SpeedKind.CLIMB}),
        (item(178, 3, 2), Action.SPEED, {"speed_kind": SpeedKind.DESCENT}),
        (item(178, 1, -1), Action.OTHER, {}),
        (item(206, 25), Action.OTHER, {}),
    ],
)
def test_items_that_are_understood(found: MissionItem, action: Action, known: dict[str, object]) -> None:
    assert found.action is action
    assert {name: getattr(found, name) for name in known} == known


def test_a_speed_of_minus_two_is_the_vehicles_own_again() -> None:
    assert item(178, 1, -2).action is Action.SPEED
    assert math.isnan(item(178, 1, -2).speed_ms)


@pytest.mark.parametrize(
    ("frame", "known"),
    [(0, Frame.SEA), (5, Frame.SEA), (3, Frame.HOME), (6, Frame.HOME), (10, Frame.TERRAIN), (11, Frame.TERRAIN)],
)
def test_each_altitude_frame_is_known(frame: int, known: Frame) -> None:
    assert item(16, frame=frame).frame is known


def test_zeros_of_an_ardupilot_mean_where_it_is_and_as_it_is() -> None:
    loiter = item(19, 10, lat=0.0, lon=0.0, alt=0.0)
    assert math.isnan(loiter.lat_deg)
    assert math.isnan(loiter.lon_deg)
    assert math.isnan(loiter.alt_m)
    assert item(16, alt=0.0, px4=True).alt_m == 0.0
    assert item(22, lat=0.0, lon=0.0).alt_m == 50.0


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (item(16, lat=NAN), "no place"),
        (item(16, lat=NAN, lon=NAN), "no place"),
        (item(16, lat=91.0), "latitude 91"),
        (item(16, lon=-181.0), "longitude -181"),
        (item(16, alt=1e6), "height"),
        (item(16, alt=math.inf), "height"),
        (item(16, frame=1), "frame 1"),
        (item(16, frame=-1), "without a frame"),
        (item(16, -5), "stay of -5"),
        (item(18, NAN), "turns"),
        (item(19, NAN), "stay of nan"),
        (item(178, 1, 400), "speed of 400"),
        (item(178, NAN, 5), "speed"),
        (item(177, NAN, 1), "jump"),
        (item(93, -1), "time of day"),
        (item(3000, 3), "VTOL transition"),
        (item(84), "VTOL take-off"),
        (item(208, 2), "not understood"),
        (item(60_000), "command 60000"),
    ],
)
def test_what_is_not_understood_says_why(found: MissionItem, words: str) -> None:
    assert found.action is Action.UNKNOWN
    assert words in found.reason


def test_an_item_that_is_not_understood_makes_the_route_unknown() -> None:
    found = mission([HOME, item(3000, 3)], "link")
    assert found.reason == "item 1: a VTOL transition is not understood (command 3000)"
    assert mission([HOME, item(16)], "link").reason == ""


def test_gaps_and_jumps_to_nowhere_make_the_route_unknown() -> None:
    assert "item 1 of the mission is missing" in mission([HOME, mission_item(Fields(2, 3, 16, 0, 0, 0, 0, 47, 8, 9))],
                                                         "link").reason  # fmt: skip
    assert "jumps to item 9" in mission([HOME, item(177, 9, 1)], "link").reason
    assert mission([HOME], "link").reason == "the mission has no items"


def test_odd_fields_of_the_home_item_refuse_nothing() -> None:
    odd = mission_item(Fields(0, 1, 16, 0, 0, 0, 0, 999.0, 0.0, 1e9))
    assert mission([odd, item(16)], "link").reason == ""


@pytest.mark.parametrize("command", [16, 17, 18, 19, 20, 22, 31, 82, 93, 94, 177, 178])
def test_an_item_survives_being_sent(command: int) -> None:
    first = item(command, 1.0, 2.0, 3.0)
    again = mission_item(item_fields(first))
    assert repr(again) == repr(first)


def test_navigation_commands_are_flown_and_others_are_not() -> None:
    assert [commands.is_flown(c) for c in (16, 20, 93, 177, 206)] == [True, True, True, False, False]


@pytest.mark.parametrize(
    ("number", "mode"),
    [
        (0, Mode.MANUAL), (1, Mode.MANUAL), (2, Mode.MANUAL), (3, Mode.MISSION), (4, Mode.MANUAL), (5, Mode.HOLD),
        (6, Mode.RETURN), (7, Mode.HOLD), (9, Mode.LAND), (16, Mode.HOLD), (17, Mode.HOLD),
        (21, Mode.RETURN_BY_TRACK), (27, Mode.MISSION), (99, Mode.UNKNOWN),
    ],
)  # fmt: skip
def test_each_mode_of_arducopter_is_known_by_number_and_name(number: int, mode: Mode) -> None:
    assert copter_mode(number) is mode
    assert copter_mode_named(str(number)) is mode


def test_modes_of_old_text_logs_have_names() -> None:
    assert [copter_mode_named(name) for name in ("AUTO", " rtl", "ALT_HOLD", "what")] == [
        Mode.MISSION, Mode.RETURN, Mode.MANUAL, Mode.UNKNOWN,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("main", "of_auto", "mode"),
    [
        (1, 0, Mode.MANUAL), (3, 0, Mode.MANUAL), (6, 0, Mode.MANUAL), (4, 2, Mode.TAKEOFF), (4, 3, Mode.HOLD),
        (4, 4, Mode.MISSION), (4, 5, Mode.RETURN), (4, 6, Mode.LAND), (4, 9, Mode.LAND), (4, 77, Mode.UNKNOWN),
        (10, 0, Mode.UNKNOWN),
    ],
)  # fmt: skip
def test_each_mode_of_px4_is_known_by_number(main: int, of_auto: int, mode: Mode) -> None:
    assert px4_mode(main << 16 | of_auto << 24) is mode


def test_navigation_states_of_px4() -> None:
    assert [px4_state(n) for n in (0, 3, 4, 5, 12, 17, 18, 99)] == [
        Mode.MANUAL, Mode.MISSION, Mode.HOLD, Mode.RETURN, Mode.LAND, Mode.TAKEOFF, Mode.LAND, Mode.UNKNOWN,
    ]  # fmt: skip


def test_old_and_new_names_of_ardupilot_say_the_same() -> None:
    old = {
        "WPNAV_SPEED": 750.0, "WPNAV_SPEED_UP": 250.0, "WPNAV_SPEED_DN": 150.0, "RTL_ALT": 3000.0, "RTL_SPEED": 900.0,
        "LAND_SPEED": 50.0, "LAND_SPEED_HIGH": 120.0, "LAND_ALT_LOW": 1000.0, "RTL_ALT_FINAL": 0.0, "WPNAV_RADIUS": 200,
        "RTL_CLIMB_MIN": 500.0,
        "CIRCLE_RADIUS": 2500.0,
        "WPNAV_ACCEL": 150.0,
        "CIRCLE_RATE": -15.0,
    }  # fmt: skip
    new = {
        "WP_SPD": 7.5, "WP_SPD_UP": 2.5, "WP_SPD_DN": 1.5, "RTL_ALT_M": 30.0, "RTL_SPEED_MS": 9.0, "LAND_SPD_MS": 0.5,
        "LAND_SPD_HIGH_MS": 1.2, "LAND_ALT_LOW_M": 10.0, "RTL_ALT_FINAL_M": 0.0, "WP_RADIUS_M": 2.0,
        "RTL_CLIMB_MIN_M": 5.0,
        "CIRCLE_RADIUS_M": 25.0,
        "WP_ACC": 1.5,
        "CIRCLE_RATE": -15.0,
    }  # fmt: skip
    one, other = return_settings(old), return_settings(new)
    assert repr(one) == repr(other)
    assert (one.cruise_ms, one.return_height_m, one.land_fast_ms) == (7.5, 30.0, 1.2)


@pytest.mark.parametrize(
    ("name", "stated", "field", "si"),
    [
        ("WP_SPD_UP", 3.0, "climb_ms", 3.0), ("WPNAV_SPEED_UP", 300.0, "climb_ms", 3.0),
        ("MPC_Z_V_AUTO_UP", 3.0, "climb_ms", 3.0), ("MPC_Z_VEL_MAX_UP", 3.0, "climb_ms", 3.0),
        ("WP_SPD_DN", 2.0, "descent_ms", 2.0), ("WPNAV_SPEED_DN", 200.0, "descent_ms", 2.0),
        ("MPC_Z_V_AUTO_DN", 2.0, "descent_ms", 2.0), ("MPC_Z_VEL_MAX_DN", 2.0, "descent_ms", 2.0),
        ("WP_SPD", 8.0, "cruise_ms", 8.0), ("WPNAV_SPEED", 800.0, "cruise_ms", 8.0),
        ("MPC_XY_CRUISE", 8.0, "cruise_ms", 8.0),
        ("RTL_ALT_M", 40.0, "return_height_m", 40.0), ("RTL_ALT", 4000.0, "return_height_m", 40.0),
        ("RTL_RETURN_ALT", 40.0, "return_height_m", 40.0),
        ("RTL_SPEED_MS", 9.0, "return_ms", 9.0), ("RTL_SPEED", 900.0, "return_ms", 9.0),
        ("RTL_ALT_FINAL_M", 5.0, "return_final_m", 5.0), ("RTL_ALT_FINAL", 500.0, "return_final_m", 5.0),
        ("RTL_CLIMB_MIN_M", 6.0, "return_climb_min_m", 6.0), ("RTL_CLIMB_MIN", 600.0, "return_climb_min_m", 6.0),
        ("RTL_LOIT_TIME", 7000.0, "return_hold_s", 7.0), ("RTL_LAND_DELAY", 7.0, "return_hold_s", 7.0),
        ("LAND_SPD_MS", 0.6, "land_ms", 0.6), ("LAND_SPEED", 60.0, "land_ms", 0.6),
        ("MPC_LAND_SPEED", 0.6, "land_ms", 0.6),
        ("LAND_SPD_HIGH_MS", 1.7, "land_fast_ms", 1.7), ("LAND_SPEED_HIGH", 170.0, "land_fast_ms", 1.7),
        ("LAND_ALT_LOW_M", 12.0, "land_slow_below_m", 12.0), ("LAND_ALT_LOW", 1200.0, "land_slow_below_m", 12.0),
        ("MPC_LAND_ALT2", 12.0, "land_slow_below_m", 12.0),
    ],
)  # fmt: skip
def test_every_parameter_of_speeds_and_heights_has_its_unit(name: str, stated: float, field: str, si: float) -> None:
    assert getattr(return_settings({name: stated}), field) == pytest.approx(si)
    assert name in NAMES and any(name in names_to_ask({}, is_px4) for is_px4 in (False, True))
    assert name not in names_to_ask({name: stated}, is_px4=name.startswith("MPC_"))


@pytest.mark.parametrize("is_px4", [False, True])
def test_an_autopilot_is_asked_for_its_own_names_only(is_px4: bool) -> None:
    asked = names_to_ask({}, is_px4)
    assert set(asked) <= NAMES and len(set(asked)) == len(asked)
    assert ("MPC_XY_CRUISE" in asked, "WPNAV_SPEED" in asked, "RTL_ALT" in asked) == (is_px4, not is_px4, not is_px4)
    assert names_to_ask(dict.fromkeys(NAMES, 1.0), is_px4) == []


@pytest.mark.parametrize(
    ("name", "stated", "field"),
    [
        ("WPNAV_SPEED", 1e12, "cruise_ms"), ("WPNAV_SPEED_DN", 1e-9, "descent_ms"),
        ("MPC_Z_V_AUTO_UP", 101.0, "climb_ms"), ("LAND_SPEED", -50.0, "land_ms"),
        ("RTL_ALT", 1e9, "return_height_m"), ("RTL_LOIT_TIME", 1e9, "return_hold_s"),
        ("CIRCLE_RADIUS", 1e9, "circle_radius_m"), ("WPNAV_SPEED", math.inf, "cruise_ms"),
    ],
)  # fmt: skip
def test_a_speed_or_height_that_no_multirotor_has_is_not_stated(name: str, stated: float, field: str) -> None:
    assert math.isnan(getattr(return_settings({name: stated}), field))


def test_a_return_speed_of_zero_is_that_of_the_mission() -> None:
    assert math.isnan(return_settings({"RTL_SPEED": 0.0}).return_ms)
    assert return_settings({"RTL_ALT": 0.0}).return_height_m == 0.0
    assert return_settings({"RTL_LOIT_TIME": 5000.0}).return_hold_s == 5.0


def test_parameters_of_px4_become_speeds_and_heights() -> None:
    found = return_settings(
        {"MPC_XY_CRUISE": 5.0, "MPC_Z_V_AUTO_UP": 3.0, "MPC_Z_V_AUTO_DN": 1.5, "RTL_RETURN_ALT": 60.0,
         "RTL_LAND_DELAY": -1.0, "RTL_DESCEND_ALT": 30.0, "MPC_LAND_SPEED": 0.7, "RTL_CONE_ANG": 45.0}
    )  # fmt: skip
    assert (found.cruise_ms, found.climb_ms, found.return_height_m) == (5.0, 3.0, 60.0)
    assert found.return_final_m == 30.0  # it waits there and does not land
    assert found.return_cone_slope == pytest.approx(1.0)
    assert found.return_cone_within_m == 10.0  # RTL_MIN_DIST, if nobody states it
    assert return_settings({"RTL_CONE_ANG": 45.0, "RTL_MIN_DIST": 20.0}).return_cone_within_m == 20.0
    assert math.isnan(return_settings({"RTL_CONE_SLOPE": 3.0}).return_cone_within_m)  # ArduPilot's cone has no limit


def test_the_autopilot_gives_the_defaults_whenever_it_is_heard() -> None:
    early, late = NavigationBuilder(), NavigationBuilder()
    early.autopilot(0.0, is_px4=True)
    early.parameter(1.0, "RTL_RETURN_ALT", 40.0)
    late.parameter(0.0, "RTL_RETURN_ALT", 40.0)
    late.autopilot(1.0, is_px4=True)
    assert repr(early.now.settings) == repr(late.now.settings)
    assert (late.now.settings.is_px4, late.now.settings.return_height_m) == (True, 40.0)


def test_a_parameter_heard_after_a_restart_adds_to_those_of_before() -> None:
    resumed = NavigationBuilder()
    resumed.settings(0.0, {"RTL_ALT": 3000.0})
    resumed.parameter(1.0, "WPNAV_SPEED", 750.0)
    assert (resumed.now.settings.return_height_m, resumed.now.settings.cruise_ms) == (30.0, 7.5)


def test_a_way_home_that_may_lead_elsewhere_says_so() -> None:
    assert "rally" in return_settings({"RALLY_TOTAL": 2.0}).return_reason
    assert "terrain" in return_settings({"RTL_ALT_TYPE": 1.0}).return_reason
    assert "RTL_TYPE 2" in return_settings({"RTL_TYPE": 2.0, "RTL_RETURN_ALT": 30.0}).return_reason
    assert "RTL_TYPE 1" in return_settings({"RTL_TYPE": 1.0, "RTL_RETURN_ALT": 30.0}).landing_reason
    straight = return_settings({"RALLY_TOTAL": 0.0, "RTL_TYPE": 0.0, "RTL_ALT": 1500.0})
    assert straight.return_reason == straight.landing_reason == ""
