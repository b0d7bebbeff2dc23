"""A battery that is a MAVLink component of its own: in flight, and in the replay of a log."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from daemon_bench import Bench
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.errors import BadInput
from uavbatt.live.config import FeedSection, RecordSection
from uavbatt.records import Flight, Sample, Status
from uavbatt.simulate.tlog_writer import battery_status, heartbeat, sys_status
from uavbatt.telemetry import read_log

BATTERY, GIMBAL = 36, 26
LOWER_V = 3.0  # of the voltages of batteries that are not the aircraft's own


class Part(NamedTuple):
    """A component beside the autopilot: the type in its heartbeat, and its battery's number and voltage at first."""

    component: int = 180
    kind: int = BATTERY
    number: int = 0
    volts: float = 16.0


def beat(kind: int, autopilot: int = 8) -> Any:
    return dialect.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 3, 3)


def row(k: int, volts: float = 16.0) -> Sample:
    drawn_Ah = 12.0 * k / 5.0 / 3600.0
    return Sample(0.0, volts - 0.5 * drawn_Ah, 12.0, 25.0, drawn_Ah, armed=True)


NO_BATTERY = sys_status(Sample(0.0, 0.0))  # as ArduPilot sends it without a battery monitor


def said(k: int, parts: Sequence[Part], own: Sequence[int] = (), own_from: int = 0) -> list[tuple[int, Any]]:
    """What is sent at step `k` of 5 Hz, each with its component: the autopilot's batteries are the numbers `own`."""
    sent: list[tuple[int, Any]] = [(1, heartbeat(True)), *((p.component, beat(p.kind)) for p in parts)] * (k % 5 == 0)
    sent += [(p.component, battery_status(row(k, p.volts), p.number)) for p in parts]
    sent += [(1, battery_status(row(k), number)) for number in own if k >= own_from]
    return [*sent, (1, NO_BATTERY)] if not own else sent


def fly(bench: Bench, seconds: int, parts: Sequence[Part], own: Sequence[int] = (), own_from: int = 0) -> None:
    for k in range(5 * seconds):
        for component, message in said(k, parts, own, own_from):
            bench.send(message, component=component)
        bench.daemon.turn()
        bench.now_s += 0.2


def log(folder: Path, seconds: int, parts: Sequence[Part], own: Sequence[int] = (), own_from: int = 0) -> Path:
    path = folder / "flight.tlog"
    with path.open("wb") as file:
        for k in range(5 * seconds):
            for component, message in said(k, parts, own, own_from):
                link = dialect.MAVLink(None, srcSystem=1, srcComponent=component)
                file.write(struct.pack(">Q", 1_700_000_000_000_000 + 200_000 * k) + bytes(message.pack(link)))
    return path


def rows_of(bench: Bench) -> dict[int, int]:
    return {report.instance: report.rows for report in bench.daemon.board.reports}


def unused(bench: Bench) -> list[str]:
    return [note for note in bench.daemon.board.notes if "is heard and not used" in note]


def notes(flight: Flight) -> str:
    return "\n".join(flight.notes)


def test_it_is_the_battery_of_an_autopilot_without_one(tmp_path: Path) -> None:
    bench = Bench()
    fly(bench, 60, [Part()])
    (report,) = bench.daemon.board.reports
    assert (report.system, report.instance) == (1, 0) and report.rows >= 270
    shown = report.at(bench.now_s)
    assert shown.status is not Status.STALE and shown.remaining_s > 0.0 and not unused(bench)
    flight = read_log(log(tmp_path, 60, [Part()]))
    assert len(flight.samples) == 300 and flight.samples[-1].armed and flight.instance == 0
    assert flight.samples[-1].voltage_V == pytest.approx(row(299).voltage_V, abs=1e-3)
    assert "batteries of system 1 component 180 read" in notes(flight)


def test_two_of_them_are_two_batteries(tmp_path: Path) -> None:
    parts = [Part(180, number=0), Part(181, number=1)]
    bench = Bench()
    fly(bench, 20, parts)
    assert rows_of(bench).keys() == {0, 1}
    assert read_log(log(tmp_path, 20, parts)).instances == (0, 1)


