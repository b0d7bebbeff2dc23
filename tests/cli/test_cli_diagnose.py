"""`uavbatt diagnose` from the shell: outputs, exit codes, one line for what went wrong."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import pytest
from command import called, run
from factories import generic_pack

from uavbatt.battery import battery_file
from uavbatt.cli.diagnose_records import one_size
from uavbatt.errors import NotEnoughData
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, with_effects, write_log

CELLS, CAPACITY_AH, CUTOFF_V, LOW_V = 4, 5.0, 13.2, 14.0


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two flights whose current sensor reads a quarter too much."""
    folder = tmp_path_factory.mktemp("logs")
    pack = generic_pack(CELLS, CAPACITY_AH, CUTOFF_V, LOW_V)
    pack = with_effects(pack, {"current_gain": 1.25})
    paths = []
    for i, (power_W, ambient_C) in enumerate([(320.0, 22.0), (280.0, 12.0)]):
        path = folder / f"flight_{i}.csv"
        write_log(path, simulate_flight(pack, SimulatedFlight(power_W, ambient_C, rate_Hz=1.0, seed=i + 1)), pack)
        paths.append(path)
    return paths


# Effects left out where the fact is another: fewer to try.
LEFT_OUT = ("weak_cell", "charge_transfer", "temperature_lag", "current_delay", "airflow_cooling", "resistance_growth")
WITHOUT = [word for name in LEFT_OUT for word in ("--without", name)]


def pack_options() -> list[str]:
    return ["--battery", "lipo-generic", "--cells", "4", "--capacity-ah", "5", "--cutoff-voltage", "13.2"]


