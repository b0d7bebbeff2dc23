"""Rows as columns: the same rules as row by row, the same meaning as message by message."""

from __future__ import annotations

import math
import random
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cases import first_quick
from factories import generic_pack
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.DFReader import FORMAT_TO_STRUCT
from pymavlink.dialects.v20 import ardupilotmega as dialect
from pymavlink.generator.mavcrc import x25crc

from uavbatt.mavlink import fields
from uavbatt.records import Sample
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, write_log
from uavbatt.telemetry import read_log
from uavbatt.telemetry.builder import LogBuilder, default_instance
from uavbatt.telemetry.column_rules import add_rows, times_s
from uavbatt.telemetry.columns import UNKNOWN, Columns, rows_of
from uavbatt.telemetry.formats import dataflash_binary, tlog_frames, tlog_payloads
from uavbatt.telemetry.formats.checksum import checksums

NUMBERS = st.one_of(st.floats(-10, 300), st.sampled_from([math.nan, 0.0, -1.0, 200.0, 5000.0, -2500.0]))
CLOCK = st.one_of(st.floats(0, 200), st.sampled_from([3.0, 4e5, math.nan]))


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(CLOCK, NUMBERS, NUMBERS, st.integers(0, 2), st.sampled_from([0, 1, UNKNOWN])), max_size=12))
def test_columns_keep_the_rules_of_rows(rows: list[tuple[float, float, float, int, int]]) -> None:
    one, many = LogBuilder(), LogBuilder()
    for raw_s, volts, amps, instance, armed in rows:
        one.add(instance, Sample(one.time_s(raw_s), volts, amps, armed=(False, True, None)[armed]))
    raw_s, volts, amps, instance, armed = (np.array([r[i] for r in rows], np.float64) for i in range(5))
    empty = np.full(len(rows), math.nan)
    time_s = times_s(many, raw_s)
    columns = Columns(time_s, volts, amps, empty, empty, empty, armed.astype(np.int8))
    add_rows(many, instance.astype(np.int64), columns)
    assert list(many.columns) == list(one.rows)
    assert repr({number: kept.samples() for number, kept in many.columns.items()}) == repr(one.rows)
    assert repr({number: rows_of(kept).samples() for number, kept in one.rows.items()}) == repr(one.rows)
    assert not one.rows or default_instance(many) == default_instance(one)
    assert many.all_notes() == one.all_notes() and many.now_s == one.now_s


MILLIVOLTS = st.sampled_from([0, 1, 3700, 4100, 16400, 65534, 65535])


@settings(max_examples=200, deadline=None)
@given(
    st.lists(MILLIVOLTS, min_size=10, max_size=10),
    st.lists(MILLIVOLTS, min_size=4, max_size=4),
    st.sampled_from([-1, -150, 0, 1250, 32767]),
    st.sampled_from([-1, 0, 700]),
    st.sampled_from([32767, 0, -1000, 2510]),
    st.integers(-128, 127),
)
def test_payloads_mean_what_messages_mean(mV: Any, ext: Any, cA: int, mAh: int, cdeg: int, percent: int) -> None:
    link = dialect.MAVLink(None)
    status = dialect.MAVLink_battery_status_message(3, 0, 0, cdeg, mV, cA, mAh, -1, percent, voltages_ext=ext)
    sys_status = dialect.MAVLink_sys_status_message(0, 0, 0, 0, mV[0], cA, percent, 0, 0, 0, 0, 0, 0)
    battery2 = dialect.MAVLink_battery2_message(mV[0], cA)
    scalar = (fields.battery_status(status), fields.sys_status(sys_status), fields.battery2(battery2))
    for message, expected in zip((status, sys_status, battery2), scalar, strict=True):
        kind = tlog_payloads.KINDS[message.get_msgId()]
        payload = message.pack(link)[10:-2].ljust(kind.layout.itemsize, b"\0")[: kind.layout.itemsize]
        said = kind.read(np.frombuffer(payload, kind.layout))
        cells = () if said.cells_V is None else tuple(v for v in said.cells_V[0].tolist() if v == v)
        numbers = [float(column[0]) for column in said[1:-1]]
        assert repr((int(said.instance[0]), *numbers, cells)) == repr(
            (expected.id, expected.voltage_V, expected.current_A, expected.temp_C, expected.consumed_Ah,
             expected.reported_soc, expected.cell_voltages_V)
        )  # fmt: skip


def test_own_tables_are_those_of_pymavlink() -> None:
    known = tlog_frames.SEEDS.keys() & dialect.mavlink_map.keys()
    assert {number: dialect.mavlink_map[number].crc_extra for number in known} == {
        number: tlog_frames.SEEDS[number] for number in known
    }
    assert tlog_frames.SEEDS.keys() - known <= {372}  # BATTERY_INFO: younger than some releases of pymavlink
    for character, (code, scale, _) in FORMAT_TO_STRUCT.items():
        ours, divisor = dataflash_binary.CHARACTERS[character]
        assert np.dtype(ours).itemsize == struct.calcsize("<" + code), character
        assert divisor == (0 if scale is None else round(1 / scale)), character


