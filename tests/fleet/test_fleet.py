"""A fleet: bad logs are rows, finished logs are not done again, both tables say the same, any address can be read."""

from __future__ import annotations

import csv
import json
import math
import os
import subprocess
import sys
import time
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from command import called

pytest.importorskip("distributed", reason="the extra `fleet` is not installed")
pytest.importorskip("pyarrow", reason="the extra `fleet` is not installed")

from uavbatt.battery import battery_file
from uavbatt.battery.scaling import pack_of
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.errors import BadInput, MissingExtra, UsageError
from uavbatt.fleet import journal, run, tables
from uavbatt.fleet.fly import Job, fly_log
from uavbatt.fleet.logs import JOURNAL, LogFile, find_logs
from uavbatt.fleet.look import reasons, urgency
from uavbatt.fleet.row import LOST, FlightRow, row_of
from uavbatt.simulate.flight import SimulatedFlight, write_log
from uavbatt.simulate.flight import simulate_flight as simulated

GENERIC = "lipo-generic"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A short flight to its end, as a telemetry log."""
    pack = pack_of(battery_file.read_battery(GENERIC), 4, 5.0, 13.2, math.nan)
    path = tmp_path_factory.mktemp("log") / "a.tlog"
    write_log(path, simulated(pack, SimulatedFlight(power_W=700.0, rate_Hz=0.5)), pack)
    return path.read_bytes()


@pytest.fixture
def logs(tmp_path: Path, log: bytes) -> Path:
    """Two aircraft with two sound logs, and two files that are none."""
    folder = tmp_path / "logs"
    for name, content in (
        ("heron/1.tlog", log),
        ("swift/2.tlog", log[: len(log) // 2]),
        ("heron/broken.tlog", b"junk"),
        ("swift/empty.BIN", b""),
    ):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return folder


def job() -> Job:
    return Job(battery_file.read_battery(GENERIC), PackOptions())


def call(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from uavbatt.cli import main; main()", "fleet", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300)


def both_tables(folder: Path) -> list[dict[str, Any]]:
    """The rows of the Parquet table, after comparing them with those of the CSV."""
    from pyarrow import parquet

    rows: list[dict[str, Any]] = parquet.read_table(folder / tables.PARQUET).to_pylist()
    with (folder / tables.CSV).open(newline="") as stream:
        texts = list(csv.DictReader(stream))
    assert len(rows) == len(texts)
    for row, text in zip(rows, texts, strict=True):
        assert list(row) == list(text)
        for name, value in row.items():
            if value is None:
                assert text[name] == ""
            elif isinstance(value, bool):
                assert text[name] == str(value).lower()
            elif isinstance(value, int | float):
                assert float(text[name]) == value
            elif isinstance(value, str):
                assert text[name] == value
            else:
                assert text[name] == value.strftime("%Y-%m-%d %H:%M:%SZ")
    return rows


def test_end_to_end_with_bad_logs_and_again(logs: Path, tmp_path: Path) -> None:
    output = tmp_path / "out"
    first = call(logs, "-o", output, "--workers", "2")
    assert first.returncode == 0, first.stderr
    assert "4 logs (4 done now): 2 replayed, 2 failed" in first.stdout
    rows = {Path(row["file"]).name: row for row in both_tables(output)}
    assert {name: row["status"] for name, row in rows.items()} == {
        "1.tlog": "ok", "2.tlog": "ok", "broken.tlog": "bad", "empty.BIN": "bad",
    }  # fmt: skip
    assert "empty file" in rows["empty.BIN"]["reason"] and "another kind" in rows["broken.tlog"]["reason"]
    whole, half = rows["1.tlog"], rows["2.tlog"]
    assert (whole["aircraft"], half["aircraft"], whole["system"]) == ("heron", "swift", 1)
    assert whole["start_utc"].year == 2023 and whole["cells"] == 4 and whole["capacity_Ah"] == 5.0
    assert whole["energy_Wh"] > 1.5 * half["energy_Wh"] > 0.0 and whole["charge_Ah"] > half["charge_Ah"] > 0.0
    assert whole["end_of_flight_s"] > 0.0 and math.isfinite(whole["error_60_s"]) and half["error_60_s"] is None
    assert whole["resistance_scale_sd"] > 0.0 and whole["capacity_scale_sd"] > 0.0
    page = (output / "fleet.html").read_text("utf-8")
    assert "heron" in page and "another kind" in page

    (logs / "swift/empty.BIN").write_bytes((logs / "swift/2.tlog").read_bytes())
    words = (f"{logs}/**/*.tlog", logs / "swift/empty.BIN", "-o", output, "--workers", "1")
    again = called("fleet", *words, folder=tmp_path)  # without another process to be started
    assert "4 logs (1 done now): 3 replayed, 1 failed" in again.stdout
    assert len(both_tables(output)) == 4


def test_an_existing_cluster(logs: Path, tmp_path: Path) -> None:
    told = tmp_path / "scheduler.json"
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment}
    place = ["--scheduler-file", str(told)]
    processes = [
        subprocess.Popen([sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard",
                          "--host", "127.0.0.1", *place], **quiet),  # type: ignore[call-overload]
        subprocess.Popen([sys.executable, "-m", "distributed.cli.dask_worker", "--no-dashboard", "--no-nanny",
                          "--nthreads", "1", "--local-directory", str(tmp_path), *place], **quiet),  # type: ignore[call-overload]
    ]  # fmt: skip
    try:
        until = time.monotonic() + 60.0
        while not told.exists() and time.monotonic() < until:
            time.sleep(0.05)
        address = json.loads(told.read_text())["address"]
        found = find_logs([str(logs)])
        done = list(run.run_fleet(run.connected(1, address), found, job(), tmp_path / "out"))
        assert [d.done for d in done] == [0, 1, 2, 3, 4]
        assert sum(row.status == "ok" for row in run.rows(tmp_path / "out", found, job())) == 2
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait(60)


def test_logs_are_left_out_by_name_or_path(tmp_path: Path) -> None:
    for name in ("a/flight.tlog", "a/bench_1.tlog", "b/flight.tlog"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"x")

    def left(*without: str) -> list[str]:
        return [str(Path(log.name).relative_to(tmp_path)) for log in find_logs([str(tmp_path)], without)]

    assert left("bench*") == ["a/flight.tlog", "b/flight.tlog"]
    assert left("*/b/*", "bench_?.tlog") == ["a/flight.tlog"]
    with pytest.raises(UsageError, match=r"--exclude flight: expected a pattern .* it fits none"):
        left("flight")
    with pytest.raises(UsageError, match="all are left out"):
        left("*.tlog")


def test_no_scheduler_no_logs_no_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UsageError, match="expected a Dask scheduler that answers"), run.connected(1, "nowhere:?"):
        pass
    with pytest.raises(UsageError, match=r"nothing.*found none"):
        find_logs([str(tmp_path / "nothing*.tlog")])
    with pytest.raises(UsageError, match="address that can be listed"):
        find_logs(["nosuchprotocol://x/*.tlog"])
    monkeypatch.setitem(sys.modules, "distributed", None)
    run.check_extra()
    with pytest.raises(MissingExtra, match=r"uavbatt\[fleet\]") as caught:
        run.check_extra("tcp://somewhere:8786")
    assert caught.value.exit_code == 3


def test_logs_behind_addresses(tmp_path: Path, log: bytes) -> None:
    import fsspec

    memory = fsspec.filesystem("memory")
    for name in ("/fleet/a.tlog", "/fleet/b.tlog", "/fleet/notes.txt"):
        memory.pipe_file(name, log)
    with zipfile.ZipFile(tmp_path / "flights.zip", "w") as archive:
        archive.writestr("summer/c.tlog", log)
    found = find_logs(["memory://fleet/*.tlog", f"zip://summer/*.tlog::file://{tmp_path}/flights.zip"])
    assert [(f.name.split("/")[-1] if "zip" not in f.name else "zip", f.size) for f in found] == [
        ("a.tlog", len(log)), ("b.tlog", len(log)), ("zip", len(log)),
    ]  # fmt: skip
    assert all(f.read() == log for f in found)
    assert [row.status for f in found[1:] for row in fly_log(f, job())] == ["ok", "ok"]
    (gone,) = fly_log(LogFile("memory://fleet/gone.tlog", 1, ""), job())
    assert gone.status == LOST and "a log that can be read" in gone.reason


def test_the_table_of_an_earlier_run_is_no_log(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    for name in ("a.csv", "flights.csv", "out/flights.csv", "out/flights.jsonl"):
        (tmp_path / name).write_text("time_s,voltage_V\n")
    assert [Path(log.name).relative_to(tmp_path.resolve()) for log in find_logs([str(tmp_path)])] == [
        Path("a.csv"),
        Path("flights.csv"),
    ]


def test_the_journal_survives_a_crash(tmp_path: Path) -> None:
    keys = {"k0": 0, "k1": 1, "k2": 2, "k3": 3}
    with journal.Journal(tmp_path / JOURNAL, keys, row_of) as first:
        first.add(2, "k2", [FlightRow(file="c", end_soc=0.25), FlightRow(file="c", flight=2)])
        first.add(0, "k0", [FlightRow(file="a", status=LOST, reason="its disk was away")])
        first.add(1, "k1", [FlightRow(file="b", inside_60=True)])
    path = tmp_path / JOURNAL
    path.write_bytes(path.read_bytes() + b'{"key": "k3", "fi')
    with journal.Journal(tmp_path / JOURNAL, keys, row_of) as second:
        assert [n in second for n in range(4)] == [False, True, True, False]
        second.add(3, "k3", [FlightRow(file="d")])
    with journal.Journal(tmp_path / JOURNAL, keys, row_of) as third:
        rows = [row for _, of_log in third.rows() for row in of_log]
    assert [row.file for row in rows] == ["a", "b", "c", "c", "d"]  # what was not read is told as well
    assert rows[1].inside_60 is True and rows[2].end_soc == 0.25 and math.isnan(rows[4].end_soc)
    assert [row.flight for row in rows] == [1, 1, 1, 2, 1]


def test_keys_tell_what_changed() -> None:
    one = LogFile("a", 5, "1")
    same = journal.job_key(job())
    assert journal.key(one, same) == journal.key(LogFile("a", 5, "1"), journal.job_key(job()))
    other = journal.job_key(Job(battery_file.read_battery("lpab-3s"), PackOptions()))
    stated = journal.job_key(Job(battery_file.read_battery(GENERIC), PackOptions(capacity_Ah=4.0)))
    keys = [(one, same), (LogFile("a", 6, "1"), same), (LogFile("a", 5, "2"), same), (one, other), (one, stated)]
    assert len({journal.key(*pair) for pair in keys}) == 5
    assert row_of({**FlightRow(file="x").plain(), "of a later version": 1}).file == "x"


def test_whatever_happens_is_a_row(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = tmp_path / "N123" / "a.csv"
    path.parent.mkdir()
    path.write_text("time_s,voltage_V,current_A\n0,16,10\n1,15.9,10\n")
    found = find_logs([str(path)])[0]
    by_name = Job(battery_file.read_battery(GENERIC), PackOptions(capacity_Ah=5.0), aircraft_pattern=r"/(N\d+)/")
    assert [row.aircraft for row in fly_log(found, by_name)] == ["N123"]
    assert "capacity" in fly_log(found, job())[0].reason  # nobody states one
    monkeypatch.setattr("uavbatt.fleet.fly.read_bytes", lambda *_: 1 / 0)
    (row,) = fly_log(found, by_name)
    assert (row.status, row.reason) == ("bad", "ZeroDivisionError in uavbatt itself: division by zero")
    with pytest.raises(BadInput, match="a folder that can be written"):
        journal.Journal(path / JOURNAL, {}, row_of)


@pytest.mark.parametrize(
    ("near", "beyond", "words"),
    [
        ({"end_soc": 0.05}, {"end_soc": 0.049}, "landed nearly empty: state of charge 0.05"),
        ({"refused_share": 0.2}, {"refused_share": 0.21}, "21% of the forecasts in the air refused"),
        ({"mean_nis": 3.0}, {"mean_nis": 3.1}, "the battery file explains it badly (mean NIS 3.1)"),
        ({"resistance_scale": 1.59}, {"resistance_scale": 1.61}, "resistance 1.61 times the battery file's"),
        ({"certificate": "generic", "resistance_scale": 1.9}, {"resistance_scale": 1.9}, "resistance 1.90 times the"),
        ({"error_120_s": 60.0}, {"error_120_s": 61.0}, "two minutes before the end the forecast was 61 s too long"),
        ({"error_120_s": 61.0, "inside_120": True}, {"error_120_s": 61.0}, "two minutes before the end the forecast"),
        ({"trust": "with care"}, {"trust": "no"}, "not to be trusted: rows are missing"),
    ],
)
def test_a_flight_is_looked_at_from_one_bound_on_and_says_why(
    near: dict[str, Any], beyond: dict[str, Any], words: str
) -> None:
    ordinary: dict[str, Any] = {
        "file": "a.tlog", "certificate": "fitted", "end_soc": 0.3, "duration_s": 600.0, "end_of_flight_s": math.nan,
        "refused_share": 0.0, "mean_nis": 1.0, "resistance_scale": 1.0, "resistance_scale_sd": 0.1,
        "error_120_s": 0.0, "inside_120": False,
    }  # fmt: skip
    assert reasons(FlightRow(**{**ordinary, **near}), ("rows are missing",)) == []
    (reason,) = reasons(FlightRow(**{**ordinary, **beyond}), ("rows are missing",))
    assert reason.startswith(words) and urgency(FlightRow(file="a.tlog", look=reason)) > 0.0


def test_a_flight_that_stayed_in_the_air_below_the_cut_off_is_looked_at() -> None:
    row = FlightRow(file="a.tlog", end_soc=0.3)
    assert reasons(row, (), 30.0) == reasons(row, ()) == []
    assert reasons(row, (), 31.0) == ["flew on below the cut-off voltage"]


def test_minutes_on_the_ground_at_the_end_of_a_log_are_no_flight(tmp_path: Path) -> None:
    """Landed within 20 s of the cut-off, then seven minutes with the motors off: it did not fly on."""
    pack = pack_of(battery_file.read_battery(GENERIC), 4, 5.0, 13.2, math.nan)
    rows = simulated(pack, SimulatedFlight(power_W=700.0, rate_Hz=0.5))[:-10]
    resting = replace(rows[-1], voltage_V=14.0, current_A=0.4, armed=False)
    idle = [replace(resting, time_s=resting.time_s + 2.0 * k) for k in range(1, 210)]
    write_log(tmp_path / "a.tlog", [*rows, *idle], pack)
    (row,) = fly_log(find_logs([str(tmp_path)])[0], job())
    assert row.duration_s > row.end_of_flight_s + 400.0 and "flew on" not in row.look
    assert row.mean_power_W == pytest.approx(700.0, rel=0.05)
    assert row.air_s == pytest.approx(row.duration_s - 418.0 - 20.0, abs=5.0)
