"""An effect that changes within each flight: it is none that has a name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from planted_flights import FILE, MISSIONS, PACK, fly, found

from uavbatt.battery.model import Array
from uavbatt.diagnosis.diagnosis import options_of, problem_of
from uavbatt.diagnosis.refit.candidates import NOTHING
from uavbatt.diagnosis.refit.solver import refit
from uavbatt.diagnosis.search.drift import drifting
from uavbatt.fitting.observed import ObservedRecord


def from_to(record: ObservedRecord, first: float, last: float) -> ObservedRecord:
    """The record as a current sensor shows it whose gain goes from one value to another."""
    run = record.time_s / record.time_s[-1]
    return replace(record, current_A=record.current_A * (first + (last - first) * run))


def warming(record: ObservedRecord, per_K: float) -> ObservedRecord:
    """The record as a converter shows it whose gain goes with the temperature: right at 25 °C."""
    return replace(record, voltage_V=record.voltage_V * (1.0 + per_K * (record.temp_C - 25.0)))


@pytest.fixture(scope="module")
def flights() -> list[ObservedRecord]:
    return [fly(*mission) for mission in MISSIONS[:3]]


def test_a_gain_that_grows_over_each_flight_is_no_declared_effect(flights: list[ObservedRecord]) -> None:
    diagnosis = found([from_to(r, 1.0, 1.3) for r in flights])
    assert diagnosis.verdict == "undeclared_effect"
    assert any("current_gain is not the same throughout a record: it changes by +0.3" in r for r in diagnosis.reasons)
    assert all(c.probability <= 0.4 for c in diagnosis.classes)
    assert not diagnosis.after.candidate.names  # nothing of it enters the battery file


@pytest.mark.parametrize(
    ("name", "reading"),
    [
        pytest.param("voltage_offset", lambda r: r.voltage_V + 0.2 * r.time_s / r.time_s[-1], marks=pytest.mark.slow),
        ("voltage_gain", lambda r: r.voltage_V * (1.0 + 0.02 * r.time_s / r.time_s[-1])),
    ],
)
def test_a_drift_is_told_although_a_steady_value_of_another_effect_fits_better(
    flights: list[ObservedRecord], name: str, reading: Callable[[ObservedRecord], Array]
) -> None:
    """Of these two a pair was named, or a gain of the current, while only the best single effect could drift."""
    diagnosis = found([replace(r, voltage_V=reading(r)) for r in flights])
    assert diagnosis.verdict == "undeclared_effect"
    assert any(f"{name} is not the same throughout a record" in r for r in diagnosis.reasons)
    assert all(c.probability <= 0.4 for c in diagnosis.classes)


def test_a_voltage_whose_gain_goes_with_the_temperature_is_no_declared_effect() -> None:
    cold = [fly(8.0, 170.0, 2), fly(12.0, 150.0, 5), fly(17.0, 140.0, 4)]
    diagnosis = found([warming(r, 0.0015) for r in cold])
    assert diagnosis.verdict == "undeclared_effect"
    told = [r for r in diagnosis.reasons if "voltage_gain is not the same throughout a record" in r]
    assert told and "from the coldest of the temperatures read to the warmest" in told[0]
    assert all(c.probability <= 0.4 for c in diagnosis.classes)
    assert not diagnosis.after.candidate.names


@pytest.mark.slow  # the voltage whose gain goes with the temperature, above, is its witness
def test_a_converter_that_warms_is_told_where_no_effect_is_worth_a_name(flights: list[ObservedRecord]) -> None:
    diagnosis = found([warming(r, 0.0015) for r in flights])
    assert diagnosis.verdict == "undeclared_effect"
    assert diagnosis.classes[0].members == ("voltage_gain",) and diagnosis.classes[0].probability <= 0.4
    assert any("voltage_gain is not the same throughout a record" in r for r in diagnosis.reasons)


@pytest.mark.slow  # planted gains in test_diagnosis.py are its witness
def test_a_gain_of_the_voltage_that_is_the_same_throughout_is_named(flights: list[ObservedRecord]) -> None:
    diagnosis = found([replace(r, voltage_V=1.015 * r.voltage_V) for r in flights])
    assert diagnosis.verdict == "effect_found"
    assert "voltage_gain" in diagnosis.classes[0].members


@pytest.mark.slow
def test_a_gain_that_is_the_same_throughout_is_named(flights: list[ObservedRecord]) -> None:
    diagnosis = found([from_to(r, 1.15, 1.15) for r in flights])
    assert diagnosis.verdict == "effect_found"
    assert diagnosis.classes[0].members[0] == "current_gain"


def test_a_refit_with_a_drift_finds_how_large_it_is(flights: list[ObservedRecord]) -> None:
    problem = problem_of([from_to(r, 1.0, 1.3) for r in flights], FILE, PACK)
    options = {o.name: o for o in options_of(problem, FILE, ())}
    steady = refit(problem, [options["current_gain"]], start=[refit(problem, [NOTHING])[0]])[0]
    drift = drifting(problem, steady)
    assert drift is not None and drift.total < steady.total
    np.testing.assert_allclose(drift.values()[0], [1.15, 0.3], atol=0.03)


def test_a_refit_with_a_drift_along_the_temperature_finds_how_large_it_is(flights: list[ObservedRecord]) -> None:
    records = [warming(r, 0.0015) for r in flights]
    gap = (flights[0].time_s > 300.0) & (flights[0].time_s < 400.0)  # what was not read is between what was
    records[0] = replace(records[0], temp_C=np.where(gap, np.nan, records[0].temp_C))
    problem = problem_of(records, FILE, PACK)
    options = {o.name: o for o in options_of(problem, FILE, ())}
    steady = refit(problem, [options["voltage_gain"]], start=[refit(problem, [NOTHING])[0]])[0]
    drift = drifting(problem, steady, "temperature")
    assert drift is not None and drift.total < steady.total
    coldest_C, warmest_C = np.nanmin(problem.evidence.stack.temp_C), np.nanmax(problem.evidence.stack.temp_C)
    gain = 1.0 + 0.0015 * (0.5 * (coldest_C + warmest_C) - 25.0)
    np.testing.assert_allclose(drift.values()[0], [gain, 0.0015 * (warmest_C - coldest_C)], atol=0.003)


def test_what_acts_on_the_state_of_the_cell_does_not_drift(flights: list[ObservedRecord]) -> None:
    problem = problem_of(flights, FILE, PACK)
    fade = next(o for o in options_of(problem, FILE, ()) if o.name == "capacity_fade")
    assert drifting(problem, refit(problem, [fade], iterations=1)[0]) is None
