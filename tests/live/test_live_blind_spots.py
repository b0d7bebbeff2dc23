"""Times at which the crew heard nothing, or the longer time of another pack, while a flight came to its end."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from daemon_bench import Bench
from factories import generic_pack
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.records import Sample, Status
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight
from uavbatt.simulate.tlog_writer import battery_status, heartbeat

OPTIONS = PackOptions(capacity_Ah=5.0, cells=4, cutoff_V=13.2)
SETTINGS = ForecastSettings(forecast_period_s=5.0)


def flight() -> list[Sample]:
    pack = generic_pack(4, 5.0, 13.2, math.nan)
    return simulate_flight(pack, SimulatedFlight(power_W=320.0, start_soc=0.4, rate_Hz=1.0))


def texts(bench: Bench) -> list[str]:
    return [m.text for m in bench.to_gcs() if m.get_type() == "STATUSTEXT"]


@pytest.mark.parametrize("is_emptying", [True, False])
def test_a_forger_does_not_silence_the_end_of_the_flight(is_emptying: bool) -> None:
    """Two senders of one identity disagree: the time is refused, and yet one of them shows that the pack is empty."""
    bench = Bench(OPTIONS, settings=SETTINGS)
    rows = flight() if is_emptying else flight()[:60]
    for k, sample in enumerate(rows):
        real = sample if is_emptying else replace(sample, voltage_V=16.4, consumed_Ah=0.0)
        bench.send(heartbeat(bool(sample.armed)), sender="a")
        bench.send(battery_status(real, 0), sender="a")
        if k > 30:
            bench.send(battery_status(replace(real, voltage_V=real.voltage_V + 1.0), 0), sender="b")
        bench.daemon.turn()
        bench.now_s += 1.0
    (report,) = bench.daemon.board.reports
    assert report.at(bench.now_s).status is Status.REFUSED
    assert any("two senders disagree" in text for text in texts(bench))
    assert any("may end within 2 min: land" in text for text in texts(bench)) is is_emptying


@pytest.mark.parametrize("is_new_number", [False, True])
def test_the_longer_time_of_another_pack_does_not_replace_that_of_a_silent_one(is_new_number: bool) -> None:
    """Of two packs the emptier falls silent: REM_S leapt to the other's time. A pack under a new number is shown."""
    bench = Bench(OPTIONS, settings=SETTINGS)
    for k, sample in enumerate(flight()[:110]):
        bench.send(heartbeat(bool(sample.armed)))
        full = replace(sample, voltage_V=16.2 - 0.002 * k if sample.armed else 16.5, current_A=0.7 * sample.current_A)
        if k < 70:
            bench.send(battery_status(sample, 0))
        if k >= 70 or not is_new_number:
            bench.send(battery_status(sample if is_new_number else full, 1))
        bench.daemon.turn()
        bench.now_s += 1.0
    assert [report.instance for report in bench.daemon.board.reports] == ([1, 0] if is_new_number else [0, 1])
    assert math.isnan(bench.named()["REM_S"]) is not is_new_number
    assert any("time unknown, no telemetry" in text for text in texts(bench))


def test_the_pack_that_is_left_gives_its_last_alarms() -> None:
    """The silent pack keeps its place, and the aircraft flies on: the end of the other is not hidden behind it."""
    bench = Bench(OPTIONS, settings=SETTINGS)
    for k, sample in enumerate(flight()):
        bench.send(heartbeat(bool(sample.armed)))
        emptier = replace(sample, voltage_V=sample.voltage_V - 0.3, current_A=1.3 * sample.current_A)
        if k < 70:
            bench.send(battery_status(emptier, 0))
        bench.send(battery_status(sample, 1))
        bench.daemon.turn()
        bench.now_s += 1.0
    assert [report.instance for report in bench.daemon.board.reports] == [0, 1]
    assert any(text.startswith("Battery 1: 0:") for text in texts(bench))


def test_a_lost_number_is_said_although_the_last_heartbeat_came_on_the_ground() -> None:
    """A router sends the heartbeats on another way: the loss in flight was taken for that of a landed vehicle."""
    bench = Bench(OPTIONS, settings=SETTINGS)
    for k, sample in enumerate(flight()[:100]):
        if k < 15:
            bench.send(heartbeat(False))
        bench.send(battery_status(sample if k < 60 else replace(sample, current_A=math.nan), 0))
        bench.daemon.turn()
        bench.now_s += 1.0
    assert any("time unknown" in text for text in texts(bench))


@pytest.mark.parametrize("is_armed", [True, False])
def test_an_armed_vehicle_without_any_battery_reading_is_announced_once(is_armed: bool) -> None:
    """A smart battery that reports its percentage only: the ground station heard nothing at all."""
    bench = Bench(OPTIONS)
    told = dialect.MAVLink_battery_status_message(0, 0, 0, 32767, [65535] * 10, -1, -1, -1, 60)
    for _ in range(60):
        bench.send(heartbeat(is_armed))
        bench.send(told)
        bench.daemon.turn()
        bench.now_s += 1.0
    assert texts(bench) == ["No battery readings: time unknown"] * is_armed


@pytest.mark.parametrize("rows", [110, None])
def test_late_telemetry_still_says_that_the_flight_ends(rows: int | None) -> None:
    """A modem holds all frames back for 20 s (or the vehicle's clock was set back): the alarm never came."""
    bench = Bench(OPTIONS, settings=SETTINGS)
    for k, sample in enumerate(flight()[:rows]):
        bench.send(heartbeat(bool(sample.armed)))
        bench.send(dialect.MAVLink_system_time_message(0, 1000 * (200 + k - 20 * (k > 60))))
        bench.send(battery_status(sample if rows is None else replace(sample, voltage_V=16.4, consumed_Ah=0.0), 0))
        bench.daemon.turn()
        bench.now_s += 1.0
    assert bench.daemon.board.reports[0].at(bench.now_s).status is Status.STALE
    assert any("time unknown, telemetry comes late" in text for text in texts(bench))
    assert any("may end within 2 min: land" in text for text in texts(bench)) is (rows is None)
