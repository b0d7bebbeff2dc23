"""The slow filter: what flights say together, and what is never averaged in."""

from __future__ import annotations

import math

import numpy as np
import pytest
from packs.made import RATED_AH, TYPE_OHM, flight

from uavbatt.battery.battery_file import GENERIC, GENERIC_LITHIUM_ION
from uavbatt.packs import ageing
from uavbatt.packs.findings import of_battery_file
from uavbatt.packs.outlook import outlook
from uavbatt.packs.records import PackBelief, PackRow
from uavbatt.packs.words import retire_words
from uavbatt.report.packs import packs_report

WIGGLE = (0.01, -0.02, 0.015, -0.005, 0.02, -0.015, 0.0, 0.01, -0.01, 0.005)


def kinds(found):
    return [f.kind for f in found.findings]


def charge(found):
    return math.exp(found.known.mean[1]) / RATED_AH


def ohms(found):
    return math.exp(found.known.mean[0]) / TYPE_OHM


def test_a_steady_pack_is_known_better_after_every_flight_and_has_no_findings():
    found = ageing.history([flight(k, 1.2 + w, 0.9 + w) for k, w in enumerate(WIGGLE)])
    sd = [math.sqrt(f.known.covariance[1, 1]) for f in found[:4]]
    assert sd == sorted(sd, reverse=True)
    assert charge(found[-1]) == pytest.approx(0.9, abs=0.02)
    assert ohms(found[-1]) == pytest.approx(1.2, abs=0.05)
    assert not any(kinds(f) for f in found)


def test_a_flight_that_says_nothing_of_the_charge_leaves_it_where_it_was():
    before, after = ageing.history([flight(0, 1.0, 0.9, charge_sd=0.02), flight(1, 1.0, 0.6, charge_sd=5.0)])
    assert charge(after) == pytest.approx(charge(before), rel=0.005)


def test_an_ageing_pack_is_followed_and_its_trend_foretells_the_end():
    found = ageing.history([flight(k, 1.03**k, 0.98**k) for k in range(8)])
    assert not any(kinds(f) for f in found)
    seen = outlook(found[-1].known, RATED_AH, 8, "a-make")
    assert seen.capacity_trend == pytest.approx(math.log(0.98), abs=0.006)
    left = math.log(0.98**7 / 0.8) / -math.log(0.98)
    assert seen.retire_lo_flights < left < seen.retire_hi_flights
    assert seen.capacity_lo_Ah < 0.98**7 * RATED_AH < seen.capacity_hi_Ah


def test_no_end_in_sight_is_told_as_such():
    found = ageing.history([flight(k, charge_sd=0.01) for k in range(10)])
    assert outlook(found[-1].known, RATED_AH, 10, "a-make").retire_hi_flights == math.inf


def test_the_generic_file_alone_retires_no_pack():
    found = ageing.history([flight(k, 1.5, 0.73) for k in range(8)])
    own, generic = (outlook(found[-1].known, RATED_AH, 8, name) for name in ("a-make", GENERIC))
    assert retire_words(own) == "retire now: below 80% already"
    assert retire_words(generic) == "probably below 80% already, but not certain: measure its charge"
    assert generic.capacity_lo_Ah < 0.6 * RATED_AH and generic.capacity_hi_Ah > 0.85 * RATED_AH


def test_ohms_above_those_of_the_generic_file_are_no_evidence_of_age():
    """Of a pack with twice its ohms, a tenth of the capacity was taken for lost."""
    told = {"ohm": 2.0, "charge": 1.0, "ohm_sd": 0.15, "charge_sd": 2.0}
    own, generic = (ageing.history([flight(0, **told, battery=name)])[-1] for name in ("a-make", GENERIC))
    assert charge(own) < 0.9 < charge(generic)
    seen = outlook(generic.known, RATED_AH, 1, GENERIC)
    assert seen.capacity_lo_Ah < 0.66 * RATED_AH and seen.capacity_hi_Ah > RATED_AH


