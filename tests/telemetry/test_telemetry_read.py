"""Recognising logs, files that are none, ULog, and the description of a log."""

from __future__ import annotations

import gc
import math
import random
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from uavbatt.errors import BadInput, MissingExtra
from uavbatt.records import Flight, PackFacts, Sample
from uavbatt.telemetry import read_log
from uavbatt.telemetry.builder import LogBuilder, default_instance
from uavbatt.telemetry.cleaning.readings import plausible_temperature_C
from uavbatt.telemetry.identity import gps_utc_s
from uavbatt.telemetry.quality.drawn import loaded_A
from uavbatt.telemetry.quality.info import describe, lines, sag_correlation, temperature_verdict


@pytest.mark.parametrize("name", ["a.tlog", "a.BIN", "a.log", "a.csv", "a.ulg", "a"])
@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\n \n",
        b"\x89PNG\r\n\x1a\n" + random.Random(1).randbytes(3000),
        b"%PDF-1.7\n" + random.Random(2).randbytes(3000),
        random.Random(4).randbytes(5000),
        b"Dear all,\nthis is a letter.\n",
        b"\0" * 4000,
        b"ULog\x01\x12\x35",
        b"ULog\x01\x12\x35" + random.Random(5).randbytes(3000),
        b"\xa3\x95\x80" + random.Random(6).randbytes(3000),
    ],
    ids=["empty", "blank", "png", "pdf", "noise", "text", "zeros", "ulog head", "ulog noise", "dataflash noise"],
)
def test_what_is_no_flight_log_is_named_in_one_line(
    tmp_path: Path, name: str, data: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(BadInput) as caught:
        read_log(path)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)
    assert capsys.readouterr().out == ""


def test_a_missing_file_and_a_directory_are_named(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="found no such file"):
        read_log(tmp_path / "nowhere.tlog")
    with pytest.raises(BadInput, match="found a directory"):
        read_log(str(tmp_path))


def test_import_is_light() -> None:
    code = "import sys, uavbatt.telemetry; print(any(m in sys.modules for m in ('pymavlink', 'pyulog', 'numpy')))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_ulog_needs_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.ulg"
    path.write_bytes(b"ULog\x01\x12\x35" + bytes(100))
    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(MissingExtra, match=r"uavbatt\[ulog\]"):
        read_log(path)


def test_a_flown_ulog_is_read_with_the_cells_it_flew(shared_data: Path) -> None:
    pytest.importorskip("pyulog")
    one = read_log(shared_data / "flights/px4/hexa_6s_33s.ulg")
    assert (one.kind, len(one.samples), one.instances) == ("ulog", 166, (0,))
    assert one.facts_at(0.0).cells_series == 6  # not the 3 of the left-over BAT_N_CELLS
    assert math.isnan(one.facts_at(0.0).capacity_Ah)
    assert one.samples[0].time_s == pytest.approx(0.42527)
    two = read_log(shared_data / "flights/px4/vtol_ground_two_batteries.ulg", instance=1)
    assert two.instances == (0, 1)
    assert two.samples[0].voltage_V == pytest.approx(49.745, abs=1e-3)
    facts = two.facts_at(0.0)
    assert (facts.cells_series, facts.capacity_Ah, facts.critical_voltage_V) == (12, 6.0, 42.0)
    assert math.isnan(facts.low_voltage_V) and facts.sag_compensated is None


