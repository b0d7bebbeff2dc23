"""What is remembered of a pack, and the estimate of it in flight: neither throws the other away."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from daemon_bench import Bench
from packs.made import flight as flight_of_a_pack
from pymavlink.dialects.v20 import ardupilotmega as dialect
from test_live_faults import OPTIONS, SELDOM, flight

from uavbatt.battery import battery_file
from uavbatt.battery.remembered import PackHealth
from uavbatt.live.config import PacksSection, StateSection
from uavbatt.live.memory.pack_keeper import PackKeeper
from uavbatt.live.tracked_battery import TrackedBattery
from uavbatt.packs import airborne
from uavbatt.packs.ledger import Ledger, prior
from uavbatt.records import NAN, PackFacts, Sample
from uavbatt.simulate.tlog_writer import battery_status

FLOWN = 120  # rows before the crash


@pytest.fixture
def ledger(tmp_path: Path) -> Path:
    """A ledger that has met pack A."""
    with Ledger(tmp_path / "packs.sqlite") as opened:
        opened.save("A", flight_of_a_pack(0))
    return tmp_path / "packs.sqlite"


@pytest.fixture
def health(ledger: Path) -> PackHealth:
    with Ledger(ledger) as opened:
        last = opened.last("A")
    assert last is not None
    return prior(last, last.flight.start_utc_s, "0" * 64)


def settle(bench: Bench) -> None:
    """Wait until the ledger was asked and written."""
    keeper = bench.daemon.batteries._keeper
    assert isinstance(keeper, PackKeeper)
    keeper._worker.submit(lambda: None).result()


def test_a_flight_that_is_resumed_before_the_first_heartbeat_goes_on(ledger: Path, tmp_path: Path) -> None:
    """Nobody has said yet that it flies, and the ledger remembers the pack."""
    sections = {"state": StateSection(file=str(tmp_path / "state.json")), "packs": PacksSection(str(ledger), "A")}
    first = Bench(OPTIONS, settings=SELDOM, **sections)
    first.play(flight()[:FLOWN])
    first.daemon.close()
    bench = Bench(OPTIONS, first.now_s + 1.0, settings=SELDOM, **sections)
    for sample in flight()[FLOWN + 2 : FLOWN + 8]:
        bench.send(battery_status(sample, 0))
        bench.daemon.turn()
        settle(bench)
        bench.now_s += 0.5
    assert bench.daemon.armed is None
    assert "battery 0: resumed from a state 2 s old" in bench.daemon.board.notes
    assert bench.daemon.board.reports[0].flying_since_s < first.now_s
    bench.daemon.close()


def test_a_process_that_is_stopped_in_the_air_leaves_its_last_rows_in_the_ledger(ledger: Path) -> None:
    bench = Bench(OPTIONS, settings=SELDOM, packs=PacksSection(str(ledger), "A"))
    bench.fly(68.0)
    bench.daemon.close()
    with Ledger(ledger) as opened:
        (flight,) = airborne.left_over(opened)
    assert flight.flight.name == "A" and flight.rows[-1].time_s > 68.0 - 2.0 * airborne.ROW_S


def test_rows_of_the_vehicle_that_comes_next_are_in_no_flight_of_the_last_one(ledger: Path) -> None:
    bench = Bench(OPTIONS, settings=SELDOM, packs=PacksSection(str(ledger)))
    bench.send(dialect.MAVLink_param_value_message(b"BATT_SERIAL_NUM", 7.0, 9, 1, 0))
    bench.fly(20.0)
    bench.now_s += 11.0  # system 1 is silent, and system 42 tells no serial
    for _ in range(100):
        bench.send(dialect.MAVLink_heartbeat_message(2, 3, 128, 0, 4, 3), system=42)
        bench.send(battery_status(Sample(0.0, 15.0, 40.0, 25.0, 0.1, armed=True), 0), system=42)
        bench.daemon.turn()
        bench.now_s += 0.2
    bench.daemon.close()
    assert bench.daemon.board.reports[0].system == 42
    with Ledger(ledger) as opened:
        assert airborne.left_over(opened) == []


def smart_battery(serial: bytes, number: int = 0) -> Any:
    """SMART_BATTERY_INFO of a pack."""
    return dialect.MAVLink_smart_battery_info_message(
        number, 0, 0, 5000, -1, 3, serial, b"m", 65535, 0, 0, 0, 0, 4, 0, 0, b""
    )


@pytest.mark.parametrize(
    ("messages", "serial"),
    [
        ([(smart_battery(b"B7"), 1, 1)], "B7"),
        ([(smart_battery(b"B7"), 1, 180)], "B7"),  # a component of its own
        ([(smart_battery(b"B7"), 1, 180), (smart_battery(b"B8", number=1), 1, 181)], "B7"),
        ([(smart_battery(b"B9"), 9, 1)], ""),  # another vehicle's
    ],
    ids=["by the autopilot", "by itself", "and another pack", "of another vehicle"],
)
def test_a_pack_that_says_who_it_is_flies_under_its_serial(
    ledger: Path, messages: list[tuple[Any, int, int]], serial: str
) -> None:
    bench = Bench(OPTIONS, settings=SELDOM, packs=PacksSection(str(ledger)))
    bench.fly(1.0)
    for message, system, component in messages:
        bench.send(message, system=system, component=component)
    bench.fly(20.0)
    settle(bench)
    with Ledger(ledger) as opened:
        assert [left.flight.name for left in airborne.left_over(opened)] == ([serial] if serial else [])
    bench.daemon.close()


def tracked(samples: tuple[Sample, ...]) -> TrackedBattery:
    """The estimate of pack A, which nobody has met, after some rows."""
    battery = TrackedBattery(battery_file.read_battery("lipo-generic"), OPTIONS, SELDOM)
    battery.remember("A", None)
    for sample in samples:
        battery.step(sample, PackFacts())
    return battery


def test_a_pack_that_has_flown_keeps_its_estimate_until_it_is_charged(health: PackHealth) -> None:
    """What its flight has taught counts from the next charge on."""
    flown = flight(0.5)
    battery = tracked(flown)
    before = battery.estimator.belief
    battery.remember("A", health)
    assert battery.estimator.belief is before and battery.estimator.remembered is None
    shift_s = flown[-1].time_s + 60.0
    for sample in flight()[:20]:
        battery.step(replace(sample, time_s=sample.time_s + shift_s), PackFacts())
    assert battery.estimator.remembered is health
    assert battery.estimator.belief is not None and battery.estimator.belief.mean[0] > 0.9


def test_a_pack_that_has_not_flown_begins_with_what_is_remembered(health: PackHealth) -> None:
    battery = tracked(flight()[:20])
    battery.remember("A", health)
    assert battery.estimator.remembered is health and battery.estimator.belief is None


def test_a_pack_of_another_name_begins_anew_though_the_ledger_knows_neither() -> None:
    battery = tracked(flight()[:FLOWN])
    battery.remember("A", None)
    assert battery.estimator.belief is not None
    battery.remember("B", None)
    assert battery.estimator.belief is None


@pytest.mark.parametrize("next_one", [b"B7", b"B8"])
def test_another_serial_on_the_ground_is_another_pack_without_a_ledger(next_one: bytes) -> None:
    """It is charged as the first one was when it landed, and nothing counts the charge: only its serial tells."""
    bench = Bench(OPTIONS, settings=SELDOM)
    bench.send(smart_battery(b"B7"))
    rows = [replace(sample, consumed_Ah=NAN) for sample in flight()[:FLOWN]]
    bench.play([*(replace(sample, armed=False) for sample in rows[:10]), *rows[10:]])
    flown = bench.daemon.board.reports[0].estimate
    rest = [replace(rows[-1], time_s=float(k), voltage_V=16.6, current_A=0.1, armed=False) for k in range(20)]
    bench.now_s += 30.0
    bench.send(smart_battery(next_one))
    bench.play(rest)
    landed = bench.daemon.board.reports[0].estimate
    assert (landed.resistance_scale_sd > 1.5 * flown.resistance_scale_sd) is (next_one == b"B8")


def test_another_pack_begins_without_what_is_remembered_of_the_last(health: PackHealth) -> None:
    battery = tracked(())
    battery.remember("A", health)
    for sample in flight()[:FLOWN]:
        battery.step(sample, PackFacts())
    battery.remember("B", None)
    assert battery.estimator.remembered is None and battery.estimator.belief is None
