"""What speaks for a battery: BATTERY_STATUS, or SYS_STATUS where that has ended; the same in a replay."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pytest
from cases import first_quick
from daemon_bench import Bench
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.live.config import RecordSection
from uavbatt.records import Sample, Status
from uavbatt.simulate.tlog_writer import battery_status, heartbeat, sys_status
from uavbatt.telemetry import read_log
from uavbatt.telemetry.formats.tlog import read_tlog


def row(drawn_Ah: float) -> Sample:
    return Sample(0.0, 16.0 - 0.5 * drawn_Ah, 12.0, 25.0, drawn_Ah, armed=True)


def fly(bench: Bench, seconds: float, *kinds: str, start_Ah: float = 0.0) -> None:
    """The named messages at 5 Hz: `sys`, or the number of a battery."""
    for k in range(int(5 * seconds)):
        if k % 5 == 0:
            bench.send(heartbeat(True))
        sample = row(start_Ah + 12.0 * k / 5.0 / 3600.0)
        for kind in kinds:
            bench.send(sys_status(sample) if kind == "sys" else battery_status(sample, int(kind)))
        bench.daemon.turn()
        bench.now_s += 0.2


def recorded(folder: Path) -> list[Sample]:
    (path,) = folder.glob("*.tlog")
    return list(read_log(path).samples)


def test_sys_status_speaks_again_where_battery_status_ends(tmp_path: Path) -> None:
    """Two stream groups of ArduPilot: one of them is stopped in flight."""
    bench = Bench(record=RecordSection(folder=str(tmp_path), when="always"))
    fly(bench, 30.0, "0", "sys")
    rows = bench.daemon.board.reports[0].rows
    fly(bench, 30.0, "sys", start_Ah=0.1)
    shown = bench.daemon.board.reports[0].at(bench.now_s)
    assert shown.status is not Status.STALE and shown.remaining_s > 0.0
    assert bench.daemon.board.reports[0].rows == rows + 126
    fly(bench, 10.0, "0", "sys", start_Ah=0.2)
    assert bench.daemon.board.reports[0].rows == rows + 126 + 50
    bench.daemon.close()
    assert len(recorded(tmp_path)) == rows + 126 + 50


def test_sys_status_says_nothing_of_a_vehicle_with_two_batteries() -> None:
    bench = Bench()
    fly(bench, 10.0, "0", "1", "sys")
    rows = {report.instance: report.rows for report in bench.daemon.board.reports}
    fly(bench, 20.0, "1", "sys", start_Ah=0.03)
    assert {report.instance: report.rows for report in bench.daemon.board.reports} == {0: rows[0], 1: rows[1] + 100}


@pytest.mark.parametrize(("times", "rows"), [(1, 0), (2, 2), (3, 3)])
def test_a_second_battery_must_be_heard_twice(times: int, rows: int) -> None:
    """One BATTERY2 may be damaged: it makes no battery that is stale for the rest of the flight."""
    bench = Bench()
    fly(bench, 10.0, "0")
    for _ in range(times):
        bench.send(dialect.MAVLink_battery2_message(24000, 300))
        fly(bench, 1.0, "0", start_Ah=0.03)
    fly(bench, 6.0, "0", start_Ah=0.04)  # until it is clear that no BATTERY_STATUS speaks for it
    known = {report.instance: report.rows for report in bench.daemon.board.reports}
    assert known.pop(1, 0) == rows
    assert known.keys() == {0}


def test_messages_without_a_voltage_are_told_from_none_at_all() -> None:
    """A battery monitor that is not set up, or not connected: the page said "no battery telemetry yet" alone."""
    bench = Bench()
    for _ in range(10):
        bench.send(heartbeat(True))
        bench.send(battery_status(Sample(0.0, 0.0, 0.0), 0))
        bench.daemon.turn()
        bench.now_s += 1.0
    assert bench.daemon.board.reports == ()
    assert "battery messages come without a voltage" in " ".join(bench.daemon.board.notes)
    fly(bench, 5.0, "0")
    assert bench.daemon.board.notes == () and bench.daemon.board.reports[0].rows == 25


def test_a_voltage_that_ends_in_the_air_is_told_from_a_silent_link() -> None:
    """The wire of the voltmeter breaks: the page said "no telemetry", while messages came."""
    bench = Bench()
    fly(bench, 10.0, "0")
    for _ in range(10):
        bench.send(heartbeat(True))
        bench.send(battery_status(Sample(0.0, 0.0, 12.0, armed=True), 0))
        bench.daemon.turn()
        bench.now_s += 1.0
    assert "without a voltage: is its wire broken" in " ".join(bench.daemon.board.notes)
    fly(bench, 5.0, "0", start_Ah=0.04)
    assert bench.daemon.board.notes == ()


def gentle(bench: Bench, seconds: int, *disarmed_s: int) -> None:
    """A hover of 1.2 C, a row and a heartbeat each second; some heartbeats say that it is disarmed."""
    for k in range(seconds):
        bench.send(heartbeat(k not in disarmed_s))
        bench.send(battery_status(row(12.0 * k / 3600.0), 0))
        bench.daemon.turn()
        bench.now_s += 1.0


@pytest.mark.parametrize(("disarmed_s", "flight_s"), first_quick(2, [((60,), 89.0), ((60, 61), 27.0), ((), 89.0)]))
def test_one_damaged_heartbeat_begins_no_flight(disarmed_s: tuple[int, ...], flight_s: float, tmp_path: Path) -> None:
    """A load below 1.5 C on the ground is a payload's: two heartbeats that say "disarmed" end a flight, not one."""
    record = RecordSection(folder=str(tmp_path), when="always")
    bench = Bench(PackOptions(cells=4, capacity_Ah=10.0, cutoff_V=13.2), record=record)
    gentle(bench, 90, *disarmed_s)
    (report,) = bench.daemon.board.reports
    assert report.as_line(bench.now_s - 1.0)["flight_s"] == pytest.approx(flight_s)
    bench.daemon.close()
    ended_s = 61 if len(disarmed_s) > 1 else None
    assert [k for k, sample in enumerate(recorded(tmp_path)) if not sample.armed] == ([ended_s] if ended_s else [])


