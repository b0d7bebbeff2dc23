"""A command that a signal ends leaves no half-written file, and a mark of byte order spoils no text file."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from command import SURROUNDINGS, UAVBATT, called

from uavbatt.battery import battery_file

LOGS = Path(__file__).parents[2] / "logs"
PATIENCE_S = 60.0
MARK = b"\xef\xbb\xbf"
VEHICLE = b"""name = "m"\nbattery = "lipo-generic"\nsource = "x"
[phases]\ntake_off_W = 300.0\nflight_W = 300.0\nlast_minute_W = 300.0
[[traces]]\ntime_s = [0.0, 300.0]\npower_W = [300.0, 300.0]\nsoc = [1.0, 0.3]\n"""
MISSION = b"QGC WPL 110\n0 1 0 16 0 0 0 0 47.0 8.0 500 1\n1 0 3 22 0 0 0 0 0 0 30000 1\n"
PLAN = ("plan", "--cells", "4", "--capacity-ah", "5")


@pytest.fixture
def by_default() -> Iterator[None]:
    """A process that is started meanwhile is ended by SIGHUP, even if these tests run under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("by_default")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_replay_that_is_ended_leaves_nothing(name: str, tmp_path: Path) -> None:
    words = [str(UAVBATT), "replay", str(LOGS / "quad_3s.BIN"), "--capacity-ah", "4", "--jsonl", "a.jsonl"]
    with subprocess.Popen(
        words, cwd=tmp_path, env={**os.environ, **SURROUNDINGS}, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        until_s = time.monotonic() + PATIENCE_S
        while not list(tmp_path.iterdir()) and time.monotonic() < until_s:
            time.sleep(0.005)
        assert [path.suffix for path in tmp_path.iterdir()] == [".part"]
        number = getattr(signal, name)
        process.send_signal(number)
        out, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, out, err) == (128 + number, b"", f"uavbatt: ended by {name}\n".encode())
    assert not list(tmp_path.iterdir())


def test_a_signal_that_is_ignored_ends_nothing(tmp_path: Path) -> None:
    """As under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        done = called(*PLAN, "--power-w", "300", folder=tmp_path)
        assert done.returncode == 0 and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_battery_and_vehicle_file_of_a_windows_editor(tmp_path: Path) -> None:
    (tmp_path / "a.battery.toml").write_bytes(MARK + battery_file._text("lipo-generic")[0].replace(b"\n", b"\r\n"))
    (tmp_path / "a.vehicle.toml").write_bytes(MARK + VEHICLE.replace(b"\n", b"\r\n"))
    done = called(*PLAN, "--battery", "a.battery.toml", "--vehicle", "a.vehicle.toml", folder=tmp_path)
    assert done.returncode == 0, done.stderr


def test_mission_and_configuration_of_a_windows_editor(tmp_path: Path) -> None:
    """Both are read: what is said of them is about their content."""
    (tmp_path / "a.waypoints").write_bytes(MARK + MISSION)
    (tmp_path / "a.vehicle.toml").write_bytes(VEHICLE)
    done = called(*PLAN, "--vehicle", "a.vehicle.toml", "--mission", "a.waypoints", folder=tmp_path)
    assert "a height of 30000 m" in done.stderr
    (tmp_path / "a.toml").write_bytes(MARK + b"[link]\nendpoint = 5\n")
    done = called("live", "--config", "a.toml", folder=tmp_path)
    assert "key link.endpoint" in done.stderr
