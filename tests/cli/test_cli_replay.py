"""`uavbatt replay`, `info` and `simulate` as a user runs them: files, streams, exit codes."""

from __future__ import annotations

import csv
import gzip
import io
import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from command import UAVBATT, called, run
from frames import hover, write_log

from uavbatt import __version__
from uavbatt.output import COLUMNS

ROOT = Path(__file__).parents[2]
LOG = ROOT / "logs/hexa_6s_cold.csv"
PACK = ("--capacity-ah", "5")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """One replay with every output; (folder, stdout)."""
    folder = tmp_path_factory.mktemp("whole")
    outputs = ("--jsonl", "f.jsonl", "--csv", "f.csv", "--json", "f.json", "--report", "f.html")
    done = run("replay", LOG, *PACK, *outputs, folder=folder)
    assert done.returncode == 0 and done.stderr == ""
    assert {p.name for p in folder.iterdir()} == {"f.jsonl", "f.csv", "f.json", "f.html"}
    return folder, done.stdout


def rows(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def test_one_line_a_row(whole: tuple[Path, str]) -> None:
    found = rows(whole[0] / "f.jsonl")
    logged = list(csv.DictReader(LOG.open()))
    assert [r["time_s"] for r in found] == [float(row["time_s"]) for row in logged]
    assert [r["voltage_V"] for r in found] == [float(row["voltage_V"]) for row in logged]
    for row in found:
        assert list(row) == list(COLUMNS)
        assert row["status"] in ("ok", "converging", "refused", "stale")
        known = [row[k] for k in ("remaining_lo_s", "remaining_s", "remaining_hi_s")]
        if row["status"] == "refused":
            assert known == [None] * 3 and row["reason"]
        else:
            assert 0.0 <= known[0] <= known[1] <= known[2]
        assert 0.0 <= row["soc"] <= 1.0
    assert "NaN" not in (whole[0] / "f.jsonl").read_text()


def test_csv_and_json_lines_say_the_same(whole: tuple[Path, str]) -> None:
    table = list(csv.DictReader((whole[0] / "f.csv").open(encoding="utf-8")))
    for ours, theirs in zip(rows(whole[0] / "f.jsonl"), table, strict=True):
        for key in ("soc", "remaining_s", "temp_C"):
            assert theirs[key] == ("" if ours[key] is None else str(ours[key]))


def test_the_summary(whole: tuple[Path, str]) -> None:
    summary = json.loads((whole[0] / "f.json").read_text(encoding="utf-8"))
    assert summary["battery"] == "lipo-generic" and summary["certificate_status"] == "generic"
    assert (summary["cells"], summary["capacity_Ah"], summary["skipped_bytes"]) == (6, 5.0, 0)
    assert summary["cutoff_V"] == pytest.approx(19.8) and summary["cutoff_from"] == "battery file"
    assert summary["capacity_from"] == "--capacity-ah" and summary["rows"] == 947
    assert {s["label"] for s in summary["scores"]} >= {"half time", "120 s before"}
    for score in summary["scores"]:
        assert score["error_s"] == pytest.approx(score["remaining_s"] - score["before_end_s"])
    assert "generic, not certified" in whole[1] and "end of flight at" in whole[1]
    assert str(LOG) in whole[1]


def test_the_report_opens_offline(whole: tuple[Path, str]) -> None:
    page = (whole[0] / "f.html").read_text(encoding="utf-8")
    assert page.lower().startswith("<!doctype html") and "lipo-generic" in page
    for remote in ('src="http', "src='http", 'href="http', "@import", "url(http"):
        assert remote not in page


def test_prefix_invariance_through_the_command(whole: tuple[Path, str], tmp_path: Path) -> None:
    data = LOG.read_bytes()
    (tmp_path / "cut.csv").write_bytes(data[: len(data) // 4 + 7])
    assert called("replay", "cut.csv", *PACK, "--jsonl", "cut.jsonl", folder=tmp_path).returncode == 0
    cut = (tmp_path / "cut.jsonl").read_text().splitlines()
    assert len(cut) > 200
    assert cut == (whole[0] / "f.jsonl").read_text().splitlines()[: len(cut)]


def test_garbage_in_the_autopilots_charge_through_the_command(whole: tuple[Path, str], tmp_path: Path) -> None:
    table = list(csv.DictReader(LOG.open()))[:200]
    with (tmp_path / "lies.csv").open("w", newline="") as stream:
        writer = csv.DictWriter(stream, table[0].keys())
        writer.writeheader()
        for k, row in enumerate(table):
            writer.writerow({**row, "consumed_Ah": f"{-k * 3.7:.2f}", "reported_soc": f"{(k % 7) / 7:.3f}"})
    assert called("replay", "lies.csv", *PACK, "--jsonl", "lies.jsonl", folder=tmp_path).returncode == 0
    told = (tmp_path / "lies.jsonl").read_text().splitlines()
    assert len(told) == 200 and told == (whole[0] / "f.jsonl").read_text().splitlines()[:200]


def short(folder: Path, name: str, rows_kept: int = 60) -> None:
    (folder / name).write_text("".join(LOG.read_text().splitlines(keepends=True)[: rows_kept + 1]))


def test_several_logs_make_folders(tmp_path: Path) -> None:
    short(tmp_path, "a.csv")
    short(tmp_path, "b.csv", 45)
    outputs = ("--jsonl", "lines", "--report", "pages", "--json", "all.json")
    assert called("replay", "a.csv", "b.csv", *PACK, *outputs, folder=tmp_path).returncode == 0
    assert {p.name for p in (tmp_path / "lines").iterdir()} == {"a.jsonl", "b.jsonl"}
    assert {p.name for p in (tmp_path / "pages").iterdir()} == {"a.html", "b.html"}
    assert [s["rows"] for s in json.loads((tmp_path / "all.json").read_text())] == [60, 45]


@pytest.mark.parametrize("load", ["recent", "log", "400"])
def test_loads(load: str, tmp_path: Path) -> None:
    short(tmp_path, "a.csv")
    done = called("replay", "a.csv", *PACK, "--load", load, "--jsonl", "a.jsonl", folder=tmp_path)
    assert done.returncode == 0
    last = rows(tmp_path / "a.jsonl")[-1]
    assert 300.0 < last["remaining_s"] < 1500.0


def test_options_of_the_pack_are_used(tmp_path: Path) -> None:
    short(tmp_path, "a.csv", 300)  # in the first four minutes what is usual for a pack of the size counts as well
    ends = {}
    for name, more in {
        "plain": (),
        "reserve": ("--reserve-soc", "0.4"),
        "cutoff": ("--cutoff-voltage", "21.6"),
        "small": ("--capacity-ah", "3"),
    }.items():
        assert called("replay", "a.csv", *PACK, *more, "--jsonl", f"{name}.jsonl", folder=tmp_path).returncode == 0
        ends[name] = rows(tmp_path / f"{name}.jsonl")[-1]["remaining_s"]
    assert all(ends[name] < ends["plain"] for name in ("reserve", "cutoff", "small"))


def test_forecasts_to_a_reserve_are_not_judged_by_the_cut_off(tmp_path: Path, whole: tuple[Path, str]) -> None:
    outputs = ("--json", "s.json", "--report", "r.html")
    done = called("replay", LOG, *PACK, "--reserve-soc", "0.2", *outputs, folder=tmp_path)
    said = "he forecasts end at the reserve of 20%, the log at the cut-off: they are not compared"
    assert done.returncode == 0 and done.stdout.count(said) == 1 and "optimistic" not in done.stdout
    assert (tmp_path / "r.html").read_text(encoding="utf-8").count(said) == 2
    summary = json.loads((tmp_path / "s.json").read_text(encoding="utf-8"))
    assert (summary["reserve_soc"], summary["scores"]) == (0.2, []) and summary["end_of_flight_s"] > 0.0
    assert json.loads((whole[0] / "f.json").read_text(encoding="utf-8"))["reserve_soc"] == 0.0


def test_a_plan_states_its_reserve(tmp_path: Path) -> None:
    pack = ("--cells", "4", "--capacity-ah", "5", "--power-w", "250")
    assert called("plan", *pack, "--reserve-soc", "0.2", "--json", "p.json", folder=tmp_path).returncode == 0
    assert json.loads((tmp_path / "p.json").read_text(encoding="utf-8"))["reserve_soc"] == 0.2


def test_lines_on_standard_output_are_nothing_but_lines(tmp_path: Path) -> None:
    short(tmp_path, "a.csv", 40)
    done = run("replay", "a.csv", *PACK, "--jsonl", "-", folder=tmp_path)
    assert done.returncode == 0
    assert [json.loads(line)["time_s"] for line in done.stdout.splitlines()] == [float(t) for t in range(40)]


def test_a_reader_that_leaves_is_no_traceback(tmp_path: Path) -> None:
    short(tmp_path, "a.csv")
    command = f"'{UAVBATT}' replay a.csv --capacity-ah 5 --jsonl - | head -n 1"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, cwd=tmp_path, timeout=300)
    assert len(done.stdout.splitlines()) == 1 and "Traceback" not in done.stderr


def test_files_are_written_although_the_reader_leaves(tmp_path: Path) -> None:
    short(tmp_path, "a.csv")
    command = f"set -o pipefail; '{UAVBATT}' replay a.csv --capacity-ah 5 --json s.json | true"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, cwd=tmp_path, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads((tmp_path / "s.json").read_text(encoding="utf-8"))["rows"] == 60


def test_a_stream_of_ascii_takes_every_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    short(tmp_path, "é✈.csv")
    monkeypatch.setenv("PYTHONIOENCODING", "ascii")
    done = run("replay", "é✈.csv", *PACK, "--json", "-", folder=tmp_path)
    assert done.returncode == 0 and "Traceback" not in done.stderr
    assert done.stdout.isascii() and json.loads(done.stdout)["log"] == "é✈.csv"
    done = run("replay", "é✈.csv", *PACK, "--jsonl", "-", folder=tmp_path)
    assert done.returncode == 0 and len([json.loads(line) for line in done.stdout.splitlines()]) == 60
    done = run("replay", "é✈.csv", *PACK, "--report", "-", folder=tmp_path)
    assert done.returncode == 0 and done.stdout.isascii() and "&#233;&#9992;.csv" in done.stdout


def test_standard_input_and_pipes_are_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    short(tmp_path, "a.csv")
    data = (tmp_path / "a.csv").read_bytes()
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))
    done = called("replay", "-", *PACK, "--plain", folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "") and done.stdout.startswith("standard input: ")
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(gzip.compress(data))))
    assert called("replay", "-", *PACK, "--plain", folder=tmp_path).stdout == done.stdout
    os.mkfifo(tmp_path / "pipe.csv")
    threading.Thread(target=(tmp_path / "pipe.csv").write_bytes, args=(data,), daemon=True).start()
    done = run("replay", "pipe.csv", *PACK, "--plain", folder=tmp_path, timeout_s=60.0)
    assert (done.returncode, done.stderr) == (0, "")


