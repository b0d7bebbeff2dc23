"""F4b, F11: many who connect and want nothing end no process, and keep neither the autopilot nor the user out."""

from __future__ import annotations

import json
import resource
import socket
import sys
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from daemon_bench import Bench
from live_rig import (
    PATIENCE_S,
    Station,
    StreamVehicle,
    Vehicle,
    connecting,
    descriptors,
    free_port,
    listening,
    running,
    until,
)

from uavbatt.live.config import HttpSection
from uavbatt.mavlink.links import open_autopilot, open_link
from uavbatt.mavlink.tcp_server import MOST_CLIENTS, QUIET_S

MANY = 1100
ROOM = 2 * MANY  # descriptors

FULL = f"""
import os, resource, sys
resource.setrlimit(resource.RLIMIT_NOFILE, ({ROOM}, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
null = os.open(os.devnull, os.O_RDWR)
os.set_inheritable(null, True)
for number in range(3, {MANY}):
    os.dup2(null, number, inheritable=True) if number != null else None
"""
LIVE = [sys.executable, "-c", FULL + "from uavbatt.cli import main; main()", "live"]
PROXY = [sys.executable, "-c", FULL + "import runpy; runpy.run_module('uavbatt.live.feeds.proxy', run_name='__main__')"]


@pytest.fixture
def room() -> Iterator[None]:
    """Descriptors enough for this process and its children."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < ROOM:
        pytest.skip(f"this system allows {hard} descriptors, {ROOM} are needed")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, ROOM), hard))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.fixture
def streaming() -> Iterator[tuple[StreamVehicle, int]]:
    """A vehicle that is called by TCP, and its port."""
    port = free_port()
    made = StreamVehicle(listening(port))
    made.start()
    yield made, port
    made.is_over = True
    made.join(0.5)


def is_time_left(message: Any) -> bool:
    return message.get_type() == "NAMED_VALUE_FLOAT" and message.name == "REM_S" and message.value > 60


def now(port: int) -> dict[str, Any]:
    """What the page knows, asked by a new connection; empty when it does not answer."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/now.json", timeout=PATIENCE_S) as answer:
            return dict(json.load(answer))
    except OSError:
        return {}


@pytest.mark.parametrize("feed", [pytest.param("named", marks=pytest.mark.slow), "proxy"])  # the second has both feeds
def test_a_process_whose_descriptors_are_above_1023_flies_on(
    room: None, vehicle: Vehicle, tmp_path: Path, feed: str
) -> None:
    station = Station()
    where = [f"udpin:127.0.0.1:{vehicle.to[1]}", "--gcs", f"udpout:127.0.0.1:{station.port}", "--capacity-ah", "5"]
    with running(*where, "--feed", "named", "--feed", feed, program=LIVE, XDG_RUNTIME_DIR=str(tmp_path)) as process:
        station.until(is_time_left)
        assert max(descriptors(process.pid)) >= MANY and process.poll() is None


def test_a_proxy_whose_descriptors_are_above_1023_passes_on(room: None, vehicle: Vehicle, tmp_path: Path) -> None:
    station = Station()
    settings = {"autopilot": f"udpin:127.0.0.1:{vehicle.to[1]}", "gcs": [f"udpout:127.0.0.1:{station.port}"]}
    with running(json.dumps(settings | {"control": str(tmp_path / "c.sock")}), program=PROXY) as process:
        station.until(lambda m: m.get_type() == "BATTERY_STATUS")
        assert max(descriptors(process.pid)) >= MANY and process.poll() is None


def test_1100_idle_connections_end_nothing_and_leave_room_for_the_user(
    room: None, streaming: tuple[StreamVehicle, int]
) -> None:
    """Half of them send half a header. The link drops, more come, the link returns."""
    pytest.importorskip("uvicorn")
    vehicle, endpoint = streaming
    port = free_port()
    arguments = [f"tcp:127.0.0.1:{endpoint}", "--capacity-ah", "5", "--http", f"127.0.0.1:{port}"]

    def rows() -> int:
        return int(now(port).get("counts", {}).get("rows", 0))

    with running(*arguments) as process, ExitStack() as crowd:

        def comes(number: int) -> None:
            line = crowd.enter_context(socket.create_connection(("127.0.0.1", port), 10.0))
            if number % 2:
                line.sendall(b"GET /now.json HTTP/1.1\r\nHost: x\r\n")

        until(rows)
        for number in range(MANY):
            comes(number)
        before, broken = rows(), vehicle.end
        broken.shutdown(socket.SHUT_RDWR)
        for number in range(20):
            comes(number)
        until(lambda: vehicle.end not in (None, broken))
        until(lambda: rows() > before + 10)
        assert process.poll() is None and len(descriptors(process.pid)) < 200


