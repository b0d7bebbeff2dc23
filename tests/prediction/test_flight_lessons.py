"""The lessons of flown legs: a regression of two numbers, and a wind of a minute."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uavbatt.navigation import Wind
from uavbatt.prediction.route.flight_lessons import SHORT_LEG_S, FlightLessons, Timing
from uavbatt.prediction.route.legs import Leg, Phase, Point

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