def test_two_of_them_with_one_id_are_not_mixed(tmp_path: Path) -> None:
    parts = [Part(180), Part(181, volts=16.0 - LOWER_V)]
    bench = Bench()
    fly(bench, 20, parts)
    assert bench.daemon.board.reports[0].estimate.voltage_V > 15.9
    assert unused(bench) == ["battery 0 of component 181 is heard and not used: component 180 reports it"]
    flight = read_log(log(tmp_path, 20, parts))
    assert min(sample.voltage_V for sample in flight.samples) > 15.9
    assert "system 1 component 181 ignored" in notes(flight)


@pytest.mark.parametrize("number", [0, 1])
def test_the_autopilots_own_battery_is_kept_and_the_other_is_named(number: int, tmp_path: Path) -> None:
    parts = [Part(number=number, volts=16.0 - LOWER_V)]
    bench = Bench()
    fly(bench, 20, parts, own=[0])
    assert rows_of(bench) == {0: 100} and bench.daemon.board.reports[0].estimate.voltage_V > 15.9
    assert unused(bench) == [f"battery {number} of component 180 is heard and not used: "
                             "the autopilot reports its own batteries"]  # fmt: skip
    flight = read_log(log(tmp_path, 20, parts, own=[0]))
    assert (len(flight.samples), flight.instances) == (100, (0,))
    assert "battery messages of system 1 component 180 ignored" in notes(flight)


def test_an_autopilot_that_reports_the_battery_later_is_believed(tmp_path: Path) -> None:
    parts = [Part(volts=16.0 - LOWER_V)]
    bench = Bench()
    fly(bench, 30, parts, own=[0], own_from=100)
    assert bench.daemon.board.reports[0].estimate.voltage_V > 15.9 and len(unused(bench)) == 1
    flight = read_log(log(tmp_path, 30, parts, own=[0], own_from=100))
    assert min(sample.voltage_V for sample in flight.samples) > 15.9


@pytest.mark.parametrize("kind", [GIMBAL, 18])
def test_the_battery_of_a_payload_is_never_taken(kind: int, tmp_path: Path) -> None:
    bench = Bench()
    fly(bench, 20, [Part(kind=kind)])
    assert rows_of(bench) == {}
    with pytest.raises(BadInput):
        read_log(log(tmp_path, 20, [Part(kind=kind)]))


def test_a_battery_of_another_vehicle_is_not_ours() -> None:
    bench = Bench()
    for k in range(100):
        bench.send(heartbeat(True))
        bench.send(beat(BATTERY), system=2, component=180)
        bench.send(battery_status(row(k), 0), system=2, component=180)
        bench.daemon.turn()
        bench.now_s += 0.2
    assert rows_of(bench) == {}


def test_a_second_sender_of_its_identity_is_not_mixed_in() -> None:
    bench = Bench()
    fly(bench, 10, [Part()])
    before = rows_of(bench)[0]
    for k in range(50):
        for component, message in said(50 + k, [Part()]):
            bench.send(message, component=component)
        bench.send(battery_status(row(0, 16.0 - LOWER_V), 0), component=180, sender="other")
        bench.daemon.turn()
        bench.now_s += 0.2
    assert rows_of(bench) == {0: before + 50}
    assert any("disagree on battery 0" in note for note in bench.daemon.board.notes)
    assert bench.daemon.board.reports[0].at(bench.now_s).status is Status.REFUSED


def test_our_own_feed_that_comes_back_is_neither_used_nor_named() -> None:
    bench = Bench(feed=FeedSection(kinds=("battery",)))
    fly(bench, 20, [Part(number=8)], own=[0])
    assert rows_of(bench).keys() == {0} and not unused(bench)


def test_the_recording_of_its_flight_is_replayed(tmp_path: Path) -> None:
    bench = Bench(record=RecordSection(folder=str(tmp_path), when="always"))
    fly(bench, 30, [Part()])
    rows = rows_of(bench)[0]
    bench.daemon.close()
    (path,) = tmp_path.glob("*.tlog")
    samples = read_log(path).samples
    assert len(samples) >= rows and samples[-1].voltage_V == pytest.approx(row(149).voltage_V, abs=1e-3)
