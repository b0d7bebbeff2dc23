"""Telemetry CSV: what is read, and how each slip is named."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from uavbatt.errors import BadInput
from uavbatt.records import Flight
from uavbatt.telemetry import read_log

HEAD = "time_s,voltage_V,current_A,temp_C,consumed_Ah,reported_soc,armed\n"


def read(tmp_path: Path, text: str, name: str = "flight.csv") -> Flight:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return read_log(path)


def test_every_column_is_read_and_an_empty_cell_is_unknown(tmp_path: Path) -> None:
    flight = read(tmp_path, HEAD + "5,16.4,12.5,25,0.7,0.8,1\n6.5,16.3,,nan,,,\n")
    first, second = flight.samples
    assert flight.kind == "csv"
    assert (first.time_s, first.voltage_V, first.current_A, first.temp_C) == (0.0, 16.4, 12.5, 25.0)
    assert (first.consumed_Ah, first.reported_soc, first.armed) == (0.7, 0.8, True)
    assert second.time_s == 1.5 and second.armed is None
    assert all(math.isnan(v) for v in (second.current_A, second.temp_C, second.consumed_Ah, second.reported_soc))


def test_order_of_columns_bom_spaces_and_unknown_columns(tmp_path: Path) -> None:
    flight = read(tmp_path, "\ufeffvoltage_V, altitude_m ,time_s\r\n16.4,3,0\r\n\r\n16.3,4,1\r\n", "any.txt")
    assert [s.voltage_V for s in flight.samples] == [16.4, 16.3]
    assert math.isnan(flight.samples[0].current_A)
    assert flight.notes == ("column `altitude_m` is not known, ignored",)


def test_a_long_pause_is_no_reboot(tmp_path: Path) -> None:
    flight = read(tmp_path, "time_s,voltage_V\n0,16\n100000,15\n")
    assert [s.time_s for s in flight.samples] == [0.0, 100000.0]


@pytest.mark.parametrize("current", ["current_a", "current_filtered_a"])
def test_what_px4_writes_for_unknown_is_unknown_in_a_table_of_ulog2csv(tmp_path: Path, current: str) -> None:
    head = f"timestamp,voltage_v,{current},discharged_mah,remaining,temperature\n"
    first, second = read(tmp_path, head + "0,16.4,-1.0,-1,-1,0.0\n1000000,16.3,-0.5,500,0.8,25\n").samples
    unknown = (first.current_A, first.consumed_Ah, first.reported_soc, first.temp_C)
    assert all(math.isnan(value) for value in unknown)
    assert (second.current_A, second.consumed_Ah, second.reported_soc, second.temp_C) == (-0.5, 0.5, 0.8, 25.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,current_A\n0,1\n", "header: expected a column `voltage_V`"),
        ("voltage_V,current_A\n0,1\n", "header: expected a column `time_s`"),
        ("time_s,voltge_V\n0,1\n", r"column `voltge_V`: expected a known column \(did you mean `voltage_V`\?\)"),
        ("time_s,voltage_v\n0,1\n", r"column `voltage_v`: expected a known column \(did you mean `voltage_V`\?\)"),
        ("time_s,voltage_mV\n0,1\n", r"column `voltage_mV`: expected a known column \(did you mean `voltage_V`\?\)"),
        ("time_s,voltage_V,curent_A\n0,1,2\n", r"`curent_A`: expected a known column \(did you mean `current_A`\?\)"),
        ("time_s,voltage_V,temperature_C\n0,1,2\n", "`temp_C`"),
        ("time_s,voltage_V,voltage_V\n0,1,2\n", "column `voltage_V`: expected each column once"),
        ("time_s;voltage_V\n0;1\n", "found semicolons"),
        ("time_s\tvoltage_V\n0\t1\n", "found tabs"),
        ("time_s,voltage_V\n0,16\n,16\n", r"row 2 \(line 3\), column time_s: expected a number, found an empty"),
        ("time_s,voltage_V\n0,16\n1,nan\n", r"row 2 \(line 3\), column voltage_V: expected a number"),
        ("time_s,voltage_V\n0,16\n1,inf\n", r"row 2 \(line 3\), column voltage_V: expected a number"),
        ("time_s,voltage_V\n0,abc\n", r"row 1 \(line 2\), column voltage_V: expected a number, found `abc`"),
        ("time_s,voltage_V,current_A\n0,16,1_0\n", "column current_A: expected a number"),
        ("time_s,voltage_V\n0,16\n5,16\n4,16\n", r"row 3 \(line 4\), column time_s: expected time not before 5 s"),
        ("time_s,voltage_V\n0,16400\n", r"row 1 \(line 2\), column voltage_V: expected volts"),
        ("time_s,voltage_V,reported_soc\n0,16,80\n", r"row 1 \(line 2\), column reported_soc: expected 0..1"),
        ("time_s,voltage_V,armed\n0,16,yes\n", "column armed: expected 0 or 1"),
        ("time_s,voltage_V\n0,16\n1,16,3\n", r"row 2 \(line 3\): expected 2 cells, found 3"),
        ("time_s,voltage_V\n", "expected battery messages with a voltage"),
    ],
)
def test_a_slip_is_named_in_one_line_with_its_place(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(BadInput, match=message) as caught:
        read(tmp_path, text)
    assert str(tmp_path / "flight.csv") in str(caught.value)
    assert "\n" not in str(caught.value)


def whole_flight(
    step: float, per_A: float, counter: bool = False, *, mean_A: float = 15.0, end_V: float = 13.0, rise: float = 0.0
) -> str:
    """A table of `mean_A` for 1000 s, a row a second: `step` [s] in its unit of time, `per_A` of its unit of current.

    rise : share by which the current has grown at the end
    """
    text = "time_s,voltage_V,current_A" + ",consumed_Ah" * counter + "\n"
    for k in range(1000):
        counted = f",{mean_A * k / 3600.0:.4f}" * counter
        amps = 0.1 if k < 20 else mean_A * (1.0 + k % 3 / 15.0 + rise * k / 999.0)
        text += f"{step * k:.7f},{16.6 - (16.6 - end_V) * k / 999.0:.3f},{per_A * amps:g}{counted}\n"
    return text


@pytest.mark.parametrize(
    ("text", "column", "found"),
    [
        (whole_flight(1 / 60, 1.0, True), "time_s", "0.073 Ah by the current, 4.2 Ah by the counter (minutes?)"),
        (whole_flight(1 / 3600, 1.0, True), "time_s", "0.0012 Ah by the current, 4.2 Ah by the counter (hours?)"),
        (whole_flight(1 / 60, 1.0), "time_s", "a pack flown from 16.6 to 13.0 V in 16 (minutes or hours?)"),
        (whole_flight(1 / 3600, 1.0), "time_s", "a pack flown from 16.6 to 13.0 V in 0.27 (minutes or hours?)"),
        (whole_flight(1.0, 1000.0, True, mean_A=1.5), "current_A",
         "4.4e+02 Ah by the current, 0.42 Ah by the counter (milliamperes?)"),
        (whole_flight(1.0, 1000.0), "current_A", "more than any pack gives in most rows (milliamperes?)"),
        (whole_flight(1000.0, 1.0), "time_s", "rows 1000 apart (milliseconds?)"),
    ],
    ids=["minutes by the counter", "hours by the counter", "minutes", "hours", "mA by the counter", "mA", "ms"],
)  # fmt: skip
def test_another_unit_is_named(tmp_path: Path, text: str, column: str, found: str) -> None:
    """The first line of the replay was that of another flight, and nothing said so."""
    with pytest.raises(BadInput) as caught:
        read(tmp_path, text)
    unit = {"time_s": "seconds", "current_A": "amperes"}[column]
    assert str(caught.value) == f"{tmp_path / 'flight.csv'}: column {column}: expected {unit}, found {found}"


@pytest.mark.parametrize(
    "text",
    [
        whole_flight(1.0, 1.0),
        whole_flight(1.0, 1.0, True),
        whole_flight(0.06, 10.0),
        whole_flight(1 / 60, 1.0, end_V=15.8),
        whole_flight(1 / 60, 1.0, rise=0.6),
        whole_flight(1.0, 0.02),
        whole_flight(1.0, 0.02, True),
        whole_flight(20.0, 0.05),
    ],
    ids=["as it is", "with a counter", "a minute at 30 C", "17 s of a flight", "17 s whose load grows", "a sensor that "
         "reads low", "such a sensor and a counter", "an aeroplane of long endurance"],
)  # fmt: skip
def test_no_plausible_flight_is_refused(tmp_path: Path, text: str) -> None:
    assert len(read(tmp_path, text).samples) == 1000


def test_some_impossible_currents_are_no_other_unit(tmp_path: Path) -> None:
    lines = whole_flight(1.0, 1.0).splitlines()
    damaged = [line.rpartition(",")[0] + ",5000" if 100 < k <= 130 else line for k, line in enumerate(lines)]
    samples = read(tmp_path, "\n".join(damaged) + "\n").samples
    assert len(samples) == 1000 and sum(math.isnan(sample.current_A) for sample in samples) == 30


def test_a_cut_last_row_is_left_out(tmp_path: Path) -> None:
    flight = read(tmp_path, "time_s,voltage_V,current_A\n0,16,1\n1,16,1\n2,1")
    assert len(flight.samples) == 2
    assert flight.skipped_bytes == 3


def test_a_measured_table_is_read_as_it_is(shared_data: Path) -> None:
    flight = read_log(shared_data / "flights/m100/m100_001_752.csv")
    assert len(flight.samples) == 61
    assert (flight.samples[1].time_s, flight.samples[1].current_A) == (11.002, 17.325)
