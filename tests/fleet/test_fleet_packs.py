"""A fleet with a pack ledger: the rows and the ledger are those of replaying the logs one by one in order of time."""

from __future__ import annotations

import csv
import json
import sqlite3
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from command import Done, called
from factories import generic_pack

pytest.importorskip("pyarrow", reason="the extra `fleet` is not installed")

from uavbatt.battery.scaling import Pack
from uavbatt.fleet import run
from uavbatt.fleet.errand import Errand
from uavbatt.packs.ledger import Ledger
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, with_effects
from uavbatt.simulate.tlog_writer import write_tlog

FIRST_US, DAY_US = 1_790_000_000_000_000, 86_400_000_000
WHOLE = 5.0
LATER = "a_4.tlog"
# name of the log, serial, day: the names are not in the order of time
LOGS = (("a_3.tlog", 7, 1), ("a_1.tlog", 7, 4), ("a_2.tlog", 7, 7), ("b_1.tlog", 8, 2), ("other.tlog", 8, 5))


def pack(name: str) -> Pack:
    """A pack in service; that of the last log has three cells, under the label of one with four."""
    cells = 3 if name.startswith("other") else 4
    made = generic_pack(cells, WHOLE, 3.3 * cells, 3.5 * cells)
    return with_effects(made, {"capacity_fade": 0.2}) if name.startswith("a") else made


def write(folder: Path, name: str, serial: int, day: int) -> None:
    flown = simulate_flight(pack(name), SimulatedFlight(power_W=500.0, rate_Hz=0.5, seed=day))
    parameters = {"BATT_CAPACITY": 1000.0 * WHOLE, "BATT_CRT_VOLT": pack(name).cutoff_V, "BATT_SERIAL_NUM": serial}
    write_tlog(folder / name, flown, parameters, epoch_us=FIRST_US + day * DAY_US)


@pytest.fixture(scope="module", autouse=True)
def compiled_flights() -> Iterator[None]:
    """The fleet is compiled, however few its flights, as the replays are: the same to rounding (tests/compiled)."""
    with patch("uavbatt.fleet.fly.MANY_FLIGHTS", 0):
        yield


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of five logs of two labels."""
    folder = tmp_path_factory.mktemp("packs")
    (folder / "logs").mkdir()
    for name, serial, day in LOGS:
        write(folder / "logs", name, serial, day)
    return folder


@pytest.fixture(scope="module")
def one_by_one(logs: Path) -> dict[str, dict[str, Any]]:
    """Each log's summary and what was said of it, replayed one by one in order of time."""
    found = {}
    for name, _, _ in sorted(LOGS, key=lambda log: log[2]):
        done = called("replay", f"logs/{name}", "--packs", "replay.sqlite", "--json", f"{name}.json", folder=logs)
        assert done.returncode == 0, done.stderr
        found[name] = {**json.loads((logs / f"{name}.json").read_text("utf-8")), "said": done.stdout}
    return found


class Here:
    """A crew of one in this process: starting the workers of two passes is most of the work of so few logs."""

    size = 1

    def __init__(self) -> None:
        self._queue: deque[tuple[int, Errand[Any]]] = deque()

    def send(self, number: int, errand: Errand[Any]) -> None:
        self._queue.append((number, errand))

    def finished(self) -> tuple[int, Any]:
        number, errand = self._queue.popleft()
        return number, errand.done()


@contextmanager
def crew_here(workers: int, scheduler: str | None = None) -> Iterator[Here]:
    yield Here()


def fleet(folder: Path, output: str, workers: int = 0) -> Done:
    """The command with `workers` processes; 0: all in this one."""
    words = ("fleet", "logs", "-o", output, "--workers", str(workers or 1), "--packs", f"{output}.sqlite")
    with patch.object(run, "connected", run.connected if workers else crew_here):
        done = called(*words, folder=folder)
    assert done.returncode == 0, done.stderr
    return done


def table(folder: Path, output: str) -> dict[str, dict[str, str]]:
    with (folder / output / "flights.csv").open(newline="", encoding="utf-8") as stream:
        return {Path(row["file"]).name: row for row in csv.DictReader(stream)}


def remembered(path: Path) -> list[tuple[object, ...]]:
    """The ledger's rows, but for their numbers."""
    with sqlite3.connect(path) as ledger:
        query = "SELECT name, key, told_log_Ah, told_log_ohm, known_log_Ah, known_log_ohm, known_covariance, flights"
        found = ledger.execute(f"{query}.findings FROM flights JOIN packs ON packs.id = pack ORDER BY name, key")
        return list(found)


@pytest.fixture(scope="module")
def flown(logs: Path) -> Done:
    """The first run over the five logs, in this process."""
    return fleet(logs, "out0")


# Two workers: slow, for how rows come back from processes is asked in test_fleet.py and test_fleet_workers.py.
@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_rows_and_ledger_are_those_of_replay_in_order_of_time(
    workers: int, logs: Path, one_by_one: dict[str, dict[str, Any]], flown: Done
) -> None:
    output = f"out{workers}"
    done = fleet(logs, output, workers) if workers else flown
    assert "5 logs (5 done now)" in done.stdout
    rows = table(logs, output)
    assert set(rows) == set(one_by_one)
    for name, summary in one_by_one.items():
        half = next(score for score in summary["scores"] if score["label"] == "half time")
        assert float(rows[name]["error_half_s"]) == pytest.approx(half["error_s"], abs=1e-6), name
        assert float(rows[name]["end_soc"]) == pytest.approx(summary["end_soc"], abs=1e-9), name
    assert remembered(logs / f"{output}.sqlite") == remembered(logs / "replay.sqlite")


