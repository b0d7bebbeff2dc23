"""Every kind of endpoint with a vehicle at its other end; signed frames; who may read the page."""

from __future__ import annotations

import itertools
import os
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from typing import Any

import pytest
from daemon_bench import OPTIONS, Bench, FakeLink
from live_rig import PATIENCE_S, ROOT, Pty, StreamVehicle, Vehicle, connecting, free_port, listening, until
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.battery import battery_file
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.errors import BadInput, UsageError
from uavbatt.live.config import Config, FeedSection, HttpSection, LinkSection, checked
from uavbatt.live.daemon import Daemon
from uavbatt.live.feeds.web import serve
from uavbatt.mavlink.endpoint import Link, parse
from uavbatt.mavlink.links import open_link
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.telemetry import read_log

KEY = bytes(range(32))


class CalledVehicle(Vehicle):
    """The same quad on UDP, but it waits to be called: the far end of a `udpout`."""

    def __init__(self, port: int) -> None:
        super().__init__(port)
        self.line.bind(self.to)
        self.caller: Any = None

    def write(self, data: bytes) -> None:
        if self.caller is not None:
            self.line.sendto(data, self.caller)

    def read(self) -> bytes:
        try:
            data, self.caller = self.line.recvfrom(4096)
        except (BlockingIOError, ConnectionRefusedError):
            return b""
        return data


def at(kind: str) -> tuple[str, StreamVehicle | Vehicle]:
    """An endpoint of this kind, and the vehicle at its other end."""
    port = free_port()
    if kind == "serial":
        line = Pty()
        return f"{line.name},115200", StreamVehicle(lambda: line)
    if kind == "tcp":
        return f"tcp:127.0.0.1:{port}", StreamVehicle(listening(port))
    if kind == "tcpin":
        return f"tcpin:127.0.0.1:{port}", StreamVehicle(connecting(port))
    return f"{kind}:127.0.0.1:{port}", CalledVehicle(port) if kind == "udpout" else Vehicle(port)


@pytest.fixture
def flown(request: pytest.FixtureRequest) -> Iterator[tuple[Daemon, Any]]:
    """A daemon at a real link of the kind asked for, and its vehicle."""
    endpoint, vehicle = at(request.param)
    station = FakeLink()
    daemon = Daemon(
        Config(link=LinkSection(endpoint=endpoint, gcs=["x"])), battery_file.read_battery("lipo-generic"),
        OPTIONS, ForecastSettings(),
        open_link(endpoint), [station],
    )  # fmt: skip
    vehicle.start()
    yield daemon, vehicle
    vehicle.is_over = True
    vehicle.join(6.0)
    daemon.close()


def rows(daemon: Daemon) -> int:
    daemon.turn()
    return int(daemon.board.counts.get("rows", 0))


@pytest.mark.parametrize("flown", ["udpin", "udpout", "tcp", "tcpin", "serial"], indirect=True)
def test_every_kind_of_endpoint_brings_rows_and_takes_a_heartbeat(flown: tuple[Daemon, Any]) -> None:
    daemon, vehicle = flown
    until(lambda: rows(daemon) >= 5)
    until(lambda: (daemon.turn(), vehicle.heard)[1])
    assert {m.get_type() for m in vehicle.heard} == {"HEARTBEAT"}
    assert daemon.board.reports[0].estimate.current_A == 12.0


def both_ways(one: Link, other: Link) -> tuple[bytes, bytes]:
    """What two ends hear of each other, the first one to speak first."""
    at_s, heard, answered = itertools.count(100.0), b"", b""

    def spoken() -> bool:
        nonlocal heard, answered
        one.write(b"hello", next(at_s))
        heard += b"".join(data for data, _ in other.read(next(at_s)))
        if heard:
            other.write(b"answer", next(at_s))
        answered += b"".join(data for data, _ in one.read(next(at_s)))
        return bool(answered)

    until(spoken)
    one.close()
    other.close()
    return heard[:5], answered[:6]


