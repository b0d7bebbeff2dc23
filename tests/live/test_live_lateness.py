"""A link that holds frames back for seconds or minutes: what comes is not what is."""

from __future__ import annotations

import itertools
import math

import pytest
from daemon_bench import Bench
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.live.feeds.proxy_client import ProxyClient
from uavbatt.live.feeds.web import content
from uavbatt.records import Sample
from uavbatt.simulate.tlog_writer import battery_status, heartbeat


def fly(bench: Bench, seconds: float, late_s: float = 0.0) -> None:
    """Fly at 12 A with a clock that the autopilot tells; what is received was sent `late_s` [s] before."""
    for k in range(int(5 * seconds)):
        sent_s = bench.now_s - 1000.0 - late_s
        if k % 5 == 0:
            bench.send(heartbeat(True))
            bench.send(dialect.MAVLink_system_time_message(0, int(1000 * (sent_s + 50.0))))
        drawn_Ah = 12.0 * sent_s / 3600.0
        volts = 16.0 - 0.5 * drawn_Ah + 0.002 * (k % 3)
        bench.send(battery_status(Sample(0.0, volts, 12.0 + 0.05 * (k % 3), 25.0, drawn_Ah, armed=True), 0))
        bench.daemon.turn()
        bench.now_s += 0.2


def held_back(bench: Bench, late_s: float) -> None:
    """From now on the link is so late: nothing comes for so long, then the rows go on where they stood."""
    bench.now_s += late_s
    fly(bench, 10.0, late_s)


def said(bench: Bench) -> list[str]:
    return [m.text for m in bench.to_gcs() if m.get_type() == "STATUSTEXT"]


def test_telemetry_that_is_some_seconds_late_is_said_and_deducted() -> None:
    bench = Bench()
    fly(bench, 40.0)
    held_back(bench, 6.0)
    report, shown = bench.daemon.board.reports[0], content(bench.daemon.board, bench.now_s - 0.2)["batteries"][0]
    assert 5.5 < report.remaining.remaining_s - shown["remaining_s"] < 6.5 and 5.5 < shown["age_s"] < 6.5
    assert [warning for warning in shown["warnings"] if "comes late: 6 s" in warning]
    assert shown["status"] != "stale" and said(bench).count("Battery 0: telemetry comes late") == 1
    assert bench.named()["REM_S"] == pytest.approx(shown["remaining_s"], abs=2.0)


@pytest.mark.parametrize("late_s", [15.0, 60.0])
def test_telemetry_that_is_late_by_more_is_none(late_s: float) -> None:
    """What is shown as so many seconds left would be over a minute before it says so."""
    bench = Bench()
    fly(bench, 40.0)
    held_back(bench, late_s)
    shown = content(bench.daemon.board, bench.now_s)["batteries"][0]
    assert (shown["status"], shown["remaining_s"]) == ("stale", None)
    assert shown["reason"].startswith(f"the telemetry comes late: {late_s:.0f} s")
    assert math.isnan(bench.named()["REM_S"])
    fly(bench, 5.0)
    assert bench.daemon.board.reports[0].at(bench.now_s).remaining_s > 0.0


def test_a_burst_after_a_short_silence_is_not_late() -> None:
    bench = Bench()
    fly(bench, 40.0)
    first_s = bench.now_s
    for k in itertools.count():  # what was held back for six seconds comes at once
        sent_s = first_s + k - 1000.0
        bench.send(dialect.MAVLink_system_time_message(0, int(1000 * (sent_s + 50.0))))
        row = Sample(0.0, 16.0 - 0.5 * 12.0 * sent_s / 3600.0, 12.0, 25.0, 12.0 * sent_s / 3600.0, armed=True)
        bench.send(battery_status(row, 0))
        if k == 6:
            break
    bench.now_s += 6.0
    bench.daemon.turn()
    bench.now_s += 0.2
    fly(bench, 10.0)
    assert "Battery 0: telemetry comes late" not in said(bench)
    assert not [w for w in bench.daemon.board.reports[0].estimate.warnings if "late" in w]


def test_the_proxy_deducts_it_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()
    fly(bench, 40.0)
    held_back(bench, 6.0)
    told: list[bytes] = []
    monkeypatch.setattr(ProxyClient, "_tell", lambda self, kind, body: told.append(body))
    ProxyClient.estimate(ProxyClient.__new__(ProxyClient), bench.daemon.board.reports[0], bench.now_s)
    left_s = bench.daemon.board.reports[0].remaining.remaining_s
    assert 5.5 < left_s - memoryview(told[0][4:12]).cast("B").cast("d")[0] < 6.5