def test_standard_input_of_two_batteries_is_one_pack(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = write_log(tmp_path / "two.tlog", [*hover(60, 23.0, 9.0), *hover(60, 23.1, 9.0, instance=1)])
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(log.read_bytes())))
    done = called("replay", "-", *PACK, "--join", "parallel", folder=tmp_path)
    assert done.returncode == 0 and "batteries 0, 1 joined in parallel" in done.stdout


def test_info(tmp_path: Path) -> None:
    for name, kind in (("quad_4s.tlog", "tlog"), ("quad_3s.BIN", "dataflash-binary"), ("hexa_6s_cold.csv", "csv")):
        done = called("info", ROOT / "logs" / name, folder=tmp_path)
        assert done.returncode == 0 and kind in done.stdout and "trust        yes" in done.stdout
        assert done.stderr == ""


def test_simulate_is_repeatable(tmp_path: Path) -> None:
    for name in ("a.tlog", "b.tlog"):
        call = ("simulate", "-o", name, "--power-w", "900", "--rate-hz", "1", "--seed", "8")
        done = called(*call, "--effect", "weak_cell=0.1", folder=tmp_path)
        assert done.returncode == 0 and done.stdout == "" and "rows" in done.stderr
    assert (tmp_path / "a.tlog").read_bytes() == (tmp_path / "b.tlog").read_bytes()
    assert {p.name for p in tmp_path.iterdir()} == {"a.tlog", "b.tlog"}


def test_help_and_version(tmp_path: Path) -> None:
    assert run("--version", folder=tmp_path).stdout.strip() == f"uavbatt {__version__}"
    shown = run("-h", folder=tmp_path)
    assert shown.returncode == 0 and all(c in shown.stdout for c in ("validate", "replay", "info", "simulate"))