@pytest.mark.parametrize(("calls", "waits"), [("udpout", "udpin"), ("tcp", "tcpin")])
@pytest.mark.parametrize(("host", "place"), [("[::1]", "[::1]"), ("[::1]", "[::]"), ("127.0.0.1", "[::]")])
def test_an_address_of_ipv6_stands_in_brackets(calls: str, waits: str, host: str, place: str) -> None:
    if not socket.has_dualstack_ipv6():
        pytest.skip("no IPv6 on this machine")
    port = free_port()
    waiting = open_link(f"{waits}:{place}:{port}")
    assert both_ways(open_link(f"{calls}:{host}:{port}"), waiting) == (b"hello", b"answer")


@pytest.mark.parametrize("text", ["udpin:::1:14550", "tcp:[::1:14550", "udpin:[127.0.0.1]:14550"])
def test_an_address_whose_port_is_a_guess_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match=r"expected udpin:HOST:PORT.*stands in brackets"):
        parse(text)


@pytest.mark.parametrize(("ours", "theirs"), [("udpin", "udpout"), ("tcpin", "tcp"), ("tcp", "tcpin")])
def test_a_log_that_is_played_on_a_socket_gives_its_rows(ours: str, theirs: str) -> None:
    """scripts/play_tlog.py as the vehicle: a minute of the sample log at twentyfold speed."""
    port, station = free_port(), FakeLink()
    log = ROOT / "logs/quad_4s.tlog"
    link = open_link(f"{ours}:127.0.0.1:{port}")
    settings = Config(link=LinkSection(endpoint="x", gcs=["y"]))
    daemon = Daemon(
        settings, battery_file.read_battery("lipo-generic"), PackOptions(), ForecastSettings(), link, [station]
    )
    command = [sys.executable, str(ROOT / "scripts/play_tlog.py"), str(log), f"{theirs}:127.0.0.1:{port}"]
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    player = subprocess.Popen([*command, "--speed", "20", "--seconds", "60"], env=env)
    wanted = [s.voltage_V for s in read_log(log).samples if s.time_s <= 60.0]
    seen: list[float] = []
    step = daemon._step
    daemon._step = lambda row, *at: (seen.append(row.sample.voltage_V), step(row, *at))[1]  # type: ignore[method-assign]
    try:
        until(lambda: (daemon.turn(), len(seen) >= 0.6 * len(wanted))[1])
    finally:
        player.terminate()
        player.wait(PATIENCE_S)
        daemon.close()
    begins = range(len(wanted)) if ours == "tcp" else [0]  # before the connection it plays to nobody
    assert any(seen == wanted[k : k + len(seen)] for k in begins)
    assert ours == "tcp" or daemon._reader.parameters["BATT_CAPACITY"] == 5000.0
    assert daemon.board.reports[0].battery == "lipo-generic"


@pytest.mark.parametrize("flown", ["tcp", "tcpin"], indirect=True)
def test_a_broken_stream_is_opened_again(flown: tuple[Daemon, Any]) -> None:
    daemon, vehicle = flown
    before = until(lambda: rows(daemon) if rows(daemon) >= 3 else 0)
    vehicle.end.shutdown(socket.SHUT_RDWR)
    until(lambda: rows(daemon) >= before + 5)


def test_a_peer_that_is_not_there_is_tried_with_growing_pauses() -> None:
    link, tried = open_link(f"tcp:127.0.0.1:{free_port()}"), []
    connected = link._connected  # type: ignore[attr-defined]
    link._connected = lambda now_s: (tried.append(now_s), connected(now_s))[1]  # type: ignore[attr-defined]
    for k in range(3000):
        link.read(k / 50.0)
    pauses = [b - a for a, b in itertools.pairwise(tried) if b - a > 0.1]
    assert pauses[0] == pytest.approx(0.5, abs=0.1) and max(pauses) == pytest.approx(10.0, abs=0.2)
    link.close()


def test_a_serial_line_that_is_none_is_said_or_waited_for(tmp_path: Any) -> None:
    with pytest.raises(UsageError, match="expected udpin"):
        parse("ttyACM0")
    line = open_link(str(tmp_path / "ttyACM0") + ",115200")
    assert line.read(0.0) == []
    (tmp_path / "ttyACM1").write_text("a file")
    assert open_link(str(tmp_path / "ttyACM1") + ",115200").read(0.0) == []


