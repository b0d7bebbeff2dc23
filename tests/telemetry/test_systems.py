"""A .tlog with two vehicles: the first that speaks of a battery, or the one that is named."""

from __future__ import annotations

from pathlib import Path

import pytest
from command import called
from frames import hover, write_log

from uavbatt.errors import UsageError
from uavbatt.telemetry import read_log


@pytest.fixture
def two_vehicles(tmp_path: Path) -> Path:
    return write_log(tmp_path / "two.tlog", [*hover(60, 16.7, 12.0, system=1), *hover(50, 25.1, 20.0, system=42)])


def test_the_vehicle_that_is_named_is_read(two_vehicles: Path) -> None:
    first, second = read_log(two_vehicles), read_log(two_vehicles, system=42)
    assert first == read_log(two_vehicles, system=1)
    assert (first.identity.system, second.identity.system) == (1, 42)
    assert (len(first.samples), len(second.samples)) == (60, 50)
    assert (first.samples[-1].current_A, second.samples[-1].current_A) == (12.0, 20.0)


@pytest.mark.parametrize("command", ["info", "replay"])
def test_the_commands_take_the_number(two_vehicles: Path, command: str) -> None:
    stated = ("--capacity-ah", "5") if command == "replay" else ()
    first = called(command, two_vehicles, *stated, folder=two_vehicles.parent)
    second = called(command, two_vehicles, "--system", "42", *stated, folder=two_vehicles.parent)
    assert first.returncode == second.returncode == 0, second.stderr
    assert first.stdout != second.stdout


def test_a_vehicle_that_is_not_there_is_named_with_those_that_are(two_vehicles: Path) -> None:
    with pytest.raises(UsageError, match="no battery messages of system 7; systems that have some: 1, 42"):
        read_log(two_vehicles, system=7)


def test_other_logs_hold_one_vehicle(tmp_path: Path) -> None:
    (tmp_path / "f.csv").write_text("time_s,voltage_V,current_A\n0,16,10\n1,15.9,10\n")
    with pytest.raises(UsageError, match="holds several vehicles"):
        read_log(tmp_path / "f.csv", system=1)
