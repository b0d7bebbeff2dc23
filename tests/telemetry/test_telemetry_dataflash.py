"""DataFlash logs, binary and text, from records written here byte by byte."""

from __future__ import annotations

import math
import random
import struct
from pathlib import Path

import pytest

from uavbatt.errors import BadInput, UsageError
from uavbatt.records import Flight, Sample
from uavbatt.telemetry import read_log

CODES = {"h": "h", "H": "H", "I": "I", "Q": "Q", "B": "B", "f": "f", "c": "h", "N": "16s", "n": "4s"}


def fmt(kind: int, name: str, chars: str, labels: str) -> bytes:
    length = 3 + struct.calcsize("<" + "".join(CODES[c] for c in chars))
    packed = struct.pack("<BB4s16s64s", kind, length, name.encode(), chars.encode(), labels.encode())
    return b"\xa3\x95\x80" + packed


def rec(kind: int, chars: str, *values: float | bytes) -> bytes:
    return b"\xa3\x95" + bytes([kind]) + struct.pack("<" + "".join(CODES[c] for c in chars), *values)


def read(tmp_path: Path, data: bytes, instance: int | None = None, name: str = "log.BIN") -> Flight:
    path = tmp_path / name
    path.write_bytes(data)
    return read_log(path, instance)


BAT_VARIANTS = {
    "4.0": ("Qfffffcf", "TimeUS,Volt,VoltR,Curr,CurrTot,EnrgTot,Temp,Res"),
    "4.1": ("QBfffffcf", "TimeUS,Instance,Volt,VoltR,Curr,CurrTot,EnrgTot,Temp,Res"),
    "rem": ("QBfffffcfB", "TimeUS,Inst,Volt,VoltR,Curr,CurrTot,EnrgTot,Temp,Res,RemPct"),
    "health": ("QBfffffcfBBB", "TimeUS,Inst,Volt,VoltR,Curr,CurrTot,EnrgTot,Temp,Res,RemPct,H,SH"),
}


def bat(variant: str, time_us: int, volt: float, curr: float, temp_c: int = 2500, inst: int = 0) -> bytes:
    chars, labels = BAT_VARIANTS[variant]
    by_label = {
        "TimeUS": time_us, "Instance": inst, "Inst": inst, "Volt": volt, "VoltR": 99.0, "Curr": curr,
        "CurrTot": 1500.0, "EnrgTot": 1.0, "Temp": temp_c, "Res": 0.01, "RemPct": 55, "H": 1, "SH": 100,
    }  # fmt: skip
    return rec(10, chars, *(by_label[label] for label in labels.split(",")))


@pytest.mark.parametrize("variant", BAT_VARIANTS)
def test_every_variant_of_bat_gives_the_same_row(tmp_path: Path, variant: str) -> None:
    chars, labels = BAT_VARIANTS[variant]
    data = fmt(10, "BAT", chars, labels)
    data += bat(variant, 5_000_000, 16.5, 12.5) + bat(variant, 5_500_000, 16.25, 13.5, temp_c=0)
    flight = read(tmp_path, data)
    assert flight.kind == "dataflash-binary"
    first, second = flight.samples
    assert (first.time_s, second.time_s) == (0.0, 0.5)
    assert (first.voltage_V, first.current_A, first.temp_C, first.consumed_Ah) == (16.5, 12.5, 25.0, 1.5)
    assert math.isnan(second.temp_C)  # Temp 0: no sensor
    if "RemPct" in labels:
        assert first.reported_soc == 0.55
    else:
        assert math.isnan(first.reported_soc)


@pytest.mark.parametrize(
    ("chars", "labels", "values"),
    [
        ("hIhhhf", "Thr,ThrInt,Volt,Curr,Vcc,CurrTot", (0, 1, 1093, 2532, 5000, 700.0)),
        ("IhIhhhf", "TimeMS,ThrOut,ThrInt,Volt,Curr,Vcc,CurrTot", (7000, 0, 1, 1093, 2532, 5000, 700.0)),
        ("IhhhHfh", "TimeMS,Throttle,Volt,Curr,Vcc,CurrTot,Volt2", (7000, 0, 1093, 2532, 5000, 700.0, 0)),
        ("Qfff", "TimeUS,Volt,Curr,CurrTot", (7_000_000, 10.93, 25.32, 700.0)),
    ],
)
def test_every_variant_of_curr_gives_the_same_row(
    tmp_path: Path, chars: str, labels: str, values: tuple[float, ...]
) -> None:
    data = fmt(9, "CURR", chars, labels) + rec(9, chars, *values) * 3
    flight = read(tmp_path, data)
    sample = flight.samples[0]
    assert sample.voltage_V == pytest.approx(10.93, abs=1e-6)
    assert sample.current_A == pytest.approx(25.32, abs=1e-5)
    assert sample.consumed_Ah == pytest.approx(0.7)
    if "Time" not in labels:
        assert [s.time_s for s in flight.samples] == [0.0, 1.0, 2.0]
        assert any("no time" in note for note in flight.notes)


