"""The report of a row that comes late, and the trend on the page: how the time left went in the last ten minutes."""

from __future__ import annotations

from dataclasses import replace

import pytest

from uavbatt.live.report import LATE_ENDS_SOON, TREND_PERIOD_S, TREND_S, Report, Trend
from uavbatt.records import NAN, Estimate, Remaining, Status


def report(left_s: float, at_s: float, instance: int = 0) -> Report:
    estimate = Estimate(at_s, 0.5, 0.01, 15.0, 12.0, 25.0, 180.0, 0.0, 1.0, Status.OK)
    remaining = Remaining(at_s, left_s, left_s - 60.0, left_s + 90.0, NAN, Status.OK, "", left_s - 60.0)
    return Report(instance, 1, 1, estimate, remaining, at_s)


@pytest.mark.parametrize(("late_s", "shown_s"), [(2.9, 300.0), (3.1, 296.9), (9.9, 290.1)])
def test_a_delay_of_seconds_is_deducted_and_one_within_the_usual_is_not(late_s: float, shown_s: float) -> None:
    late = report(300.0, 100.0).late_by(late_s)
    assert late.at(100.0).remaining_s == pytest.approx(shown_s)
    assert late.at(102.0).remaining_s == pytest.approx(shown_s - 2.0)
    assert any("comes late" in warning for warning in late.estimate.warnings) == (shown_s < 300.0)


def test_a_line_has_the_numbers_of_now() -> None:
    found = replace(report(300.0, 100.0), cells=4, flying_since_s=40.0).as_line(102.04)
    told = {"age_s": 2.04, "remaining_s": 298.0, "flight_s": 62.0, "cells": 4, "cell_voltage_V": 3.75, "waiting": False}
    assert {key: found[key] for key in told} == told
    unknown = report(300.0, 100.0).as_line(102.04)
    assert unknown["cells"] is None and unknown["cell_voltage_V"] is None and unknown["plan_s"] is None
    late = replace(report(300.0, 100.0), cells=4).as_line(110.0)
    assert (late["status"], late["remaining_s"], late["cell_voltage_V"], late["cells"]) == ("stale", None, None, 4)


def test_a_point_has_its_age_and_the_interval_of_its_time() -> None:
    trend = Trend()
    trend.look(100.0, [report(600.0, 100.0), report(300.0, 100.0, instance=1)])
    trend.look(107.0, [report(590.0, 107.0)])
    assert trend.lines(110.0) == {
        0: [[10.0, 600.0, 540.0, 690.0], [3.0, 590.0, 530.0, 680.0]],
        1: [[10.0, 300.0, 240.0, 390.0]],
    }


def test_a_point_is_taken_every_five_seconds_and_kept_for_ten_minutes() -> None:
    trend = Trend()
    for second in range(1000):
        trend.look(float(second), [report(2000.0 - second, float(second))])
    ages_s = [point[0] for point in trend.lines(999.0)[0]]
    assert len(ages_s) == TREND_S / TREND_PERIOD_S + 1
    assert ages_s[0] == 4.0 + TREND_S and ages_s[-1] == 4.0  # the last point was taken at 995 s


def test_a_silence_is_a_gap_and_another_vehicle_begins_anew() -> None:
    trend, last = Trend(), report(600.0, 100.0)
    trend.look(100.0, [last])
    trend.look(160.0, [last])
    assert trend.lines(160.0)[0][-1] == [0.0, None, None, None]
    trend.forget()
    assert trend.lines(160.0) == {}


@pytest.mark.parametrize(
    ("late_s", "left_s", "is_told"),
    [(30.0, 205.0, True), (30.0, 215.0, False), (9.0, 185.0, False), (11.0, 185.0, True), (2.0, 100.0, False)],
)
def test_a_row_that_comes_too_late_warns_by_the_time_that_has_passed_since(
    late_s: float, left_s: float, is_told: bool
) -> None:
    """Its number is no longer shown, so that the alarm must not wait for one. At worst 60 s less are left than said."""
    late = report(left_s, 100.0).late_by(late_s)
    assert (LATE_ENDS_SOON in late.estimate.warnings) is is_told
    assert late.is_stale(100.0) is (late_s > 10.0)
