"""A log in which the pack was changed between two flights: every command takes them for two."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import pytest
from factories import generic_pack
from typer.testing import CliRunner

import uavbatt
from uavbatt.battery import battery_file, vehicle_file
from uavbatt.cli.app import app
from uavbatt.packs.ledger import Ledger
from uavbatt.records import Sample
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, with_effects, write_log
from uavbatt.simulate.tlog_writer import write_tlog

BETWEEN_S = 300.0


def flight(seed: int) -> list[Sample]:
    return list(simulate_flight(generic_pack(), SimulatedFlight(600.0, rate_Hz=1.0, seed=seed)))


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The first flight, the second, and both in one log with five minutes of silence between them."""
    folder, first, second = tmp_path_factory.mktemp("logs"), flight(1), flight(2)
    begin_s = first[-1].time_s + BETWEEN_S
    both = [*first, *(replace(sample, time_s=sample.time_s + begin_s) for sample in second)]
    made = {"first": first, "second": second, "both": both}
    for name, samples in made.items():
        write_log(folder / f"{name}.tlog", samples, generic_pack())
    return {name: folder / f"{name}.tlog" for name in made}


def write_flight(log: Path, serial: int, fade: float, epoch_s: float) -> float:
    """Write a flight of a pack, landed at its end; return when a ground station could hear the next one [s]."""
    pack = with_effects(generic_pack(), {"capacity_fade": fade})
    flown = list(simulate_flight(pack, SimulatedFlight(600.0, rate_Hz=0.5, seed=int(epoch_s) % 97)))
    last = flown[-1]
    flown += [replace(last, time_s=last.time_s + k, current_A=0.1, voltage_V=14.0, armed=False) for k in range(1, 20)]
    parameters = {"BATT_CAPACITY": 5000.0, "BATT_CRT_VOLT": 13.2, "BATT_SERIAL_NUM": serial}
    write_tlog(log, flown, parameters, epoch_us=int(1e6 * epoch_s))
    return epoch_s + flown[-1].time_s + BETWEEN_S


# Slow, for test_the_ledger_remembers_both asks whether each pack has its own entry.
@pytest.mark.slow
def test_a_pack_is_not_taken_for_the_worn_one_before_it_in_the_log(tmp_path: Path) -> None:
    """The flight of the first pack was remembered under the second's serial, which flew with the first's health."""
    worn, new, both = (tmp_path / f"{name}.tlog" for name in ("worn", "new", "both"))
    ledger, copy = tmp_path / "packs.sqlite", tmp_path / "copy.sqlite"
    for day in range(3):
        begin_s = write_flight(worn, 7, 0.3, 1.79e9 + 86_400.0 * day)
        write_flight(new, 8, 0.0, begin_s)
        if day < 2:
            for log in (worn, new):
                uavbatt.replay(log, packs=ledger)
    before = ledger.read_bytes()
    copy.write_bytes(before)
    alone = uavbatt.replay(new, packs=copy)
    both.write_bytes(worn.read_bytes() + new.read_bytes())  # as a ground station records them
    first, second = uavbatt.replay(both, packs=ledger).flights
    for found, expected in zip(second.outcome.checkpoints, alone.outcome.checkpoints, strict=True):
        assert found.remaining_s == pytest.approx(expected.remaining_s, abs=10.0), found.label
    copy.write_bytes(before)
    run("fleet", both, "-o", tmp_path / "out", "--packs", copy, "--workers", 1)
    errors_s = [part.outcome.checkpoints[0].error_s for part in (first, second)]
    assert [float(row["error_half_s"]) for row in table(tmp_path / "out")] == pytest.approx(errors_s, abs=1.0)
    for remembering in (ledger, copy):
        with Ledger(remembering) as remembered:
            assert [len(remembered.flights(name)) for name in ("7", "8")] == [3, 3]


def run(*words: object) -> str:
    found = CliRunner().invoke(app, [str(word) for word in words])
    assert found.exit_code == 0, found.output
    return found.output


