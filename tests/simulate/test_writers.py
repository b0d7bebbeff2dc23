"""The log writers against pymavlink's readers: what was written comes back, within the wire's steps."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

from uavbatt.records import NAN, Sample
from uavbatt.simulate.dataflash_writer import write_dataflash
from uavbatt.simulate.tlog_writer import EPOCH_US, cell_fields_mV, current_cA, write_tlog

PARAMETERS = {"BATT_CAPACITY": 5016.0, "BATT_LOW_VOLT": 14.0, "BATT_CRT_VOLT": 13.2}
FLIGHT = (
    Sample(0.0, 16.7897, 0.334, 25.331, 0.0, 0.995, armed=False),
    Sample(0.5, 16.123, 18.4567, 26.0, 0.0123, 0.98, armed=True),
    Sample(1.25, NAN, NAN, NAN, NAN, NAN, armed=True),
    Sample(2.0, 15.9, -0.01, 0.0, 0.05, 0.0, armed=None),
    Sample(63.731, 15.0, -4.2, -19.87, 1.5, 0.4, armed=False),
)


def messages(path: Path, *kinds: str) -> Iterator[Any]:
    with closing(mavutil.mavlink_connection(str(path))) as log:
        while (message := log.recv_match(type=list(kinds) or None)) is not None:
            yield message


def test_tlog_reads_back(tmp_path: Path) -> None:
    path = tmp_path / "f.tlog"
    write_tlog(path, FLIGHT, PARAMETERS, battery_id=3)
    rows = list(messages(path, "BATTERY_STATUS"))
    assert [row.id for row in rows] == [3] * len(FLIGHT)
    for row, sample in zip(rows, FLIGHT, strict=True):
        assert row._timestamp - EPOCH_US * 1e-6 == pytest.approx(sample.time_s, abs=5e-6)
        assert row.get_srcSystem() == 1 and row.get_srcComponent() == 1
        assert row.get_msgbuf()[0] == 0xFD  # MAVLink 2
        assert row.time_remaining == 0 and row.charge_state == 0 and row.energy_consumed == -1
    assert (rows[0].voltages[0], rows[0].current_battery, rows[0].temperature) == (16790, 33, 2533)
    assert (rows[1].current_consumed, rows[1].battery_remaining) == (12, 98)
    assert set(rows[2].voltages) == {65535}
    assert (rows[2].current_battery, rows[2].current_consumed) == (-1, -1)
    assert (rows[2].temperature, rows[2].battery_remaining) == (32767, -1)
    assert (rows[3].current_battery, rows[3].temperature, rows[3].battery_remaining) == (-2, 0, 0)
    assert (rows[4].current_battery, rows[4].temperature) == (-420, -1987)


def test_tlog_sys_status_and_parameters(tmp_path: Path) -> None:
    path = tmp_path / "f.tlog"
    write_tlog(path, FLIGHT, PARAMETERS)
    status = list(messages(path, "SYS_STATUS"))
    assert [row.voltage_battery for row in status] == [16790, 16123, 65535, 15900, 15000]
    assert [row.battery_remaining for row in status] == [100, 98, -1, 0, 40]
    read = {m.param_id: m.param_value for m in messages(path, "PARAM_VALUE")}
    assert read == pytest.approx(PARAMETERS)
    assert not list(messages(path, "BAD_DATA"))


def test_tlog_heartbeats_follow_arming(tmp_path: Path) -> None:
    path = tmp_path / "f.tlog"
    write_tlog(path, FLIGHT, {})
    beats = [(round(m._timestamp - EPOCH_US * 1e-6, 3), bool(m.base_mode & 128)) for m in messages(path, "HEARTBEAT")]
    assert beats == [(0.0, False), (0.5, True), (2.0, True), (63.731, False)]


def test_unknown_arming_writes_no_heartbeat(tmp_path: Path) -> None:
    path = tmp_path / "f.tlog"
    write_tlog(path, [Sample(float(t), 16.0, 5.0) for t in range(5)])
    assert not list(messages(path, "HEARTBEAT"))
    assert len(list(messages(path, "BATTERY_STATUS"))) == 5


def test_link_bits_of_the_time_are_clear(tmp_path: Path) -> None:
    path = tmp_path / "f.tlog"
    write_tlog(path, [Sample(0.000_003, 16.0)], epoch_us=1_600_000_000_000_001)
    assert struct.unpack(">Q", path.read_bytes()[:8])[0] == 1_600_000_000_000_004


@pytest.mark.parametrize(
    ("volts", "expected"),
    [
        (65.534, [65534, 0]),
        (66.0, [65534, 466]),
        (131.2, [65534, 65534, 132]),
        (0.0, [0]),
        (NAN, []),
    ],
)
def test_packs_above_the_field(volts: float, expected: list[int]) -> None:
    fields, extended = cell_fields_mV(Sample(0.0, volts))
    assert fields == expected + [65535] * (10 - len(expected))
    assert extended == [0] * 4


def test_cells_fill_the_fields_and_their_extension() -> None:
    fields, extended = cell_fields_mV(Sample(0.0, 48.0, cell_voltages_V=(4.0,) * 10 + (3.9, 0.0)))
    assert fields == [4000] * 10
    assert extended == [3900, 1, 0, 0]  # a measured 0 is sent as 1
    with pytest.raises(ValueError, match="15 cells"):
        cell_fields_mV(Sample(0.0, 60.0, cell_voltages_V=(4.0,) * 15))


@pytest.mark.parametrize(
    ("amps", "wire"), [(NAN, -1), (-0.01, -2), (-0.004, 0), (400.0, 32767), (-400.0, -32767), (12.345, 1234)]
)
def test_current_on_the_wire(amps: float, wire: int) -> None:
    assert current_cA(amps) == wire


def test_dataflash_reads_back(tmp_path: Path) -> None:
    path = tmp_path / "f.BIN"
    write_dataflash(path, FLIGHT, PARAMETERS, instance=1)
    rows = list(messages(path, "BAT"))
    assert len(rows) == len(FLIGHT)
    for row, sample in zip(rows, FLIGHT, strict=True):
        assert sample.time_s * 1e6 == pytest.approx(row.TimeUS, abs=0.5)
        assert row.Inst == 1
        assert row.Volt == pytest.approx(sample.voltage_V, rel=1e-6, nan_ok=True)
        assert row.Curr == pytest.approx(sample.current_A, rel=1e-6, nan_ok=True)
        assert row.CurrTot == pytest.approx(sample.consumed_Ah * 1000, rel=1e-6, nan_ok=True)
        assert math.isnan(row.VoltR) and math.isnan(row.EnrgTot) and math.isnan(row.Res)
    assert [row.Temp for row in rows] == pytest.approx([25.33, 26.0, 0.0, 0.01, -19.87])
    assert [row.RemPct for row in rows] == [100, 98, 255, 0, 40]


def test_dataflash_parameters_and_arming(tmp_path: Path) -> None:
    path = tmp_path / "f.BIN"
    write_dataflash(path, FLIGHT, PARAMETERS)
    assert {m.Name: m.Value for m in messages(path, "PARM")} == pytest.approx(PARAMETERS)
    assert [(m.TimeUS, m.ArmState) for m in messages(path, "ARM")] == [(0, 0), (500_000, 1), (63_731_000, 0)]
    assert [(m.TimeUS, m.Id) for m in messages(path, "EV")] == [(0, 11), (500_000, 10), (63_731_000, 11)]
    assert path.read_bytes()[:3] == b"\xa3\x95\x80"


@pytest.mark.parametrize("write", [write_tlog, write_dataflash])
@pytest.mark.parametrize(
    "samples",
    [
        [Sample(1.0, 16.0), Sample(0.5, 16.0)],
        [Sample(NAN, 16.0)],
        [Sample(-1.0, 16.0)],
    ],
)
def test_a_failed_write_leaves_what_was_there(tmp_path: Path, write: Any, samples: list[Sample]) -> None:
    path = tmp_path / "old"
    path.write_text("old")
    with pytest.raises(ValueError, match="time"):
        write(path, samples, PARAMETERS)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("write", [write_tlog, write_dataflash])
def test_equal_values_give_equal_bytes(tmp_path: Path, write: Any) -> None:
    write(tmp_path / "a", FLIGHT, PARAMETERS)
    write(tmp_path / "b", iter(FLIGHT), PARAMETERS)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    with pytest.raises(ValueError, match="16 characters"):
        write(tmp_path / "c", FLIGHT, {"A_PARAMETER_TOO_LONG": 1.0})
