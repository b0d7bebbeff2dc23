"""Telemetry logs, from frames packed by pymavlink, and the sentinels of every field."""

from __future__ import annotations

import gzip
import math
import random
import struct
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from cases import first_quick
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.errors import BadInput
from uavbatt.mavlink import fields
from uavbatt.records import Flight
from uavbatt.telemetry import read_log

EPOCH_S = 1_700_000_000.0


def pack(
    message: Any, time_s: float, system: int = 1, component: int = 1, v1: bool = False, sign: bool = False
) -> bytes:
    link = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
    if sign:
        link.signing.secret_key, link.signing.sign_outgoing = b"k" * 32, True
    frame = message.pack(link, force_mavlink1=v1)
    return struct.pack(">Q", round((EPOCH_S + time_s) * 1e6)) + bytes(frame)


def battery(
    mV: list[int] | None = None, cA: int = 1250, mAh: int = 700, cdeg: int = 2510, percent: int = 80, id: int = 0,
    ext: list[int] | None = None,
) -> Any:  # fmt: skip
    voltages = (mV or [16400]) + [65535] * (10 - len(mV or [0]))
    return dialect.MAVLink_battery_status_message(
        id, 0, 0, cdeg, voltages, cA, mAh, -1, percent, voltages_ext=ext or [0, 0, 0, 0]
    )


def sys_status(mV: int = 15000, cA: int = 500, percent: int = 50) -> Any:
    return dialect.MAVLink_sys_status_message(0, 0, 0, 0, mV, cA, percent, 0, 0, 0, 0, 0, 0)


def heartbeat(armed: bool = True, autopilot: int = 3, type: int = 2) -> Any:
    return dialect.MAVLink_heartbeat_message(type, autopilot, 128 if armed else 0, 0, 3, 3)


def param(name: str, value: float, type: int = 9) -> Any:
    return dialect.MAVLink_param_value_message(name.encode(), value, type, 1, 0)


def read(tmp_path: Path, *packed: bytes, instance: int | None = None) -> Flight:
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"".join(packed))
    return read_log(path, instance)


@pytest.mark.parametrize(("v1", "sign"), [(False, False), (True, False), (False, True)])
def test_a_battery_message_becomes_a_row_with_the_armed_flag(tmp_path: Path, v1: bool, sign: bool) -> None:
    flight = read(
        tmp_path, pack(heartbeat(), 0.0, v1=v1, sign=sign), pack(battery(), 1.5, v1=v1, sign=sign),
        pack(heartbeat(armed=False), 1.9), pack(heartbeat(armed=False), 2.0), pack(battery(), 3.0),
    )  # fmt: skip
    first, second = flight.samples
    assert (flight.kind, flight.duration_s) == ("tlog", 3.0)
    assert (first.time_s, first.voltage_V, first.current_A) == (1.5, 16.4, 12.5)
    assert (first.temp_C, first.consumed_Ah, first.reported_soc) == (25.1, 0.7, 0.8)
    assert (first.armed, second.armed) == (True, False)