def verified(frames: list[bytes], key: bytes) -> list[Any]:
    """The messages, each signature checked as a receiver does it."""
    reader = dialect.MAVLink(None)
    reader.signing.secret_key = key
    return [reader.decode(bytearray(frame)) for frame in frames]


def test_our_frames_are_signed_with_the_key_at_the_time_of_the_clock(tmp_path: Any) -> None:
    path = tmp_path / "key"
    path.write_text(KEY.hex() + "\n")
    link = LinkSection(endpoint="x", gcs=["y"], request=True, signing_key_file=str(path))
    bench = Bench(link=link, feed=FeedSection(kinds=("named", "battery")))
    bench.fly(8.0)
    sent = [m for frames in (bench.link.sent, bench.station.sent) for m in verified(frames, KEY)]
    assert {"HEARTBEAT", "COMMAND_LONG", "NAMED_VALUE_FLOAT", "BATTERY_STATUS"} <= {m.get_type() for m in sent}
    stamps = [int.from_bytes(d[-12:-6], "little") for d in bench.station.sent if d[6] == 193]
    assert stamps == sorted(set(stamps))  # no frame may be sent again by somebody else
    assert stamps[-1] / 1e5 + 1_420_070_400 == pytest.approx(time.time(), abs=30.0)
    with pytest.raises(dialect.MAVError, match="signature"):
        verified(bench.station.sent, KEY[::-1])


def test_a_vehicle_that_signs_is_heard() -> None:
    bench = Bench()
    bench._out.signing.secret_key, bench._out.signing.sign_outgoing = KEY, True
    bench.fly(3.0)
    assert bench.daemon.board.counts["rows"] == 15 and bench.daemon.board.counts["bad_checksums"] == 0


@pytest.mark.parametrize("text", ["", "00", "zz" * 32, None])
def test_a_key_that_is_none_is_refused(tmp_path: Any, text: str | None) -> None:
    path = tmp_path / "key"
    if text is not None:
        path.write_text(text)
    with pytest.raises(BadInput, match="64 hexadecimal digits"):
        Bench(link=LinkSection(endpoint="x", gcs=["y"], signing_key_file=str(path)))


def test_the_page_is_read_with_the_token_only() -> None:
    pytest.importorskip("starlette")
    pytest.importorskip("uvicorn")
    bench, port = Bench(), free_port()
    bench.fly(3.0)
    settings = HttpSection(listen=f"0.0.0.0:{port}", token="correct horse")
    serve(settings, lambda: bench.daemon.board, lambda: bench.now_s)

    def asked(path: str, **headers: str) -> int:
        request = urllib.request.Request(f"http://127.0.0.1:{port}{path}", headers=headers)
        try:
            return int(urllib.request.urlopen(request, timeout=PATIENCE_S).status)
        except urllib.error.HTTPError as error:
            return error.code
        except urllib.error.URLError:
            return 0

    until(lambda: asked("/healthz") == 200)
    for path in ("/", "/now.json", "/metrics", "/events", "/register_service"):
        assert asked(path) == 401 and asked(f"{path}?token=wrong") == 401
        assert asked(path, Authorization="Bearer wrong horse") == 401
    assert asked("/now.json?token=correct%20horse") == 200
    assert asked("/", Authorization="Bearer correct horse") == 200
    for listen, token in ((":8080", ""), ("127.0.0.1:8080", ""), ("0.0.0.0:8080", "correct horse")):
        checked(Config(link=LinkSection(endpoint="x"), http=HttpSection(listen=listen, token=token)))
    for listen, token in (("0.0.0.0:8080", ""), ("192.168.1.2:8080", "short"), ("[::]:8080", "")):
        with pytest.raises(UsageError, match=r"http\.token"):
            checked(Config(link=LinkSection(endpoint="x"), http=HttpSection(listen=listen, token=token)))
