"""The first minutes: what was expected at take-off widens what the flight itself says, and fades."""

from __future__ import annotations

import math

import numpy as np
import pytest
from factories import generic_pack

from uavbatt import Estimator, Sample
from uavbatt.prediction.load.library import UnknownAircraft
from uavbatt.prediction.load.scenarios import ConstantLoad, RecentMean
from uavbatt.prediction.simulation.time_to_end import EndTimes
from uavbatt.prediction.take_off import FORGOTTEN_S, AtTakeOff, is_open, load_before_take_off
from uavbatt.records import Remaining

EXPECTED_S = tuple(np.linspace(300.0, 1800.0, 64).tolist())


def joined(fresh_s: np.ndarray, at_s: float) -> np.ndarray:
    return AtTakeOff(100.0, 250.0, EXPECTED_S, EXPECTED_S).joined(at_s, EndTimes(fresh_s, fresh_s)).end_s


def test_at_take_off_the_upper_end_is_what_was_expected() -> None:
    ends_s = joined(np.linspace(400.0, 700.0, 128), 100.0)
    assert ends_s[-1] > 1700.0 and np.all(np.diff(ends_s) >= 0.0)


def test_it_fades_and_is_gone_after_minutes() -> None:
    fresh_s = np.linspace(400.0, 700.0, 128)
    tops = [joined(fresh_s, 100.0 + age_s)[-1] for age_s in (0.0, 60.0, 120.0, FORGOTTEN_S)]
    assert tops == sorted(tops, reverse=True) and tops[-1] == 700.0
    assert joined(fresh_s, 101.0 + FORGOTTEN_S) is fresh_s


def test_a_flight_that_looks_short_is_not_talked_well() -> None:
    """The lower end and, where little seems left, the middle are never later than by the flight itself."""
    for short_s in (np.linspace(0.0, 90.0, 128), np.linspace(50.0, 800.0, 128)):
        ends_s = joined(short_s, 110.0)
        assert np.all(ends_s[:32] <= short_s[:32])
    assert np.median(joined(np.linspace(0.0, 90.0, 128), 110.0)) <= 45.5


def test_a_flight_that_looks_long_is_taken_down_to_what_was_expected() -> None:
    """Motors that idle on the ground promise hours."""
    ends_s = joined(np.linspace(4000.0, 9000.0, 128), 100.0)
    assert ends_s[6] < 500.0 and ends_s[-1] < 2000.0


def test_the_power_that_is_flown_takes_over_from_the_one_that_was_expected() -> None:
    expected = AtTakeOff(100.0, 250.0, EXPECTED_S, EXPECTED_S)
    at_first, later = (expected.at_power(time_s, 500.0).end_s for time_s in (100.0, 200.0))
    np.testing.assert_array_equal(at_first, EXPECTED_S)
    np.testing.assert_allclose(later, np.array(EXPECTED_S) / 2.0, rtol=0.01)


def test_only_a_load_that_nobody_states_is_expected() -> None:
    assert is_open(UnknownAircraft()) and not is_open(RecentMean()) and not is_open(ConstantLoad(300.0, 0.04))
    pack = generic_pack()
    assert load_before_take_off(ConstantLoad(300.0, 0.04), pack) == ConstantLoad(300.0, 0.04)
    larger = generic_pack(capacity_Ah=10.0)
    small_W, large_W = (load_before_take_off(UnknownAircraft(), p).typical_W(None) for p in (pack, larger))  # type: ignore[arg-type]
    assert large_W == pytest.approx(2.0 * small_W)


def flown(amps: list[float]) -> list[Remaining]:
    """What is said of a 4S 5 Ah pack that draws these currents, one a second."""
    estimator = Estimator.from_battery("lipo-generic", cells=4, capacity_Ah=5.0, cutoff_V=13.2)
    rows = [Sample(float(k), 16.75 - 0.03 * a - 0.0005 * k, a, 25.0) for k, a in enumerate(amps)]
    return [said for _, said in estimator.run(rows)]


def test_the_first_interval_holds_what_is_said_a_minute_later() -> None:
    said = [r for r in flown([0.1] * 10 + [3.0] * 12 + [14.0] * 70) if math.isfinite(r.remaining_s)]
    first, last = said[0], said[-1]
    assert first.time_s < 20.0  # while the motors spool up
    assert first.time_s + first.remaining_lo_s < last.time_s + last.remaining_s < first.time_s + first.remaining_hi_s


def test_spool_up_leaves_nothing_behind() -> None:
    """A minute after the take-off it is the same whether the motors idled before or not."""
    idled = flown([0.1] * 10 + [3.0] * 20 + [14.0] * 60)[-1]
    at_once = flown([0.1] * 30 + [14.0] * 60)[-1]
    assert idled.remaining_s == pytest.approx(at_once.remaining_s, rel=0.1)


def test_nothing_depends_on_a_later_row() -> None:
    amps = [0.1] * 10 + [3.0] * 6 + [14.0] * 40
    whole, cut = ([(r.remaining_lo_s, r.remaining_s, r.remaining_hi_s) for r in flown(a)] for a in (amps, amps[:40]))
    np.testing.assert_array_equal(whole[:40], cut)


def test_a_load_that_doubles_in_flight_never_makes_the_time_longer() -> None:
    """Two minutes after take-off one of two parallel packs falls out, and the other carries all."""
    said = flown([0.1] * 20 + [14.0] * 120 + [28.0] * 60)
    before = next(r.remaining_s for r in said if r.time_s == 139.0)
    assert max(r.remaining_s for r in said if r.time_s >= 140.0) <= before
