"""Tables that apps and loggers write: DJI flights (AirData, Flight Reader), logs of radios, decoded blackbox logs.

The files are made up; their columns, units and rates are those of real exports.
"""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime
from pathlib import Path

import pytest

from uavbatt.errors import BadInput
from uavbatt.records import Flight, Sample
from uavbatt.telemetry import read_log

AIRDATA = (
    "time(millisecond),datetime(utc),latitude,voltage(v), pitch(degrees),battery_percent,voltageCell1,voltageCell2,"
    "voltageCell3,current(A),battery_temperature(f),message\n"
)
RECORD = (
    "CUSTOM.date [local], OSD.flyTime, OSD.flyTime [s], OSD.isMotorOn, BATTERY.chargeLevel, "
    "BATTERY.currentCapacity [mAh], BATTERY.fullCapacity [mAh], BATTERY.voltage [V], BATTERY.cellVoltage1 [V], "
    "BATTERY.cellVoltage2 [V], BATTERY.current [A], BATTERY.temperature [C], APP.message\n"
)
BLACKBOX = (
    "loopIteration, time (us), vbatLatest (V), amperageLatest (A), energyCumulative (mAh), flightModeFlags (flags)\n"
)

RADIO = (
    "Date,Time,1RSS(dB),RQly(%),TPWR(mW),GPS,Alt(m),RxBt(V),Curr(A),Capa(mAh),Bat%(%),FM,Rud,Thr,SA,LSW,CH1(us),"
    "TxBat(V)\n"
)


def read(tmp_path: Path, text: str | bytes, name: str = "flight.csv") -> Flight:
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_log(path)


def airdata_rows(seconds: int) -> str:
    """Ten rows a second, in which the pack speaks once; silent (0 V) in the first second."""
    rows = []
    for k in range(10 * seconds):
        second = k // 10
        volts, amps = (8.6 - 0.01 * second, 4.0 + 0.1 * second) if second else (0.0, 0.0)
        rows.append(f"{100 * k},2026-05-01 10:00:{second:02d},47.5,{volts:.3f}, 1.5,95,4.25,4.24,0,{amps:.1f},77,\n")
    return "".join(rows)


def record_row(k: int, *, motors: str = "True", amps: float = 4.0, full: str = "1931") -> str:
    return f"5/1/2026,0m {k / 10}s,{k / 10},{motors},92,1762,{full},8.083,4.036,4.029,{amps},29.2,\n"


def test_an_airdata_table_gives_each_row_once_with_its_cells(tmp_path: Path) -> None:
    flight = read(tmp_path, AIRDATA + airdata_rows(4))
    assert (flight.kind, flight.notes) == ("airdata", ("1 rows without a possible voltage dropped",))
    assert [s.time_s for s in flight.samples] == [1.0, 2.0, 3.0]  # not the repetitions
    first = flight.samples[0]
    assert (first.voltage_V, first.current_A, first.cell_voltages_V) == (8.59, 4.1, (4.25, 4.24))
    assert first.temp_C == pytest.approx(25.0)
    assert math.isnan(first.reported_soc) and math.isnan(first.consumed_Ah) and first.armed is None
    facts = flight.facts_at(1.0)
    assert facts.cells_series == 2 and math.isnan(facts.capacity_Ah)
    assert flight.identity.start_utc_s == datetime(2026, 5, 1, 10, tzinfo=UTC).timestamp()


def test_airdata_in_metric_units(tmp_path: Path) -> None:
    flight = read(tmp_path, AIRDATA.replace("temperature(f)", "temperature(c)") + airdata_rows(3))
    assert flight.samples[0].temp_C == 77.0


def test_a_reading_that_lasts_is_a_row_a_second(tmp_path: Path) -> None:
    """A steady pack is no silent one."""
    rows = "".join(f"{100 * k},,47.5,8.5,1,95,4.25,4.25,0,4.5,77,\n" for k in range(31))
    assert [s.time_s for s in read(tmp_path, AIRDATA + rows).samples] == [0.0, 1.0, 2.0, 3.0]


def test_a_dji_flight_record(tmp_path: Path) -> None:
    text = "sep=,\n" + RECORD + record_row(0, motors="False") + record_row(1) + record_row(2) + record_row(3, amps=4.5)
    flight = read(tmp_path, text)
    assert flight.kind == "dji-record"
    assert [(s.time_s, s.armed, s.current_A) for s in flight.samples] == [
        (0.0, False, 4.0), (0.1, True, 4.0), (0.3, True, 4.5),
    ]  # fmt: skip
    assert flight.samples[0].voltage_V == 8.083 and flight.samples[0].temp_C == 29.2
    assert flight.samples[0].cell_voltages_V == (4.036, 4.029)
    facts = flight.facts_at(0.0)
    assert (facts.cells_series, facts.capacity_Ah) == (2, pytest.approx(1.931))


