"""The programs of examples/ run as a reader would run them, and say what they promise."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

ROOT = Path(__file__).resolve().parents[1]
LEADS = ("harness_resistance", "harness_ohm=0.015")


def ran(name: str, *words: str | Path, folder: Path) -> subprocess.CompletedProcess[str]:
    call = [sys.executable, str(ROOT / "examples" / name), *map(str, words)]
    surroundings = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    return subprocess.run(call, capture_output=True, text=True, cwd=folder, env=surroundings, timeout=300.0)


def test_every_example_is_run_here() -> None:
    names = {path.stem for path in (ROOT / "examples").glob("*.py")}
    assert names == {"replay_a_log", "live_udp", "plan_a_flight", "add_an_effect"}


def test_replay_a_log(tmp_path: Path, short_log: Path) -> None:
    done = ran("replay_a_log.py", short_log, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "half time: said" in done.stdout and "less than two minutes left at worst: from" in done.stdout
    wrong = ran("replay_a_log.py", "nothing.tlog", folder=tmp_path)
    assert wrong.returncode == 1 and "nothing.tlog" in wrong.stderr and "Traceback" not in wrong.stderr


@pytest.mark.parametrize(("minutes", "code", "said"), [("1", 0, "fits"), ("60", 1, "does not fit")])
def test_plan_a_flight(tmp_path: Path, minutes: str, code: int, said: str) -> None:
    done = ran("plan_a_flight.py", minutes, "250", "20", folder=tmp_path)
    assert (done.returncode, done.stdout.count(said)) == (code, 1), done.stderr


def test_add_an_effect(tmp_path: Path, short_log: Path) -> None:
    done = ran("add_an_effect.py", short_log, "new.battery.toml", *LEADS, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    without, with_it = done.stdout.splitlines()
    assert without.startswith("without: ") and with_it.startswith("with harness_resistance: ")
    assert without.partition(": ")[2] != with_it.partition(": ")[2]
    assert "harness_ohm = 0.015" in (tmp_path / "new.battery.toml").read_text()
    wrong = ran("add_an_effect.py", short_log, "new.battery.toml", "wishes", "size=1", folder=tmp_path)
    assert wrong.returncode == 1 and "wishes" in wrong.stderr and "Traceback" not in wrong.stderr


@pytest.mark.live
def test_live_udp(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    call = [sys.executable, str(ROOT / "examples" / "live_udp.py"), f"udpin:127.0.0.1:{port}", "3"]
    surroundings = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    with (
        subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=surroundings) as program,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle,
    ):
        wire = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        cells_mV = [3900] * 4 + [65535] * 6
        row = wire.battery_status_encode(0, 0, 1, 2500, cells_mV, 1500, 0, -1, -1)
        until = time.monotonic() + 60.0
        while program.poll() is None and time.monotonic() < until:  # it hears nothing before it listens
            vehicle.sendto(row.pack(wire), ("127.0.0.1", port))
            time.sleep(0.05)
        program.kill()
        said, wrong = program.communicate()
    assert program.returncode == 0, wrong
    assert len(said.splitlines()) == 3 and all(line.startswith("soc ") for line in said.splitlines())
