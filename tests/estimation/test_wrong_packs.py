"""Packs of another model that hold less than stated: the table of the issue, and what must follow from row to row.

A 4S pack of a stated 5 Ah that holds 5.0 to 3.5, 4 mohm a cell, 300 W with gusts, cut-off 13.2 V, charged full; once
with the generic battery, once with one that was fitted to flights of healthy packs of the same make.
"""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scoring import wrong_cases, wrong_judged
from scoring.other_pack import CELLS, CUTOFF_V, FULL_AH, MAKES, SOC, Flown, Make
from scoring.wrong_cases import FITTED, GENERIC, ISSUE_AH, Case
from scoring.wrong_judged import Judged

from uavbatt.battery import model
from uavbatt.battery.scaling import pack_of
from uavbatt.log_replay.run import ReplayedRow, steps
from uavbatt.records import Flight

pytestmark = pytest.mark.slow
IN_TIME_S, EARLIEST_S = {GENERIC: 45.0, FITTED: 60.0}, 180.0
GENERIC_LONG_S, FITTED_LONG_S = 25.0, 15.0
STEADY_S = 5.0  # between two packs: a forecast is as old as that
PAIRS = list(pairwise(ISSUE_AH))
EVERY = [(battery, ah) for battery in (GENERIC, FITTED) for ah in ISSUE_AH]


def case(battery: str, ah: float) -> Case:
    """A row of the table."""
    return next(c for c in wrong_cases.issue() if (c.battery, c.capacity_Ah) == (battery, ah))


@cache
def run(battery: str, ah: float) -> tuple[Flown, list[ReplayedRow]]:
    """A flight, and what is said of it."""
    return wrong_judged.replayed(case(battery, ah))


@cache
def judged(battery: str, ah: float) -> Judged:
    """The figures of a flight."""
    return wrong_judged.judge(case(battery, ah), *run(battery, ah))


# --- the simulator -----------------------------------------------------------------------------------------------


def test_the_simulator_keeps_its_books() -> None:
    """Charge drawn is charge gone, and the flight ends by the rule of the true voltage."""
    flown, _ = run(GENERIC, 4.0)
    drawn_Ah = sum(flown.current_A) / 3600.0
    assert flown.soc[-1] == pytest.approx(1.0 - drawn_Ah / 4.0, abs=1e-9)
    assert np.mean(flown.voltage_V[-5:]) < CUTOFF_V <= np.mean(flown.voltage_V[-6:-1])
    assert all(abs(row.voltage_V - true_V) < 0.06 for row, true_V in zip(flown.rows, flown.voltage_V, strict=True))


def test_what_a_pack_holds_is_how_long_it_flies() -> None:
    """All else equal, and none of it ends without charge: the wells are not level."""
    flights = [run(GENERIC, ah)[0] for ah in ISSUE_AH]
    shares = [(flown.end_s - flown.start_s) / (ah / FULL_AH) for flown, ah in zip(flights, ISSUE_AH, strict=True)]
    assert max(shares) / min(shares) == pytest.approx(1.0, abs=0.02)
    assert all(0.01 < flown.soc[-1] < 0.08 for flown in flights)


@pytest.mark.parametrize("ah", ISSUE_AH)
def test_a_generic_battery_does_not_claim_to_know_what_a_make_leaves_in_its_cells(ah: float) -> None:
    """It counts down to its own empty: 3 % too low in the last 20 s, where the filter alone is sure to 0.6 %."""
    flown, rows = run(GENERIC, ah)
    last = [
        (row.estimate, soc)
        for row, soc in zip(rows, flown.soc, strict=True)
        if row.estimate.time_s > flown.end_s - 20.0
    ]
    assert all(abs(known.soc - soc) < 2.0 * known.soc_sd for known, soc in last)
    assert rows[0].estimate.soc_sd < 0.03  # at full charge every make is full


def test_the_flights_are_the_same_every_time() -> None:
    names = [c.name for c in wrong_cases.sampled(2)]
    assert len(set(names)) == len(names)
    again = {c.name: c for c in wrong_cases.sampled(6)}
    assert all(again[c.name] == c for c in wrong_cases.sampled(2))
    first = wrong_cases.sampled(1)[0]
    assert first.flown().rows == first.flown().rows


# --- the table of the issue --------------------------------------------------------------------------------------


@pytest.mark.parametrize("ah", ISSUE_AH)
def test_generic_the_lower_end_is_not_too_long(ah: float) -> None:
    """In the last two minutes, at every row."""
    assert judged(GENERIC, ah).lo_excess_s <= GENERIC_LONG_S


@pytest.mark.parametrize("ah", ISSUE_AH)
@pytest.mark.parametrize("left_s", [120.0, 60.0])
def test_fitted_the_lower_end_is_not_too_long(ah: float, left_s: float) -> None:
    said = judged(FITTED, ah).before[left_s]
    assert said.lo_s - said.true_s <= FITTED_LONG_S


@pytest.mark.parametrize("ah", ISSUE_AH)
@pytest.mark.parametrize("battery", [GENERIC, FITTED])
def test_the_alarm_is_in_time(battery: str, ah: float) -> None:
    assert judged(battery, ah).alarm_s >= IN_TIME_S[battery]


@pytest.mark.parametrize("ah", [5.0, 4.5])
def test_fitted_the_alarm_is_not_early(ah: float) -> None:
    assert judged(FITTED, ah).alarm_s <= EARLIEST_S