def test_who_sends_half_a_header_is_sent_away_and_who_asked_for_a_stream_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("uvicorn")
    from uavbatt.live.feeds import connections, web

    monkeypatch.setattr(connections, "REQUEST_WITHIN_S", 1.0)
    monkeypatch.setattr(connections, "LOOK_PERIOD_S", 0.1)
    bench, port = Bench(), free_port()
    bench.fly(3.0)
    web.serve(HttpSection(listen=f"127.0.0.1:{port}"), lambda: bench.daemon.board, lambda: bench.now_s)
    until(lambda: now(port))

    def said(text: bytes) -> socket.socket:
        line = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
        line.sendall(text)
        return line

    stream = said(b"GET /events HTTP/1.1\r\nHost: x\r\n\r\n")
    slow = said(b"GET /now.json HTTP/1.1\r\n")
    slow.setblocking(False)
    dribbled = 0

    def is_gone() -> bool:
        nonlocal dribbled
        try:
            slow.sendall(b"x")
            dribbled += 1
            return slow.recv(1) == b""
        except BlockingIOError:
            return False
        except OSError:
            return True

    until(is_gone)
    assert dribbled > 3  # it went on saying something
    heard = b""
    while heard.count(b"data: ") < 8:  # more than it was sent until then
        more = stream.recv(4096)
        assert more
        heard += more
    stream.close()


def test_silent_clients_do_not_keep_the_autopilot_out_of_tcpin() -> None:
    """More than the table holds connect and say nothing; then the vehicle comes, and then as many again."""
    port, station = free_port(), Station()
    vehicle = StreamVehicle(connecting(port))
    arguments = [f"tcpin:127.0.0.1:{port}", "--gcs", f"udpout:127.0.0.1:{station.port}", "--capacity-ah", "5"]
    with running(*arguments) as process, ExitStack() as crowd:
        until(lambda: reached(port, crowd))
        for _ in range(2 * MOST_CLIENTS):
            reached(port, crowd)
        vehicle.start()
        station.until(is_time_left)
        first = vehicle.end
        for _ in range(2 * MOST_CLIENTS):
            reached(port, crowd)
        station.until(is_time_left)
        vehicle.is_over = True
        vehicle.join(6.0)
        assert vehicle.end is first and process.poll() is None


def reached(port: int, crowd: ExitStack) -> bool:
    """One more client that says nothing."""
    try:
        crowd.enter_context(socket.create_connection(("127.0.0.1", port), PATIENCE_S))
    except OSError:
        return False
    return True


def has(link: Any, client: socket.socket, now_s: float) -> bool:
    """Whether the client is still connected."""
    link.read(now_s)
    client.settimeout(0.05)
    try:
        return client.recv(1) != b""
    except TimeoutError:
        return True
    except OSError:
        return False


@pytest.mark.parametrize(("opened", "is_kept"), [(open_autopilot, False), (open_link, True)])
def test_a_client_that_never_speaks_is_sent_away_where_an_autopilot_is_expected(opened: Any, is_kept: bool) -> None:
    """A ground station may only listen, and an autopilot that has spoken may be silent."""
    port = free_port()
    link, where = opened(f"tcpin:127.0.0.1:{port}"), ("127.0.0.1", port)
    with socket.create_connection(where) as silent, socket.create_connection(where) as talks:
        link.read(0.0)
        talks.sendall(b"x")
        assert link.read(0.1)
        assert has(link, silent, 59.0)
        assert has(link, silent, 61.0) is is_kept
        assert has(link, talks, 3600.0)
    link.close()


def test_in_a_full_table_who_speaks_keeps_the_place() -> None:
    port = free_port()
    link = open_link(f"tcpin:127.0.0.1:{port}")
    with ExitStack() as crowd:

        def comes(now_s: float) -> socket.socket:
            made = crowd.enter_context(socket.create_connection(("127.0.0.1", port), PATIENCE_S))
            link.read(now_s)
            return made

        clients = [comes(0.0) for _ in range(MOST_CLIENTS)]
        for client in clients[1:]:
            client.sendall(b"x")
        assert len(link.read(10.0)) == MOST_CLIENTS - 1
        second = comes(10.0)  # in the place of the only one that never spoke
        assert has(link, second, 10.0) and not has(link, clients[0], 10.0)
        second.sendall(b"x")
        assert link.read(10.0)
        assert not has(link, comes(10.0), 10.0)  # all have spoken just now
        for client in clients[2:]:
            client.sendall(b"x")
        assert len(link.read(11.0 + QUIET_S)) == MOST_CLIENTS - 2
        assert has(link, comes(11.0 + QUIET_S), 11.0 + QUIET_S)
        assert not has(link, clients[1], 11.0 + QUIET_S) and has(link, clients[2], 11.0 + QUIET_S)
    link.close()