def integer(name: str, value: int) -> Any:
    """As PX4 sends it: the bits."""
    (bits,) = struct.unpack("<f", struct.pack("<i", value))
    return dialect.MAVLink_param_value_message(name.encode(), bits, dialect.MAV_PARAM_TYPE_INT32, 1, 0)


@pytest.mark.parametrize("is_px4", [True, False])
def test_an_integer_waits_for_the_first_heartbeat(tmp_path: Path, is_px4: bool) -> None:
    """The parameters come before the process knows who sends them."""
    bench = Bench(PackOptions(), record=RecordSection(folder=str(tmp_path), when="always"))
    name = "BAT1_N_CELLS" if is_px4 else "BATT_LOW_TIMER"
    value = integer(name, 4)
    if not is_px4:
        value = dialect.MAVLink_param_value_message(name.encode(), 4.0, dialect.MAV_PARAM_TYPE_INT8, 1, 0)
    for message in (value, dialect.MAVLink_param_value_message(b"BAT1_CAPACITY", 5000.0, 9, 1, 0)):
        bench.send(message)
    bench.send(battery_status(row(0.0), 0))
    bench.daemon.turn()
    beat = heartbeat(False)
    beat.autopilot = dialect.MAV_AUTOPILOT_PX4 if is_px4 else dialect.MAV_AUTOPILOT_ARDUPILOTMEGA
    bench.send(beat)
    bench.daemon.turn()
    reader = bench.daemon.batteries._reader
    assert reader.parameters == {name: 4.0, "BAT1_CAPACITY": 5000.0}
    bench.now_s += 1.0
    bench.send(battery_status(row(0.001), 0))
    bench.daemon.turn()
    bench.daemon.close()
    (path,) = tmp_path.glob("*.tlog")
    said = {said_name: said_value for _, said_name, said_value in read_tlog(path.name, path.read_bytes()).parameters}
    assert said[name] == 4.0 and said["BAT1_CAPACITY"] == 5000.0