def test_time_counts_from_the_first_timed_record_of_any_kind(tmp_path: Path) -> None:
    chars, labels = BAT_VARIANTS["4.1"]
    data = fmt(10, "BAT", chars, labels) + fmt(11, "IMU", "Qf", "TimeUS,GyrX")
    data += fmt(12, "GPS", "BIB", "Status,TimeMS,Week") + rec(12, "BIB", 3, 109_206_800, 1)
    data += rec(11, "Qf", 1_000_000, 0.0) + bat("4.1", 4_000_000, 16.0, 1.0) + rec(11, "Qf", 9_000_000, 0.0)
    flight = read(tmp_path, data)
    assert flight.samples[0].time_s == 3.0
    assert flight.duration_s == 8.0


def test_the_battery_with_a_current_is_the_default_one(tmp_path: Path) -> None:
    chars, labels = BAT_VARIANTS["4.1"]
    data = fmt(10, "BAT", chars, labels)
    for n in range(3):
        data += bat("4.1", n * 1_000_000, 12.0, math.nan) + bat("4.1", n * 1_000_000, 24.0, 5.0, inst=1)
    flight = read(tmp_path, data)
    assert (flight.instance, flight.instances) == (1, (0, 1))
    assert read(tmp_path, data, instance=0).samples[0].voltage_V == 12.0
    with pytest.raises(UsageError, match="no battery instance 4; the log has: 0, 1"):
        read(tmp_path, data, instance=4)


def test_second_battery_by_name(tmp_path: Path) -> None:
    data = fmt(9, "CURR", "Qfff", "TimeUS,Volt,Curr,CurrTot") + fmt(8, "CUR2", "Qfff", "TimeUS,Volt,Curr,CurrTot")
    data += rec(9, "Qfff", 0, 12.0, 1.0, 0.0) + rec(8, "Qfff", 0, 24.0, 2.0, 0.0)
    assert read(tmp_path, data, instance=1).samples[0].voltage_V == 24.0
    chars, labels = BAT_VARIANTS["4.0"]
    data = fmt(10, "BAT", chars, labels) + fmt(13, "BAT2", chars, labels)
    data += bat("4.0", 0, 12.0, 1.0) + bat("4.0", 0, 24.0, 1.0).replace(b"\xa3\x95\x0a", b"\xa3\x95\x0d")
    assert read(tmp_path, data, instance=1).samples[0].voltage_V == 24.0


def test_cells_join_the_row_of_their_instant(tmp_path: Path) -> None:
    chars, labels = BAT_VARIANTS["4.1"]
    bcl = "QBfHHHH"
    data = fmt(10, "BAT", chars, labels) + fmt(14, "BCL", bcl, "TimeUS,Instance,Volt,V1,V2,V3,V4")
    data += bat("4.1", 0, 12.0, 1.0) + rec(14, bcl, 0, 0, 12.0, 4001, 4002, 0, 65535)
    data += bat("4.1", 1_000_000, 12.0, 1.0)
    first, second = read(tmp_path, data).samples
    assert first.cell_voltages_V == (4.001, 4.002)
    assert second.cell_voltages_V == ()


def test_the_armed_flag_follows_the_events(tmp_path: Path) -> None:
    chars, labels = BAT_VARIANTS["4.1"]
    data = fmt(10, "BAT", chars, labels) + fmt(15, "EV", "QB", "TimeUS,Id") + fmt(16, "ARM", "QB", "TimeUS,ArmState")
    steps = [rec(15, "QB", 1, 10), rec(15, "QB", 2, 15), rec(15, "QB", 3, 11), rec(16, "QB", 4, 1)]
    data += bat("4.1", 0, 12.0, 1.0)
    for n, step in enumerate(steps):
        data += step + bat("4.1", n + 5, 12.0, 1.0)
    assert [s.armed for s in read(tmp_path, data).samples] == [None, True, True, False, True]


def parm(name: str, value: float, time_us: int | None = None) -> bytes:
    if time_us is None:
        return rec(20, "Nf", name.encode(), value)
    return rec(20, "QNf", time_us, name.encode(), value)