def table(folder: Path) -> list[dict[str, str]]:
    with (folder / "flights.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_each_flight_has_its_own_answer_page_and_summary(logs: dict[str, Path], tmp_path: Path) -> None:
    summary, page = tmp_path / "both.json", tmp_path / "both.html"
    said = run("replay", logs["both"], "--json", summary, "--report", page)
    assert said.count("The battery was at its end before you landed") == 2
    assert f"{logs['both']}, flight 2 of 2:" in said
    assert "flight 2 of 2" in (tmp_path / "both-2.html").read_text("utf-8")
    first, second = json.loads(summary.read_text())["flights"]
    alone = [uavbatt.replay(logs[name]).outcome for name in ("first", "second")]
    assert first["end_of_flight_s"] == alone[0].end_of_flight_s
    begin_s = second["end_of_flight_s"] - alone[1].end_of_flight_s
    assert begin_s == pytest.approx(alone[0].duration_s + BETWEEN_S, abs=1.0)
    for found, expected in ((first, alone[0]), (second, alone[1])):
        assert [score["error_s"] for score in found["scores"]] == pytest.approx(
            [checkpoint.error_s for checkpoint in expected.checkpoints], abs=5.0
        )


def test_the_page_of_a_second_flight_is_not_that_of_another_log(logs: dict[str, Path], tmp_path: Path) -> None:
    for name, log in (("a", "both"), ("a-2", "second")):
        (tmp_path / f"{name}.tlog").write_bytes(logs[log].read_bytes())
    (tmp_path / "pages").mkdir()
    run("replay", tmp_path / "a.tlog", tmp_path / "a-2.tlog", "--report", tmp_path / "pages")
    assert {path.name for path in (tmp_path / "pages").iterdir()} == {"a.tlog.html", "a.tlog-2.html", "a-2.tlog.html"}


def test_the_python_face_gives_each_flight(logs: dict[str, Path]) -> None:
    both = uavbatt.replay(logs["both"])
    one, two = both.flights
    assert len(one) + len(two) == len(both)
    assert one.flights == (one,)
    assert two.outcome.checkpoints[0].inside


def test_a_fit_of_the_log_is_that_of_its_flights(logs: dict[str, Path], tmp_path: Path) -> None:
    """It was refused: 1.5 times the stated capacity were drawn."""
    pack = ("--cells", 4, "--capacity-ah", 5, "--cutoff-voltage", 13.2)
    run("fit", logs["both"], "-o", tmp_path / "a.battery.toml", *pack)
    run("fit", logs["first"], logs["second"], "-o", tmp_path / "b.battery.toml", *pack)
    one, other = (battery_file.read_battery(tmp_path / f"{name}.battery.toml") for name in "ab")
    assert one.parameters == other.parameters


def test_the_ledger_remembers_both(logs: dict[str, Path], tmp_path: Path) -> None:
    said = run("replay", logs["both"], "--packs", tmp_path / "a.sqlite", "--pack", "A")
    assert "2 flights remembered" in said
    assert "more charge after 5 minutes: another pack under this name?" in said
    uavbatt.replay(logs["both"], packs=tmp_path / "b.sqlite", pack="A")
    assert "2 flights" in run("packs", tmp_path / "b.sqlite")


def test_a_fleet_tells_which_forecasts_missed(logs: dict[str, Path], tmp_path: Path) -> None:
    """Under twice the load that is stated, a pack ends long before it was expected to."""
    run("fleet", logs["first"], "-o", tmp_path / "out", "--load", 300)
    (row,) = table(tmp_path / "out")
    scores = uavbatt.replay(logs["first"], load=300.0).outcome.checkpoints
    inside = {column: row[f"inside_{column}"] for column in ("half", "240", "120", "60")}
    assert list(inside.values()) == [str(score.inside).lower() for score in scores]
    assert set(inside.values()) == {"true", "false"}


def test_a_fleet_has_a_row_for_each(logs: dict[str, Path], tmp_path: Path) -> None:
    """Only the first was judged."""
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/both.tlog").write_bytes(logs["both"].read_bytes())
    assert "1 log (1 done now): 2 replayed, 0 failed" in run("fleet", tmp_path / "logs", "-o", tmp_path / "out")
    one, two = table(tmp_path / "out")
    assert one["file"] == two["file"] and (one["flight"], two["flight"]) == ("1", "2")
    run("replay", logs["both"], "--json", tmp_path / "both.json")
    for row, told in zip((one, two), json.loads((tmp_path / "both.json").read_text())["flights"], strict=True):
        for column, key in (("duration_s", "duration_s"), ("end_of_flight_s", "end_of_flight_s"), ("rows", "rows")):
            assert float(row[column]) == pytest.approx(told[key])
        assert float(row["error_half_s"]) == pytest.approx(told["scores"][0]["error_s"], abs=0.1)


def test_a_log_that_begins_on_usb_power_teaches_as_one_that_does_not(tmp_path: Path) -> None:
    flown = flight(3)
    usb = [Sample(float(k), 4.9, 0.0, 25.0, 0.0, armed=False) for k in range(30)]
    later = [replace(sample, time_s=sample.time_s + 30.0) for sample in flown]
    for name, samples in (("plain", flown), ("usb", [*usb, *later])):
        write_log(tmp_path / f"{name}.tlog", samples, generic_pack())
    plans = [run("plan", "--like", tmp_path / f"{name}.tlog").splitlines() for name in ("plain", "usb")]
    assert plans[0][0] == plans[1][0]  # cells, capacity, cut-off
    assert plans[0][3] == plans[1][3]  # endurance
    files = [tmp_path / f"{name}.vehicle.toml" for name in ("plain", "usb")]
    for file in files:
        log = tmp_path / file.name.replace("vehicle.toml", "tlog")
        run("fit", log, "--cells", 4, "--battery", "lipo-generic", "--vehicle", file)
    powers = [vehicle_file.read_vehicle(file).phases for file in files]
    assert powers[0].flight_W == pytest.approx(powers[1].flight_W)
