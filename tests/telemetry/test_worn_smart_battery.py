"""A smart battery whose own gauge says that it is worn: what it holds today counts, within what a gauge can know."""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from frames import hover, smart, write_log
from scoring.other_pack import CELLS, CUTOFF_V, Flown, Pack, Power
from scoring.other_pack import flight as flown_flight

from uavbatt.battery import battery_file
from uavbatt.battery.sizing.log_statements import size_from_rows
from uavbatt.battery.sizing.pack_size import PackOptions, PackSize, size_of_pack
from uavbatt.estimator import Estimator
from uavbatt.mavlink import fields
from uavbatt.packs.remembering import flight_for_ledger
from uavbatt.records import Flight, Identity, PackFacts
from uavbatt.telemetry import read_log
from uavbatt.telemetry.join import Wiring, joined
from uavbatt.telemetry.parameters import capacity_notes, facts_timeline, statements_of

GENERIC = battery_file.read_battery("lipo-generic")
NEW = PackFacts(CELLS, 5.0, critical_voltage_V=CUTOFF_V)
WORN = replace(NEW, full_share=0.76)


def sized(facts: PackFacts, options: PackOptions | None = None) -> PackSize:
    return size_of_pack(GENERIC, options or PackOptions(), facts, CELLS)


@pytest.fixture(scope="module")
def worn() -> Flown:
    """A flight of a pack that holds 3.8 of 5 Ah, to its end."""
    return flown_flight(Pack(capacity_Ah=3.8), Power(), seed=5)


# --- what is stated ------------------------------------------------------------------------------------------------


def test_the_gauge_in_smart_battery_info_and_battery_info() -> None:
    told = struct.pack("<iiHHHHHBBB", 5000, 4150, 41, 65535, 0, 0, 0, 0, 1, 1)
    assert fields.pack_identity(fields.SMART_BATTERY_INFO, told).full_Ah == pytest.approx(4.15)
    told = struct.pack("<10f2H5B", *[0.0] * 8, 16.0, 13.5, 0, 0, 0, 0, 0, 84, 6)
    assert fields.pack_identity(fields.BATTERY_INFO, told).full_Ah == pytest.approx(13.5)
    untold = struct.pack("<iiHHHHHBBB", 5000, -1, 41, 65535, 0, 0, 0, 0, 1, 1)
    assert math.isnan(fields.pack_identity(fields.SMART_BATTERY_INFO, untold).full_Ah)


@pytest.mark.parametrize(
    ("parameters", "full_Ah", "capacity_Ah"),
    [
        ({}, 4.2, 4.2),
        ({"BATT_CAPACITY": 5000.0}, 4.2, 4.2),
        ({"BAT1_CAPACITY": 5000.0}, 4.2, 4.2),
        ({"BATT_CAPACITY": 4000.0}, 4.2, 4.0),  # the crew has stated less itself
        ({"BATT_CAPACITY": 10_000.0}, 4.2, 10.0),  # the gauge is of one of two packs at one monitor
        ({}, 2.4, 5.0),  # a gauge that was never calibrated
        ({}, 5.3, 5.0),  # as good as new: no gauge knows more than what is printed
    ],
)
def test_less_than_is_stated_counts(parameters: dict[str, float], full_Ah: float, capacity_Ah: float) -> None:
    said = {**parameters, **dict(statements_of(fields.PackIdentity(0, cells=4, capacity_Ah=5.0, full_Ah=full_Ah)))}
    facts = facts_timeline(((0.0, name, value) for name, value in said.items()), 0, is_telemetry=True)[-1][1]
    assert sized(facts).capacity_Ah == pytest.approx(capacity_Ah)
    assert any("says that it holds 4200 of 5000 mAh" in n for n in capacity_notes(said, 0)) == (capacity_Ah == 4.2)


def test_the_caller_counts_before_the_gauge() -> None:
    found = sized(WORN, PackOptions(capacity_Ah=4.5))
    assert (found.capacity_Ah, found.rated_Ah) == (4.5, 4.5)
    found = sized(WORN)
    assert (found.capacity_Ah, found.capacity_from, found.rated_Ah) == (pytest.approx(3.8), "vehicle", 5.0)


