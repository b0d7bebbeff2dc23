"""Places, winds and homes that no aircraft can have: they neither end a forecast nor raise an alarm."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from uavbatt.navigation import METRES_PER_DEGREE, NAN, Home, Position
from uavbatt.telemetry.route.builder import NavigationBuilder

LAT_DEG, LON_DEG = 60.0, 179.9999  # near the line where the longitude begins anew
EAST_DEG = 1.0 / (METRES_PER_DEGREE * math.cos(math.radians(LAT_DEG)))  # of one metre
Velocity = tuple[float, float, float]


def take(
    builder: NavigationBuilder, time_s: float, east_m: float, height_m: float = 30.0, told: Velocity = (0.0, 8.0, 0.0)
) -> Position:
    """Return the position that is known after one more message."""
    builder.position(time_s, LAT_DEG, math.remainder(LON_DEG + east_m * EAST_DEG, 360.0), height_m, *told)
    known = builder.now.position
    assert known is not None
    return known


def east_m(place: Position) -> float:
    return math.remainder(place.lon_deg - LON_DEG, 360.0) / EAST_DEG


@pytest.mark.parametrize(("leap_m", "high_m"), [(400.0, 0.0), (30_000.0, 0.0), (0.0, 2000.0), (-1e6, 0.0)])
def test_a_leap_of_some_seconds_moves_nothing(leap_m: float, high_m: float) -> None:
    builder = NavigationBuilder()
    for half in range(40):
        is_lost = 10 <= half < 16
        place = take(builder, half / 2, 4.0 * half + leap_m * is_lost, 30.0 + high_m * is_lost)
        assert east_m(place) == pytest.approx(36.0 if is_lost else 4.0 * half, abs=0.01)
        assert place.height_m == 30.0


def test_a_place_that_stays_is_believed_in_the_end() -> None:
    """The estimator had the wrong place before, or the aircraft was carried while nobody listened."""
    builder = NavigationBuilder()
    for half in range(40):
        place = take(builder, half / 2, 500.0 * (half >= 10), told=(0.0, 0.1, 0.0))
        assert east_m(place) == pytest.approx(500.0 if half >= 20 else 0.0, abs=0.01)
        assert place.east_ms == 0.1  # nothing flew at 1000 m/s


def test_places_that_leap_about_are_not_believed() -> None:
    builder = NavigationBuilder()
    take(builder, 0.0, 0.0)
    for half in range(1, 60):
        assert east_m(take(builder, half / 2, 9000.0 * (half % 2 or -1))) == 0.0


@pytest.mark.parametrize("step_s", [0.25, 1.0, 30.0])
@pytest.mark.parametrize("speed_ms", [8.0, 25.0, 60.0])
def test_every_place_of_a_flight_is_believed(speed_ms: float, step_s: float) -> None:
    builder = NavigationBuilder()
    for k in range(20):
        assert east_m(take(builder, k * step_s, speed_ms * k * step_s)) == pytest.approx(speed_ms * k * step_s, abs=0.1)


def test_a_clock_that_is_set_back_is_no_leap() -> None:
    builder = NavigationBuilder()
    take(builder, 1000.0, 0.0)
    assert east_m(take(builder, 5.0, 900.0)) == pytest.approx(900.0)


@pytest.mark.parametrize("untold", [(0.0, 0.0, 0.0), (NAN, NAN, NAN), (8.0, 0.0, NAN), (300.0, 0.0, 0.0)])
def test_a_velocity_that_is_not_told_is_that_of_the_places(untold: Velocity) -> None:
    builder = NavigationBuilder()
    take(builder, 0.0, 0.0, 30.0, untold)
    place = take(builder, 0.5, 6.0, 31.0, untold)
    assert (place.north_ms, place.east_ms, place.up_ms) == pytest.approx((0.0, 12.0, 2.0), abs=1e-6)


def test_a_hover_of_an_autopilot_that_tells_velocities_is_a_hover() -> None:
    """The place of a receiver wanders by a metre while the aircraft stands."""
    builder = NavigationBuilder()
    take(builder, 0.0, 0.0)
    assert take(builder, 0.5, 1.0, told=(0.0, 0.0, 0.0)).east_ms == 0.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_vertical_velocity_of_the_wrong_sign_is_turned_by_the_heights(sign: float) -> None:
    """ArduPilot sent it so until 2018: climbs were taken for descents, and the turn-back was wrong by 50 s."""
    builder, climbs_ms = NavigationBuilder(), [2.5] * 20 + [0.0] * 20 + [-1.5] * 20
    height_m, up_ms = 0.0, []
    for half, climb_ms in enumerate(climbs_ms):
        height_m += 0.5 * climb_ms
        up_ms.append(take(builder, 0.5 * half, 4.0 * half, height_m, (0.0, 8.0, sign * climb_ms)).up_ms)
    assert up_ms[8:] == pytest.approx(climbs_ms[8:])


def test_a_height_that_is_never_told_turns_no_velocity() -> None:
    builder = NavigationBuilder()
    assert [take(builder, k, 8.0 * k, 0.0, (0.0, 8.0, 2.5)).up_ms for k in range(20)] == [2.5] * 20


def test_places_far_apart_in_time_tell_no_velocity() -> None:
    builder = NavigationBuilder()
    take(builder, 0.0, 0.0, told=(NAN, NAN, NAN))
    assert math.isnan(take(builder, 20.0, 40.0, told=(NAN, NAN, NAN)).east_ms)


def test_a_step_of_the_place_is_no_velocity() -> None:
    """An estimator that corrects itself by 45 m in half a second did not fly at 90 m/s."""
    builder = NavigationBuilder()
    places = [take(builder, half / 2, 45.0 * (half >= 3), told=(NAN, NAN, NAN)) for half in range(6)]
    assert [east_m(place) for place in places] == pytest.approx([0.0, 0.0, 0.0, 45.0, 45.0, 45.0])
    speeds_ms = [place.east_ms for _, place in pairwise(places)]
    assert speeds_ms == pytest.approx([0.0, 0.0, NAN, 0.0, 0.0], nan_ok=True)


def test_a_wind_in_which_nothing_flies_is_a_fault() -> None:
    builder = NavigationBuilder()
    builder.wind(0.0, 12.0, -9.0)
    builder.wind(1.0, 80.0, 0.0)
    builder.wind(2.0, math.inf, 0.0)
    assert builder.now.wind is not None
    assert (builder.now.wind.north_ms, builder.now.wind.east_ms) == (12.0, -9.0)


def test_a_home_out_of_all_reach_is_a_fault() -> None:
    home, wrong = Home(LAT_DEG, LON_DEG, 400.0), Home(LAT_DEG + 30.0, LON_DEG, 400.0)
    builder = NavigationBuilder()
    builder.home(0.0, home)
    take(builder, 1.0, 40.0)
    builder.home(2.0, wrong)
    assert builder.now.home == home
    builder.home(3.0, moved := Home(LAT_DEG + 0.01, -LON_DEG, 400.0))  # 1.1 km away, across 180 degrees
    assert builder.now.home == moved