def test_a_flight_to_the_knee_is_believed_with_the_generic_file():
    (worn,) = ageing.history([flight(0, 1.5, 0.68, charge_sd=0.05, battery=GENERIC)])
    assert charge(worn) == pytest.approx(0.68, rel=0.04)


def test_an_interval_from_now_to_never_is_no_date():
    found = ageing.history([flight(k, 1.0, 0.86) for k in range(8)])
    assert retire_words(outlook(found[-1].known, RATED_AH, 8, GENERIC)) == "not known when to retire it"


def row(name: str, capacity: float, battery: str) -> PackRow:
    known = ageing.history([flight(k, 1.0, capacity) for k in range(8)])[-1].known
    return PackRow(name, 4, RATED_AH, TYPE_OHM, math.nan, outlook(known, RATED_AH, 8, battery), ())


def test_the_page_does_not_call_an_unknown_end_no_end():
    """Of two packs read with the generic file it said "no end in sight", and the table "not known"."""
    page = packs_report("packs.sqlite", [row("A", 0.86, GENERIC), row("B", 0.87, GENERIC)], [])
    assert "It is not known when to retire 2 packs" in page and "No end in sight" not in page
    page = packs_report("packs.sqlite", [row("A", 0.86, GENERIC), row("B", 0.7, "a-make")], [])
    assert "First to retire: B, retire now" in page and "It is not known when to retire 1 pack " in page
    assert "No end in sight" in packs_report("packs.sqlite", [row("C", 1.0, "a-make")], [])


def test_a_pack_says_that_it_is_read_with_the_generic_file():
    for name in (GENERIC, GENERIC_LITHIUM_ION):
        (finding,) = of_battery_file(name)
        assert finding.kind == "generic_file" and name in finding.words
    assert of_battery_file("a-make") == ()


def test_damage_is_named_and_believed_at_once():
    flights = [flight(k, 1.0 + w) for k, w in enumerate(WIGGLE[:5])] + [flight(k, 1.3) for k in (5, 6)]
    found = ageing.history(flights)
    assert kinds(found[5]) == ["sudden_ohms"]
    assert ohms(found[5]) == pytest.approx(1.3, abs=0.05)
    assert kinds(found[6]) == []


def test_damage_that_one_flight_leaves_open_is_named_after_the_second():
    flights = [flight(k, 1.0 + w) for k, w in enumerate(WIGGLE[:5])] + [flight(k, 1.155) for k in (5, 6)]
    found = ageing.history(flights)
    assert kinds(found[5]) == []
    assert kinds(found[6]) == ["sudden_ohms"]
    (finding,) = found[6].findings
    assert "damaged, or ageing fast?" in finding.words
    assert float(finding.words.partition(" % more resistance")[0]) == pytest.approx(15.0, abs=2.0)
    assert ohms(found[6]) == pytest.approx(1.155, abs=0.03)


def test_fast_ageing_that_looked_like_damage_is_followed_all_the_same():
    found = ageing.history([flight(k, 1.05**k, 0.98**k, ohm_sd=0.06, charge_sd=0.05) for k in range(8)])
    assert charge(found[-1]) == pytest.approx(0.98**7, abs=0.03)
    assert not any(kinds(f) for f in found)


def test_a_cell_that_died_is_a_sudden_loss_of_charge():
    found = ageing.history([*(flight(k) for k in range(5)), flight(5, 1.0, 0.75)])
    assert kinds(found[5]) == ["sudden_loss"]
    assert charge(found[5]) < 0.85


def test_a_better_pack_under_the_same_name_is_named_and_set_aside():
    old = [flight(k, 1.5, 0.8) for k in range(5)]
    *_, before, swapped, after = ageing.history([*old, flight(5, 1.0, 1.0), flight(6, 1.5, 0.8)])
    assert kinds(swapped) == ["another_pack"]
    assert charge(swapped) == pytest.approx(charge(before), rel=0.02)
    assert kinds(after) == []
    assert charge(after) == pytest.approx(0.8, abs=0.02)


