"""A card holds logs that cannot be read: beside others they are left out by name, alone they are an error."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command import called
from factories import generic_pack

from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, write_log

SIZE = ("--cells", "4", "--capacity-ah", "5")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for k, power_W in enumerate((300.0, 350.0)):
        flown = simulate_flight(generic_pack(), SimulatedFlight(power_W, rate_Hz=0.5, seed=k))
        write_log(tmp_path / f"flight{k}.csv", flown, generic_pack())
    (tmp_path / "of_no_bytes.BIN").write_bytes(b"")
    (tmp_path / "of_no_battery.csv").write_text("time_s,voltage_V,current_A,temp_C\n", encoding="utf-8")
    return tmp_path


def test_fit_leaves_them_out_by_name(folder: Path) -> None:
    logs = sorted(path.name for path in folder.iterdir())
    done = called("fit", *logs, "-o", "q.battery.toml", "--vehicle", "q.vehicle.toml", *SIZE, folder=folder)
    assert done.returncode == 0, done.stderr
    warned = [line for line in done.stderr.splitlines() if line.endswith(": left out")]
    assert warned == [
        "warning: of_no_battery.csv: expected battery messages with a voltage, found none: left out",
        *(line for line in warned if line.startswith("warning: of_no_bytes.BIN: expected a flight log")),
    ]
    assert "q.battery.toml: fitted to 0 bench tests, 2 flights" in done.stdout
    assert (folder / "q.vehicle.toml").exists()


def test_diagnose_leaves_them_out_by_name(folder: Path) -> None:
    logs = ["flight0.csv", "of_no_bytes.BIN", "flight1.csv"]
    done = called("diagnose", *logs, "--battery", "lipo-generic", *SIZE, folder=folder)
    assert done.returncode == 0, done.stderr
    assert "warning: of_no_bytes.BIN: expected a flight log" in done.stderr


@pytest.mark.parametrize(
    "command", [("fit", "-o", "q.battery.toml"), ("diagnose", "--battery", "lipo-generic")], ids=["fit", "diagnose"]
)
def test_a_folder_stands_for_the_logs_in_it(folder: Path, command: tuple[str, ...], tmp_path: Path) -> None:
    """As for `fleet`; a second recording in it and what cannot be read are left out by name."""
    (folder / "copies").mkdir()
    (folder / "copies/flight1.csv").write_bytes((folder / "flight1.csv").read_bytes())
    done = called(command[0], folder, *command[1:], *SIZE, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert f"warning: {folder}/of_no_bytes.BIN: expected a flight log" in done.stderr
    assert f"warning: {folder}/flight1.csv: the same flight as {folder}/copies/flight1.csv: left out" in done.stderr


def test_replay_takes_the_logs_of_a_folder_one_by_one(folder: Path, tmp_path: Path) -> None:
    done = called("replay", folder, *SIZE, "--json", tmp_path / "all.json", folder=tmp_path)
    assert done.returncode == 1
    told = {Path(one["log"]).name: one for one in json.loads((tmp_path / "all.json").read_text(encoding="utf-8"))}
    assert list(told) == ["flight0.csv", "flight1.csv", "of_no_battery.csv", "of_no_bytes.BIN"]
    assert [name for name, one in told.items() if "error" in one] == ["of_no_battery.csv", "of_no_bytes.BIN"]


def test_a_folder_without_logs_is_named(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    done = called("replay", "empty", *SIZE, folder=tmp_path)
    assert (done.returncode, done.stderr) == (
        2,
        "uavbatt: empty: expected a folder with flight logs, found none in it\n",
    )


@pytest.mark.parametrize("logs", [("of_no_bytes.BIN",), ("of_no_bytes.BIN", "of_no_battery.csv")])
def test_where_none_can_be_read_the_first_is_named(folder: Path, logs: tuple[str, ...]) -> None:
    done = called("fit", *logs, "-o", "q.battery.toml", *SIZE, folder=folder)
    assert done.returncode == 1
    assert done.stderr.startswith("uavbatt: of_no_bytes.BIN: expected a flight log") and done.stderr.count("\n") == 1
    assert not (folder / "q.battery.toml").exists()


def test_a_name_of_no_file_is_a_slip(folder: Path) -> None:
    done = called("fit", "flight0.csv", "flihgt1.csv", "-o", "q.battery.toml", *SIZE, folder=folder)
    assert done.returncode == 1
    assert "flihgt1.csv" in done.stderr and "no such file" in done.stderr
    assert not (folder / "q.battery.toml").exists()
