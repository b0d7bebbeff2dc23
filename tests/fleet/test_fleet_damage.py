"""F10, F15: a damaged journal ends no run and is healed; no cell of the table is a formula."""

from __future__ import annotations

import csv
import gzip
import json
import zipfile
from pathlib import Path

import pytest
from command import Done, called

pytest.importorskip("distributed", reason="the extra `fleet` is not installed")
pytest.importorskip("pyarrow", reason="the extra `fleet` is not installed")

ROWS = "time_s,voltage_V,current_A\n" + "".join(f"{t},{16.0 - 0.002 * t:.3f},12\n" for t in range(60))


def fleet(folder: Path) -> Done:
    arguments = ("--capacity-ah", "5", "--cells", "4", "--workers", "1")
    return called("fleet", "logs", "-o", "out", *arguments, folder=folder)


def table(folder: Path) -> list[dict[str, str]]:
    with (folder / "out/flights.csv").open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fleet of one log, flown once."""
    folder = tmp_path_factory.mktemp("fleet")
    (folder / "logs/=HYPERLINK(1)").mkdir(parents=True)
    (folder / "logs/=HYPERLINK(1)/a.csv").write_text(ROWS)
    assert fleet(folder).returncode == 0
    return folder


def changed(line: str, key: str = "", **values: object) -> str:
    entry = json.loads(line)
    return json.dumps({"key": key or entry["key"], "rows": [{**row, **values} for row in entry["rows"]]})


def without(line: str, name: str) -> str:
    entry = json.loads(line)
    return json.dumps({**entry, "rows": [{k: v for k, v in row.items() if k != name} for row in entry["rows"]]})


DAMAGE = {
    "no file": lambda line: without(line, "file"),
    "a text for a number": lambda line: changed(line, end_soc="half"),
    "a number for a text": lambda line: changed(line, file=7),
    "a bad date": lambda line: changed(line, start_utc="the day before"),
    "a status that is none": lambda line: changed(line, status="fine"),
    "a number that fits no table": lambda line: changed(line, rows=10**30),
    "a number that fits no flight": lambda line: changed(line, flight=0),
    "no row": lambda line: json.dumps({**json.loads(line), "rows": []}),
    "rows that are none": lambda line: json.dumps({**json.loads(line), "rows": [7]}),
    "a list": lambda _: "[1, 2, 3]",
    "null": lambda _: "null",
    "nested deeply": lambda line: '{"key": ' + "[" * 100_000,
    "another encoding": lambda _: "\xff\xfe",
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_row_is_left_out_and_the_file_healed(damage: str, flown: Path) -> None:
    journal = flown / "out/flights.jsonl"
    whole = journal.read_text()
    journal.write_bytes(whole.encode() + (DAMAGE[damage](whole) + "\n").encode("latin-1"))
    done = fleet(flown)
    assert done.returncode == 0 and "1 log (0 done now): 1 replayed" in done.stdout
    assert f"{Path('out/flights.jsonl')}: damaged rows left out: 1" in done.stderr
    assert journal.read_text() == whole and len(table(flown)) == 1
    assert "damaged" not in fleet(flown).stderr


def test_logs_that_cannot_be_read_are_counted_with_their_reason(tmp_path: Path) -> None:
    """One that gives an error of its disk, and one of a size that no log has: a crew must not take them for flown."""
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/a.csv").write_text(ROWS)
    (tmp_path / "logs/b.csv").symlink_to("/proc/self/mem")
    with (tmp_path / "logs/c.BIN").open("wb") as file:
        file.truncate(5 << 30)
    done = fleet(tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "3 logs (3 done now): 1 replayed, 2 failed" in done.stdout
    assert "found a file of more than 4 GiB" in done.stdout and "Input/output error" in done.stdout
    assert sorted(row["status"] for row in table(tmp_path)) == ["bad", "lost", "ok"]
    assert "(1 done now): 1 replayed, 2 failed" in fleet(tmp_path).stdout  # the disk may be better by now


def test_the_log_of_a_damaged_row_is_flown_again(flown: Path) -> None:
    journal = flown / "out/flights.jsonl"
    whole = journal.read_text()
    journal.write_text(without(whole, "file") + "\n")
    done = fleet(flown)
    assert done.returncode == 0 and "1 log (1 done now): 1 replayed" in done.stdout
    assert journal.read_text() == whole


def test_rows_of_another_run_are_not_judged(flown: Path) -> None:
    journal = flown / "out/flights.jsonl"
    whole = journal.read_text()
    other = changed(whole, key="of another version", end_soc="half") + "\n"
    journal.write_text(other + whole + "junk\n" + '{"key": "cut sho')
    done = fleet(flown)
    assert "(0 done now)" in done.stdout and "damaged rows left out: 1" in done.stderr
    assert journal.read_text() == other + whole
    journal.write_text(whole)


def test_no_cell_is_a_formula(flown: Path) -> None:
    (row,) = table(flown)
    assert row["aircraft"] == "'=HYPERLINK(1)"
    assert float(row["duration_s"]) == 59.0 and not row["file"].startswith("'")
    from pyarrow import parquet

    assert parquet.read_table(flown / "out/flights.parquet").to_pylist()[0]["aircraft"] == "=HYPERLINK(1)"


def test_every_beginning_that_a_spreadsheet_runs(tmp_path: Path) -> None:
    from uavbatt.fleet import tables
    from uavbatt.fleet.row import FlightRow

    hostile = ("=1+1", "+1", "-1", "@SUM(1)", "\t=1", "\r=1")
    tables.write_tables(
        tmp_path, [FlightRow(file=text, hardware=text, duration_s=-1.0, warnings="a = b") for text in hostile]
    )
    with (tmp_path / tables.CSV).open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["file"] for row in rows] == [row["hardware"] for row in rows] == [f"'{text}" for text in hostile]
    assert {row["duration_s"] for row in rows} == {"-1"} and {row["warnings"] for row in rows} == {"a = b"}


def test_a_file_name_that_is_no_text_ends_no_run(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    try:
        (tmp_path / "logs/a\udcff.csv").write_text(ROWS)
    except OSError:
        pytest.skip("this file system takes no such name")
    done = fleet(tmp_path)
    assert done.returncode == 0 and "1 replayed" in done.stdout
    assert "(0 done now)" in fleet(tmp_path).stdout
    assert table(tmp_path)[0]["file"].endswith("a?.csv")


def test_packed_logs_are_flown_as_they_are(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    (logs / "a.csv").write_text(ROWS)
    (logs / "b.csv.gz").write_bytes(gzip.compress(ROWS.encode()))
    (logs / "c.csv.gz").write_bytes(gzip.compress(ROWS.encode())[:-9])
    for name, inside in (("d.zip", ("a.csv",)), ("e.zip", ("a.csv", "b.csv"))):
        with zipfile.ZipFile(logs / name, "w") as archive:
            for one in inside:
                archive.writestr(one, ROWS)
    done = fleet(tmp_path)
    assert "5 logs (5 done now): 3 replayed" in done.stdout
    found = {Path(row["file"]).name: row for row in table(tmp_path)}
    for name in ("b.csv.gz", "d.zip"):
        assert {k: v for k, v in found[name].items() if k not in ("file", "size_bytes")} == {
            k: v for k, v in found["a.csv"].items() if k not in ("file", "size_bytes")
        }
    assert found["c.csv.gz"]["reason"].startswith("expected a whole gzip or zip file")
    assert found["e.zip"]["reason"].startswith("expected an archive of one log, found 2 files")


def test_a_log_that_lost_a_share_of_its_bytes_needs_a_look(short_log: Path, tmp_path: Path) -> None:
    """A hole in the middle of a flight looked like a good log; the cut end of one harms nothing."""
    whole, middle = short_log.read_bytes(), short_log.stat().st_size // 2
    hole = len(whole) // 20
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/hole.tlog").write_bytes(whole[:middle] + b"\xff" * hole + whole[middle + hole :])
    (tmp_path / "logs/packed.tlog.gz").write_bytes(gzip.compress(whole[:middle] + b"\xff" * hole + whole[middle:]))
    (tmp_path / "logs/cut.tlog").write_bytes(whole[: middle + 3])
    assert fleet(tmp_path).returncode == 0
    looks = {Path(row["file"]).name: row["look"] for row in table(tmp_path)}
    assert all("5% of the log could not be read" in looks[name] for name in ("hole.tlog", "packed.tlog.gz"))
    assert "could not be read" not in looks["cut.tlog"]