def test_the_flights_before_make_the_next_forecast_better(one_by_one: dict[str, dict[str, Any]]) -> None:
    first, last = (abs(one_by_one[name]["scores"][0]["error_s"]) for name in ("a_3.tlog", "a_2.tlog"))
    assert last < first


def test_a_pack_of_other_cells_under_a_label_is_named_and_not_taken_in(
    logs: Path, one_by_one: dict[str, dict[str, Any]], flown: Done
) -> None:
    words = "expected flights of 4 cells as before, found 3: another pack under this name?"
    assert words in flown.stderr
    assert words in table(logs, "out0")["other.tlog"]["look"]
    assert words in one_by_one["other.tlog"]["said"]
    assert one_by_one["other.tlog"]["pack_findings"] == ["another_pack"]


def test_a_run_goes_on_where_it_was_and_a_flight_in_between_changes_those_after_it(
    logs: Path, one_by_one: dict[str, dict[str, Any]], flown: Done
) -> None:
    """It goes on with the first run's own folder, so that it stands behind the tests that read that."""
    assert "5 logs (0 done now)" in fleet(logs, "out0").stdout
    journal = logs / "out0/flights.jsonl"
    lines = journal.read_text("utf-8").splitlines(keepends=True)
    journal.write_text("".join(lines[:2]) + lines[2][:40], "utf-8")  # interrupted while it wrote the third
    (logs / "out0/lessons.jsonl").unlink()
    assert "5 logs (3 done now)" in fleet(logs, "out0").stdout
    assert remembered(logs / "out0.sqlite") == remembered(logs / "replay.sqlite")

    write(logs / "logs", LATER, 7, 6)  # between the second and the third flight of its pack
    try:
        assert "6 logs (2 done now)" in fleet(logs, "out0").stdout
    finally:
        (logs / "logs" / LATER).unlink()


def test_damage_is_among_what_a_person_should_look_at(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    for day in range(4):
        made = with_effects(pack("b.tlog"), {"resistance_growth": 0.0 if day < 3 else 0.9})
        flown = simulate_flight(made, SimulatedFlight(power_W=500.0, rate_Hz=0.5, seed=day))
        parameters = {"BATT_CAPACITY": 1000.0 * WHOLE, "BATT_CRT_VOLT": 13.2, "BATT_SERIAL_NUM": 9}
        write_tlog(tmp_path / f"logs/{day}.tlog", flown, parameters, epoch_us=FIRST_US + day * DAY_US)
    fleet(tmp_path, "out")
    rows = table(tmp_path, "out")
    assert "more resistance at once: damaged?" in rows["3.tlog"]["look"]
    assert not any("pack 9" in rows[f"{day}.tlog"]["look"] for day in range(3))


def test_two_logs_of_one_flight_are_said_to_be_one(tmp_path: Path) -> None:
    """The second was opened a minute later, as by another ground station, and is shorter."""
    (tmp_path / "logs").mkdir()
    flown = simulate_flight(pack("b.tlog"), SimulatedFlight(power_W=500.0, rate_Hz=0.5, seed=1))
    parameters = {"BATT_CAPACITY": 1000.0 * WHOLE, "BATT_CRT_VOLT": 13.2, "BATT_SERIAL_NUM": 9}
    for name, part, late_s in (("whole", flown, 0), ("part", flown[:100], 60)):
        write_tlog(tmp_path / f"logs/{name}.tlog", part, parameters, epoch_us=FIRST_US + late_s * 1_000_000)
    assert "1 flight in out.sqlite, which remembers 1 pack;" in fleet(tmp_path, "out").stdout


def test_a_log_of_the_future_is_said_and_is_not_the_last_of_its_pack(logs: Path, tmp_path: Path) -> None:
    """Its date stood as that of the pack's last flight, before which no other one came any more."""
    (tmp_path / "logs").mkdir()
    in_a_year = round((time.time() * 1e6 - FIRST_US) / DAY_US) + 365
    for name, day in (("now.tlog", 1), ("wrong.tlog", in_a_year)):
        write(tmp_path / "logs", name, 7, day)
    arguments = ("--packs", "p.sqlite", "--workers", "1")
    assert called("fleet", "logs", "-o", "out", *arguments, folder=tmp_path).returncode == 0
    with (tmp_path / "out/flights.csv").open(newline="", encoding="utf-8") as stream:
        looks = {Path(row["file"]).name: row["look"] for row in csv.DictReader(stream)}
    assert "in the future: the clock of the log is wrong" in looks["wrong.tlog"]
    assert "future" not in looks["now.tlog"]
    replayed = called("replay", "logs/wrong.tlog", "--packs", "p.sqlite", folder=tmp_path)
    assert "nothing learned: dated 2" in replayed.stdout and "in the future" in replayed.stdout
    with Ledger(tmp_path / "p.sqlite") as ledger:
        assert [one.flight.source for one in ledger.flights("7")] == ["now.tlog"]
