"""What people use as ground stations, against `uavbatt live`: MAVSDK-Python, MAVProxy, Chromium.

They are no dependencies of the project: $UAVBATT_GCS_PYTHON names an interpreter that has `mavsdk` and MAVProxy,
else this one is asked; a test without its program is skipped with the reason.
"""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import pytest
from browser import Browser
from daemon_bench import Bench
from live_rig import PATIENCE_S, free_port, until
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.live.config import HttpSection
from uavbatt.live.feeds.web import serve
from uavbatt.records import Route, Sample
from uavbatt.simulate.tlog_writer import battery_status, heartbeat
from uavbatt.telemetry import read_log

PROGRAM = [sys.executable, "-c", "from uavbatt.cli import main; main()", "live"]
GCS_PYTHON = os.environ.get("UAVBATT_GCS_PYTHON", sys.executable)
MISSION = ((47.1, 8.1, 10.0), (47.2, 8.2, 123.0))
SEEN_BY_MAVSDK = """
import asyncio, math, sys
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
async def main(port, wanted):
    sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    await sdk.add_any_connection(f"udpin://127.0.0.1:{port}")
    drone = await sdk.first_autopilot(timeout_s=10)
    async for battery in TelemetryAsync(drone).subscribe_battery():
        if battery.id == wanted and math.isfinite(battery.time_remaining_s):
            print("SEEN", battery.time_remaining_s, flush=True)
            return
asyncio.run(asyncio.wait_for(main(int(sys.argv[1]), int(sys.argv[2])), 25))
"""


