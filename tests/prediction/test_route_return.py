"""The way home from any point: by what the vehicle states, and by what crews usually set where it states nothing."""

from __future__ import annotations

from dataclasses import replace

import pytest
from route_rig import SETTINGS, mission, to

from uavbatt.navigation import UNSTATED, Action, MissionItem, ReturnSettings, completed
from uavbatt.prediction.route.legs import Point
from uavbatt.prediction.route.way_home import possible_returns, return_assumed, return_reason, way_home
from uavbatt.telemetry.route.settings import return_settings


def test_the_way_home_climbs_first_and_never_descends_to_its_height() -> None:
    low, high = way_home(Point(0.0, 100.0, 10.0), SETTINGS), way_home(Point(0.0, 100.0, 60.0), SETTINGS)
    assert low[0].end.height_m == 30.0
    assert high[0].end.height_m == 60.0
    assert high[0].run_m == pytest.approx(100.0)


def test_a_return_whose_height_nobody_states_is_as_high_as_crews_set_it() -> None:
    """An ArduCopter's own 15 m told the turn-back of an aircraft that climbs to 40 m up to 84 s too late."""
    low = Point(0.0, 300.0, 10.0)
    for settings, heights_m in ((UNSTATED, {15.0, 30.0, 60.0}), (replace(UNSTATED, is_px4=True), {30.0, 60.0})):
        ways = [way_home(low, possible) for possible in possible_returns(settings)]
        assert {legs[0].end.height_m for legs in ways} == heights_m
        assert {legs[1].speed_ms for legs in ways} == {5.0, 10.0}
        assert len(ways) == 2 * len(heights_m)


def test_a_return_climbs_at_least_as_much_as_the_vehicle_states() -> None:
    climbs = replace(SETTINGS, return_climb_min_m=20.0)  # RTL_CLIMB_MIN; RTL_ALT is 30 m
    heights_m = [way_home(Point(0.0, 300.0, at_m), climbs)[0].end.height_m for at_m in (5.0, 20.0, 50.0)]
    assert heights_m == [30.0, 40.0, 70.0]


@pytest.mark.parametrize(
    ("stated", "ways", "words"),
    [
        (SETTINGS, 1, ""),
        (replace(SETTINGS, return_height_m=float("nan")), 3, "return at 15 to 60 m assumed"),
        (replace(SETTINGS, return_height_m=0.0), 1, ""),  # it stays at its height
        (replace(SETTINGS, return_ms=float("nan")), 1, ""),  # it flies home at its cruise
        (replace(SETTINGS, return_ms=float("nan"), cruise_ms=float("nan")), 2, "return at 5 to 10 m/s assumed"),
        (ReturnSettings(seen_ms=8.74), 6, "return at 15 to 60 m and 8.7 to 10 m/s assumed"),
        (ReturnSettings(seen_ms=12.3), 6, "return at 15 to 60 m and 10 to 12 m/s assumed"),
        (ReturnSettings(is_px4=True, cruise_ms=5.0), 2, "return at 30 to 60 m assumed"),
    ],
)
def test_only_what_the_vehicle_does_not_state_is_assumed(stated: ReturnSettings, ways: int, words: str) -> None:
    assert len(possible_returns(stated)) == ways
    said = return_assumed(stated)
    assert (words in said) if words else not said


def test_what_a_vehicle_states_has_priority_over_what_is_usual() -> None:
    usual = replace(SETTINGS, return_reason="rally points")
    found = completed(ReturnSettings(cruise_ms=7.0, return_height_m=0.0), usual)
    assert found == replace(SETTINGS, cruise_ms=7.0, return_height_m=0.0)  # reasons are the vehicle's own
    assert completed(SETTINGS, ReturnSettings(cruise_ms=9.0)) == SETTINGS


@pytest.mark.parametrize("rtl_type", [1.0, 3.0])
def test_a_px4_that_prefers_a_landing_flies_straight_home_without_one(rtl_type: float) -> None:
    settings = return_settings({"RTL_TYPE": rtl_type, "RTL_RETURN_ALT": 30.0}, is_px4=True)
    assert return_reason(mission(to(1, 100.0, 0.0, 30.0)), settings) == ""
    landing = mission(to(1, 100.0, 0.0, 30.0), MissionItem(2, Action.LAND))
    vtol = mission(to(1, 100.0, 0.0, 30.0), MissionItem(2, Action.UNKNOWN, command=85, reason="a VTOL lands"))
    begun = mission(to(1, 100.0, 0.0, 30.0), MissionItem(2, Action.OTHER, command=189))
    for flown in (landing, vtol, begun, None):  # without a mission, nobody knows whether it has a landing
        assert f"RTL_TYPE {rtl_type:g}" in return_reason(flown, settings)


def test_the_cone_of_a_px4_counts_only_near_home() -> None:
    """An ArduCopter uses its cone at any distance."""
    cone = replace(SETTINGS, return_cone_slope=0.5)
    px4 = replace(cone, return_cone_within_m=10.0)
    near, far = Point(0.0, 8.0, 2.0), Point(0.0, 40.0, 2.0)
    assert [way_home(at, px4)[0].end.height_m for at in (near, far)] == [4.0, 30.0]
    assert [way_home(at, cone)[0].end.height_m for at in (near, far)] == [4.0, 20.0]
