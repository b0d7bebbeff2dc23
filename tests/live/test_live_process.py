"""`uavbatt live` as people run it: processes, sockets on 127.0.0.1, kill -9, the page, the service manager."""

from __future__ import annotations

import itertools
import json
import random
import signal
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import pytest
from command import refused_live
from daemon_bench import Bench
from live_rig import PATIENCE_S, Station, Vehicle, free_port, manager_at, running, until
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.cli import live_process
from uavbatt.records import Sample
from uavbatt.simulate.tlog_writer import battery_status
from uavbatt.telemetry import read_log


def is_timed(message: Any) -> bool:
    return message.get_type() == "BATTERY_STATUS" and message.get_srcComponent() == 1 and message.time_remaining > 0


def is_untimed(message: Any) -> bool:
    return message.get_type() == "BATTERY_STATUS" and message.time_remaining == 0


def test_the_proxy_outlives_its_estimator(vehicle: Vehicle, tmp_path: Path) -> None:
    """A kill -9 takes the time away but no frame; a restart brings it back, inside its interval."""
    station, config = Station(), tmp_path / "u.toml"
    config.write_text("[state]\nperiod_s = 1.0\n")
    arguments = [
        f"udpin:127.0.0.1:{vehicle.to[1]}", "--gcs", f"udpout:127.0.0.1:{station.port}", "--feed", "proxy",
        "--feed", "named", "--capacity-ah", "5", "--state", str(tmp_path / "state.json"), "--config", str(config),
    ]  # fmt: skip
    runtime = {"RUNTIME_DIRECTORY": str(tmp_path)}
    with running(*arguments, **runtime) as first:
        station.until(is_timed)
        end_s = time.monotonic() + 2.5  # a state is saved
        station.until(lambda m: time.monotonic() > end_s)
        first.send_signal(signal.SIGKILL)
        first.wait()
    killed_s, before = time.monotonic(), dict(station.named)
    station.until(is_untimed)
    with running(*arguments, **runtime):
        after = station.until(is_timed)
        passed_s = time.monotonic() - killed_s
        assert before["REM_LO_S"] < after.time_remaining + passed_s < before["REM_HI_S"]
        assert vehicle.heard == []
        station.line.sendto(b"\xfe any bytes \xfd", station.peer)
        until(lambda: vehicle.raw == b"\xfe any bytes \xfd")
    steps = {(b - a) % 256 for a, b in itertools.pairwise(station.sequence)}
    assert steps == {1}  # not a frame was lost, doubled or moved
    assert not list(tmp_path.glob("*.sock"))  # an orderly stop takes the proxy with it


def test_what_reaches_the_autopilot_with_every_feed_and_requests(vehicle: Vehicle, tmp_path: Path) -> None:
    """Of ours three messages, of the ground station every byte, of batteries nothing."""
    station, gcs = Station(), dialect.MAVLink(None, srcSystem=255, srcComponent=190)
    feeds = ["--feed", "proxy", "--feed", "battery", "--feed", "named", "--request"]
    arguments = [f"udpin:127.0.0.1:{vehicle.to[1]}", "--gcs", f"udpout:127.0.0.1:{station.port}", *feeds]
    said = bytes(dialect.MAVLink_param_set_message(1, 1, b"BATT_MONITOR", 4.0, 9).pack(gcs))
    with running(*arguments, RUNTIME_DIRECTORY=str(tmp_path)):
        station.until(is_timed)
        station.until(lambda m: m.get_srcComponent() == 180 and m.get_type() == "BATTERY_STATUS")
        for _ in range(20):
            station.line.sendto(said, station.peer)
        until(lambda: vehicle.raw.count(said) == 20)
    heard = {(m.get_srcSystem(), m.get_srcComponent(), m.get_type()) for m in vehicle.heard}
    ours = {(1, 193, kind) for kind in ("HEARTBEAT", "COMMAND_LONG", "PARAM_REQUEST_READ")}
    assert heard == {*ours, (255, 190, "PARAM_SET")}
    assert {m.command for m in vehicle.heard if m.get_type() == "COMMAND_LONG"} == {511}


class BadRadio(Vehicle):
    """A tenth is lost, a tenth comes twice, a tenth late; between come noise and another vehicle's low battery."""

    def __init__(self, port: int) -> None:
        super().__init__(port)
        self._dice, self._late, self.is_silent = random.Random(4), b"", False
        self._other: Any = dialect.MAVLink(None, srcSystem=2, srcComponent=1)

    def write(self, data: bytes) -> None:
        if self.is_silent:
            return
        chance = self._dice.random()
        if chance < 0.1:
            return
        if 0.2 < chance < 0.3:
            data, self._late = self._late, data
        for piece in (data, data if chance < 0.2 else b"", self._late if chance > 0.6 else b""):
            if piece:
                super().write(piece)
        super().write(self._dice.randbytes(self._dice.randrange(60)))
        other = battery_status(Sample(0.0, 13.4, 40.0, 25.0, 4.5), 0)
        super().write(bytes(other.pack(self._other)))


