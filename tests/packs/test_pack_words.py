"""What is said of a pack and of its flights: numbers in the crew's units, and nothing that is not so."""

from __future__ import annotations

import math

import numpy as np
import pytest
from packs.made import DAY_S, FIRST_UTC_S, flight

from uavbatt.packs.ageing import history, prior
from uavbatt.packs.findings import another, between, by_itself, sudden
from uavbatt.packs.records import PackFinding
from uavbatt.packs.words import flight_line, trend_words


@pytest.mark.parametrize(
    ("trend", "sd", "words"),
    [
        (-0.016, 0.004, "\N{MINUS SIGN}1.6 % a flight"),
        (0.02, 0.004, "+2.0 % a flight"),
        (0.0005, 0.001, "steady"),
        (-0.016, 0.02, "trend not known yet"),
    ],
)
def test_a_trend_is_told_in_percent_a_flight_once_it_is_known(trend: float, sd: float, words: str) -> None:
    assert trend_words(trend, sd) == words


def test_a_dated_flight_is_in_the_future_only_beyond_tomorrow() -> None:
    (after,) = history([flight(0)])
    said = {days: flight_line(after, FIRST_UTC_S - days * DAY_S) for days in (-30.0, 0.5, 2.0)}
    assert "in the future" not in said[-30.0] and "in the future" not in said[0.5]  # a log may tell local time
    assert "in the future: the clock of the log is wrong" in said[2.0]
    (undated,) = history([flight(0, start_utc_s=math.nan)])
    said_undated = flight_line(undated, 0.0)
    assert said_undated.lstrip().startswith("no date") and "future" not in said_undated


def test_what_a_flight_did_not_tell_is_called_unknown() -> None:
    (after,) = history([flight(0, soc_end=0.31, temp_mean_C=math.nan)])
    assert "flight_00.tlog: charge unknown to 0.31, no temperature; " in flight_line(after, FIRST_UTC_S)


def test_more_charge_after_some_minutes_is_another_pack_under_the_name() -> None:
    first = flight(0, soc_end=0.2)
    lands_s = FIRST_UTC_S + first.duration_s
    (found,) = between(first, flight(1, start_utc_s=lands_s + 120.0, soc_start=0.9))
    assert found.words == "70 % more charge after 2 minutes: another pack under this name?"
    assert between(first, flight(1, start_utc_s=lands_s + 3600.0, soc_start=0.9)) == ()  # a charger of 1 C is usual


@pytest.mark.parametrize(("below_V", "words"), [(0.05, ""), (0.07, "cell 3 lies 70 mV below the others under load")])
def test_a_cell_that_lies_clearly_below_the_others_is_named(below_V: float, words: str) -> None:
    assert "".join(f.words for f in by_itself(flight(0, weak_cell=3, weak_cell_V=below_V))) == words


def test_another_battery_file_makes_a_remembered_pack_less_sure() -> None:
    known = history([flight(k, charge=0.85) for k in range(4)])[-1].known
    same, other = (np.diag(prior(known, 3.0, other_file=told).covariance) for told in (False, True))
    assert np.all(other > same) and np.all(same > np.diag(known.covariance)[:2])


def test_without_a_thermometer_a_remembered_pack_may_be_in_the_cold() -> None:
    known = history([flight(k, temp_mean_C=math.nan) for k in range(4)])[-1].known
    warm, unknown = (np.diag(prior(known, 3.0, has_thermometer=told).covariance) for told in (True, False))
    assert np.all(unknown > warm)
    *_, last = history([*(flight(k, temp_mean_C=math.nan) for k in range(4)), flight(4, 1.6, temp_mean_C=math.nan)])
    assert last.findings[0].words.endswith("damaged, or cold? No temperature was measured")


@pytest.mark.parametrize(
    ("finding", "words"),
    [
        (sudden(np.array([5.0, -1.0]), np.log([1.3, 0.95])), "30 % more resistance at once: damaged?"),
        (sudden(np.array([1.0, -5.0]), np.log([1.02, 0.8])), "20 % less charge at once: damaged?"),
        (another(np.array([-5.0, 1.0]), np.log([0.6, 1.02])), "40 % less resistance at once, which no pack can do"),
        (another(np.array([-1.0, 5.0]), np.log([0.98, 1.25])), "25 % more charge at once, which no pack can do"),
    ],
)
def test_a_change_is_told_by_the_quantity_that_is_further_off(finding: PackFinding, words: str) -> None:
    assert finding.words.startswith(words)


@pytest.mark.parametrize(
    ("ohm", "charge", "words"),
    [(1.5, 1.0, "% more resistance"), (0.5, 1.0, "% less resistance"), (1.0, 0.6, "% less charge")],
)
def test_a_change_in_a_history_is_told_with_its_size(ohm: float, charge: float, words: str) -> None:
    """The expected state of a pack that does not change is that of its flights before."""
    found = history([*(flight(k) for k in range(5)), flight(5, ohm, charge)])[-1]
    said = next(finding.words for finding in found.findings if words in finding.words)
    changed = abs(ohm - 1.0) or abs(charge - 1.0)
    assert float(said.partition(" %")[0]) == pytest.approx(100.0 * changed, abs=6.0)
