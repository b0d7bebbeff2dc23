"""What the tests of the companion process share besides scripts/daemon_bench.py: vehicles, stations, processes."""

from __future__ import annotations

import os
import pty
import socket
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.records import Sample
from uavbatt.simulate.tlog_writer import battery_status, heartbeat

ROOT = Path(__file__).resolve().parents[1]
PATIENCE_S = 60.0  # until a test gives up: a busy machine is late, and late is not wrong
PROGRAM = [sys.executable, "-c", "from uavbatt.cli import main; main()", "live"]


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Vehicle(threading.Thread):
    """A quad over UDP: heartbeat, BATTERY_STATUS at 10 Hz, answers to PARAM_REQUEST_READ; keeps what it was sent."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self.line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.line.setblocking(False)
        self.to = ("127.0.0.1", port)
        self.is_over, self.heard, self.raw = False, [], b""
        self._link: Any = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        self._parser: Any = dialect.MAVLink(None)

    def run(self) -> None:
        k, drawn_Ah = 0, 0.0
        while not self.is_over:
            drawn_Ah += 12.0 * 0.1 / 3600.0
            if k % 10 == 0:
                self.send(heartbeat(True))
            self.send(battery_status(Sample(0.0, 16.0 - drawn_Ah / 2, 12.0, 25.0, drawn_Ah, 0.9, True), 0))
            k += 1
            time.sleep(0.1)
            self.listen()
        self.line.close()

    def send(self, message: Any) -> None:
        self.write(bytes(message.pack(self._link)))
        self._link.seq = (self._link.seq + 1) % 256

    def write(self, data: bytes) -> None:
        self.line.sendto(data, self.to)

    def read(self) -> bytes:
        """What has come in; empty when nothing."""
        try:
            return self.line.recv(4096)
        except (BlockingIOError, ConnectionRefusedError):
            return b""

    def listen(self) -> None:
        while data := self.read():
            self.raw += data
            for message in self._parser.parse_buffer(data) or []:
                self.heard.append(message)
                if message.get_type() == "PARAM_REQUEST_READ" and message.param_id == "BATT_CAPACITY":
                    self.send(dialect.MAVLink_param_value_message(b"BATT_CAPACITY", 5200.0, 9, 1, 0))


class StreamVehicle(Vehicle):
    """The same quad at a stream; `reopen` gives its end, again when it has broken off."""

    def __init__(self, reopen: Callable[[], Any]) -> None:
        super().__init__(0)
        self._reopen, self.end = reopen, None

    def write(self, data: bytes) -> None:
        try:
            self.end = self.end or self._reopen()
            self.end.sendall(data)
        except OSError:
            self.end = None

    def read(self) -> bytes:
        try:
            return self.end.recv(4096) if self.end is not None else b""
        except OSError:
            return b""


def listening(port: int) -> Callable[[], socket.socket]:
    server = socket.create_server(("127.0.0.1", port))
    server.settimeout(PATIENCE_S)

    def accept() -> socket.socket:
        made, _ = server.accept()
        made.setblocking(False)
        return made

    return accept


def connecting(port: int) -> Callable[[], socket.socket]:
    def connect() -> socket.socket:
        made = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
        made.setblocking(False)
        return made

    return connect


class Pty:
    """The vehicle's end of a serial line that is none."""

    def __init__(self) -> None:
        self.fd, self._line = pty.openpty()
        tty.setraw(self.fd)
        os.set_blocking(self.fd, False)
        self.name = os.ttyname(self._line)

    def sendall(self, data: bytes) -> None:
        os.write(self.fd, data)

    def recv(self, size: int) -> bytes:
        return os.read(self.fd, size)


class Station:
    """A ground station that listens on UDP."""

    def __init__(self) -> None:
        self.line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.line.bind(("127.0.0.1", 0))
        self.line.settimeout(0.2)
        self.port = int(self.line.getsockname()[1])
        self._parser: Any = dialect.MAVLink(None)
        self.peer: Any = None
        self.sequence: list[int] = []  # of the autopilot's frames
        self.named: dict[str, float] = {}

    def until(self, wanted: Callable[[Any], bool]) -> Any:
        """The first message that is wanted."""
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            try:
                data, self.peer = self.line.recvfrom(4096)
            except TimeoutError:
                continue
            for message in self._parser.parse_buffer(data) or []:
                if message.get_srcComponent() == 1:
                    self.sequence.append(message.get_seq())
                if message.get_type() == "NAMED_VALUE_FLOAT":
                    self.named[message.name] = message.value
                if wanted(message):
                    return message
        raise AssertionError(f"nothing of the kind in {PATIENCE_S} s")


@contextmanager
def running(*arguments: str, program: Sequence[str] = PROGRAM, **environment: str) -> Iterator[subprocess.Popen[str]]:
    """`uavbatt live` (or another program) with these arguments; ended with the block."""
    env = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT), **environment}
    process = subprocess.Popen([*program, *arguments], stderr=subprocess.PIPE, text=True, env=env)
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(PATIENCE_S)
        finally:
            process.kill()


@contextmanager
def manager_at(path: Path) -> Iterator[list[bytes]]:
    """A service manager's socket; the list fills with what it is told."""
    told: list[bytes] = []
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.bind(str(path))

        def listen() -> None:
            while not told or told[-1] != b"end":
                told.append(line.recv(4096))

        thread = threading.Thread(target=listen, daemon=True)
        thread.start()
        yield told
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
            end.sendto(b"end", str(path))
        thread.join(PATIENCE_S)


def descriptors(pid: int) -> list[int]:
    """The open descriptors of a process."""
    return [int(name) for name in os.listdir(f"/proc/{pid}/fd")]


def until(condition: Callable[[], Any]) -> Any:
    """The first true value of `condition`, asked every 50 ms."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        if value := condition():
            return value
        time.sleep(0.05)
    raise AssertionError(f"not within {PATIENCE_S} s")