@pytest.mark.parametrize("share", [0.0, -1.0, 0.3, 1.2, math.nan, math.inf])
def test_a_share_that_no_gauge_says_is_not_used(share: float) -> None:
    assert sized(replace(NEW, full_share=share)).capacity_Ah == 5.0


@pytest.mark.parametrize("wiring", Wiring)
def test_joined_batteries_are_as_worn_as_the_worst(wiring: Wiring) -> None:
    rows = hover_rows()
    one, two = (Flight("two.csv", "csv", rows, k, (0, 1), ((0.0, f),)) for k, f in enumerate((NEW, WORN)))
    assert joined([one, two], wiring).facts_at(1.0).full_share == 0.76


def hover_rows() -> tuple:
    return tuple(flown_flight(Pack(), Power(), seconds=30).rows)


# --- in logs -------------------------------------------------------------------------------------------------------


def test_a_telemetry_log_of_a_worn_smart_battery(tmp_path: Path) -> None:
    rows = [*hover(40, 16.5, 12.0), smart(5000, 4, 2.0, full_mAh=4200)]
    flight = read_log(write_log(tmp_path / "a.tlog", rows))
    found = size_from_rows(GENERIC, PackOptions(), flight, flight.facts_at(math.inf))
    assert (found.capacity_Ah, found.rated_Ah) == (pytest.approx(4.2), pytest.approx(5.0))
    assert (
        "the battery itself says that it holds 4200 of 5000 mAh when full: that counts, if you state none"
        in flight.notes
    )


# --- in flight -----------------------------------------------------------------------------------------------------


def half_time_error(flown: Flown, facts: PackFacts) -> tuple[float, float]:
    """The error of the median at half time, of the time that was left [s], and the worst excess of the 5 % point."""
    estimator = Estimator(GENERIC)
    estimator.update_facts(facts)
    said = [(e.time_s, r.remaining_s, r.remaining_lo_s) for e, r in estimator.run(flown.rows)]
    time_s, median_s, lo_s = np.array(said).T
    left_s = flown.end_s - time_s
    half = int(np.searchsorted(time_s, 0.5 * (flown.start_s + flown.end_s)))
    return float(median_s[half] - left_s[half]), float(np.nanmax((lo_s - left_s)[left_s < 120.0]))


def test_a_worn_pack_that_says_so_is_known_from_the_first_minute(worn: Flown) -> None:
    (unsaid_s, _), (said_s, excess_s) = half_time_error(worn, NEW), half_time_error(worn, WORN)
    assert abs(said_s) < 30.0 < unsaid_s
    assert excess_s < 5.0


def test_a_gauge_that_learns_in_flight_does_not_begin_the_estimate_anew(worn: Flown) -> None:
    estimator = Estimator(GENERIC)
    estimator.update_facts(WORN)
    list(estimator.run(worn.rows[:120]))
    estimator.update_facts(replace(WORN, full_share=0.74))
    assert estimator.belief is not None
    assert estimator.pack_size is not None and estimator.pack_size.capacity_Ah == pytest.approx(3.8)
    estimator.update_facts(replace(WORN, full_share=0.6))  # not the same pack, or heard for the first time
    assert estimator.belief is None


def test_on_the_ground_the_gauge_is_believed_at_once(worn: Flown) -> None:
    estimator = Estimator(GENERIC)
    estimator.update_facts(WORN)
    list(estimator.run(worn.rows[:10]))
    estimator.update_facts(replace(WORN, full_share=0.74))
    assert estimator.pack_size is not None and estimator.pack_size.capacity_Ah == pytest.approx(3.7)


def test_the_ledger_measures_by_itself_what_is_left_of_a_new_pack(worn: Flown) -> None:
    identity = Identity(battery_serial="A", start_utc_s=1.79e9)
    log = Flight("1.tlog", "tlog", worn.rows, facts=((0.0, WORN),), identity=identity, duration_s=worn.end_s)
    record = flight_for_ledger(GENERIC, PackOptions(), log).record
    unsaid = flight_for_ledger(GENERIC, PackOptions(), replace(log, facts=((0.0, NEW),))).record
    assert record is not None and record.rated_Ah == 5.0
    assert record == unsaid
