"""The first answer of `uavbatt replay`, and many logs in one call, as a pilot meets them."""

from __future__ import annotations

import gzip
import json
import math
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from command import UAVBATT, called
from factories import generic_estimator

from uavbatt import Estimator, Sample
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.log_replay.outcome import Landing, Outcome, outcome
from uavbatt.log_replay.run import steps
from uavbatt.records import Flight
from uavbatt.report.flight.answer import first_answer, rounded
from uavbatt.report.flight.limits import limits_of
from uavbatt.telemetry import read_log

LOGS = Path(__file__).parents[2] / "logs"
STATED = PackOptions(cells=4, capacity_Ah=5.0, cutoff_V=13.2)
SHORT = "time_s,voltage_V,current_A\n" + "".join(
    f"{k},{16.2 - 0.002 * k:.3f},{0.1 if k < 5 else 18}\n" for k in range(90)
)


def landed(rest_s: float, air_s: float = 300.0) -> Outcome:
    """A flight of a 4S pack that hovers at 18 A, lands well charged and lies at rest."""
    hover = [Sample(float(k), 16.2 - 0.0013 * k, 18.0, 25.0) for k in range(10, int(air_s))]
    rest = [Sample(air_s + k, 16.0, 0.1, 25.0) for k in range(int(rest_s))]
    ground = [Sample(float(k), 16.7, 0.1, 25.0) for k in range(10)]
    run = list(steps(Flight("f.csv", "csv", (*ground, *hover, *rest)), generic_estimator(STATED)))
    return outcome(run, 13.2)


def test_the_answer_is_of_the_last_row_in_the_air_however_long_it_lies_afterwards() -> None:
    soon, late = landed(20.0).landing, landed(200.0).landing
    assert soon is not None and late is not None
    assert soon == late and soon.time_s == pytest.approx(299.0) and not soon.is_cut
    assert 0.0 < soon.remaining_lo_s < soon.remaining_s < soon.remaining_hi_s


def test_a_log_that_ends_in_the_air_says_so() -> None:
    cut = landed(0.0).landing
    assert cut is not None and cut.is_cut
    assert first_answer(cut, math.nan, 13.2).startswith("The log ends in the air with")


def without_current(lost_A: float, armed: bool | None, *, to_the_end: bool = False, rest_s: int = 0) -> Outcome:
    """A flight of 18 A from 10 s on whose sensor says `lost_A` from 200 s on; it lands after 400 s, or flies empty."""
    end_s = 600 if to_the_end else 400
    fall_V = [0.0013 * k if k < 400 else 0.52 + 0.016 * (k - 400) for k in range(end_s)]
    ground = [Sample(float(k), 16.7, 0.1, 25.0, armed=armed and False) for k in range(10)]
    air = [Sample(float(k), 16.2 - fall_V[k], 18.0 if k < 200 else lost_A, 25.0, armed=armed) for k in range(10, end_s)]
    rest = [Sample(float(end_s + k), 16.1, lost_A, 25.0, armed=armed and False) for k in range(rest_s)]
    run = list(steps(Flight("f.csv", "csv", (*ground, *air, *rest)), generic_estimator(STATED)))
    return outcome(run, 13.2)


@pytest.mark.parametrize("armed", [True, None])
@pytest.mark.parametrize("lost_A", [math.nan, 0.0, 0.3])
def test_a_flight_goes_on_without_its_current(lost_A: float, armed: bool | None) -> None:
    """The last number before the sensor died was told as what was left at the landing, minutes later."""
    found = without_current(lost_A, armed, rest_s=60)
    assert found.landing is not None
    assert found.landing.time_s == pytest.approx(399.0) and not found.landing.is_cut
    assert 0.5 < found.refused_in_air < 0.8 and math.isnan(found.end_soc)
    said = first_answer(found.landing, found.end_of_flight_s, 13.2)
    assert said.startswith("How much longer you could have flown is not known: the current was lost 3 min 2")