@pytest.mark.slow  # bad radios without a process are its witness, in test_live_faults.py
def test_a_bad_radio_over_a_real_socket(tmp_path: Path) -> None:
    """The time is that of a good link, stale when nothing comes, back when it does."""
    vehicle, station = BadRadio(free_port()), Station()
    vehicle.start()

    def is_time(message: Any) -> bool:
        return message.get_type() == "NAMED_VALUE_FLOAT" and message.name == "REM_S"

    arguments = [f"udpin:127.0.0.1:{vehicle.to[1]}", "--gcs", f"udpout:127.0.0.1:{station.port}"]
    try:
        with running(*arguments, "--system", "1", "--capacity-ah", "5", "--record", str(tmp_path)):
            station.until(lambda m: is_time(m) and m.value > 60)
            end_s = time.monotonic() + 3.0
            station.until(lambda m: time.monotonic() > end_s)
            flown = dict(station.named)
            vehicle.is_silent, silent_s = True, time.monotonic()
            station.until(lambda m: is_time(m) and m.value != m.value)
            vehicle.is_silent = False
            again = station.until(lambda m: is_time(m) and m.value > 60)
            passed_s = time.monotonic() - silent_s
    finally:
        vehicle.is_over = True
    good = Bench()
    good.fly(6.0)
    clean = good.daemon.board.reports[0]
    assert clean.remaining.remaining_lo_s < flown["REM_S"] < clean.remaining.remaining_hi_s
    assert flown["SOC"] == pytest.approx(clean.estimate.soc, abs=0.03)
    assert flown["REM_LO_S"] < again.value + passed_s < flown["REM_HI_S"]
    assert {"REM_S", "REM_LO_S", "REM_HI_S", "SOC"} <= set(station.named)  # TURN_S and HOME_SOC where home is known
    (log,) = tmp_path.glob("*.tlog")
    assert {s.voltage_V for s in read_log(log).samples if s.voltage_V < 14.0} == set()


def test_requests_are_answered_and_the_page_shows_it(vehicle: Vehicle, tmp_path: Path) -> None:
    port, record = free_port(), tmp_path / "flights"
    base = f"http://127.0.0.1:{port}"
    arguments = [f"udpin:127.0.0.1:{vehicle.to[1]}", "--request", "--http", f"127.0.0.1:{port}"]
    arguments += ["--record", str(record)]
    notified = tmp_path / "notify"
    with manager_at(notified) as told, running(*arguments, NOTIFY_SOCKET=str(notified)) as process:
        shown = wait_for_page(port)
        assert shown["batteries"][0]["cells"] == 4 and shown["batteries"][0]["remaining_s"] > 60
        assert urllib.request.urlopen(f"{base}/healthz").status == 200
        assert b"uavbatt_remaining_seconds" in urllib.request.urlopen(f"{base}/metrics").read()
        with urllib.request.urlopen(f"{base}/events") as events:
            assert events.readline().startswith(b"data: {")
        assert b"EventSource" in urllib.request.urlopen(f"{base}/").read()
        vehicle.is_over = True
        until(lambda: health(base) == 503)
        assert json.load(urllib.request.urlopen(f"{base}/now.json"))["status"] == "stale"
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE_S) == 0
    assert {m.get_type() for m in vehicle.heard} == {"HEARTBEAT", "COMMAND_LONG", "PARAM_REQUEST_READ"}
    assert {b"READY=1", b"WATCHDOG=1", b"STOPPING=1"} <= set(told) and any(m.startswith(b"STATUS=") for m in told)
    (lines,) = record.glob("*.jsonl")
    assert json.loads(lines.read_text().splitlines()[-1])["soc"] > 0.5


def wait_for_page(port: int) -> dict[str, Any]:
    """What the page shows once it shows a time."""

    def shown() -> dict[str, Any] | None:
        try:
            said: dict[str, Any] = json.load(urllib.request.urlopen(f"http://127.0.0.1:{port}/now.json"))
        except urllib.error.URLError:
            return None
        return said if said["batteries"] and said["batteries"][0]["remaining_s"] is not None else None

    found: dict[str, Any] = until(shown)
    return found


def health(base: str) -> int:
    """The status that the page answers to a service that watches it."""
    try:
        return int(urllib.request.urlopen(f"{base}/healthz").status)
    except urllib.error.HTTPError as refusal:
        return refusal.code


def test_what_cannot_be_run_is_said_in_one_line(tmp_path: Path) -> None:
    config = tmp_path / "u.toml"
    config.write_text('[feed]\nnamed_rate_Hz = "fast"\n')
    for arguments, code, words in (
        ((), 2, "ENDPOINT"),
        (("udpin:nowhere",), 2, "expected udpin:HOST:PORT"),
        (("udpin:127.0.0.1:1451", "--feed", "proxy"), 2, "--gcs"),
        (("udpin:127.0.0.1:1451", "--http", "0.0.0.0:8080"), 2, "http.token"),
        (("udpin:127.0.0.1:1451", "--config", str(config)), 1, "key feed.named_rate_Hz"),
    ):
        done = refused_live(*arguments, folder=tmp_path)
        assert (done.returncode, done.stderr.count("\n")) == (code, 1) and words in done.stderr, done.stderr


def test_ctrl_c_while_it_still_loads_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It takes half a second until the process has taken the signals over: a traceback was shown."""

    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(live_process, "load_filterpy", interrupted)
    assert live_process.main() == 130
    assert capsys.readouterr().err == "uavbatt: interrupted\n"
