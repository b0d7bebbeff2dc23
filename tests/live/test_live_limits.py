"""F18: flapping bits, crash loops, many senders and slow resolvers: what others do without meaning a battery."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
from daemon_bench import Bench
from live_rig import PATIENCE_S, free_port, until
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.live.config import RecordSection
from uavbatt.live.feeds import proxy
from uavbatt.mavlink.links import MOST_PEERS, open_link
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.records import Sample
from uavbatt.simulate.tlog_writer import battery_status, heartbeat
from uavbatt.telemetry import read_log

SELDOM = ForecastSettings(forecast_period_s=30.0)  # what is recorded does not hang on forecasts


def turns(bench: Bench, armed: bool, seconds: float) -> None:
    for k in range(int(2 * seconds)):
        bench.send(heartbeat(armed))
        bench.send(battery_status(Sample(0.0, 16.0, 12.0, 25.0, 0.1 + k / 600), 0))
        bench.daemon.turn()
        bench.now_s += 0.5


def earlier_flights(folder: Path, number: int) -> set[str]:
    """Recordings of an hour each, years ago."""
    for k in range(number):
        path = folder / f"uavbatt-20250101-{k:02d}0000.tlog"
        begun_s = 1.6e9 + 10_000 * k
        path.write_bytes(int(begun_s * 1e6).to_bytes(8, "big") + b"frames")
        os.utime(path, (begun_s + 3600.0, begun_s + 3600.0))
    return {path.name for path in folder.glob("*.tlog")}


def test_a_flapping_armed_bit_is_one_recording(tmp_path: Path) -> None:
    flights = earlier_flights(tmp_path, 5)
    settings = RecordSection(folder=str(tmp_path), when="while-armed", max_files=6, min_free_MB=0.0)
    bench = Bench(record=settings, settings=SELDOM)
    for k in range(60):
        turns(bench, k % 2 == 0, 2.0)
    turns(bench, True, 5.0)
    bench.daemon.close()
    made = {path.name for path in tmp_path.glob("*.tlog")} - flights
    assert len(made) == 1 and flights <= {path.name for path in tmp_path.glob("*.tlog")}
    samples = read_log(tmp_path / made.pop()).samples
    assert all(sample.armed for sample in samples) and samples[-1].time_s == pytest.approx(124.5, abs=0.6)


@pytest.mark.parametrize("is_heard", [True, False])
def test_a_landing_of_minutes_ends_a_recording(tmp_path: Path, is_heard: bool) -> None:
    record = RecordSection(folder=str(tmp_path), when="while-armed", min_free_MB=0.0)
    bench = Bench(record=record, settings=SELDOM)
    turns(bench, True, 10.0)
    turns(bench, False, 130.0 if is_heard else 2.0)
    bench.now_s += 0.0 if is_heard else 130.0
    turns(bench, True, 10.0)
    bench.daemon.close()
    assert len(list(tmp_path.glob("*.tlog"))) == 2


def test_a_crash_loop_pushes_out_one_flight_at_most(tmp_path: Path) -> None:
    flights = earlier_flights(tmp_path, 6)
    for k in range(12):
        bench = Bench(record=RecordSection(folder=str(tmp_path), max_files=6, min_free_MB=0.0), start_s=5.0 * k)
        bench.fly(1.0)
        bench.daemon.close()
        begun_s = bench.wall_offset_s + 5.0 * k
        for path in tmp_path.glob("uavbatt-2*.tlog"):
            if path.name not in flights and path.stat().st_mtime > begun_s + 3600.0:
                os.utime(path, (begun_s + 1.0, begun_s + 1.0))
    there = {path.name for path in tmp_path.glob("*.tlog")}
    assert len(there) == 6 and len(flights & there) == 5


@contextmanager
def listening() -> Iterator[tuple[Any, int]]:
    port = free_port()
    with closing(open_link(f"udpin:127.0.0.1:{port}")) as link:
        yield link, port


def crowd(link: Any, port: int, number: int) -> None:
    """Datagrams of so many sockets, one each."""
    lines = []
    for _ in range(number):
        line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        line.sendto(b"hello", ("127.0.0.1", port))
        lines.append(line)
    heard = 0
    while heard < number:
        heard += len(link.read(1.0))
    for line in lines:
        line.close()


@pytest.mark.parametrize("crowd_first", [True, False])
def test_many_senders_do_not_push_the_autopilot_out(crowd_first: bool) -> None:
    """More senders than places between two frames of the autopilot: a command still reaches it."""
    with listening() as (link, port), closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as autopilot:
        autopilot.settimeout(PATIENCE_S)
        if crowd_first:
            crowd(link, port, 2 * MOST_PEERS)
        for _ in range(5):
            autopilot.sendto(b"telemetry", ("127.0.0.1", port))
            until(lambda: link.read(1.0))
        crowd(link, port, 3 * MOST_PEERS)
        link.write(b"command", 1.0)
        assert autopilot.recv(100) == b"command"
        assert len(link._peers) == MOST_PEERS


def test_the_proxy_reaches_the_autopilot_past_many_senders(tmp_path: Path) -> None:
    port, station_port = free_port(), free_port()
    settings = proxy.ProxySettings(f"udpin:127.0.0.1:{port}", [f"udpin:127.0.0.1:{station_port}"], str(tmp_path / "c"))
    served = proxy.Proxy(settings)
    autopilot, station = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    frame = bytes(heartbeat(True).pack(dialect.MAVLink(None, srcSystem=1, srcComponent=1)))
    with closing(served), closing(autopilot), closing(station):
        for line in (autopilot, station):
            line.settimeout(PATIENCE_S)
        for _ in range(3):
            autopilot.sendto(frame, ("127.0.0.1", port))
            served.turn(0.0)
        crowd_lines = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(40)]
        for line in crowd_lines:
            line.sendto(frame, ("127.0.0.1", port))
            served.turn(0.0)
        station.sendto(b"command", ("127.0.0.1", station_port))
        until(lambda: (served.turn(0.0), _has(autopilot))[1])
        assert autopilot.recv(100) == b"command"
        for line in crowd_lines:
            line.close()


def _has(line: socket.socket) -> bool:
    try:
        return bool(line.recv(100, socket.MSG_PEEK | socket.MSG_DONTWAIT))
    except BlockingIOError:
        return False


def test_a_slow_resolver_does_not_hold_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """While the name is looked for the loop turns; once found it connects, and a name that is none is tried again."""
    answered, looked = threading.Event(), []

    def slow(host: str, *_: object, **__: object) -> list[tuple[object, ...]]:
        looked.append(host)
        answered.wait(PATIENCE_S)
        if len(looked) == 1:
            raise socket.gaierror(socket.EAI_AGAIN, "try again")
        return [(socket.AF_INET6, 2, 17, "", ("::1", 0, 0, 0)), (socket.AF_INET, 2, 17, "", ("127.0.0.1", 0))]

    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        monkeypatch.setattr(socket, "getaddrinfo", slow)
        link, now_s = open_link(f"tcp:drone.example:{server.getsockname()[1]}"), [0.0]
        until(lambda: (link.read(now_s[0]), looked)[1])
        for _ in range(1000):
            assert link.read(now_s[0]) == []
        assert looked == ["drone.example"]
        answered.set()

        def turned() -> bool:
            now_s[0] += 0.05
            link.read(now_s[0])
            return bool(list(link.filenos()))

        until(turned)
        assert len(looked) == 2
        server.accept()[0].close()
        link.close()