def test_a_dji_flight_record_of_older_programs(tmp_path: Path) -> None:
    head = (
        "CUSTOM.updateTime,OSD.flyTime [s],OSD.isMotorUp,CENTER_BATTERY.relativeCapacity,SMART_BATTERY.voltage [V],"
        "CENTER_BATTERY.current [A],CENTER_BATTERY.voltageCell1 [V],CENTER_BATTERY.temperature [C]\n"
    )
    flight = read(tmp_path, head + "10:00:00.1,0.1,True,80,15.2,9.5,3.8,86\n")
    (only,) = flight.samples
    assert (only.voltage_V, only.current_A, only.armed, only.cell_voltages_V) == (15.2, 9.5, True, (3.8,))
    assert math.isnan(only.temp_C)  # its unit is not what the name says


def test_who_flew_and_with_which_pack(tmp_path: Path) -> None:
    head = "OSD.flyTime [s],BATTERY.voltage [V],RECOVER.batterySerial,DETAILS.batterySerial,DETAILS.aircraftSerial\n"
    named = read(tmp_path, head + "0,15.2,,,\n1,15.1,,3QFPHBSC,3NZCHBG0\n").identity
    assert (named.battery_serial, named.hardware) == ("3QFPHBSC", "3NZCHBG0")
    nobody = read(tmp_path, head + "0,15.2,,0,\n").identity
    assert (nobody.battery_serial, nobody.hardware) == ("", "")


def test_a_date_that_is_none_is_not_known(tmp_path: Path) -> None:
    flight = read(tmp_path, AIRDATA + airdata_rows(3).replace("2026-05-01 10:00:0", "yesterday "))
    assert math.isnan(flight.identity.start_utc_s)


def test_what_the_pack_states_holds_from_its_first_word(tmp_path: Path) -> None:
    """A later reading of another full capacity does not change the pack in flight."""
    flight = read(tmp_path, RECORD + record_row(0) + record_row(20, full="1800"))
    assert [facts.capacity_Ah for _, facts in flight.facts] == [pytest.approx(1.931)]


def test_a_dji_flight_record_without_a_blank_or_a_suffix(tmp_path: Path) -> None:
    text = "sep=,\n" + RECORD.replace(", ", ",") + record_row(0)
    assert read(tmp_path, text, "record").kind == "dji-record"


def radio_row(
    clock: str, volts: float, amps: float, *, mode: str = "ACRO", quality: int = 100, day: str = "2026-05-01"
) -> str:
    fields = f'-52,{quality},250,47.5 8.5,31,{volts:.1f},{amps:.1f},12,98,"{mode}",0,-12,1,0x0000000000000000,1500,7.9'
    return f"{day},{clock},{fields}\n"


