"""The proxy on streams: partial frames are held 20 ms at most, a client that does not read is dropped."""

from __future__ import annotations

import os
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from live_rig import PATIENCE_S, Station, Vehicle, descriptors, free_port, until
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.live import clock
from uavbatt.live.feeds import proxy, rewriter
from uavbatt.live.feeds.proxy_client import ProxyClient
from uavbatt.records import Sample
from uavbatt.simulate.tlog_writer import battery_status, heartbeat


def framed(message: Any) -> bytes:
    return bytes(message.pack(dialect.MAVLink(None, srcSystem=1, srcComponent=1)))


BATTERY = framed(battery_status(Sample(0.0, 16.0, 12.0, 25.0, 0.1), 0))
BEAT = framed(heartbeat(True))


class Around:
    """A proxy between two TCP streams, and the estimator's control line."""

    def __init__(self, folder: Path) -> None:
        fc, gcs, control = free_port(), free_port(), str(folder / "control.sock")
        settings = proxy.ProxySettings(f"tcpin:127.0.0.1:{fc}", [f"tcpin:127.0.0.1:{gcs}"], control)
        command = [sys.executable, "-m", "uavbatt.live.feeds.proxy", proxy.json.dumps(settings._asdict())]
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        self.vehicle, self.station = self._connected(fc), self._connected(gcs)
        self.gcs_port = gcs
        self.control = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        until(lambda: self.control.connect_ex(control) == 0)  # it may be bound and not listen yet
        self.control.settimeout(PATIENCE_S)
        self.station.sendall(b"hello")
        assert self.vehicle.recv(100) == b"hello"  # both are in

    def _connected(self, port: int) -> socket.socket:
        for _ in range(100):
            try:
                made = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
                made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                return made
            except ConnectionRefusedError:
                time.sleep(0.05)
        raise AssertionError("the proxy does not listen")

    def tell(self, remaining_s: float) -> None:
        body = struct.pack(rewriter.ESTIMATE_LAYOUT, 1, 1, 0, rewriter.OK, remaining_s, 0.5, clock.now_s())
        self.control.sendall(proxy.message(proxy.ESTIMATE, body))
        time.sleep(0.1)

    def seen(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            data += self.station.recv(size - len(data))
        return data


@pytest.fixture
def around(tmp_path: Path) -> Iterator[Around]:
    made = Around(tmp_path)
    yield made
    made.process.terminate()
    made.process.wait(PATIENCE_S)


def rewritten(around: Around) -> bool:
    """Send a frame in two parts and one behind it; True if it came out with our time, False if as it was."""
    around.vehicle.sendall(BATTERY[:15])
    time.sleep(0.002)
    around.vehicle.sendall(BATTERY[15:] + BEAT)
    head = around.seen(12)
    frame = head + around.seen(38 if head[1] == 38 else len(BATTERY) - 12)  # 321 s: 38 bytes, zeros behind it trimmed
    assert around.seen(len(BEAT)) == BEAT
    if frame == BATTERY:
        return False
    assert dialect.MAVLink(None).decode(bytearray(frame)).time_remaining == 321
    return True


def test_a_frame_in_two_parts_is_rewritten_and_a_lonely_part_is_not_held(around: Around) -> None:
    around.tell(321.5)
    until(lambda: rewritten(around))  # on a busy machine the second part may come after the 20 ms that are waited
    around.vehicle.sendall(BATTERY[:15])
    assert around.seen(15) == BATTERY[:15]
    around.vehicle.sendall(BATTERY[15:] + BEAT)
    assert around.seen(len(BATTERY) - 15 + len(BEAT)) == BATTERY[15:] + BEAT


def test_an_autopilots_own_time_that_is_replaced_is_logged(around: Around) -> None:
    own = framed(dialect.MAVLink_battery_status_message(0, 0, 0, 2500, [16000] + [65535] * 9, 1200, 1, 1, 80, 700, 1))
    around.tell(321.5)
    around.vehicle.sendall(own)
    frame = around.seen(len(own))
    assert dialect.MAVLink(None).decode(bytearray(frame)).time_remaining == 321
    assert around.process.stderr is not None
    assert around.process.stderr.readline().endswith("battery 0: its own 700 s replaced by 321 s\n")


def test_the_estimator_hears_the_original_and_cannot_speak_to_the_autopilot(around: Around) -> None:
    around.tell(100.0)
    around.vehicle.sendall(BATTERY)
    messages, told = proxy.Messages(), []
    while not told:
        told = messages.feed(around.control.recv(4096))
    assert told == [(proxy.TELEMETRY, BATTERY)]
    around.control.sendall(proxy.message(proxy.TO_AUTOPILOT, BEAT) + proxy.message(proxy.TO_GCS, BEAT))
    assert around.seen(12 + 37)[0] == 0xFD and around.seen(len(BEAT)) == BEAT
    around.vehicle.settimeout(0.3)
    with pytest.raises(TimeoutError):
        around.vehicle.recv(10)


def test_a_client_that_does_not_read_is_dropped_and_nobody_waits(around: Around) -> None:
    before = len(descriptors(around.process.pid))
    with socket.create_connection(("127.0.0.1", around.gcs_port)):
        until(lambda: len(descriptors(around.process.pid)) > before)
        block = bytes(10_000)  # no frame at all passes as well

        def is_dropped() -> bool:
            around.vehicle.sendall(block)
            assert around.seen(len(block)) == block
            return len(descriptors(around.process.pid)) == before

        until(is_dropped)


def test_a_proxy_that_is_killed_is_started_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the estimator, which then hears the autopilot through the new one."""
    monkeypatch.setattr(os, "nice", lambda step: 0)  # the tests are not made to wait
    vehicle, station = Vehicle(free_port()), Station()
    endpoints = (f"udpin:127.0.0.1:{vehicle.to[1]}", [f"udpout:127.0.0.1:{station.port}"])
    client = ProxyClient(proxy.ProxySettings(*endpoints, str(tmp_path / "control.sock")))
    vehicle.start()

    def heard() -> int:
        client.read(time.monotonic())
        return client.pid

    try:
        first = until(heard)
        station.until(lambda m: m.get_type() == "BATTERY_STATUS")
        os.kill(first, signal.SIGKILL)
        second = until(lambda: heard() if heard() != first else 0)
        station.line.settimeout(0.01)
        assert second and until(lambda: client.read(time.monotonic()))
        station.until(lambda m: m.get_type() == "BATTERY_STATUS")
    finally:
        vehicle.is_over = True
        client.stop()
