"""A link that cannot be opened: why, said once, on the page, and tried again until it is there."""

from __future__ import annotations

import os
import pty
import socket
from pathlib import Path

import pytest
from daemon_bench import OPTIONS, Bench
from live_rig import free_port, until

from uavbatt.battery import battery_file
from uavbatt.live.config import Config, LinkSection
from uavbatt.live.daemon import Daemon
from uavbatt.live.feeds.web import content
from uavbatt.mavlink.links import open_link
from uavbatt.prediction.forecaster import ForecastSettings


def test_a_device_that_is_not_there_is_named_until_it_comes_and_when_it_goes(tmp_path: Path) -> None:
    device = tmp_path / "ttyLater"
    link = open_link(f"{device},57600")
    assert link.read(0.0) == []
    assert link.problem == f"cannot open {device}: No such file or directory, trying again"
    ours, theirs = pty.openpty()
    device.symlink_to(os.ttyname(theirs))
    link.read(0.1)
    assert link.problem  # the pause is not over
    link.read(1.0)
    assert link.problem == ""
    os.close(ours)
    os.close(theirs)
    until(lambda: link.read(2.0) or link.problem)
    assert link.problem == f"lost {device}, trying again"
    link.close()


def test_a_file_that_is_no_serial_line_is_told_as_one(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("no line")
    link = open_link(f"{path},57600")
    link.read(0.0)
    assert link.problem.startswith(f"cannot open {path}: ") and "no serial line" in link.problem
    link.close()


def test_a_refused_connection_is_told_and_forgotten_when_somebody_listens() -> None:
    port = free_port()
    link = open_link(f"tcp:127.0.0.1:{port}")
    now_s = 0.0

    def after_a_while() -> str:
        nonlocal now_s
        now_s += 11.0  # the longest pause
        link.read(now_s)
        return link.problem

    until(lambda: "refused" in after_a_while())
    assert link.problem == f"cannot open tcp:127.0.0.1:{port}: Connection refused, trying again"
    with socket.create_server(("127.0.0.1", port)):
        until(lambda: after_a_while() == "")
    link.close()


def test_the_process_says_it_once_a_change_and_shows_it_as_the_reason(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    device, clock = tmp_path / "ttyLater", [0.0]
    endpoint = f"{device},57600"
    config = Config(link=LinkSection(endpoint=endpoint))
    battery = battery_file.read_battery("lipo-generic")
    link = open_link(endpoint)
    daemon = Daemon(config, battery, OPTIONS, ForecastSettings(), link, clock_s=lambda: clock[0])
    wanted = f"cannot open {device}: No such file or directory, trying again"
    for clock[0] in range(40):
        daemon.turn()
    shown = content(daemon.board, clock[0])
    assert shown["reason"] == wanted and wanted in shown["notes"] and shown["status"] == "stale"
    assert capfd.readouterr().err.count(wanted) == 1
    ours, theirs = pty.openpty()
    device.symlink_to(os.ttyname(theirs))
    for clock[0] in range(40, 60):
        daemon.turn()
    shown = content(daemon.board, clock[0])
    assert shown["reason"] == "no battery telemetry yet" and wanted not in shown["notes"]
    assert capfd.readouterr().err.count(f"{endpoint} is open") == 1
    daemon.close()
    os.close(ours)
    os.close(theirs)


def test_a_link_that_is_open_from_the_start_is_not_told(capfd: pytest.CaptureFixture[str]) -> None:
    bench = Bench()
    bench.fly(2.0)
    assert "is open" not in capfd.readouterr().err
