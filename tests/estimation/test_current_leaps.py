"""A current that leaps: used at once where the voltage answers, else not for two seconds, and used if it stays."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest
from scoring.other_pack import Pack
from scoring.scenarios import flight

from uavbatt import Estimator
from uavbatt.records import Sample
from uavbatt.telemetry.cleaning.cleaner import Cleaner

STRUCK, SHOWN = 150, 240  # rows, one a second
CAPACITY_AH = 5.0


@cache
def rows() -> tuple[Sample, ...]:
    return tuple(flight(Pack())[:SHOWN])


def struck(amps: float, count: int = 1) -> list[Sample]:
    """The flight with some rows of one current, which the pack never gave."""
    return [replace(s, current_A=amps) if 0 <= k - STRUCK < count else s for k, s in enumerate(rows())]


def time_left_s(flown: list[Sample]) -> list[float]:
    """The time left after the spike, row by row."""
    estimator = Estimator.from_battery("lipo-generic", cells=4, capacity_Ah=CAPACITY_AH, cutoff_V=13.2)
    return [remaining.remaining_s for _, remaining in estimator.run(flown)][STRUCK:]


@cache
def sound() -> tuple[float, ...]:
    return tuple(time_left_s(list(rows())))


@pytest.mark.parametrize(("amps", "count"), [(300.0, 1), (300.0, 2), (60.0, 1), (0.0, 1), (-300.0, 1)])
def test_a_spike_that_the_voltage_does_not_answer_moves_no_time(amps: float, count: int) -> None:
    hit = time_left_s(struck(amps, count))
    assert hit == pytest.approx(list(sound()), rel=0.005)


def cleaned(changes: list[tuple[float, float]], row_s: float = 1.0) -> list[float]:
    """The currents that are used, of rows with these voltages and currents."""
    cleaner, used = Cleaner(), []
    for k, (volts, amps) in enumerate(changes):
        cleaner, sample = cleaner.clean(Sample(k * row_s, volts, amps), capacity_Ah=CAPACITY_AH)
        used.append(sample.current_A)
    return used


CRUISE, CLIMB = (15.4, 20.0), (14.6, 60.0)


def test_a_climb_counts_from_its_first_row() -> None:
    assert cleaned([CRUISE, CLIMB, CLIMB, CRUISE]) == [20.0, 60.0, 60.0, 20.0]


def test_a_climb_whose_voltage_comes_late_counts_with_it() -> None:
    assert cleaned([CRUISE, (15.4, 60.0), CLIMB, (14.6, 20.0), CRUISE]) == [20.0, 20.0, 60.0, 60.0, 20.0]


@pytest.mark.parametrize("row_s", [0.1, 0.3, 1.0])
def test_a_current_that_comes_after_its_voltage_counts_at_once(row_s: float) -> None:
    assert cleaned([CRUISE, CRUISE, (14.6, 20.0), CLIMB, CLIMB], row_s) == [20.0, 20.0, 20.0, 60.0, 60.0]


@pytest.mark.parametrize("row_s", [0.2, 1.0, 4.0])
def test_a_current_that_stays_counts_after_two_seconds(row_s: float) -> None:
    """A voltage that is made free of the load by the autopilot never answers."""
    used = cleaned([CRUISE, *[(15.4, 60.0)] * 20], row_s)
    held = used.count(20.0) - 1
    assert held * row_s == pytest.approx(max(2.0, row_s), abs=1e-6)
    assert used[held + 1 :] == [60.0] * (20 - held)


def test_rows_that_are_far_apart_are_used_as_they_come() -> None:
    assert cleaned([CRUISE, (15.4, 60.0), CRUISE], row_s=10.0) == [20.0, 60.0, 20.0]