class Autopilot(threading.Thread):
    """Heartbeat and BATTERY_STATUS at 10 Hz to `port`; keeps and answers parameters."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self.line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.line.setblocking(False)
        self.to, self.is_over = ("127.0.0.1", port), False
        self.parameters = {"BATT_CAPACITY": 5200.0, "BATT_MONITOR": 4.0}
        self.mission: list[Any] = [item(k, True) for k in range(len(MISSION))]
        self._written: list[Any] = []  # of an upload
        self._count = 0
        self._link: Any = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        self._parser: Any = dialect.MAVLink(None)

    def run(self) -> None:
        k = 0
        while not self.is_over:
            if k % 10 == 0:
                self.send(heartbeat(True))
            self.send(battery_status(Sample(0.0, 16.0 - k * 1e-4, 12.0, 25.0, k / 3000, 0.9, True), 0))
            k += 1
            time.sleep(0.1)
            self.answer()

    def send(self, message: Any) -> None:
        self.line.sendto(message.pack(self._link), self.to)
        self._link.seq = (self._link.seq + 1) % 256

    def answer(self) -> None:
        while True:
            try:
                data = self.line.recv(4096)
            except (BlockingIOError, ConnectionRefusedError):
                return
            for message in self._parser.parse_buffer(data) or []:
                kind, names = message.get_type(), []
                if kind == "PARAM_REQUEST_LIST":
                    names = list(self.parameters)
                elif kind == "PARAM_REQUEST_READ":
                    names = [message.param_id or list(self.parameters)[message.param_index]]
                elif kind == "PARAM_SET":
                    self.parameters[message.param_id] = message.param_value
                    names = [message.param_id]
                elif kind == "MISSION_REQUEST_LIST":
                    self.send(dialect.MAVLink_mission_count_message(255, 230, len(self.mission)))
                elif kind in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
                    self.send(as_asked(self.mission[message.seq], kind == "MISSION_REQUEST_INT"))
                elif kind in ("MISSION_CLEAR_ALL", "MISSION_COUNT", "MISSION_ITEM_INT"):
                    self.write(kind, message)
                for name in names:
                    at, count = list(self.parameters).index(name), len(self.parameters)
                    value = self.parameters[name]
                    self.send(dialect.MAVLink_param_value_message(name.encode(), value, 9, count, at))

    def write(self, kind: str, message: Any) -> None:
        """A station writes a mission."""
        if kind == "MISSION_COUNT":
            self._count, self._written = message.count, []
        elif kind == "MISSION_ITEM_INT" and message.seq == len(self._written):
            self._written.append(message)
        else:
            self.mission = []
        if kind != "MISSION_CLEAR_ALL" and len(self._written) < self._count:
            self.send(dialect.MAVLink_mission_request_int_message(255, 230, len(self._written)))
            return
        self.mission = self._written or self.mission
        self.send(dialect.MAVLink_mission_ack_message(255, 230, 0))


def item(number: int, as_int: bool) -> Any:
    """A waypoint of the mission."""
    latitude, longitude, altitude = MISSION[number]
    head = (255, 230, number, 3, 16, 0, 1, 0, 0, 0, 0)
    if as_int:
        return dialect.MAVLink_mission_item_int_message(*head, int(latitude * 1e7), int(longitude * 1e7), altitude)
    return dialect.MAVLink_mission_item_message(*head, latitude, longitude, altitude)


def as_asked(held: Any, as_int: bool) -> Any:
    """An item as it was asked for."""
    head = (255, 230, held.seq, held.frame, held.command, 0, 1, 0, 0, 0, 0)
    if as_int:
        return dialect.MAVLink_mission_item_int_message(*head, held.x, held.y, held.z)
    return dialect.MAVLink_mission_item_message(*head, held.x / 1e7, held.y / 1e7, held.z)


@pytest.fixture
def ports() -> Iterator[tuple[int, int]]:
    vehicle, station = free_port(), free_port()
    autopilot = Autopilot(vehicle)
    autopilot.start()
    yield vehicle, station
    autopilot.is_over = True
    autopilot.join(2.0)


def start(ports: tuple[int, int], folder: Path, *more: str) -> subprocess.Popen[bytes]:
    arguments = [f"udpin:127.0.0.1:{ports[0]}", "--gcs", f"udpout:127.0.0.1:{ports[1]}", "--capacity-ah", "5", *more]
    env = {**os.environ, "OMP_NUM_THREADS": "1", "RUNTIME_DIRECTORY": str(folder)}
    return subprocess.Popen([*PROGRAM, *arguments], env=env, stderr=subprocess.DEVNULL)


def needs(module: str) -> None:
    if subprocess.run([GCS_PYTHON, "-c", f"import {module}"], capture_output=True).returncode:
        pytest.skip(f"`{module}` is not here: name an interpreter that has it with UAVBATT_GCS_PYTHON")


@pytest.mark.parametrize(("feed", "battery_id"), [("proxy", 0), ("battery", 8)])
def test_mavsdk_sees_the_time(ports: tuple[int, int], tmp_path: Path, feed: str, battery_id: int) -> None:
    needs("mavsdk")
    companion = start(ports, tmp_path, "--feed", feed)
    # In battery mode the autopilot's own messages reach the station by another way: here, a heartbeat is enough.
    other = Autopilot(ports[1])
    if feed == "battery":
        other.start()
    try:
        command = [GCS_PYTHON, "-c", SEEN_BY_MAVSDK, str(ports[1]), str(battery_id)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    finally:
        other.is_over = True
        companion.terminate()
        companion.wait(PATIENCE_S)
    assert "SEEN" in done.stdout, done.stdout[-500:] + done.stderr[-500:]


def console(port: int, folder: Path, steps: list[tuple[str, str]]) -> str:
    """What MAVProxy says to commands, each once the last is answered, or two seconds later."""
    script = Path(GCS_PYTHON).with_name("mavproxy.py")
    modules = "--default-modules=link,param,wp,cmdlong,arm,mode,battery,misc"
    command = [GCS_PYTHON, str(script), f"--master=udpin:127.0.0.1:{port}", "--mav20", "--no-state", modules]
    said, process = (
        [],
        subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=folder
        ),
    )
    assert process.stdin is not None and process.stdout is not None
    listener = threading.Thread(target=lambda: said.extend(iter(process.stdout.readline, "")), daemon=True)  # type: ignore[union-attr]
    listener.start()
    try:
        for line, answer in steps:
            if line:
                process.stdin.write(line + "\n")
                process.stdin.flush()
            end_s = time.monotonic() + (PATIENCE_S if answer else 2.0)
            while (not answer or answer not in "".join(said)) and time.monotonic() < end_s:
                time.sleep(0.1)
    finally:
        process.kill()
        process.wait(PATIENCE_S)
        listener.join(PATIENCE_S)
    return "".join(said)


def test_mavproxy_works_behind_the_proxy_as_without_it(ports: tuple[int, int], tmp_path: Path) -> None:
    needs("MAVProxy")
    steps = [("", "Received 2 parameters"), ("param set BATT_CAPACITY 4800", ""), ("param show BATT_CAPACITY", "4800"),
             ("wp list", "123.0"), ("status BATTERY_STATUS", "BATTERY_STATUS {")]  # fmt: skip
    direct = Autopilot(ports[1])
    direct.start()
    without = console(ports[1], tmp_path, steps)
    direct.is_over = True
    companion = start(ports, tmp_path, "--feed", "proxy")
    try:
        console(ports[1], tmp_path, [("", "Received 2 parameters")])  # until there is a time
        behind = console(ports[1], tmp_path, steps)
    finally:
        companion.terminate()
        companion.wait(PATIENCE_S)

    def lines(said: str, *wanted: str) -> list[str]:
        found = [line.split("> ")[-1].strip() for line in said.splitlines() if any(w in line for w in wanted)]
        return [line.split(" t=")[0] for line in found]  # without the time of day

    asked = ("vehicle", "online", "Received", "BATT_CAPACITY", "Requesting", "waypoints", "47.1", "47.2")
    assert lines(behind, *asked) == lines(without, *asked) and any("4800" in line for line in lines(behind, *asked))
    assert any("123.0" in line for line in lines(behind, "47.2"))
    (status,), (plain,) = lines(behind, "BATTERY_STATUS {"), lines(without, "BATTERY_STATUS {")
    assert "time_remaining : 0," in plain and "time_remaining : 0," not in status


def shown_in_chromium(browser: Browser, url: str, folder: Path, width: int, wanted: str) -> str:
    """The page's elements once its script has brought what is wanted, at a width in pixels; leaves a picture."""

    def page() -> str:
        found = str(browser.evaluate("document.documentElement.outerHTML"))
        return found if wanted in found else ""

    browser.open(url, width, "light")
    seen: str = until(page)
    picture = folder / f"{width}.png"
    browser.picture(picture)
    assert picture.read_bytes().startswith(b"\x89PNG") and picture.stat().st_size > 8000
    browser.ask("Page.navigate", url="about:blank")  # its script goes on with nothing
    return seen