def test_a_diagnosis_writes_json_battery_file_and_page(logs: list[Path], tmp_path: Path) -> None:
    outputs = {"--json": tmp_path / "d.json", "--report": tmp_path / "d.html", "-o": tmp_path / "new.battery.toml"}
    done = called("diagnose", *logs, *pack_options(), *(x for pair in outputs.items() for x in pair), folder=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(outputs["--json"].read_text())
    assert found["verdict"] in ("effect_found", "undeclared_effect")
    assert "current_gain" in found["classes"][0]["members"]
    assert set(found["classes"][0]) == {"members", "probability", "parameters", "would_separate"}
    assert set(found["classes"][0]["parameters"]["gain_I"]) == {"value", "lo", "hi", "unit"}
    assert {"voltage_rmse_V", "remaining_mae_s"} <= set(found["before"]) == set(found["after"])
    assert found["battery_file"] == str(outputs["-o"])
    assert sorted(found["held_out"]) == sorted(map(str, logs))
    assert battery_file.read_battery(outputs["-o"]).status == "fitted"
    page = outputs["--report"].read_text()
    ET.fromstring(page.split("\n", 1)[1])
    assert "current_gain" in page and "<script" not in page


def test_one_flight_is_not_enough(logs: list[Path], tmp_path: Path) -> None:
    target = tmp_path / "d.json"
    done = called("diagnose", logs[0], *pack_options(), "--json", target, folder=tmp_path)
    assert done.returncode == 4
    assert done.stderr.count("\n") == 1 and "expected at least 2" in done.stderr
    assert json.loads(target.read_text())["verdict"] == "not_enough_data"


def test_a_log_without_current_is_not_enough(tmp_path: Path) -> None:
    path = tmp_path / "volts.csv"
    path.write_text("time_s,voltage_V\n" + "".join(f"{i},16.{i % 10}\n" for i in range(400)))
    done = called("diagnose", path, *pack_options(), folder=tmp_path)
    assert done.returncode == 4
    assert "no row has a current" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["--without", "gremlins"], "--without gremlins"), (["--json", "/nowhere/at/all.json"], "existing folder")],
)
def test_a_wrong_call_is_said_in_one_line(logs: list[Path], arguments: list[str], said: str, tmp_path: Path) -> None:
    done = called("diagnose", *logs, *pack_options(), *arguments, folder=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr and "Traceback" not in done.stderr


def test_the_same_log_twice_is_no_evidence(logs: list[Path], tmp_path: Path) -> None:
    done = called("diagnose", logs[0], logs[0], *pack_options(), folder=tmp_path)
    assert done.returncode == 4
    assert f"warning: {logs[0]}: the same flight as {logs[0]}: left out" in done.stderr


def test_the_log_of_the_ground_station_is_no_check_of_the_aircrafts_own(logs: list[Path], tmp_path: Path) -> None:
    """Both hold one flight: nothing is held back, though there are two files."""
    pack = with_effects(generic_pack(CELLS, CAPACITY_AH, CUTOFF_V, LOW_V), {"current_gain": 1.25})
    for name in ("onboard.BIN", "station.tlog"):
        write_log(tmp_path / name, simulate_flight(pack, SimulatedFlight(320.0, 22.0, rate_Hz=1.0, seed=1)), pack)
    done = called("diagnose", "onboard.BIN", "station.tlog", *pack_options(), folder=tmp_path)
    assert done.returncode == 4
    assert "warning: onboard.BIN: the same flight as station.tlog: left out" in done.stderr


def test_without_temperature_it_says_which_effects_it_could_not_look_for(logs: list[Path], tmp_path: Path) -> None:
    bare = []
    for path in logs:
        rows = [line.split(",") for line in path.read_text().splitlines()]
        kept = [i for i, name in enumerate(rows[0]) if name != "temp_C"]
        bare.append(tmp_path / path.name)
        bare[-1].write_text("\n".join(",".join(r[i] for i in kept) for r in rows) + "\n")
    done = called("diagnose", *bare, *pack_options(), *WITHOUT, "--report", tmp_path / "d.html", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "no temperature" in done.stdout
    assert "No temperature was measured" in (tmp_path / "d.html").read_text()


def test_the_rows_of_a_dead_current_sensor_are_left_out_and_said(tmp_path: Path) -> None:
    """With 100 s without a current a sound pack seemed to lack an effect without a name."""
    pack = generic_pack(CELLS, CAPACITY_AH, CUTOFF_V, LOW_V)
    for i in range(2):
        flown = simulate_flight(pack, SimulatedFlight(300.0, rate_Hz=1.0, seed=i + 1))
        dead = [replace(s, current_A=0.01 * (k % 7)) if 200.0 < s.time_s <= 300.0 else s for k, s in enumerate(flown)]
        write_log(tmp_path / f"{i}.csv", dead, pack)
    done = called("diagnose", "0.csv", "1.csv", *pack_options(), *WITHOUT, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("no_missing_effect")
    assert "warning: 0.csv: 200 to 300 s left out: the current fell and the voltage did not rise" in done.stderr


def test_flights_of_two_packs_are_not_one_evidence(logs: list[Path], tmp_path: Path) -> None:
    other = tmp_path / "other.tlog"
    pack = generic_pack(6, 8.0, 19.8, 21.0)
    write_log(other, simulate_flight(pack, SimulatedFlight(350.0, 22.0, rate_Hz=1.0, seed=3)), pack)
    first = tmp_path / "first.tlog"
    pack = generic_pack(CELLS, CAPACITY_AH, CUTOFF_V, LOW_V)
    write_log(first, simulate_flight(pack, SimulatedFlight(170.0, 22.0, rate_Hz=1.0, seed=1)), pack)
    done = called("diagnose", first, other, "--battery", "lipo-generic", folder=tmp_path)
    assert done.returncode == 4
    assert "different packs" in done.stderr


def test_a_log_that_does_not_state_its_pack_is_of_the_same_pack() -> None:
    """A log without parameters had the 5.016 Ah of the battery file, the others 5 Ah, and the diagnosis was refused."""
    stated, by_file, later = (4, 5.0, 13.2), (4, 5.016, 13.2), (4, 5.0, 13.4)
    assert one_size([by_file, stated, stated, later]) == stated
    for other in ((4, 5.2, 13.2), (5, 5.0, 13.2)):
        with pytest.raises(NotEnoughData, match="different packs"):
            one_size([stated, other])


def test_followed_flights_are_taken_in_order_and_their_course_is_in_json_and_page(
    logs: list[Path], tmp_path: Path
) -> None:
    told, page = tmp_path / "f.json", tmp_path / "f.html"
    call = ("diagnose", "--follow", logs[0].parent, *pack_options(), *WITHOUT, "--json", told, "--report", page)
    done = run(*call, folder=tmp_path)  # in a process of its own
    assert done.returncode == 0, done.stderr
    assert "in the order in which they are named" in done.stderr  # a CSV does not tell its day
    assert "in every one of the 2 flights" in done.stdout
    found = json.loads(told.read_text())
    assert [Path(f["file"]).name for f in found["flights"]] == ["flight_0.csv", "flight_1.csv"]
    one = found["classes"][0]
    assert "current_gain" in one["members"] and one["since"]["flight"] == 1 and one["grows"] is False
    assert len(one["values"]) == 2 and set(one["values"][0]) == {"value", "lo", "hi", "unit"}
    text = page.read_text()
    ET.fromstring(text.split("\n", 1)[1])
    assert "flight_1.csv" in text and "<script" not in text


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--follow", "--gate", "."], "--follow: expected neither --gate nor -o"),
        (["--follow", "--packs", "p.sqlite"], "--packs: expected --pack NAME as well"),
        (["--follow", "--pack", "A1"], "expected --packs FILE as well"),
    ],
)
def test_a_wrong_call_of_follow_is_said_in_one_line(
    logs: list[Path], arguments: list[str], said: str, tmp_path: Path
) -> None:
    done = called("diagnose", *logs, *pack_options(), *arguments, folder=tmp_path)
    assert done.returncode == 2 and said in done.stderr and "Traceback" not in done.stderr


def test_the_ledger_tells_which_flights_are_of_the_pack_and_their_order(logs: list[Path], tmp_path: Path) -> None:
    from uavbatt.cli.diagnose_follow import _in_order
    from uavbatt.packs.ledger import Ledger
    from uavbatt.packs.records import FlightEvidence, FlightRecord
    from uavbatt.packs.remembering import key_of
    from uavbatt.telemetry import read_log

    flights = [read_log(path) for path in logs]
    packs, told = tmp_path / "packs.sqlite", FlightEvidence(-5.0, 1.6, 0.01, 0.01, 0.0)
    with Ledger(packs) as ledger:  # flown the other way round
        for day, flight in enumerate(reversed(flights)):
            record = FlightRecord(
                key_of(flight.samples),
                told,
                CELLS,
                CAPACITY_AH,
                0.006,
                "lipo-generic",
                "",
                1.75e9 + 86400.0 * day,
                900.0,
            )
            ledger.save("A1", record)
    ordered = _in_order(flights, packs, "A1")
    assert [f.source for f in ordered] == [f.source for f in reversed(flights)]


def test_a_gain_with_a_drift_of_nothing_is_no_finding(tmp_path: Path) -> None:
    """The drift was worth what the gain without it was worth: a weak cell was told as a gain that changes by 0."""
    for name, power_W, seed in (("a.BIN", "250", "5"), ("b.BIN", "270", "6")):
        flown = ("--power-w", power_W, "--seed", seed, "--effect", "weak_cell=0.1")
        assert called("simulate", "-o", name, *flown, folder=tmp_path).returncode == 0
    pack = ("--cells", "4", "--capacity-ah", "5", "--battery", "lipo-generic")
    said = called("diagnose", "a.BIN", "b.BIN", *pack, folder=tmp_path).stdout
    assert said.startswith("no_missing_effect") and "weak_cell (probability" in said
    assert "not the same throughout" not in said