def test_checksums_of_many_lengths_at_once() -> None:
    data = random.Random(1).randbytes(3000)
    start, length = np.arange(0, 2600, 13), np.arange(200) * 7 % 257
    seed = np.arange(200) % 256
    expected = [
        x25crc(data[at : at + size] + bytes([last])).crc
        for at, size, last in zip(start.tolist(), length.tolist(), seed.tolist(), strict=True)
    ]
    assert checksums(np.frombuffer(data, np.uint8), start, length, seed).tolist() == expected


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The same simulated flight as it is written by both writers."""

    pack = generic_pack(4, 5.0, 13.2, math.nan)
    samples = simulate_flight(pack, SimulatedFlight(power_W=350.0, rate_Hz=5.0))
    folder = tmp_path_factory.mktemp("flown")
    for name in ("a.tlog", "a.BIN"):
        write_log(folder / name, samples, pack)
    return {name: (folder / name).read_bytes() for name in ("a.tlog", "a.BIN")}


DAMAGE = {
    "drop": lambda data, at: data[:at] + data[at + 4096 :],
    "zero": lambda data, at: data[:at] + bytes(4096) + data[at + 4096 :],
    "noise": lambda data, at: data[:at] + random.Random(at).randbytes(65_536) + data[at + 65_536 :],
    "cut": lambda data, at: data[:at],
}


@pytest.mark.parametrize("name", first_quick(1, ["a.tlog", "a.BIN"]))
@pytest.mark.parametrize("kind", DAMAGE)
def test_damage_costs_its_own_rows_and_is_told(
    flown: dict[str, bytes], tmp_path: Path, name: str, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for reader in (tlog_frames, dataflash_binary):
        monkeypatch.setattr(reader, "_WINDOW", 40_000)  # many windows in a small file
    data, path = flown[name], tmp_path / name
    path.write_bytes(data)
    clean = read_log(path).samples
    size = {"noise": 65_536, "cut": 0}.get(kind, 4096)
    for at in random.Random(5).sample(range(1000, len(data) - size - 1), 12):
        path.write_bytes(DAMAGE[kind](data, at))
        flight = read_log(path)
        before = at / len(data) * len(clean)
        expected = before if kind == "cut" else len(clean) * (1 - size / len(data))
        assert len(flight.samples) == pytest.approx(expected, abs=20)  # of about 4000
        assert set(flight.samples) <= set(clean)
        hidden = {"drop": 0, "cut": 0}.get(kind, size)  # the bytes of the damage itself that are in the file
        assert hidden <= flight.skipped_bytes <= hidden + 200


def test_a_torn_stamp_is_no_leap_of_the_clock(flown: dict[str, bytes], tmp_path: Path) -> None:
    data, path = flown["a.tlog"], tmp_path / "a.tlog"
    path.write_bytes(data)
    clean = read_log(path)
    frames = tlog_frames.frames(data)
    at = int(frames.start[len(frames.start) // 2])
    path.write_bytes(data[: at - 500] + bytes(504) + data[at + 4 :])
    flight = read_log(path)
    assert flight.duration_s == clean.duration_s and set(flight.samples) < set(clean.samples)


def test_a_record_that_only_looks_like_a_definition(tmp_path: Path) -> None:
    """An FMT inside the payload of another record does not change the types."""

    def fmt(kind: int, length: int, name: bytes, chars: bytes, labels: bytes) -> bytes:
        return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, length, name, chars, labels)

    forged = fmt(10, 40, b"BAT", b"QB", b"TimeUS,X") + b"\xa3\x95"
    data = fmt(10, 3 + 20, b"BAT", b"Qfff", b"TimeUS,Volt,Curr,CurrTot")
    data += fmt(11, 3 + 128, b"FILE", b"ZZ", b"A,B")
    row = b"\xa3\x95\x0a" + struct.pack("<Qfff", 5_000_000, 16.0, 10.0, 100.0)
    data += row + b"\xa3\x95\x0b" + forged.ljust(128, b"x") + row * 3
    path = tmp_path / "a.BIN"
    path.write_bytes(data)
    flight = read_log(path)
    assert (len(flight.samples), flight.skipped_bytes) == (4, 0)


def test_a_type_may_be_defined_anew(tmp_path: Path) -> None:
    def fmt(chars: bytes, labels: bytes, length: int) -> bytes:
        return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", 10, length, b"BAT", chars, labels)

    data = fmt(b"Qff", b"TimeUS,Volt,Curr", 19)
    data += b"\xa3\x95\x0a" + struct.pack("<Qff", 1_000_000, 16.0, 10.0)
    data += fmt(b"Qf", b"TimeUS,Volt", 15) + b"\xa3\x95\x0a" + struct.pack("<Qf", 2_000_000, 15.0)
    path = tmp_path / "a.BIN"
    path.write_bytes(data)
    assert [(s.time_s, s.voltage_V) for s in read_log(path).samples] == [(0.0, 16.0), (1.0, 15.0)]
    assert dataflash_binary.read_dataflash(data).skipped_bytes == 0


def test_a_clean_log_needs_no_dialect(flown: dict[str, bytes], monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> Any:
        raise AssertionError("the dialect was asked for")

    monkeypatch.setattr(tlog_frames, "_dialect", refuse)
    found = tlog_frames.frames(flown["a.tlog"])
    assert found.skipped_bytes == 0 and len(found.start) > 100
