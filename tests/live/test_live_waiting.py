"""Before take-off: nothing is missing, and what a flight from this charge would be is told."""

from __future__ import annotations

from dataclasses import replace

from daemon_bench import Bench
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.live.feeds.web import content
from uavbatt.records import Sample

REST = Sample(0.0, 16.7, 0.1, 25.0, 0.0, armed=False)
GROUND = [replace(REST, time_s=k / 2) for k in range(20)]


def test_on_the_ground_the_endurance_from_this_charge_is_told() -> None:
    bench = Bench()
    bench.play(GROUND)
    battery = content(bench.daemon.board, bench.now_s)["batteries"][0]
    assert battery["waiting"] and battery["remaining_s"] is None
    assert 0.0 < battery["plan_lo_s"] < battery["plan_s"] < battery["plan_hi_s"] < 6 * 3600.0
    said = f"waiting for take-off; about {battery['plan_s'] / 60.0:.0f} min ("
    assert battery["reason"].startswith(said) and battery["reason"].endswith("from this charge")


def test_a_pack_that_was_used_promises_less() -> None:
    full, used = Bench(), Bench()
    full.play(GROUND)
    used.play([replace(sample, voltage_V=15.4) for sample in GROUND])
    first, second = (content(b.daemon.board, b.now_s)["batteries"][0] for b in (full, used))
    assert second["plan_s"] < 0.8 * first["plan_s"]


def test_in_the_air_the_forecast_alone_speaks() -> None:
    bench = Bench()
    bench.play([*GROUND, *(replace(REST, time_s=k / 2, voltage_V=16.0, current_A=14.0) for k in range(20, 60))])
    battery = content(bench.daemon.board, bench.now_s)["batteries"][0]
    assert not battery["waiting"] and battery["plan_s"] is None and battery["remaining_s"] > 0.0


def test_without_telemetry_nothing_is_promised() -> None:
    bench = Bench()
    bench.play(GROUND)
    battery = content(bench.daemon.board, bench.now_s + 10.0)["batteries"][0]
    assert not battery["waiting"] and battery["plan_s"] is None
    assert battery["reason"] == "no telemetry for 10 s"


def test_a_glider_that_is_met_in_the_air_does_not_wait_for_take_off() -> None:
    """The companion is started in a glide: the position shows the flight, but no load of its motor has come."""
    bench = Bench()
    for sample in GROUND:
        bench.send(dialect.MAVLink_global_position_int_message(0, 470000000, 80000000, 530000, 130000, 1500, 0, 0, 0))
        bench.play([replace(sample, armed=True)])
    battery = content(bench.daemon.board, bench.now_s)["batteries"][0]
    assert not battery["waiting"] and battery["plan_s"] is None and battery["remaining_s"] is None
    assert battery["reason"].startswith("in the air, but no load that carries the aircraft was seen")