def test_a_cut_ulog_is_a_prefix(shared_data: Path, tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    data = (shared_data / "flights/px4/hexa_6s_33s.ulg").read_bytes()
    path = tmp_path / "cut.ulg"
    path.write_bytes(data[: int(len(data) * 0.6)])
    whole, cut = read_log(shared_data / "flights/px4/hexa_6s_33s.ulg"), read_log(path)
    assert [repr(s) for s in cut.samples] == [repr(s) for s in whole.samples[: len(cut.samples)]]
    assert 0 < len(cut.samples) < len(whole.samples)


def test_an_impossible_temperature_or_jump_is_unknown() -> None:
    assert plausible_temperature_C(25.0) == 25.0
    for impossible in (math.nan, math.inf, 0.0, 2510.0, -60.0):
        assert math.isnan(plausible_temperature_C(impossible))
    assert plausible_temperature_C(26.0, 25.0, 0.1) == 26.0
    assert math.isnan(plausible_temperature_C(35.0, 25.0, 1.0))
    assert plausible_temperature_C(35.0, 25.0, 60.0) == 35.0
    # A thermometer that failed in flight: after 44 s a pack of 19 °C was believed at -25 °C, and 161 s too long.
    assert math.isnan(plausible_temperature_C(-25.0, 19.0, 600.0))
    assert plausible_temperature_C(5.0, 30.0, 300.0) == 5.0  # another pack, out of the cold, after five minutes


def flown(rows: int = 300, step_s: float = 1.0, **constant: float) -> list[Sample]:
    made = []
    for n in range(rows):
        current_A = 10.0 + 5.0 * (n % 3)
        values = {
            "voltage_V": 16.0 - 0.02 * current_A - 0.001 * n, "current_A": current_A, "temp_C": 25 + 0.01 * n,
            "consumed_Ah": 15.0 * n * step_s / 3600,
        }  # fmt: skip
        made.append(Sample(time_s=n * step_s, armed=True, **{**values, **constant}))
    return made


def flight(samples: list[Sample], facts: PackFacts | None = None, **more: object) -> Flight:
    known = ((0.0, facts or PackFacts(4, 5.0)),)
    return Flight("x", "tlog", tuple(samples), facts=known, duration_s=samples[-1].time_s, **more)  # type: ignore[arg-type]


def test_description_of_a_good_log() -> None:
    info = describe(flight(flown()))
    found, told = info.figures, "\n".join(lines(info))
    assert (info.trust, info.reasons, found.gaps, found.step_s) == ("yes", (), (), 1.0)
    assert found.total.charge_Ah == pytest.approx(15 * 299 / 3600, rel=0.01)
    assert found.total.counter_Ah == pytest.approx(found.total.charge_Ah, rel=0.01)
    assert "median rate 1 Hz" in told and "missing      reported_soc\n" in told
    assert "current      10.00 .. 20.00 A" in told and "trust        yes" in told


@pytest.mark.parametrize(
    ("constant", "trust", "reason"),
    [
        ({"current_A": math.nan}, "no", "no current"),
        ({"current_A": 0.0}, "no", "no live sensor"),
        ({"temp_C": 48.0}, "with care", "constant"),
        ({"temp_C": math.nan}, "yes", "no temperature"),
        ({"voltage_V": 15.0}, "with care", "hardly follows"),
        ({"consumed_Ah": math.nan}, "yes", ""),
    ],
)
def test_what_is_wrong_is_said(constant: dict[str, float], trust: str, reason: str) -> None:
    info = describe(flight(flown(**constant)))
    assert info.trust == trust
    assert reason in "; ".join(info.reasons)
    assert all("nan" not in line for line in lines(info))


@pytest.mark.parametrize("facts", (PackFacts(), PackFacts(4, 5.0), PackFacts(3, 5.0)))
def test_rows_without_a_voltage_change_no_verdict(facts: PackFacts) -> None:
    """As in a log of joined batteries, of which one is heard later than the other, or is lost for a row."""
    whole, lacking = flown(), [*range(5), 100]
    rows = [replace(row, voltage_V=math.nan) if n in lacking else row for n, row in enumerate(whole)]
    found, expected = (describe(flight(some, facts)) for some in (rows, whole))
    assert (found.trust, len(found.reasons)) == (expected.trust, len(expected.reasons))


def test_gaps_counter_and_facts() -> None:
    rows = flown()
    info = describe(flight(rows[:100] + rows[130:]))
    assert info.figures.gaps == ((99.0, 31.0),) and info.trust == "with care"
    total = info.figures.total
    assert total.counter_Ah == pytest.approx(total.charge_Ah, rel=0.02)  # the gap is in neither
    slow = describe(flight(flown(step_s=12.0)))
    assert slow.figures.gaps == ()
    off = [Sample(s.time_s, s.voltage_V, s.current_A, s.temp_C, s.consumed_Ah * 1.3) for s in rows]
    assert "counter says" in describe(flight(off)).reasons[0]
    assert describe(flight(rows, PackFacts(4, 5.0, sag_compensated=True))).trust == "with care"
    assert "per cell" in describe(flight(rows, PackFacts(3, 5.0))).reasons[0]
    assert describe(flight(rows[:5])).trust == "no"
    assert describe(flight(rows, notes=("reboot at 5.0 s: ...",))).trust == "with care"


def test_verdicts_of_temperature_and_sag() -> None:
    hot = [Sample(float(n), 16.0, temp_C=45.0 + 0.01 * n) for n in range(200)]
    assert "board" in temperature_verdict(hot)
    die = [Sample(float(n), 16.0, temp_C=30.0 + 8.0 * (n % 2)) for n in range(200)]
    assert "jumps" in temperature_verdict(die)
    assert sag_correlation(flown()) < -0.9
    assert math.isnan(sag_correlation(flown(10)))


def test_who_flew_and_when(shared_data: Path) -> None:
    def vehicle(name: str) -> str:
        return next(line for line in lines(describe(read_log(shared_data / name))) if line.startswith("vehicle"))

    assert vehicle("flights/ardupilot/quad_4s_3000_a.bin").endswith(
        "system 1, ArduCopter V4.0.2 (2cb4b85a), started 2020-03-03 11:49:20 UTC"
    )
    assert vehicle("flights/ardupilot/quad_3s_4000_underpowered.log").endswith("system 1, ArduCopter V3.0.1")
    assert "system 1, ArduPilot, started 2026-09-21 14:13:20 UTC" in vehicle("truth/blind/b1/flight_1.tlog")
    assert vehicle("flights/m100/m100_001_752.csv").endswith("not named in the log")


def test_real_logs_are_described(shared_data: Path) -> None:
    solo = describe(read_log(shared_data / "flights/ardupilot/solo_4s_5200_smart.bin"))
    assert solo.trust == "with care" and any("hardly follows" in r for r in solo.reasons)
    sound = describe(read_log(shared_data / "truth/reference/r0/flight_1.tlog"))
    assert (sound.trust, sound.figures.temperature) == ("yes", "plausible")
    assert sound.figures.total.charge_Ah == pytest.approx(sound.figures.total.counter_Ah, rel=0.01)


def of_batteries(*currents_A: float) -> LogBuilder:
    """A log whose batteries report these currents at the same times."""
    log = LogBuilder()
    for k in range(100):
        for number, current_A in enumerate(currents_A):
            log.add(number, Sample(log.time_s(float(k)), 15.0, current_A))
    return log


@pytest.mark.parametrize(
    ("currents_A", "number"),
    [
        ((1.0, 20.0), 1),  # a camera's pack comes first
        ((20.0, 1.0), 0),
        ((9.0, 11.0), 0),  # two in parallel
        ((10.0, 10.0, 20.0), 0),  # and a monitor that sums them
        ((math.nan, 20.0), 1),
        ((math.nan, math.nan), 0),
        ((0.0, 0.0), 0),
        ((-5.0, 20.0), 1),
    ],
)
def test_the_battery_that_carries_the_flight_is_read(currents_A: tuple[float, ...], number: int) -> None:
    assert default_instance(of_batteries(*currents_A)) == number


@pytest.mark.parametrize("idle_rows", [0, 60, 5400])
def test_a_flight_is_under_load_however_long_the_log_idles(idle_rows: int) -> None:
    """A flight of seven minutes in an hour and a half of log was none: every row counted as flown."""
    amps = np.array([0.4] * idle_rows + [18.0, 22.0] * 200 + [math.nan, 0.4])
    assert 0.4 < loaded_A(amps) < 18.0


def test_a_clock_of_another_century_was_never_set() -> None:
    """A damaged GPS week ended `info` with a year that is out of range."""
    week, time_of_week_ms = 2366.0, 172_800_000.0
    assert 1.7e9 < gps_utc_s(week, time_of_week_ms) < 1.9e9
    assert math.isnan(gps_utc_s(99_999_999.0, time_of_week_ms))


@pytest.mark.parametrize("is_on", [True, False])
def test_the_garbage_collector_is_left_as_it_was(tmp_path: Path, is_on: bool) -> None:
    """Also by a file that is no log."""
    (tmp_path / "log.csv").write_text("time_s,voltage_V\n0,16.0\n")
    (tmp_path / "bad.csv").write_text("time_s,voltage_V\n0,none\n")
    was_on = gc.isenabled()
    try:
        (gc.enable if is_on else gc.disable)()
        read_log(tmp_path / "log.csv")
        assert gc.isenabled() is is_on
        with pytest.raises(BadInput):
            read_log(tmp_path / "bad.csv")
        assert gc.isenabled() is is_on
    finally:
        (gc.enable if was_on else gc.disable)()