@pytest.mark.parametrize("battery, ah", EVERY)
def test_the_last_seconds_are_known(battery: str, ah: float) -> None:
    """Once a pack said "246 s, at least 167" five seconds before its end."""
    said = judged(battery, ah).before[5.0]
    assert said.hi_s <= 30.0 and said.median_s <= 10.0


@pytest.mark.parametrize("battery", [GENERIC, FITTED])
def test_a_pack_of_70_percent_is_named(battery: str) -> None:
    """A warning says that the pack is smaller, or that the voltage falls faster than the charge says."""
    assert judged(battery, 3.5).words_s > 0.0


@pytest.mark.parametrize("battery", [GENERIC, FITTED])
def test_a_pack_as_stated_is_not_accused(battery: str) -> None:
    assert math.isnan(judged(battery, 5.0).words_s)


# --- what must follow --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("battery", [GENERIC, FITTED])
@pytest.mark.parametrize("larger, smaller", PAIRS)
def test_a_smaller_pack_is_never_given_more_time(battery: str, larger: float, smaller: float) -> None:
    """At the same time since take-off, in the last five minutes of the smaller one's flight."""
    flown, said = run(battery, smaller)
    since_s = flown.end_s - 300.0
    pairs = [
        (small.remaining, large.remaining)
        for small, large in zip(said, run(battery, larger)[1], strict=False)
        if small.remaining.time_s >= since_s
    ]
    assert len(pairs) > 290
    for small, large in pairs:
        assert small.remaining_s <= large.remaining_s + STEADY_S, small.time_s
        assert small.remaining_lo_s <= large.remaining_lo_s + STEADY_S, small.time_s


@pytest.mark.parametrize("cut_before_s", [150.0, 20.0])
def test_what_is_said_depends_on_nothing_later(cut_before_s: float) -> None:
    """A flight of a worn pack that is cut before its end says the same until then, warnings and all."""
    flown, whole = run(GENERIC, 3.5)
    rows = tuple(row for row in flown.rows if row.time_s < flown.end_s - cut_before_s)
    cut = list(steps(Flight("cut", "csv", rows), wrong_judged.estimator(case(GENERIC, 3.5))))
    assert [repr(step) for step in cut] == [repr(step) for step in whole[: len(cut)]]


def test_row_by_row_says_the_same_as_a_replay() -> None:
    """In flight nobody looks ahead."""
    flown, whole = run(GENERIC, 3.5)
    engine = wrong_judged.estimator(case(GENERIC, 3.5))
    since = len(flown.rows) - 60
    for number, row in enumerate(flown.rows):
        _, remaining = engine.step(row)
        if number >= since:
            assert remaining.remaining_s == pytest.approx(whole[number].remaining.remaining_s, abs=0.5)


# --- the command -------------------------------------------------------------------------------------------------


def test_a_flight_that_is_not_in_the_tables_is_named() -> None:
    script = Path(__file__).parents[2] / "scripts" / "wrong_packs.py"
    found = subprocess.run([sys.executable, str(script), "--flight", "none"], capture_output=True, text=True)
    assert found.returncode == 2
    assert "--flight none" in found.stderr and "issue-4.0Ah-generic" in found.stderr


def test_the_sample_is_as_wide_as_it_says() -> None:
    drawn = wrong_cases.sampled(6)
    shares = [c.capacity_Ah / FULL_AH for c in drawn]
    assert min(shares) < 0.70 and max(shares) > 1.0
    assert min(c.start_soc for c in drawn) < 0.7
    ohms = [c.resistance * c.make.ohmAh / wrong_cases.PRIOR_OHMAH for c in drawn if c.battery == GENERIC]
    assert min(ohms) < 0.5 and max(ohms) > 2.0
    gains = [c.sensors.current_gain for c in drawn]
    assert min(gains) < 0.6 and max(gains) > 1.2
    assert replace(drawn[0], name="x").flown().end_s > 200.0


# --- what a fitted curve is doubted by -----------------------------------------------------------------------------


@pytest.mark.parametrize("make", MAKES, ids=lambda make: make.name)
def test_what_changes_of_a_fitted_curves_error_is_what_the_flight_doubts(make: Make) -> None:
    """A fit takes a part of the ohms for voltage, alike at every charge: that is no drift."""
    made = pack_of(wrong_judged.battery(FITTED, make), CELLS, FULL_AH, CUTOFF_V, math.nan)
    soc = np.linspace(0.2, 0.9, 15)
    error_V = model.open_circuit_voltage(made.cell, soc) - np.interp(soc, SOC, make.ocv_V)
    stated_V, doubted_V = (
        np.interp(soc, model.SOC_GRID, sd) for sd in (made.spread.ocv_sd_V, made.spread.ocv_drift_sd_V)
    )
    assert 0.3 * np.mean(doubted_V) < np.std(error_V) < 1.5 * np.mean(doubted_V) < 0.75 * np.mean(stated_V)


def test_the_lift_of_a_vtol_comes_again() -> None:
    """It cruises at a quarter of the power of its lift, which ends the flight: the 5 % point was 122 s too long."""
    flights = [c for c in wrong_cases.by_turns(6) if (c.battery, c.capacity_class) == (GENERIC, "VTOL")]
    assert max(wrong_judged.judged(flight).lo_excess_s for flight in flights) < 60.0
