"""The lessons of flown legs: a regression of two numbers, a wind of a minute, a level with its uncertainty."""

from __future__ import annotations

import math

import numpy as np
import pytest
from route_rig import POWERS

from uavbatt.battery.powers import UNKNOWN
from uavbatt.navigation import Wind
from uavbatt.prediction.flight_lessons import LEVEL_TAU_S, SHORT_LEG_S, FlightLessons, Timing
from uavbatt.prediction.route_legs import Leg, Phase, Point

SPEED_MS = 5.0


def leg(planned_s: float, hold_s: float = 0.0, phase: Phase = Phase.ROUTE) -> Leg:
    end = Point(SPEED_MS * planned_s, 0.0, 30.0)
    return Leg(1, phase, Point(0.0, 0.0, 30.0), end, SPEED_MS * planned_s, SPEED_MS, 2.5, 1.5, hold_s)


def test_stretch_and_speeding_are_those_of_a_regression_with_a_prior() -> None:
    """Prior and legs as rows of one system of least squares, each divided by its sd."""
    flown = [(66.0, 60.0, 5.0), (49.0, 40.0, 8.0), (130.0, 120.0, 3.0)]  # flown [s], planned [s], speed [m/s]
    timing = Timing()
    rows, values = [[1 / 0.1, 0.0], [0.0, 1 / 0.12]], [1.03 / 0.1, 0.32 / 0.12]
    for flown_s, planned_s, speed_ms in flown:
        timing = timing.after(flown_s, planned_s, speed_ms)
        sd_s = math.hypot(2.0, 0.08 * planned_s)
        rows.append([planned_s / sd_s, speed_ms / sd_s])
        values.append(flown_s / sd_s)
    expected, *_ = np.linalg.lstsq(np.array(rows), np.array(values), rcond=None)
    assert timing.factors == pytest.approx(tuple(expected))
    covariance = np.linalg.inv(np.array(rows).T @ np.array(rows))
    leg_to_come = np.array([80.0, 6.0])
    said = timing.sd(np.array([80.0]), np.array([6.0]))
    assert said == pytest.approx([math.sqrt(leg_to_come @ covariance @ leg_to_come)])


@pytest.mark.parametrize("flown_s", [1e4, 0.0])
def test_no_leg_can_make_the_factors_impossible(flown_s: float) -> None:
    timing = Timing()
    for _ in range(50):
        timing = timing.after(flown_s, 60.0, 5.0)
    stretch, speeding = timing.factors
    assert 0.5 <= stretch <= 2.0 and -0.5 <= speeding <= 2.0


def test_short_and_long_legs_teach_each_their_own_timing() -> None:
    short, long = leg(SHORT_LEG_S - 0.1), leg(SHORT_LEG_S)
    fresh = FlightLessons()
    after_short = fresh.with_timing([short], 1.1 * short.moving_s + 3.0)
    after_long = fresh.with_timing([long], 1.1 * long.moving_s + 3.0)
    assert (after_short.long, after_long.short) == (fresh.long, fresh.short)
    assert after_short.expected_s(short) > fresh.expected_s(short)
    assert after_long.expected_s(long) > fresh.expected_s(long)
    assert fresh.with_timing([short, long], 1.1 * 40.0) is fresh  # which of the two took longer is not known


@pytest.mark.parametrize(("late_s", "is_used"), [(0.4 * 63.4 + 7.0, True), (0.4 * 63.4 + 9.0, False)])
def test_a_leg_of_an_unusual_time_teaches_nothing(late_s: float, is_used: bool) -> None:
    """Usual are 1.03 · 60 s + 0.32 · 5 s = 63.4 s; beyond 40 % and 8 s more something else has happened."""
    fresh = FlightLessons()
    assert (fresh.with_timing([leg(60.0)], 63.4 + late_s) is not fresh) is is_used


def test_a_wait_at_the_end_of_a_leg_is_no_flight_and_a_take_off_no_leg() -> None:
    fresh = FlightLessons()
    assert fresh.with_timing([leg(60.0, hold_s=50.0)], 115.0) == fresh.with_timing([leg(60.0)], 65.0)
    assert fresh.with_timing([leg(60.0, phase=Phase.TAKE_OFF)], 65.0) is fresh
    assert fresh.expected_s(leg(60.0, hold_s=50.0)) == pytest.approx(1.03 * 60.0 + 0.32 * SPEED_MS + 50.0)


@pytest.mark.parametrize("row_s", [0.2, 1.0, 10.0])
def test_the_wind_is_averaged_over_a_minute_whatever_the_rows_are(row_s: float) -> None:
    lessons = FlightLessons().with_wind(Wind(0.0, 4.0), 0.0)
    for _ in range(round(60.0 / row_s)):
        lessons = lessons.with_wind(Wind(6.0, 4.0), row_s)
    assert lessons.wind == pytest.approx((6.0 * (1.0 - math.exp(-1.0)), 4.0))
    assert lessons.with_wind(None, row_s) is lessons


def test_the_level_goes_from_the_prior_to_what_was_flown_and_forgets() -> None:
    fresh = FlightLessons()
    assert fresh.level(POWERS) == (1.0, POWERS.level_sd)
    long_flown, sds = fresh, []
    for _ in range(300):
        long_flown = long_flown.with_power_ratio(1.2, 1.0)
        sds.append(long_flown.level(POWERS)[1])
    assert 1.1 < long_flown.level(POWERS)[0] < 1.2  # the law of the powers may be off by as much
    assert all(after <= before for before, after in zip([POWERS.level_sd, *sds], sds, strict=False))
    changed = long_flown
    for _ in range(round(3.0 * LEVEL_TAU_S)):
        changed = changed.with_power_ratio(0.9, 1.0)
    assert 0.9 < changed.level(POWERS)[0] < 0.95


@pytest.mark.parametrize("after", [1.35, 0.7])
def test_a_payload_changed_in_flight_is_known_after_two_minutes(after: float) -> None:
    """It was averaged away: eight minutes after 35 % more power the time left was a quarter too long."""
    lessons = FlightLessons()
    for second in range(500):
        lessons = lessons.with_power_ratio(1.0 + 0.02 * math.sin(second / 5.0), 1.0, 0.03)
    for _ in range(120):
        lessons = lessons.with_power_ratio(after, 1.0, 0.03)
    mean = lessons.level_sum_s / lessons.level_s
    assert mean == pytest.approx(after, abs=0.09)


def test_gusts_and_a_front_change_no_payload() -> None:
    """12 % for two minutes, and noisy rows: what was flown before still counts."""
    lessons, dice = FlightLessons(), np.random.default_rng(1)
    for second in range(620):
        ratio = (1.12 if second > 500 else 1.0) * math.exp(0.1 * dice.standard_normal())
        lessons = lessons.with_power_ratio(ratio, 1.0, 0.1)
    assert lessons.level_s > 300.0
    assert lessons.level_sum_s / lessons.level_s < 1.05


def test_an_unknown_aircraft_has_no_level_before_it_has_flown_a_while() -> None:
    lessons = FlightLessons()
    for second in range(40):
        assert math.isfinite(lessons.level(UNKNOWN)[0]) is (second > 20)
        lessons = lessons.with_power_ratio(1.3, 1.0)
    assert lessons.level(UNKNOWN)[0] == pytest.approx(1.3)
