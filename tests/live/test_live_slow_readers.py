"""Readers that are slower than what is sent to them get what is of now, and all that is said once."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import time
from collections.abc import Iterator
from typing import Any

import pytest
from daemon_bench import Bench
from live_rig import PATIENCE_S, free_port, until
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.live.clock import now_s
from uavbatt.live.config import HttpSection
from uavbatt.mavlink.endpoint import Link
from uavbatt.mavlink.links import open_link
from uavbatt.mavlink.outgoing import SEVERITY_CRITICAL, Outgoing

STEP_S = 0.25
SMALL = 1024  # of the reader's own buffer; the system makes 2304 of it


@pytest.fixture(params=["tcpin", "tcp"])
def slow(request: pytest.FixtureRequest) -> Iterator[tuple[Link, socket.socket]]:
    """A link to a ground station, and the station's end, which holds little."""
    port = free_port()
    if request.param == "tcpin":
        link, end = open_link(f"tcpin:127.0.0.1:{port}"), socket.socket()
        end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SMALL)
        end.connect(("127.0.0.1", port))
        link.read(0.0)
    else:
        server = socket.socket()
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SMALL)
        server.bind(("127.0.0.1", port))
        server.listen(1)
        link = open_link(f"tcp:127.0.0.1:{port}")
        until(lambda: (link.read(0.0), list(link.filenos()))[1])
        end, _ = server.accept()
        server.close()
    end.setblocking(False)
    yield link, end
    link.close()
    end.close()


def fly(link: Link, end: socket.socket, seconds: float, a_step: int) -> list[tuple[float, Any]]:
    """Send four named values every quarter of a second, read so many bytes meanwhile; return what came, and when."""
    out, parser, heard, at_s = Outgoing(1, 193), dialect.MAVLink(None), list[tuple[float, Any]](), 0.0
    while at_s < seconds:
        for name in ("REM_S", "REM_LO_S", "REM_HI_S", "SOC"):
            link.write(out.named_value(name, 600.0, int(1000 * at_s)), at_s)
        if at_s in (60.0, 90.0):
            link.write(out.text(SEVERITY_CRITICAL, f"Battery 0: {at_s:.0f} left at worst"), at_s)
        link.read(at_s)
        time.sleep(0.001)
        with contextlib.suppress(BlockingIOError):
            heard += [(at_s, message) for message in parser.parse_buffer(end.recv(a_step)) or []]
        at_s += STEP_S
    return heard


def test_a_station_on_a_slow_stream_gets_what_is_true_now(slow: tuple[Link, socket.socket]) -> None:
    """Half as fast as needed: after two minutes a time left was a minute old, and nothing showed it."""
    heard = fly(*slow, 120.0, 60)
    late = [at_s - m.time_boot_ms / 1000.0 for at_s, m in heard if m.get_type() == "NAMED_VALUE_FLOAT" and at_s > 30.0]
    assert len(late) > 200 and max(late) < 12.0  # of which ten are in the station's own buffer


def test_alarms_reach_a_station_on_a_slow_stream(slow: tuple[Link, socket.socket]) -> None:
    heard = fly(*slow, 120.0, 60)
    assert [m.text for _, m in heard if m.get_type() == "STATUSTEXT"] == [
        "Battery 0: 60 left at worst",
        "Battery 0: 90 left at worst",
    ]


def test_a_station_that_reads_as_fast_as_it_is_told_loses_nothing(slow: tuple[Link, socket.socket]) -> None:
    heard = fly(*slow, 60.0, 4096)
    sent = 4 * int(60.0 / STEP_S)
    assert sum(m.get_type() == "NAMED_VALUE_FLOAT" for _, m in heard) >= sent - 8  # the last ones are under way


def test_a_slow_browser_gets_events_of_now(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half as fast as needed: the page's number was as old as the system's buffers are large, with an age of 0."""
    pytest.importorskip("uvicorn")
    from uavbatt.live.feeds import web

    monkeypatch.setattr(web, "EVENT_PERIOD_S", 0.02)
    bench, port, shown = Bench(), free_port(), list[float]()
    bench.fly(30.0)
    web.serve(HttpSection(listen=f"127.0.0.1:{port}"), lambda: bench.daemon.board, now_s)
    with socket.socket() as reader:
        reader.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SMALL)
        until(lambda: not reader.connect_ex(("127.0.0.1", port)))
        reader.settimeout(PATIENCE_S)
        reader.sendall(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        data, end_s = b"", now_s() + 8.0
        while now_s() < end_s:
            data += reader.recv(300)
            while b"\r\n\r\n" in data:
                event, _, data = data.partition(b"\r\n\r\n")
                if b"data: {" in event:
                    said = event.partition(b"data: ")[2].partition(b"\r\n")[0]
                    shown.append(now_s() - json.loads(said)["clock_s"])
            time.sleep(0.02)
    assert len(shown) > 20 and shown[-1] < 2.0


@pytest.mark.parametrize("kind", ["tcp", "tcpin"])
def test_a_host_that_goes_without_a_word_is_not_waited_for(kind: str) -> None:
    """A power cut says nothing. TCP would give up after a quarter of an hour; until then no link is opened anew."""
    port = free_port()
    server = socket.create_server(("127.0.0.1", port)) if kind == "tcp" else None
    link = open_link(f"{kind}:127.0.0.1:{port}")
    other = socket.create_connection(("127.0.0.1", port)) if server is None else None
    descriptor = until(lambda: (link.read(0.0), list(link.filenos()))[1][-1:])[0]
    with socket.socket(fileno=os.dup(descriptor)) as ours:
        assert ours.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
        assert ours.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) <= 10_000  # ms
        silent_s = [ours.getsockopt(socket.IPPROTO_TCP, o) for o in (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL)]
        assert silent_s[0] + silent_s[1] * ours.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT) <= 10
    link.close()
    for end in (server, other):
        if end is not None:
            end.close()
