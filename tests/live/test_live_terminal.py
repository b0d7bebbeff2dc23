"""The terminal or pipe at the error stream of `live`: one that is gone, stopped or full neither ends nor halts it."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from live_rig import PATIENCE_S, PROGRAM, ROOT, Pty, Station, Vehicle, free_port, running, until

from uavbatt.live.log import tell
from uavbatt.mavlink.links import open_link
from uavbatt.simulate.tlog_writer import heartbeat


@pytest.fixture
def vehicle() -> Iterator[Vehicle]:
    made = Vehicle(free_port())
    made.start()
    yield made
    made.is_over = True
    made.join(6.0)


def is_time_left(message: object) -> bool:
    return getattr(message, "name", "") == "REM_S" and message.value == message.value  # type: ignore[attr-defined]


def arguments(vehicle: Vehicle, station: Station) -> list[str]:
    return [f"udpin:127.0.0.1:{vehicle.to[1]}", "--gcs", f"udpout:127.0.0.1:{station.port}", "--capacity-ah", "5"]


def test_a_terminal_that_hangs_up_ends_no_flight_but_ends_the_process_after_it(vehicle: Vehicle) -> None:
    """The connection by which it was started is lost when the aircraft is out of the reach of the crew's network."""
    station = Station()
    with running(*arguments(vehicle, station)) as process:
        station.until(is_time_left)
        process.send_signal(signal.SIGHUP)
        seen = int(station.until(is_time_left).time_boot_ms)
        station.until(lambda m: is_time_left(m) and m.time_boot_ms > seen + 3000)
        assert process.poll() is None
        vehicle.is_over = True
        vehicle.join(6.0)
        landed = Vehicle(vehicle.to[1])
        until(lambda: (landed.send(heartbeat(False)), process.poll() is not None)[1])
        assert process.returncode == 0


def test_a_log_that_nobody_reads_does_not_halt_the_process(vehicle: Vehicle) -> None:
    """A pipe that is full from the start: `| less`, or a terminal stopped by Ctrl-S."""
    station, (read, write) = Station(), os.pipe()
    os.set_blocking(write, False)
    with pytest.raises(BlockingIOError):
        while True:
            os.write(write, bytes(65_536))
    os.set_blocking(write, True)
    env = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen([*PROGRAM, *arguments(vehicle, station)], stderr=write, env=env)
    try:
        assert station.until(is_time_left).value > 0.0
    finally:
        process.terminate()
        assert process.wait(PATIENCE_S) == 0
        os.close(read)
        os.close(write)


def test_what_is_told_is_one_line_without_control_bytes(capfd: pytest.CaptureFixture[str]) -> None:
    tell("a device\nof \x1b[31mtwo lines")
    assert capfd.readouterr().err == "uavbatt: a device of \N{REPLACEMENT CHARACTER}[31mtwo lines\n"


def test_a_serial_line_that_another_program_reads_is_not_read_by_two(tmp_path: Path) -> None:
    """Each would get a part of every frame, and nobody would know why half of the rows are missing."""
    line = Pty()
    first, second = open_link(f"{line.name},57600"), open_link(f"{line.name},57600")
    first.read(0.0)
    second.read(0.0)
    assert first.problem == ""
    assert second.problem == f"cannot open {line.name}: another program has it open, trying again"
    first.close()
    second.read(1.0)
    assert second.problem == ""
    second.close()
