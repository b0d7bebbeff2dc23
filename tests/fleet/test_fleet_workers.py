"""F14: the workers of a fleet on this machine: no port leads to them, and one that dies takes only its log along."""

from __future__ import annotations

import math
import os
import signal
import socket
import subprocess
import sys
import threading
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from command import called
from factories import generic_pack
from live_rig import PATIENCE_S, until

pytest.importorskip("pyarrow", reason="the extra `fleet` is not installed")

from uavbatt.battery import battery_file
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.fleet import run
from uavbatt.fleet.errand import Errand
from uavbatt.fleet.fly import Job, fly_log, lost_rows
from uavbatt.fleet.logs import JOURNAL, LogFile, find_logs
from uavbatt.fleet.processes import TRIES, Processes
from uavbatt.fleet.row import LOST, FlightRow
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, write_log

COMMAND = [sys.executable, "-c", "from uavbatt.cli import main; main()", "fleet"]
LISTENS = "0A"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short flight to its end."""
    pack = generic_pack(4, 5.0, 13.2, math.nan)
    path = tmp_path_factory.mktemp("logs") / "a.tlog"
    write_log(path, simulate_flight(pack, SimulatedFlight(power_W=700.0, rate_Hz=0.2)), pack)
    return path


@pytest.fixture
def waiting(tmp_path: Path) -> LogFile:
    """A log whose reader waits for its bytes, which never come."""
    os.mkfifo(tmp_path / "b.tlog")
    return LogFile(str(tmp_path / "b.tlog"), 0, "")


def errand(log: LogFile) -> Errand[FlightRow]:
    job = Job(battery_file.read_battery("lipo-generic"), PackOptions())
    return Errand(log, partial(fly_log, job=job), partial(lost_rows, job=job))


def tree(pid: int) -> list[int]:
    """A process and all that descend from it."""
    found = [pid]
    for parent in found:
        for task in Path(f"/proc/{parent}/task").glob("*/children"):
            found += map(int, task.read_text("ascii").split())
    return found


def reader(path: Path, pid: int) -> int:
    """The process below this one that has opened the file; 0 when none has.

    One that was forked a moment ago still holds what its parent holds, and goes by its parent's name.
    """
    ours = command_line(pid)
    return next((one for one in tree(pid)[1:] if command_line(one) not in (b"", ours) and str(path) in opened(one)), 0)


def command_line(pid: int) -> bytes:
    """Of a process; empty when it is gone."""
    with suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    return b""


def opened(pid: int) -> set[str]:
    """What the descriptors of a process stand for."""
    found = set()
    with suppress(OSError):
        for descriptor in Path(f"/proc/{pid}/fd").iterdir():
            with suppress(OSError):
                found.add(os.readlink(descriptor))
    return found


def listening(pids: list[int]) -> list[str]:
    """The TCP ports that these processes listen on."""
    things = set[str]().union(*map(opened, pids))
    rows = [line.split() for name in ("tcp", "tcp6") for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]]
    return [row[1] for row in rows if row[3] == LISTENS and f"socket:[{row[9]}]" in things]


def test_a_fleet_that_runs_listens_on_no_port(log: Path, tmp_path: Path) -> None:
    """Looked at while the second log, of ten hours, is flown."""
    rows = "".join(f"{k / 10},16.0,1.0\n" for k in range(360_000))
    (tmp_path / "b.csv").write_text("time_s,voltage_V,current_A\n" + rows)
    journal = tmp_path / "out" / JOURNAL
    command = [*COMMAND, str(log), str(tmp_path / "b.csv"), "--capacity-ah", "5", "-o", str(journal.parent)]
    process = subprocess.Popen([*command, "--workers", "2"], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        until(lambda: journal.exists() and b"a.tlog" in journal.read_bytes())
        pids = tree(process.pid)
        assert len(pids) >= 3 and process.poll() is None
        assert listening(pids) == []
        with socket.create_server(("127.0.0.1", 0)) as ours:  # the test would see a port
            assert f"0100007F:{ours.getsockname()[1]:04X}" in listening([os.getpid()])
    finally:
        process.terminate()
        process.communicate(timeout=PATIENCE_S)
    assert until(lambda: not any(map(opened, pids)))  # no worker outlives the run


def test_a_worker_that_dies_takes_only_its_log_along(waiting: LogFile, log: Path) -> None:
    def kill() -> None:
        for _ in range(TRIES):
            worker = until(lambda: reader(Path(waiting.name), os.getpid()))
            os.kill(worker, signal.SIGKILL)
            until(lambda worker=worker: not opened(worker))  # type: ignore[misc]

    held = os.open(waiting.name, os.O_RDWR)  # so that opening does not wait, only reading does
    killer = threading.Thread(target=kill)
    with closing(Processes(1)) as crew:
        crew.send(1, errand(waiting))
        crew.send(2, errand(find_logs([str(log)])[0]))
        killer.start()
        rows = dict(crew.finished() for _ in range(2))
    killer.join(PATIENCE_S)
    os.close(held)
    assert (rows[1][0].status, rows[2][0].status) == (LOST, "ok")
    assert "the worker ended while it read this log" in rows[1][0].reason


def test_a_worker_that_takes_too_much_memory_is_ended(waiting: LogFile) -> None:
    with closing(Processes(1, limit_bytes=1e6)) as crew:
        crew.send(7, errand(waiting))
        number, (row,) = crew.finished()
    assert (number, row.status) == (7, LOST) and "more than 1 MB of memory" in row.reason


def test_no_more_workers_are_started_than_there_are_logs(log: Path, tmp_path: Path, monkeypatch: Any) -> None:
    """Each has its share of the memory: of many shares none is enough."""
    sizes: list[int] = []
    connected = run.connected

    def counted(size: int, scheduler: str | None) -> Any:
        sizes.append(size)
        return connected(size, scheduler)

    monkeypatch.setattr(run, "connected", counted)
    done = called("fleet", str(log), "-o", "out", "--workers", "16", "--capacity-ah", "5", folder=tmp_path)
    assert (done.returncode, sizes) == (0, [1]), done.stderr