def test_a_better_pack_twice_in_a_row_is_remembered_anew():
    old = [flight(k, 1.5, 0.8) for k in range(5)]
    *_, swapped, again = ageing.history([*old, flight(5, 1.0, 1.0), flight(6, 1.0, 1.0)])
    assert kinds(swapped) == kinds(again) == ["another_pack"]
    assert charge(again) == pytest.approx(1.0, abs=0.04)
    assert ohms(again) == pytest.approx(1.0, abs=0.05)


def test_a_worse_pack_that_was_another_is_forgotten_when_the_old_one_comes_back():
    flights = [*(flight(k) for k in range(5)), flight(5, 1.4, 0.8), flight(6), flight(7)]
    *_, damaged, back, after = ageing.history(flights)
    assert "sudden_ohms" in kinds(damaged)
    assert kinds(back) == ["another_pack"]
    assert kinds(after) == []
    assert (ohms(after), charge(after)) == (pytest.approx(1.0, abs=0.03), pytest.approx(1.0, abs=0.03))


def test_a_month_on_the_shelf_is_known_less_than_a_day():
    known = ageing.history([flight(k) for k in range(4)])[-1].known
    day, month = (np.diag(ageing.predicted(known, days).covariance) for days in (1.0, 30.0))
    assert (month[:2] > day[:2]).all()


def test_a_month_of_storage_adds_two_percent_of_ohms_and_one_of_charge_to_the_doubt():
    known = ageing.history([flight(0)])[-1].known
    now, later = (np.diag(ageing.predicted(known, days).covariance)[:2] for days in (0.0, 365.0 / 12.0))
    assert np.sqrt(later - now) == pytest.approx([0.020, 0.010], rel=0.01)
    assert ageing.days_between(flight(0), flight(1).start_utc_s) == pytest.approx(3.0)


def test_each_trend_moves_its_own_quantity_by_one_flight_a_flight():
    known = PackBelief(np.array([-4.0, 1.6, 0.003, -0.002]), np.eye(4))
    assert ageing.predicted(known, 0.0).mean == pytest.approx([-3.997, 1.598, 0.003, -0.002])


def test_days_that_nobody_knows_count_as_none_and_ten_years_as_the_most():
    known = ageing.history([flight(0)])[-1].known
    doubt = [ageing.predicted(known, days).covariance for days in (math.nan, 0.0, 3650.0, 1e6)]
    assert (doubt[0] == doubt[1]).all() and (doubt[2] == doubt[3]).all()
    assert doubt[2][0, 0] - doubt[0][0, 0] == pytest.approx(0.020**2 * 3650.0 / 30.4)


def test_another_battery_file_adds_a_tenth_of_the_ohms_and_three_percent_of_charge_to_the_doubt():
    known = ageing.history([flight(k) for k in range(4)])[-1].known
    one, other = (ageing.prior(known, 3.0, other_file=is_other) for is_other in (False, True))
    assert np.sqrt(np.diag(other.covariance - one.covariance)) == pytest.approx([0.10, 0.03])


def test_a_counter_that_falls_and_a_charge_that_no_charger_gives_are_named():
    first = flight(0, cycles=40, soc_end=0.3)
    soon = {"start_utc_s": first.start_utc_s + first.duration_s + 120.0}
    found = ageing.history([first, flight(1, cycles=12, soc_start=1.0, **soon)])
    assert kinds(found[1]) == ["charged_too_fast", "counter"]


def test_a_weak_cell_is_named_with_its_number():
    (found,) = ageing.history([flight(0, weak_cell=3, weak_cell_V=0.09)])
    assert kinds(found) == ["weak_cell"]
    assert "cell 3 lies 90 mV" in found.findings[0].words
