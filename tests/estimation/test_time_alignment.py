"""Voltage and current of one instant, where telemetry reports one of them late."""

from __future__ import annotations

import math

import pytest

from uavbatt.estimation.time_alignment import Skew
from uavbatt.records import Sample

TIMES_S = (0.0, 1.0, 1.4, 3.0, 4.0, 6.5, 7.0, 8.0)


def voltage_V(time_s: float) -> float:
    return 16.0 - 0.1 * time_s


def current_A(time_s: float) -> float:
    return 10.0 + 2.0 * time_s


@pytest.mark.parametrize("delay_s", [0.5, 2.0, -0.5, -2.0])
def test_both_quantities_of_a_row_are_of_one_instant(delay_s: float) -> None:
    """On straight lines the interpolation is exact, however far apart the rows are."""
    skew, late_s = Skew(delay_s), abs(delay_s)
    for time_s in TIMES_S:
        of_V, of_A = (time_s, time_s - late_s) if delay_s > 0.0 else (time_s - late_s, time_s)
        paired = skew.paired(Sample(time_s, voltage_V(of_V), current_A(of_A)))
        assert paired.time_s == time_s
        if time_s >= late_s:
            assert paired.voltage_V == pytest.approx(voltage_V(time_s - late_s))
            assert paired.current_A == pytest.approx(current_A(time_s - late_s))


def test_before_the_late_quantity_comes_the_early_one_is_that_of_the_first_row() -> None:
    skew = Skew(5.0)
    found = [skew.paired(Sample(time_s, voltage_V(time_s), 10.0)).voltage_V for time_s in TIMES_S[:5]]
    assert found == [voltage_V(0.0)] * 5


@pytest.mark.parametrize("time_s", [3.0, 1.2])
def test_a_row_that_is_not_later_than_the_last_has_no_partner(time_s: float) -> None:
    skew = Skew(0.5)
    for known_s in TIMES_S[:4]:
        skew.paired(Sample(known_s, voltage_V(known_s), 10.0))
    assert math.isnan(skew.paired(Sample(time_s, 12.0, 10.0)).voltage_V)
    after = skew.paired(Sample(4.0, voltage_V(4.0), current_A(3.5)))
    assert after.voltage_V == pytest.approx(voltage_V(3.5))  # the row out of order left nothing behind
