"""`uavbatt live` as people run it: processes, sockets on 127.0.0.1, kill -9, the page, the service manager."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from live_rig import PROGRAM, Station, Vehicle, free_port, manager_at, running


@pytest.fixture
def vehicle() -> Iterator[Vehicle]:
    made = Vehicle(free_port())
    made.start()
    yield made
    made.is_over = True
    made.join(2.0)


def is_timed(message: Any) -> bool:
    return message.get_type() == "BATTERY_STATUS" and message.get_srcComponent() == 1 and message.time_remaining > 0


def is_untimed(message: Any) -> bool:
    return message.get_type() == "BATTERY_STATUS" and message.time_remaining == 0


def test_the_proxy_outlives_its_estimator(vehicle: Vehicle, tmp_path: Path) -> None:
    """Times appear, a kill -9 takes them away but no frame, a restart brings them back; the autopilot hears nothing."""
    station = Station()
    arguments = [
        f"udpin:127.0.0.1:{vehicle.to[1]}", "--gcs", f"udpout:127.0.0.1:{station.port}", "--feed", "proxy",
        "--capacity-ah", "5", "--state", str(tmp_path / "state.json"),
    ]  # fmt: skip
    runtime = {"RUNTIME_DIRECTORY": str(tmp_path)}
    with running(*arguments, **runtime) as first:
        before = station.until(is_timed, 20.0)
        time.sleep(6.0)  # a state is saved
        first.send_signal(signal.SIGKILL)
        first.wait()
    last_s, longest_s = time.monotonic(), 0.0
    end_s = last_s + 4.0
    while time.monotonic() < end_s:
        station.until(lambda m: m.get_type() == "BATTERY_STATUS", 2.0)
        longest_s, last_s = max(longest_s, time.monotonic() - last_s), time.monotonic()
    assert longest_s < 1.0
    station.until(is_untimed, 2.0)
    with running(*arguments, **runtime):
        start_s = time.monotonic()
        after = station.until(is_timed, 20.0)
        assert time.monotonic() - start_s < 10.0
        assert after.time_remaining == pytest.approx(before.time_remaining, rel=0.5)
        assert vehicle.heard == []
        station.line.sendto(b"\xfe any bytes \xfd", station.peer)
    assert not list(tmp_path.glob("*.sock"))  # an orderly stop takes the proxy with it


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
        time.sleep(3.6)
        with pytest.raises(urllib.error.HTTPError, match="503"):
            urllib.request.urlopen(f"{base}/healthz")
        assert json.load(urllib.request.urlopen(f"{base}/now.json"))["status"] == "stale"
        process.send_signal(signal.SIGTERM)
        assert process.wait(8.0) == 0
    assert {m.get_type() for m in vehicle.heard} == {"HEARTBEAT", "COMMAND_LONG", "PARAM_REQUEST_READ"}
    assert {b"READY=1", b"WATCHDOG=1", b"STOPPING=1"} <= set(told) and any(m.startswith(b"STATUS=") for m in told)
    (lines,) = record.glob("*.jsonl")
    assert json.loads(lines.read_text().splitlines()[-1])["soc"] > 0.5


def wait_for_page(port: int) -> dict[str, Any]:
    """What the page shows once it shows a time."""
    end_s = time.monotonic() + 20.0
    while time.monotonic() < end_s:
        try:
            shown: dict[str, Any] = json.load(urllib.request.urlopen(f"http://127.0.0.1:{port}/now.json"))
        except urllib.error.URLError:
            time.sleep(0.1)
            continue
        if shown["batteries"] and shown["batteries"][0]["remaining_s"] is not None:
            return shown
        time.sleep(0.2)
    raise AssertionError("no time on the page in 20 s")


def refusal(*arguments: str) -> tuple[int, str]:
    done = subprocess.run([*PROGRAM, *arguments], capture_output=True, text=True, timeout=20, env={**os.environ})
    return done.returncode, done.stderr


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
        got, error = refusal(*arguments)
        assert (got, error.count("\n")) == (code, 1) and words in error, error