@pytest.mark.parametrize("lost_A", [math.nan, 0.0])
def test_a_pack_flown_empty_without_its_current_is_at_its_end_by_the_voltage(lost_A: float) -> None:
    found = without_current(lost_A, None, to_the_end=True)
    assert found.end_of_flight_s == pytest.approx(400.0 + (16.2 - 0.52 - 13.2) / 0.016, abs=5.0)
    assert all(math.isnan(c.remaining_s) for c in found.checkpoints if c.before_end_s < 300.0)


@pytest.mark.parametrize("armed", [True, None])
def test_a_current_that_is_lost_on_the_ground_changes_no_answer(armed: bool | None) -> None:
    ground = [Sample(float(k), 16.7, 0.1, 25.0, armed=armed and False) for k in range(10)]
    hover = [Sample(float(k), 16.2 - 0.0013 * k, 18.0, 25.0, armed=armed) for k in range(10, 300)]
    rest = [Sample(300.0 + k, 16.0, math.nan, 25.0, armed=armed and False) for k in range(200)]
    found = outcome(list(steps(Flight("f.csv", "csv", (*ground, *hover, *rest)), generic_estimator(STATED))), 13.2)
    assert found.landing is not None and found.landing.remaining_s > 0.0 and found.refused_in_air == 0.0


def test_a_charge_that_every_row_refuses_is_not_the_charge_at_the_end() -> None:
    """A sensor of reversed sign: "100 % charge left (100 % to 100 %)" was said of a pack that was emptied."""
    ground = [Sample(float(k), 16.7, -0.1, 25.0) for k in range(30)]
    hover = [Sample(float(k), 16.2 - 0.0035 * k, -18.0, 25.0) for k in range(30, 900)]
    found = outcome(list(steps(Flight("f.csv", "csv", (*ground, *hover)), generic_estimator(STATED))), 13.2)
    assert math.isnan(found.end_soc)
    said = first_answer(found.landing, found.end_of_flight_s, 13.2)
    assert said.startswith("The battery was at its end before you landed")


@pytest.mark.parametrize(
    ("landing", "end_s", "words"),
    [
        (
            Landing(9.0, 960.0, 480.0, 1380.0, 660.0),
            math.nan,
            "You landed with 16 min left (8 to 23 min), 11 min to",
        ),
        (Landing(9.0, 960.0, 660.0, 1380.0, 960.0), math.nan, "You landed with 16 min left (11 to 23 min)."),
        (Landing(9.0, 66.0, 0.0, 308.0, math.nan), math.nan, "You landed with 66 s left (0 s to 5 min 10 s)."),
        (Landing(9.0, 66.0, 0.0, 305.0, 0.0), 700.0, "below 13.20 V under load 11 min 40 s after"),
        (Landing(9.0, *(math.nan,) * 4, "no voltage in this row"), math.nan, "is not known: no voltage in this row."),
        (Landing(9.0, *(math.nan,) * 4, "is it stuck?"), math.nan, "is not known: is it stuck?"),
        (None, math.nan, "No flight in this log"),
    ],
)
def test_the_first_answer_says_what_the_landing_was(landing: Landing | None, end_s: float, words: str) -> None:
    assert words in first_answer(landing, end_s, 13.2)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (119.4, "119 s"),
        (121.0, "2 min"),
        (394.0, "6 min 30 s"),
        (596.0, "10 min"),
        (629.0, "10 min"),
        (960.0, "16 min"),
    ],
)
def test_the_longer_the_time_the_coarser_the_words(seconds: float, words: str) -> None:
    assert rounded(seconds) == words