def test_a_radio_s_log_gives_each_reading_once(tmp_path: Path) -> None:
    """Ten rows a second, of which the receiver sends two."""
    rows = [radio_row(f"23:59:58.{100 * k:03d}", 16.4 - 0.1 * (k // 5), 20.0 + k // 5) for k in range(10)]
    rows += [radio_row("00:00:01.000", 16.2, 22.0, day="2026-05-02")]  # over midnight
    flight = read(tmp_path, RADIO + "".join(rows))
    assert (flight.kind, flight.notes) == ("edgetx", ())
    read_of = [(s.time_s, s.voltage_V, s.current_A) for s in flight.samples]
    assert read_of == [(0.0, 16.4, 20.0), (0.5, 16.3, 21.0), (3.0, 16.2, 22.0)]
    assert math.isnan(flight.samples[0].reported_soc)
    assert [s.consumed_Ah for s in flight.samples] == pytest.approx([0.012] * 3)


def test_a_flight_mode_tells_the_arming_once_it_has_marked_it(tmp_path: Path) -> None:
    """Betaflight sets a star, INAV has modes of its own; an aircraft that does neither tells nothing."""
    modes = ("ACRO", "ACRO*", "AIR", "!FS!", "OK", "WAIT", "!ERR", "AIR")
    rows = [radio_row(f"12:00:{k:02d}.000", 16.4, 1.0, mode=mode) for k, mode in enumerate(modes)]
    armed = [s.armed for s in read(tmp_path, RADIO + "".join(rows)).samples]
    assert armed == [None, False, True, True, False, False, False, True]


def test_what_a_radio_repeats_without_a_link_is_no_reading(tmp_path: Path) -> None:
    rows = [radio_row(f"12:00:{k:02d}.000", 16.4, 20.0, quality=0 if 2 <= k < 8 else 90) for k in range(10)]
    flight = read(tmp_path, RADIO + "".join(rows))
    assert [s.time_s for s in flight.samples] == [0.0, 1.0, 8.0, 9.0]
    assert flight.notes == ("6 rows without a link to the aircraft dropped",)


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("Date,Time,RSSI(dB),RxBt(V),VFAS(V),Curr(A),TxBat(V)", "2026-05-01,12:00:00.500,80,5.1,16.4,21.5,7.9"),
        ("Date,Time,Vbat(V),Curr(A),Vbec(V),LSW", "2026-05-01,12:00:00,16.4,21.5,5.1,0x0"),
    ],
)
def test_the_sensors_of_other_receivers(tmp_path: Path, header: str, row: str) -> None:
    """With FrSky, `RxBt` is the receiver's own supply."""
    (sample,) = read(tmp_path, f"{header}\n{row}\n").samples
    assert (sample.voltage_V, sample.current_A, sample.armed) == (16.4, 21.5, None)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Date,Time,1RSS(dB),Curr(A),TxBat(V)\n2026-05-01,12:00:00.000,-50,3,7.9\n",
         "header: expected a column `VFAS(V)` or `Vbat(V)` or `RxBt(V)`, found none"),
        (RADIO + radio_row("12:00", 16.0, 1.0).replace("12:00", "noon"),
         "row 1 (line 2), column Time: expected a time as 16:39:41.300, found `noon`"),
    ],
)  # fmt: skip
def test_a_radio_s_log_without_a_pack_is_refused(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(BadInput, match=re.escape(words)):
        read(tmp_path, text)


def blackbox_rows(seconds: float, rate_Hz: int = 1000) -> str:
    rows = []
    for k in range(int(seconds * rate_Hz)):
        amps = 20.0 + (1.0 if k % 2 else -1.0)
        rows.append(
            f"{k}, {5_000_000 + k * 1_000_000 // rate_Hz}, 16.{3 - k % 2}, {amps:.2f}, {k // 100}, ANGLE_MODE|ARM\n"
        )
    return "".join(rows)


def test_a_blackbox_log_in_means_over_a_tenth_of_a_second(tmp_path: Path) -> None:
    flight = read(tmp_path, BLACKBOX + blackbox_rows(1.0))
    assert flight.kind == "blackbox" and len(flight.samples) == 9  # the last tenth may be cut
    first = flight.samples[0]
    assert first.time_s == pytest.approx(0.099)
    assert (first.voltage_V, first.current_A) == (pytest.approx(16.25), pytest.approx(20.0))
    assert math.isnan(first.consumed_Ah)


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("loopIteration, time (us), vbat (V), amperage (A)", "1, {us}, 16.2, 21.5"),
        ("loopIteration, time (ms), vbatLatest (mV), amperageLatest (mA)", "1, {ms}, 16200, 21500"),
        ("loopIteration, time (s), vbatLatest (V), amperageLatest (A)", "1, {s}, 16.2, 21.5"),
    ],
)
def test_units_and_names_of_blackbox_logs(tmp_path: Path, header: str, row: str) -> None:
    rows = "".join(row.format(us=200_000 * k, ms=200 * k, s=0.2 * k) + "\n" for k in range(3))
    flight = read(tmp_path, f"{header}\n{rows}")
    assert flight.samples[1] == Sample(pytest.approx(0.2), pytest.approx(16.2), pytest.approx(21.5))


def test_a_cut_log_has_the_same_rows_up_to_the_cut(tmp_path: Path) -> None:
    for whole in (BLACKBOX + blackbox_rows(2.0, 500), AIRDATA + airdata_rows(8)):
        rows = read(tmp_path, whole).samples
        for share in (0.3, 0.5, 0.71):
            cut = read(tmp_path, whole[: int(share * len(whole))]).samples
            assert cut and cut == rows[: len(cut)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (AIRDATA.replace("voltage(v)", "volts"), r"header: expected a column `voltage\(v\)`, found none"),
        ("OSD.latitude,BATTERY.voltage [V]\n1,2\n", r"header: expected a column `OSD.flyTime \[s\]` or `OSD"),
        ("loopIteration,time,vbatLatest\n1,2,3\n", r"header: expected a column `time \(us\)` or"),
        (AIRDATA + "0,,47,8.5\n0,,47,8.5\n", r"row 1 \(line 2\): expected 12 cells, found 4"),
        ("sep=,\n" + RECORD + record_row(0).replace("8.083", '"8,083"'), r"line 3\), column BATTERY.voltage \[V\]: "),
        (BLACKBOX + "1, X, 16.2, 20, 1, ARM\n", r"column time \(us\): expected a number, found `X`"),
        (BLACKBOX + '1, 1, 16.2, 20, 1, "' + "x" * 200_000 + "\n", "expected a table, cannot be read: field larger"),
        (AIRDATA + airdata_rows(1), "expected battery messages with a voltage, found none"),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        read(tmp_path, text)


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("LOG00001.BFL", b"H Product:Blackbox flight data recorder\nI\x00\x01\xff", "decode it with blackbox_decode"),
        ("DJIFlightRecord_2026-05-01_[10-00-00].txt", b"\x00\x01\xfe\x02" * 99, "convert it to CSV first"),
    ],
)
def test_encoded_logs_say_what_to_do(tmp_path: Path, name: str, data: bytes, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        read(tmp_path, data, name)
