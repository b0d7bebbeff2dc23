"""A pack that cannot be what is stated: no number until the voltage has told how much it holds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from factories import generic_pack

from uavbatt.battery.state_space import SIZE, Belief
from uavbatt.estimation.monitor import LARGE, MANY_OHMS, SMALL, Innovations, Monitor
from uavbatt.records import NAN, Estimate, Sample, Status

BELIEF = Belief.gaussian(np.zeros(SIZE), 1e-4 * np.eye(SIZE), 20.0)


def seen(monitor: Monitor, capacity: float, sd: float, ohms: float = 1.0) -> Monitor:
    """The monitor after a row at which a pack is believed in: capacity and ohms against what is stated."""
    time_s = 0.0 if np.isnan(monitor.sensors.changes.time_s) else monitor.sensors.changes.time_s + 1.0
    sample = Sample(time_s, 15.0 - 0.01 * time_s, 20.0 + time_s)
    estimate = Estimate(
        time_s, 0.5, 0.05, 15.0, 20.0, NAN, 300.0, 0.0, 1.0, Status.OK, "",
        capacity_scale=capacity, capacity_scale_sd=sd, wear=ohms - 1.0, wear_sd=0.1,
    )  # fmt: skip
    return monitor.after(sample, estimate, BELIEF, generic_pack())


@pytest.mark.parametrize("capacity, sd", [(1.0, 0.1), (0.9, 0.25), (0.75, 0.05), (0.6, 0.2)])
def test_wear_is_not_refused(capacity: float, sd: float) -> None:
    assert seen(Monitor(), capacity, sd).refusal == ""


def test_far_less_than_stated_is_refused_until_it_is_known_by_how_much() -> None:
    monitor = seen(Monitor(), 0.30, 0.15)
    assert monitor.refusal == SMALL and SMALL in monitor.doubts
    known = seen(monitor, 0.30, 0.03)
    assert known.refusal == "" and SMALL in known.doubts
    assert seen(known, 0.25, 0.10).refusal == ""  # the last half minute is no time to lose the number again


@pytest.mark.parametrize("capacity, sd, is_doubted", [(1.1, 0.1, False), (1.35, 0.15, False), (1.5, 0.05, True)])
def test_far_more_than_stated_is_doubted(capacity: float, sd: float, is_doubted: bool) -> None:
    """A pack warm from the car in cold air was believed half as large again, and its lower end `ok` 164 s too long."""
    monitor = seen(Monitor(), capacity, sd)
    assert (LARGE in monitor.doubts) is is_doubted and monitor.refusal == ""


@pytest.mark.parametrize("ohms, refusal", [(3.0, ""), (6.0, MANY_OHMS)])
def test_the_ohms_of_a_far_smaller_pack_are_refused(ohms: float, refusal: str) -> None:
    """A poor pack has three times the ohms of a new one; ten times the capacity stated shows as six."""
    assert seen(Monitor(), 0.75, 0.28, ohms).refusal == refusal


@pytest.mark.parametrize("row_s", [2.0, 10.0, 30.0])
def test_a_misfit_of_a_minute_is_one_at_any_distance_of_the_rows(row_s: float) -> None:
    """NIS of 8, where 2 are expected: too large within two minutes, whether a block lasts 2 s or 30 s."""
    watch, high_s = Innovations(), []
    for k in range(int(180.0 / row_s)):
        watch = watch.after(k * row_s, 8.0)
        high_s += [k * row_s] if math.isfinite(watch.high_since_s) else []
    assert 30.0 <= high_s[0] <= 90.0


def test_three_rows_that_are_far_off_are_no_misfit_of_a_minute() -> None:
    watch = Innovations()
    for k in range(60):
        watch = watch.after(2.0 * k, 5000.0 if 20 <= k < 22 else 1.0)
        assert math.isnan(watch.high_since_s)