def test_a_clean_log_needs_no_dialect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its import takes longer than to read a big log; a log begins with any message."""
    monkeypatch.delattr("uavbatt.telemetry.formats.tlog_frames._dialect")
    attitude = dialect.MAVLink_attitude_message(0, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0)
    flight = read(tmp_path, pack(attitude, 0.0), pack(heartbeat(), 0.5), pack(battery(), 1.5))
    assert ([s.time_s for s in flight.samples], flight.skipped_bytes) == ([1.5], 0)


def test_the_unknown_of_battery_status_becomes_nan() -> None:
    row = fields.battery_status(battery(cA=-1, mAh=-1, cdeg=32767, percent=-1))
    assert all(math.isnan(v) for v in (row.current_A, row.consumed_Ah, row.temp_C, row.reported_soc))
    assert fields.battery_status(battery(cdeg=0)).temp_C == 0.0  # a real 0 °C on this wire
    assert fields.battery_status(battery(cA=-150)).current_A == -1.5
    assert math.isnan(fields.battery_status(battery(mV=[65535])).voltage_V)
    assert math.isnan(fields.battery_status(battery(mV=[0])).voltage_V)


def test_pack_cells_and_packs_beyond_one_field() -> None:
    assert fields.pack_voltage_V([16400] + [65535] * 9) == (16.4, ())
    assert fields.pack_voltage_V([4100, 4090, 4080] + [65535] * 7) == (12.27, (4.1, 4.09, 4.08))
    assert fields.pack_voltage_V([65534, 4466] + [65535] * 8) == (70.0, ())
    assert fields.pack_voltage_V([16400] + [0] * 9) == (16.4, ())
    total_V, cells_V = fields.pack_voltage_V([4000] * 10, [4000, 4000, 0, 0])
    assert total_V == 48.0 and len(cells_V) == 12


def test_sys_status_and_battery2_sentinels() -> None:
    assert math.isnan(fields.sys_status(sys_status(mV=65535)).voltage_V)
    row = fields.sys_status(sys_status(cA=-1, percent=-1))
    assert math.isnan(row.current_A) and math.isnan(row.reported_soc) and row.voltage_V == 15.0
    second = fields.battery2(dialect.MAVLink_battery2_message(24000, -1))
    assert (second.id, second.voltage_V) == (1, 24.0) and math.isnan(second.current_A)
    assert math.isnan(fields.battery2(dialect.MAVLink_battery2_message(65535, 0)).voltage_V)


def test_sys_status_only_without_battery_status(tmp_path: Path) -> None:
    both = read(tmp_path, pack(heartbeat(), 0), pack(sys_status(), 1), pack(battery(), 2), pack(sys_status(), 3))
    assert [s.voltage_V for s in both.samples] == [16.4]
    alone = read(tmp_path, pack(heartbeat(), 0), pack(sys_status(), 1), pack(sys_status(), 2))
    assert [s.voltage_V for s in alone.samples] == [15.0, 15.0]
    assert any("SYS_STATUS" in note for note in alone.notes)


def test_battery2_is_instance_1(tmp_path: Path) -> None:
    message = dialect.MAVLink_battery2_message(24000, 300)
    packed = [pack(heartbeat(), 0), pack(battery(), 1), pack(message, 2)]
    assert read(tmp_path, *packed, instance=1).samples[0].voltage_V == 24.0
    newer = read(tmp_path, *packed, pack(battery(mV=[23000], id=1), 3), instance=1)
    assert [s.voltage_V for s in newer.samples] == [23.0]


def test_only_the_autopilot_speaks(tmp_path: Path) -> None:
    flight = read(
        tmp_path,
        pack(heartbeat(autopilot=8, type=6), 0, 255, 190),
        pack(heartbeat(autopilot=8, type=36), 0, 1, 180),
        pack(battery(mV=[9000]), 0.5, 1, 180),
        pack(heartbeat(), 1),
        pack(heartbeat(), 1, 2, 1),
        pack(battery(), 2),
        pack(battery(mV=[22000]), 3, 2, 1),
    )
    assert [s.voltage_V for s in flight.samples] == [16.4]
    assert flight.samples[0].time_s == 2.0  # from the first record of anybody
    assert sum("ignored" in note for note in flight.notes) == 2


def test_parameters_of_ardupilot_hold_from_when_they_are_heard(tmp_path: Path) -> None:
    flight = read(
        tmp_path, pack(heartbeat(), 0), pack(param("BATT_CAPACITY", 5000), 1), pack(battery(), 2),
        pack(param("BATT_OPTIONS", 64), 3), pack(param("BATT_LOW_VOLT", 14.0), 3), pack(battery(), 4),
    )  # fmt: skip
    assert flight.facts_at(0.5).capacity_Ah != 5.0
    assert flight.facts_at(1.0).capacity_Ah == 5.0
    assert flight.facts_at(2.0).sag_compensated is None
    assert flight.facts_at(3.0).sag_compensated is True
    assert flight.facts_at(9.0).low_voltage_V == 14.0


def test_parameters_of_px4_are_bit_patterns(tmp_path: Path) -> None:
    def bits(number: int) -> float:
        return float(struct.unpack("<f", struct.pack("<i", number))[0])

    flight = read(
        tmp_path, pack(heartbeat(autopilot=12), 0), pack(param("BAT1_N_CELLS", bits(6), type=6), 1),
        pack(param("BAT1_CAPACITY", -1.0), 1), pack(param("BAT1_V_EMPTY", 3.5), 1),
        pack(param("BAT_N_CELLS", bits(3), type=6), 2), pack(battery(), 3),
    )  # fmt: skip
    facts = flight.facts_at(3.0)
    assert (facts.cells_series, facts.critical_voltage_V) == (6, 21.0)
    assert math.isnan(facts.capacity_Ah)


def test_the_log_tells_who_flew(tmp_path: Path) -> None:
    said = dialect.MAVLink_autopilot_version_message(0, 0x04050100, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0xABC)
    flight = read(
        tmp_path, pack(heartbeat(), 0, 7), pack(said, 1, 7), pack(param("BATT_SERIAL_NUM", 77), 1, 7),
        pack(battery(), 2, 7),
    )  # fmt: skip
    who = flight.identity
    assert (who.system, who.firmware, who.hardware) == (7, "ArduPilot 4.5.1-dev", "0000000000000abc")
    assert (who.battery_serial, who.start_utc_s) == ("77", EPOCH_S)


def stream(rows: int = 400) -> list[bytes]:
    packed = [pack(heartbeat(), 0.0)]
    for n in range(rows):
        packed.append(pack(battery(mV=[16400 - n], cA=n + 1), 0.5 * n))
        packed.append(pack(dialect.MAVLink_attitude_message(n, 0.1, 0.2, 0.3, 0, 0, 0), 0.5 * n + 0.1))
    return packed


@pytest.mark.parametrize("share", [0.25, 0.6, 0.99])
def test_a_cut_log_is_a_prefix(tmp_path: Path, share: float) -> None:
    data = b"".join(stream())
    whole, cut = read(tmp_path, data), read(tmp_path, data[: int(len(data) * share)])
    assert cut.samples == whole.samples[: len(cut.samples)]
    assert len(cut.samples) == pytest.approx(400 * share, abs=3)


@pytest.mark.parametrize("filler", [b"", bytes(4096), random.Random(1).randbytes(4096)])
def test_damage_costs_only_its_own_rows(tmp_path: Path, filler: bytes) -> None:
    data = b"".join(stream())
    clean = {s.time_s: s for s in read(tmp_path, data).samples}
    at = len(data) // 3 + 5
    flight = read(tmp_path, data[:at] + filler + data[at + 4096 :])
    assert len(flight.samples) >= 400 - 4096 // 80 - 4
    assert all(clean.get(s.time_s) == s for s in flight.samples)
    assert flight.skipped_bytes > 0


def test_a_broken_crc_drops_the_row(tmp_path: Path) -> None:
    packed = stream(5)
    packed[3] = packed[3][:25] + bytes([packed[3][25] ^ 0xFF]) + packed[3][26:]
    flight = read(tmp_path, *packed)
    assert len(flight.samples) == 4
    assert flight.skipped_bytes == len(packed[3])


@pytest.mark.parametrize("payload", [b"", b"\x07"])
def test_a_head_without_a_message_at_the_very_end_is_damage(tmp_path: Path, payload: bytes) -> None:
    """A frame of version 1 with so little payload ends before the place where version 2 has its message number."""
    rows = [pack(heartbeat(), 0.0), *(pack(battery(), float(k)) for k in range(5))]
    stub = struct.pack(">Q", round((EPOCH_S + 5.0) * 1e6)) + bytes([0xFE, len(payload), 0, 1, 1, 0]) + payload + b"\0\0"
    found = read(tmp_path, *rows, stub)
    assert found.samples == read(tmp_path, *rows).samples and len(found.samples) == 5


def test_no_battery_in_a_tlog(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="expected battery messages"):
        read(tmp_path, pack(heartbeat(), 0), pack(heartbeat(), 1))


def test_environment_does_not_matter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAVLINK_DIALECT", "minimal")
    monkeypatch.delenv("MAVLINK20", raising=False)
    assert len(read(tmp_path, *stream(3)).samples) == 3


@pytest.mark.parametrize("number", first_quick(2, [1, 2, 3, 4]))
def test_real_tlogs_agree_with_pymavlink(shared_data: Path, number: int) -> None:
    from pymavlink import mavutil

    path = shared_data / f"truth/reference/r0/flight_{number}.tlog"
    rows, first_s = [], None
    with closing(mavutil.mavlink_connection(str(path))) as log:
        while (message := log.recv_match()) is not None:
            first_s = message._timestamp if first_s is None else first_s
            if message.get_type() == "BATTERY_STATUS":
                rows.append((round(message._timestamp - first_s, 3), message.voltages[0], message.current_battery))
    flight = read_log(path)
    assert [
        (round(s.time_s, 3), round(s.voltage_V * 1000), -1 if math.isnan(s.current_A) else round(s.current_A * 100))
        for s in flight.samples
    ] == rows
    assert flight.skipped_bytes == 0
    assert flight.facts_at(9e9).critical_voltage_V == pytest.approx(13.2)


def test_a_recording_says_its_period_packed_or_not(tmp_path: Path) -> None:
    log = pack(param("UAVB_FORECAST_S", 1.0), 0.0) + pack(heartbeat(), 0.5) + pack(battery(), 1.0)
    (tmp_path / "packed.tlog.gz").write_bytes(gzip.compress(log))
    assert read(tmp_path, log).forecast_period_s == read_log(tmp_path / "packed.tlog.gz").forecast_period_s == 1.0
    assert math.isnan(read(tmp_path, pack(heartbeat(), 0.5) + pack(battery(), 1.0)).forecast_period_s)