def test_facts_hold_from_the_moment_they_are_logged(tmp_path: Path) -> None:
    chars, labels = BAT_VARIANTS["4.1"]
    data = fmt(10, "BAT", chars, labels) + fmt(20, "PARM", "QNf", "TimeUS,Name,Value")
    data += parm("BATT_CAPACITY", 3300, 1_000_000) + parm("BATT_CRT_VOLT", 0, 1_000_000)
    data += bat("4.1", 2_000_000, 12.0, 1.0)
    data += parm("BATT_CRT_VOLT", 13.2, 3_000_000) + parm("BATT_OPTIONS", 64, 3_000_000)
    data += parm("BATT2_CAPACITY", 9000, 3_000_000)
    data += bat("4.1", 4_000_000, 12.0, 1.0)
    flight = read(tmp_path, data)
    early, late = flight.facts_at(1.0), flight.facts_at(3.0)
    assert early.capacity_Ah == 3.3 and math.isnan(early.critical_voltage_V)
    assert late.critical_voltage_V == pytest.approx(13.2)
    assert late.sag_compensated is False  # the option bends telemetry, not the on-board log
    assert any("3300 mAh" in note for note in flight.notes)


def test_old_parameters_without_time(tmp_path: Path) -> None:
    data = fmt(9, "CURR", "IhIhhhf", "TimeMS,ThrOut,ThrInt,Volt,Curr,Vcc,CurrTot")
    data += fmt(20, "PARM", "Nf", "Name,Value")
    data += parm("FS_BATT_VOLTAGE", 14.0) + parm("BATT_CAPACITY", 4200) + parm("BATT_MONITOR", 3)
    data += rec(9, "IhIhhhf", 5000, 0, 0, 1690, 0, 0, 0.0)
    flight = read(tmp_path, data)
    assert flight.facts_at(0.0).low_voltage_V == 14.0
    assert flight.facts_at(0.0).capacity_Ah == 4.2
    assert math.isnan(flight.samples[0].current_A)  # a voltage-only monitor logs 0 A


def test_impossible_values_are_dropped_or_unknown(tmp_path: Path) -> None:
    chars, labels = BAT_VARIANTS["4.1"]
    data = fmt(10, "BAT", chars, labels)
    for n, (volt, curr) in enumerate([(0.0, 1.0), (math.nan, 1.0), (250.0, 1.0), (12.0, 5000.0), (12.0, math.inf)]):
        data += bat("4.1", n * 1_000_000, volt, curr)
    data += bat("4.1", 6_000_000, 12.0, -0.5)
    flight = read(tmp_path, data)
    assert [s.time_s for s in flight.samples] == [3.0, 4.0, 6.0]
    assert math.isnan(flight.samples[0].current_A) and math.isnan(flight.samples[1].current_A)
    assert flight.samples[2].current_A == -0.5
    assert "3 rows without a possible voltage dropped" in flight.notes


def test_disorder_reboot_and_leap(tmp_path: Path) -> None:
    chars, labels = BAT_VARIANTS["4.1"]
    data = fmt(10, "BAT", chars, labels)
    for time_s in (100.0, 101.0, 100.5, 102.0, 3.0, 4.0, 1e9, 1e9 + 1):
        data += bat("4.1", int(time_s * 1e6), 12.0, 1.0)
    flight = read(tmp_path, data)
    assert [s.time_s for s in flight.samples] == [0.0, 1.0, 2.0, 12.0, 13.0, 14.0, 15.0]
    assert "1 rows out of order dropped" in flight.notes
    assert any(note.startswith("reboot at 2.0 s") for note in flight.notes)
    assert any(note.startswith("clock leap at 13.0 s") for note in flight.notes)


def long_log(rows: int = 2000) -> bytes:
    chars, labels = BAT_VARIANTS["4.1"]
    data = fmt(10, "BAT", chars, labels) + fmt(11, "IMU", "Qfff", "TimeUS,X,Y,Z")
    for n in range(rows):
        data += bat("4.1", n * 100_000, 12.0 + n / 1e4, 5.0) + rec(11, "Qfff", n * 100_000 + 50, 1.0, 2.0, 3.0) * 4
    return data


@pytest.mark.parametrize("damage", ["drop", "zero", "random", "big random"])
def test_damage_costs_only_its_own_rows(tmp_path: Path, damage: str, capsys: pytest.CaptureFixture[str]) -> None:
    data = long_log()
    clean = {s.time_s: s for s in read(tmp_path, data).samples}
    generator = random.Random(3)
    at, size = 90_001, 20_000 if damage == "big random" else 4096
    filler = {"drop": b"", "zero": bytes(size)}.get(damage, generator.randbytes(size))
    flight = read(tmp_path, data[:at] + filler + data[at + size :])
    lost_at_most = size // 130 + 4  # a row and its four neighbours take 130 bytes
    assert len(flight.samples) >= 2000 - lost_at_most
    assert all(clean[s.time_s] == s for s in flight.samples)
    assert flight.skipped_bytes > 0 or damage == "drop"
    assert capsys.readouterr().out == ""


