"""A current that leaps: used at once where the voltage answers, else not for seconds, and used if it stays."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import pytest
from cases import first_quick
from scoring.other_pack import Pack
from scoring.scenarios import flight

from uavbatt import Estimator
from uavbatt.records import PackFacts, Sample, Status
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


@pytest.mark.parametrize(
    ("amps", "count"), first_quick(3, [(300.0, 8), (60.0, 6), (0.0, 1), (-300.0, 1), (300.0, 1), (300.0, 2), (60.0, 1)])
)
def test_a_spike_that_the_voltage_does_not_answer_moves_no_time(amps: float, count: int) -> None:
    hit = time_left_s(struck(amps, count))
    assert hit == pytest.approx(list(sound()), rel=0.005)


def test_a_burst_of_a_quarter_minute_does_not_end_the_number() -> None:
    """Its end looked like a current sensor that fails, for the rest of the flight."""
    estimator = Estimator.from_battery("lipo-generic", cells=4, capacity_Ah=CAPACITY_AH, cutoff_V=13.2)
    said = list(estimator.run(struck(150.0, 15)))
    assert Status.REFUSED not in {estimate.status for estimate, _ in said[STRUCK:]}


def cleaned(changes: list[tuple[float, float]], row_s: float = 1.0, *, is_compensated: bool = False) -> list[float]:
    """The currents that are used, of rows with these voltages and currents."""
    cleaner, used = Cleaner().with_facts(PackFacts(sag_compensated=is_compensated)), []
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
@pytest.mark.parametrize(("amps", "wait_s"), [(60.0, 8.0), (120.0, 10.0), (0.0, 2.0)])
def test_a_current_that_stays_counts_after_a_while(amps: float, wait_s: float, row_s: float) -> None:
    """A rise of 8 C after 8 s, a larger one after 10 s; a fall, which may be a failed sensor, after 2 s."""
    used = cleaned([CRUISE, *[(15.4, amps)] * 60], row_s)
    held = used.count(20.0) - 1
    assert held == math.ceil(wait_s / row_s - 1e-9)
    assert used[held + 1 :] == [amps] * (60 - held)


def test_a_voltage_made_free_of_the_load_is_not_waited_for() -> None:
    used = cleaned([CRUISE, *[(15.4, 60.0)] * 20], is_compensated=True)
    assert used == [20.0] * 3 + [60.0] * 18


@pytest.mark.parametrize("row_s", [10.0, 25.0])
def test_a_slow_row_of_a_leap_is_held_once(row_s: float) -> None:
    """One row of ten times the current, in flights with a row every 12 s, took up to 160 s of 229."""
    assert cleaned([CRUISE, (15.4, 60.0), CRUISE], row_s) == [20.0, 20.0, 20.0]
    assert cleaned([CRUISE, (15.4, 60.0), (15.4, 60.0)], row_s) == [20.0, 20.0, 60.0]
    assert cleaned([CRUISE, CLIMB, CRUISE], row_s) == [20.0, 60.0, 20.0]


def test_rows_that_are_far_apart_are_used_as_they_come() -> None:
    assert cleaned([CRUISE, (15.4, 60.0), CRUISE], row_s=40.0) == [20.0, 60.0, 20.0]