def test_the_same_numbers_stand_in_the_summary_first_line_and_lines(tmp_path: Path) -> None:
    log = LOGS / "quad_4s.tlog"
    done = called("replay", log, "--json", "s.json", "--jsonl", "f.jsonl", folder=tmp_path)
    summary = json.loads((tmp_path / "s.json").read_text())
    rows = [json.loads(line) for line in (tmp_path / "f.jsonl").read_text().splitlines()]
    (row,) = [r for r in rows if r["time_s"] == pytest.approx(summary["landing_s"], abs=1e-3)]
    for key in ("remaining_s", "remaining_lo_s", "remaining_hi_s", "remaining_to_low_s"):
        assert summary[key] == pytest.approx(row[key], abs=0.06), key
    assert "before you landed" in done.stdout.splitlines()[0]
    readme = (LOGS.parent / "README.md").read_text(encoding="utf-8")
    shown = readme.partition("$ uavbatt replay logs/quad_4s.tlog --report flight.html\n")[2].partition("```")[0]
    assert done.stdout.replace(f"{LOGS}/", "logs/") == shown  # else: paste the new lines, and see test_docs


def test_a_log_alone_is_replayed(short_log: Path, tmp_path: Path) -> None:
    assert called(short_log, folder=tmp_path).stdout == called("replay", short_log, folder=tmp_path).stdout
    missing = called("nothing.BIN", folder=tmp_path)
    assert missing.returncode == 2 and "nothing.BIN: expected a command or a flight log" in missing.stderr


def test_one_bad_log_among_good_ones_is_a_line(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("a diary\n")
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text(SHORT)
    stated = ("--capacity-ah", "5", "--json", "s.json", "--jsonl", "lines")
    done = called("replay", "a.csv", "notes.txt", "b.csv", *stated, folder=tmp_path)
    assert done.returncode == 1 and "notes.txt" in done.stderr and "Traceback" not in done.stderr
    first, bad, last = json.loads((tmp_path / "s.json").read_text())
    assert "notes.txt" in bad["error"] and first["rows"] == last["rows"] == 90
    assert {p.name for p in (tmp_path / "lines").iterdir()} == {"a.jsonl", "b.jsonl"}


def test_logs_of_one_name_get_the_part_of_their_path_that_differs(tmp_path: Path) -> None:
    names = ("x/day/1.csv", "y/day/1.csv", "y/day/2.csv")
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(SHORT)
    done = called("replay", *names, "--capacity-ah", "5", "--jsonl", "lines", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert {p.name for p in (tmp_path / "lines").iterdir()} == {"x_day_1.jsonl", "y_day_1.jsonl", "y_day_2.jsonl"}
    assert called("replay", names[0], names[0], folder=tmp_path).returncode == 2


def test_packed_logs_and_standard_input_are_the_log_itself(tmp_path: Path) -> None:
    plain = (LOGS / "quad_4s.tlog").read_bytes()
    (tmp_path / "f.tlog.gz").write_bytes(gzip.compress(plain))
    with zipfile.ZipFile(tmp_path / "f.zip", "w") as archive:
        archive.writestr("flight.tlog", plain)
    expected = read_log(LOGS / "quad_4s.tlog").samples
    assert read_log(tmp_path / "f.tlog.gz").samples == read_log(tmp_path / "f.zip").samples == expected
    done = subprocess.run([UAVBATT, "info", "-"], input=plain, capture_output=True, cwd=tmp_path)
    assert done.returncode == 0 and b"2108" in done.stdout


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("cut.gz", gzip.compress(b"x" * 9000, mtime=0)[:40], "expected a whole gzip or zip file"),
        ("bad.zip", b"PK\x03\x04" + b"\0" * 40, "expected a whole gzip or zip file"),
    ],
)
def test_damaged_archives_are_named(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    (tmp_path / name).write_bytes(content)
    done = called("replay", name, folder=tmp_path)
    assert done.returncode == 1 and words in done.stderr and len(done.stderr.splitlines()) == 1


def test_an_archive_of_several_files_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "two.zip", "w") as archive:
        archive.writestr("a.csv", SHORT)
        archive.writestr("b.csv", SHORT)
    done = called("replay", "two.zip", folder=tmp_path)
    assert done.returncode == 1 and "found 2 files: unpack it first" in done.stderr