def test_padding_behind_the_last_record_is_no_damage(tmp_path: Path) -> None:
    flight = read(tmp_path, long_log(50) + b"\xff" * 500)
    assert (len(flight.samples), flight.skipped_bytes) == (50, 0)


@pytest.mark.parametrize("share", [0.31, 0.6, 0.875])
def test_a_cut_log_is_a_prefix(tmp_path: Path, share: float) -> None:
    data = long_log(200)
    whole, cut = read(tmp_path, data), read(tmp_path, data[: int(len(data) * share)])
    assert cut.samples == whole.samples[: len(cut.samples)]
    assert len(cut.samples) == pytest.approx(200 * share, abs=3)


TEXT = """1

ArduCopter V3.0.1
FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format
FMT, 129, 23, PARM, Nf, Name,Value
FMT, 9, 19, CURR, hIhhhf, Thr,ThrInt,Volt,Curr,Vcc,CurrTot
FMT, 13, 4, EV, B, Id
PARM, BATT_CAPACITY, 4000.000000
EV, 10
CURR, 164, 1153, 1198, 297, 5028, 0.654078
CURR, 0, 1811, 12
CURR, 0, 1811, 1210, 0, 5028, 1.030283
"""


def test_a_text_log_gives_rows_facts_and_the_bytes_of_damaged_lines(tmp_path: Path) -> None:
    flight = read(tmp_path, TEXT.encode(), name="anything.txt")
    assert flight.kind == "dataflash-text"
    first, second = flight.samples
    assert (first.time_s, first.voltage_V, first.current_A, first.armed) == (0.0, 11.98, 2.97, True)
    assert (second.time_s, second.voltage_V) == (1.0, 12.1)
    assert flight.facts == ((0.0, flight.facts_at(0.0)),)
    assert flight.facts_at(0.0).capacity_Ah == 4.0
    assert flight.skipped_bytes == len("CURR, 0, 1811, 12\n")


def test_text_with_time_and_a_cut_last_number(tmp_path: Path) -> None:
    text = (
        "FMT, 129, 3, IMU, Qf, TimeUS,X\nFMT, 9, 19, BAT, QBfff, TimeUS,Instance,Volt,Curr,CurrTot\n"
        "IMU, 1000000, 1\nBAT, 2000000, 0, 16.5, 12, 1234.5\nIMU, 5000000, 1\nBAT, 6000000, 0, 16.5, 12, 12"
    )
    flight = read(tmp_path, text.encode(), name="flight.log")
    assert [s.time_s for s in flight.samples] == [1.0, 5.0]
    assert math.isnan(flight.samples[1].consumed_Ah)


def test_a_log_without_battery_messages_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="expected battery messages"):
        read(tmp_path, fmt(11, "IMU", "Qf", "TimeUS,X") + rec(11, "Qf", 5, 1.0))


REAL = (
    "flights/ardupilot/quad_3s_2650_emptied.BIN",
    "flights/ardupilot/quad_4s_3000_a.bin",
    "flights/ardupilot/quad_4s_6000_a.bin",
    "flights/ardupilot/solo_4s_5200_smart.bin",
    "flights/ardupilot/quad_3s_4000_underpowered.log",
    "flights/ardupilot/quad_4s_4200.log",
)


@pytest.mark.parametrize("name", REAL)
def test_real_logs_agree_with_pymavlink(shared_data: Path, name: str) -> None:
    from pymavlink import DFReader

    path = shared_data / name
    reader = DFReader.DFReader_text if name.endswith(".log") else DFReader.DFReader_binary
    log, rows = reader(str(path)), []
    while (message := log.recv_match(type=["CURR", "BAT"])) is not None:
        per_volt = 100 if message.fmt.format[message._fieldnames.index("Volt")] == "h" else 1
        rows.append((message.Volt / per_volt, message.Curr / per_volt))
    assert [(s.voltage_V, s.current_A) for s in read_log(path).samples] == rows


def test_a_real_log_cut_short_is_a_prefix(shared_data: Path, tmp_path: Path) -> None:
    data = (shared_data / REAL[1]).read_bytes()
    whole, cut = read(tmp_path, data), read(tmp_path, data[: int(len(data) * 0.6)])
    last_s = cut.samples[-1].time_s
    assert _comparable(cut.samples) == _comparable(whole.samples[: len(cut.samples)])
    assert [f for f in whole.facts if f[0] <= last_s] == list(cut.facts)


def _comparable(samples: tuple[Sample, ...]) -> list[str]:
    return [repr(s) for s in samples]  # NaN is unequal to itself
