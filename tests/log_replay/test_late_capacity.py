"""A log that states the pack's capacity after its first rows, as every ground station writes one."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import pytest
from frames import frame, hover, write_log
from pymavlink.dialects.v20 import ardupilotmega as dialect

import uavbatt
from uavbatt.battery.battery_file import read_battery
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.errors import UsageError
from uavbatt.fitting.vehicle import trace
from uavbatt.records import Flight, Status
from uavbatt.telemetry import read_log


def flight(folder: Path, stated_s: float, seconds: int = 240) -> Flight:
    """A hover of which BATT_CAPACITY, 5 Ah, is heard `stated_s` [s] after the first row."""
    said = frame(dialect.MAVLink_param_value_message(b"BATT_CAPACITY", 5000.0, 9, 1, 0), stated_s)
    return read_log(write_log(folder / "f.tlog", [*hover(seconds, 16.7, 15.0), (stated_s, said)]))


@pytest.mark.parametrize("stated_s", [0.01, 3.0, 30.0])
def test_rows_before_the_capacity_is_stated_are_refused_and_the_others_flown(tmp_path: Path, stated_s: float) -> None:
    """`replay` ended with "neither the vehicle nor the battery file states one", which was false."""
    found = uavbatt.replay(flight(tmp_path, stated_s))
    for row in found:
        is_early = row.estimate.time_s < stated_s
        assert is_early == row.remaining.reason.startswith("capacity: neither the vehicle")
        assert math.isnan(row.estimate.soc) == is_early and row.estimate.voltage_V > 15.0
    assert found.pack.capacity_from == "vehicle" and found.outcome.landing is not None
    assert found.outcome.landing.remaining_s > 60.0


def test_a_statement_changes_no_row_before_it(tmp_path: Path) -> None:
    late, later = (uavbatt.replay(flight(tmp_path, stated_s)) for stated_s in (40.0, 60.0))
    same = [(a, b) for a, b in zip(late, later, strict=True) if a.estimate.time_s < 40.0]
    assert len(same) == 40 and all(repr(a) == repr(b) and a.remaining.status is Status.REFUSED for a, b in same)


def test_a_log_that_never_states_the_capacity_is_refused_whole(tmp_path: Path) -> None:
    known = flight(tmp_path, 30.0)
    nowhere = Flight(known.source, known.kind, known.samples)
    with pytest.raises(UsageError, match=r"capacity: neither the vehicle nor battery `lipo-generic` states one"):
        uavbatt.replay(nowhere)


def test_a_vehicle_file_knows_the_pack_from_the_first_row(tmp_path: Path) -> None:
    generic = read_battery("lipo-generic")
    early, late = (trace(flight(tmp_path, stated_s), generic, PackOptions()) for stated_s in (0.0, 60.0))
    assert early is not None and early == late
    assert all(a >= b for a, b in pairwise(early.soc))