def test_tables_of_ulog2csv_and_times_in_iso_8601_are_read(tmp_path: Path) -> None:
    def samples(text: str) -> list[Any]:
        (tmp_path / "f.csv").write_text(text)
        return list(read_log(tmp_path / "f.csv").samples)

    ours = samples("time_s,voltage_V,current_A,reported_soc\n0,16.2,10,0.9\n0.5,16.1,12,0.8\n")
    px4 = "timestamp,voltage_v,voltage_filtered_v,current_a,remaining\n1000000,16.2,1,10,0.9\n1500000,16.1,1,12,0.8\n"
    iso = "2026-05-01T10:00:00Z,16.2,10,0.9\n2026-05-01T12:00:00.500+02:00,16.1,12,0.8\n"
    assert samples(px4) == ours == samples("time_s,voltage_V,current_A,reported_soc\n" + iso)


def test_the_packaged_batteries_are_listed(tmp_path: Path) -> None:
    done = called("batteries", "--json", "b.json", folder=tmp_path)
    names = {"lipo-generic", "liion-generic", "lpab-3s"}
    assert names <= set(done.stdout.split())
    assert {b["battery"]["name"] for b in json.loads((tmp_path / "b.json").read_text())} == names


def test_plain_says_what_a_pilot_asks_and_no_more(tmp_path: Path) -> None:
    (tmp_path / "f.csv").write_text(SHORT)
    stated = ("replay", "f.csv", "--capacity-ah", "5", "--json")
    plain = called(*stated, "plain.json", "--plain", folder=tmp_path)
    whole = called(*stated, "whole.json", folder=tmp_path)
    said = plain.stdout.splitlines()
    assert plain.returncode == 0 and said[0] == whole.stdout.splitlines()[0]
    assert any("charge left at the end of the log" in line for line in said)
    assert not any(word in plain.stdout for word in ("rows", "cells", "lipo-generic", "NIS"))
    assert (tmp_path / "plain.json").read_text() == (tmp_path / "whole.json").read_text()


@pytest.mark.parametrize(("remaining_s", "is_said"), [(60.0, True), (280.0, True), (400.0, False), (700.0, False)])
def test_a_short_time_on_a_charged_pack_is_explained(remaining_s: float, is_said: bool) -> None:
    """12.5 min at 18 A are in 75 % of 5 Ah: where the forecast says a minute, the voltage is the reason."""
    flight = Flight("f.csv", "csv", tuple(Sample(float(k), 16.2 - 0.0013 * k, 18.0, 25.0) for k in range(200)))
    estimator = Estimator.from_battery("lipo-generic", cells=4, capacity_Ah=5.0, cutoff_V=13.2)
    run = list(steps(flight, estimator))
    found, resolved = outcome(run, 13.2), estimator.pack_size
    assert found.landing is not None and resolved is not None
    said = limits_of(replace(found, landing=replace(found.landing, remaining_s=remaining_s)), resolved, run)
    explained = [words for words in said if words.startswith("The voltage ends it, not the charge")]
    assert len(explained) == is_said and all("falls below 13.20 V (cutoff_V)" in words for words in explained)


@pytest.mark.parametrize(
    ("stated", "last_V", "is_said"), [((), 11.8, True), (("--cutoff-voltage", "13.2"), 11.8, False), ((), 13.4, False)]
)
def test_a_flight_that_goes_on_below_a_cut_off_that_nobody_stated(
    stated: tuple[str, ...], last_V: float, is_said: bool, tmp_path: Path
) -> None:
    """A lithium-ion pack is flown to 3 V a cell: "at its end before you landed" did not say whose end that was."""
    volts = [16.4 - (16.4 - last_V) * k / 600.0 for k in range(600)]
    rows = "".join(f"{k},{volts[k]:.3f},8.{k % 5}\n" for k in range(600))
    (tmp_path / "f.csv").write_text("time_s,voltage_V,current_A\n" + rows)
    for form in ((), ("--plain",)):
        done = called("replay", "f.csv", "--cells", "4", "--capacity-ah", "5", *form, *stated, folder=tmp_path)
        said = [line for line in done.stdout.splitlines() if "obody stated the cut-off" in line]
        assert len(said) == is_said and all("2 min 59 s" in line and "liion-generic" in line for line in said)