@pytest.mark.parametrize(("state", "width"), [("ok", 390), ("converging", 1280), ("refused", 390), ("stale", 1280)])
def test_chromium_shows_every_state_as_it_is(browser: Browser, tmp_path: Path, state: str, width: int) -> None:
    pytest.importorskip("uvicorn")
    bench, port = Bench(), free_port()
    rest = Sample(0.0, 16.7, 0.1, 25.0, 0.0, armed=False)
    volts = 14.6 if state == "converging" else 16.0  # begun in the air on the flat of the curve
    flight = [replace(rest, time_s=k / 2, voltage_V=volts, current_A=12.0, armed=True) for k in range(10, 40)]
    ground = [replace(rest, time_s=k / 2) for k in range(10)]
    bench.play({"ok": ground + flight, "converging": flight, "refused": ground, "stale": ground + flight}[state])
    bench.now_s += 10.0 if state == "stale" else 0.1
    serve(HttpSection(listen=f"127.0.0.1:{port}"), lambda: bench.daemon.board, lambda: bench.now_s)
    shown = {"refused": "waiting"}.get(state, state)  # on the ground nothing is wrong
    wanted = f'class="state {shown}"'
    page = shown_in_chromium(browser, f"http://127.0.0.1:{port}/", tmp_path, width, wanted)
    assert wanted in page
    known = state in ("ok", "converging")
    assert (re.search(r'class="time( low)?" data-k="time">\d+:\d\d<', page) is not None) == known
    assert ('class="time last"' in page and "s ago</small>" in page) == (state == "stale")
    assert (re.search(r'class="time (unknown|planned)"', page) is not None) == (state == "refused")
    reasons = {"ok": "probably between", "converging": "still settling", "refused": "waiting for take-off"}
    reasons["stale"] = "no telemetry for 10 s"
    assert reasons[state] in page


EVENT = "events.onmessage({ data: JSON.stringify({ ...last, clock_s: last.clock_s - %s, start: %s }) })"


def test_a_page_whose_events_come_late_shows_no_number(browser: Browser) -> None:
    """Also those after a connection that broke: the network may be as slow as before."""
    pytest.importorskip("uvicorn")
    bench, port = Bench(), free_port()
    bench.fly(20.0)
    begun_s, wall_s = bench.now_s, time.monotonic()

    def clock_s() -> float:
        return begun_s + time.monotonic() - wall_s

    def page(after: str) -> str:
        return str(browser.evaluate(f"{after}; document.getElementById('batteries').innerText"))

    serve(HttpSection(listen=f"127.0.0.1:{port}"), lambda: bench.daemon.board, clock_s)
    browser.open(f"http://127.0.0.1:{port}/", 390, "light")
    assert "probably between" in page("events.close()")
    late = page("events.onopen?.(); " + EVENT % (20, "last.start"))
    assert "this page comes 20\u202fs late" in late and "probably between" not in late
    assert "late" not in page(EVENT % (1000, "'of another process'"))
    browser.ask("Page.navigate", url="about:blank")


