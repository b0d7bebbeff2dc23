"""Files without an end are refused in one line by every command that reads a file whole: devices, pipes, huge ones."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from command import Done, called, refused_live

TLOG = Path(__file__).parents[2] / "logs/quad_4s.tlog"
ENDLESS = {"/dev/zero": "a device or a pipe", "/dev/full": "a device or a pipe", "pipe": "a device or a pipe"}
READERS = {
    "a pack": ("packs", "packs.sqlite", "--import"),
    "a battery file": ("replay", TLOG, "--battery"),
    "a vehicle file": ("replay", TLOG, "--vehicle"),
    "a mission": ("replay", TLOG, "--mission"),
    "a pack ledger": ("packs",),
    "a configuration": ("live", "udpin:127.0.0.1:1", "--config"),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    os.mkfifo(tmp_path / "pipe")
    with (tmp_path / "huge").open("wb") as file:
        file.truncate(10_000_000_000)
    return tmp_path


def ask(kind: str, name: str, folder: Path) -> Done:
    command, *more = (*READERS[kind], name)
    return refused_live(*more, folder=folder) if command == "live" else called(command, *more, folder=folder)


def assert_one_line(said: Done, *words: str) -> None:
    assert (said.returncode, said.stdout) == (1, "")
    assert len(said.stderr.splitlines()) == 1
    assert all(word in said.stderr for word in words), said.stderr


@pytest.mark.parametrize("kind", READERS)
@pytest.mark.parametrize("name", ENDLESS)
def test_what_is_no_file_is_refused_before_it_is_read(kind: str, name: str, folder: Path) -> None:
    assert_one_line(ask(kind, name, folder), f"{name}: expected {kind}", f"found {ENDLESS[name]}")


@pytest.mark.parametrize(("kind", "most"), [("a pack", "50 MB"), ("a mission", "20 MB"), ("a configuration", "1 MB")])
def test_a_file_of_ten_gigabytes_is_refused(kind: str, most: str, folder: Path) -> None:
    assert_one_line(ask(kind, "huge", folder), "huge: expected", f"at most {most}")


@pytest.mark.parametrize("command", ["replay", "info"])
def test_a_log_without_an_end_is_refused(command: str, folder: Path) -> None:
    assert_one_line(called(command, "/dev/zero", folder=folder), "/dev/zero", "found a device")
    assert_one_line(called(command, "huge", folder=folder), "huge", "more than 4 GiB")


def test_no_configuration_at_all_may_be_named(folder: Path) -> None:
    """`/dev/null` in the place of the system's own file means the defaults."""
    said = refused_live("nonsense", "--config", os.devnull, folder=folder)
    assert said.returncode == 2
    assert "endpoint `nonsense`" in said.stderr
