"""Logs that begin in the air, or with a pack that was not full, among others that begin at take-off."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from uavbatt.errors import NotEnoughData
from uavbatt.fitting import solve
from uavbatt.fitting.battery import FittedBattery, RecordedPack, fit_battery
from uavbatt.fitting.observed import ObservedRecord, stack
from uavbatt.fitting.whole_flights import alike_when_full, from_take_off
from uavbatt.records import Flight
from uavbatt.telemetry import read_log

PACK = RecordedPack("learn", 4, 5.0, 13.2)


def record(name: str, first_cell_V: float, first_A: float) -> ObservedRecord:
    """A flight of four minutes that begins with this voltage of a cell and this current."""
    time_s = np.arange(0.0, 240.0, 5.0)
    current_A = np.where(time_s > 0.0, 14.0, first_A)
    volts = 4 * (first_cell_V - 0.0005 * time_s)
    return ObservedRecord(name, time_s, volts, current_A, np.full(time_s.size, 20.0), np.nan, 4, 5.0)


RESTED, FULL = record("rested", 4.19, 0.2), record("full", 4.02, 14.0)
LATER, FULLER = record("later", 3.66, 14.0), record("fuller", 4.27, 0.2)
PART_CHARGED = record("part", 3.80, 0.2)  # at rest its charge is known


def test_a_log_that_begins_in_the_air_is_left_out_and_named() -> None:
    kept, words = from_take_off([RESTED, LATER, FULL, PART_CHARGED])
    assert [r.name for r in kept] == ["rested", "full", "part"]
    assert [w[:65] for w in words] == ["later begins under load at 3.66 V a cell and is left out: a part "]


def test_a_voltmeter_that_reads_more_than_a_full_cell_is_left_out_and_named() -> None:
    """With 0.3 V more on one pack of four cells, the curve of all ended at 4.26 V."""
    kept, words = alike_when_full([RESTED, FULLER, FULL, PART_CHARGED])
    assert [r.name for r in kept] == ["rested", "full", "part"]
    assert "fuller begins at rest at 4.27 V a cell" in words[0] and "another voltmeter" in words[0]


def test_cells_that_charge_higher_are_known_under_the_load_of_avionics_too() -> None:
    """A video link draws 0.4 C of a racing pack. Taken for ordinary cells, a later flight was told 161 s too few."""
    assert solve.fullest_V(stack([record("racer", 4.32, 2.0)])) == pytest.approx(4.32)
    assert np.isnan(solve.fullest_V(stack([FULL]))), "under load ordinary cells do not show how full they were"
    assert solve.fullest_V(stack([FULL, PART_CHARGED])) == pytest.approx(3.80)
    ordinary = [RESTED, PART_CHARGED, FULL]  # two that tell it, and one begun in the air
    kept, words = alike_when_full([*ordinary, record("racer", 4.32, 2.0)])
    assert kept == ordinary and words[0].startswith("racer begins under load at 4.32 V a cell")


def test_a_log_that_begins_in_the_air_does_not_tell_how_full_its_pack_was() -> None:
    """Two rested packs at 4.35 V a cell were left out beside three logs begun in the air: 131 s too few were said."""
    begun_in_the_air = [record(f"air {k}", 4.2, 15.0) for k in range(3)]
    rested = [record(f"rested {k}", 4.35, 0.1) for k in range(2)]
    assert alike_when_full([*begun_in_the_air, *rested]) == ([*begun_in_the_air, *rested], [])
    kept, words = alike_when_full([*begun_in_the_air, rested[0], RESTED, replace(RESTED, name="also ordinary")])
    assert len(kept) == 5 and words[0].startswith("rested 0 begins at rest at 4.35 V")


def test_where_most_logs_begin_so_all_are_kept() -> None:
    kept, (words,) = from_take_off([RESTED, LATER, LATER])
    assert kept == [RESTED, LATER, LATER]
    assert words.startswith("2 of 3 flights begin under load with about half the charge or less: their start is only")
    assert alike_when_full([RESTED, FULLER, FULLER]) == ([RESTED, FULLER, FULLER], [])
    assert from_take_off([]) == ([], [])


def fitted(flights: list[Flight]) -> FittedBattery:
    return fit_battery(PACK, [], flights)


def test_a_log_that_begins_in_the_air_does_not_bend_the_curve_of_the_others(shared_data: Path) -> None:
    flights = [read_log(path) for path in sorted((shared_data / "missions/learn").glob("*.tlog"))[:3]]
    begun_s = flights[2].samples[0].time_s + 300.0
    later = replace(flights[2], samples=tuple(s for s in flights[2].samples if s.time_s > begun_s))
    found, without = fitted([*flights[:2], later]), fitted(flights[:2])
    assert found.file.parameters == without.file.parameters
    assert "left out" in found.doubtful[0] and not any("left out" in words for words in without.doubtful)


def test_a_log_without_a_current_does_not_stop_the_fit_of_the_others(shared_data: Path) -> None:
    """One log of a stuck sensor, all rows of which were left out, ended the command for all eight."""
    flights = [read_log(path) for path in sorted((shared_data / "missions/learn").glob("*.tlog"))[:3]]
    blind = replace(flights[0], samples=tuple(replace(s, current_A=np.nan) for s in flights[0].samples))
    found = fitted([blind, *flights[1:]])
    assert "0 rows with voltage and current" in found.doubtful[0] and found.doubtful[0].endswith("left out")
    with pytest.raises(NotEnoughData, match="0 rows with voltage and current"):
        fitted([blind])