@pytest.mark.parametrize("is_returning", [False, True])
def test_an_aircraft_that_flies_home_is_not_told_when_to_turn_back(browser: Browser, is_returning: bool) -> None:
    """The page said "Turn back in, at worst: now" on the way home."""
    pytest.importorskip("uvicorn")
    bench, port = Bench(), free_port()
    bench.fly(20.0)
    way = Route("route", turn_back_s=90.0, turn_back_lo_s=30.0, home_soc_lo=0.2, is_returning=is_returning)
    way = replace(way, assumed="flight home assumed; still air assumed")
    (report,) = bench.daemon.board.reports
    report = replace(report, remaining=replace(report.remaining, route=way))
    board = replace(bench.daemon.board, reports=(report,))
    serve(HttpSection(listen=f"127.0.0.1:{port}"), lambda: board, lambda: bench.now_s)
    browser.open(f"http://127.0.0.1:{port}/", 390, "light")
    shown = until(lambda: str(browser.evaluate("document.getElementById('batteries').innerText")))
    browser.ask("Page.navigate", url="about:blank")
    assert ("Turn back in" in shown) is not is_returning
    assert "Home with, at worst" in shown
    assert "flight home assumed\nstill air assumed" in shown  # on what these numbers rest


def test_a_mission_that_mavproxy_loads_passes_the_proxy_and_is_understood(
    ports: tuple[int, int], tmp_path: Path
) -> None:
    """`wp load` and `wp list` behind the proxy, and what the estimator has recorded of it."""
    needs("MAVProxy")
    rows = ("0\t1\t0\t16\t0\t0\t0\t0\t47.0\t8.0\t400\t1", "1\t0\t3\t22\t0\t0\t0\t0\t47.0\t8.0\t30\t1",
            "2\t0\t3\t16\t0\t0\t0\t0\t47.5\t8.5\t87.0\t1")  # fmt: skip
    (tmp_path / "route.txt").write_text("\n".join(("QGC WPL 110", *rows, "")))
    recorded = tmp_path / "recorded"
    companion = start(ports, tmp_path, "--feed", "proxy", "--record", str(recorded))
    try:
        console(ports[1], tmp_path, [("", "Received 2 parameters")])  # until it is up
        steps = [
            ("", "Received 2 parameters"),
            ("wp load route.txt", "Sent all 3 waypoints"),
            ("status GPS", ""),
            ("wp list", "87.0"),
        ]
        said = console(ports[1], tmp_path, steps)
    finally:
        companion.terminate()
        companion.wait(PATIENCE_S)
    assert "47.5" in said and "87.0" in said, said
    (path,) = recorded.glob("*.tlog")
    known = read_log(path).navigation[-1]
    assert known.mission is not None and known.mission.reason == ""
    assert [i.command for i in known.mission.items] == [16, 22, 16]
    assert known.mission.items[2].alt_m == 87.0 and not known.transferring


def test_the_page_answers_to_its_own_names_and_runs_its_own_scripts_only() -> None:
    pytest.importorskip("uvicorn")
    bench, port = Bench(), free_port()
    serve(HttpSection(listen=f"127.0.0.1:{port}"), lambda: bench.daemon.board, lambda: bench.now_s)

    def answered(host: str) -> tuple[int, str]:
        connection = HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
        connection.request("GET", "/", headers={"Host": host})
        response = connection.getresponse()
        return response.status, response.headers.get("Content-Security-Policy", "")

    for own in (f"127.0.0.1:{port}", f"localhost:{port}", "companion.local", "[::1]:80", "[::1]", "192.168.1.7:8080"):
        assert answered(own)[0] == 200, own
    assert answered("evil.example")[0] == answered(f"127.0.0.1.evil.example:{port}")[0] == 421
    policy = answered("localhost")[1]
    assert "default-src 'none'" in policy and "script-src 'sha256-" in policy and "unsafe-eval" not in policy
