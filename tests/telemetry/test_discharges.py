"""Where another discharge begins in a log: a changed or charged pack, and nothing that only looks like one."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from factories import generic_pack
from frames import battery_row, frame, hover, smart, write_log
from pymavlink.dialects.v20 import ardupilotmega as dialect
from scoring.other_pack import Pack, drawn

from uavbatt.navigation import Navigation
from uavbatt.prediction.load.power_history import RecentLoad
from uavbatt.prediction.load.scenarios import FlightPoint, LoggedLoad
from uavbatt.records import NAN, Flight, Identity, PackFacts, Sample
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight
from uavbatt.telemetry import read_log
from uavbatt.telemetry.columns import rows_of
from uavbatt.telemetry.discharges import begins_s, of_discharges
from uavbatt.telemetry.quality.info import describe

FIRST_S = 300.0


@cache
def flown(start_soc: float = 1.0, power_W: float = 500.0) -> tuple[Sample, ...]:
    """A flight of five minutes, after 20 s of idling."""
    found = simulate_flight(generic_pack(), SimulatedFlight(power_W, start_soc=start_soc, rate_Hz=1.0))
    return tuple(sample for sample in found if sample.time_s <= FIRST_S)


def later(samples: tuple[Sample, ...], silence_s: float) -> tuple[Sample, ...]:
    """The rows as they come after another flight and a silence [s]."""
    begin_s = FIRST_S + silence_s
    return tuple(replace(sample, time_s=sample.time_s + begin_s) for sample in samples)


def rested(seconds: int, soc: float) -> tuple[Sample, ...]:
    """A pack on the ground after its flight, its counter going on."""
    last = flown()[-1]
    cell_V = np.interp(soc, [0.0, 1.0], [3.5, 4.2])
    return tuple(
        Sample(FIRST_S + k, 4.0 * cell_V - 0.1 * np.exp(-k / 20.0), 0.2, 25.0, last.consumed_Ah)
        for k in range(1, seconds + 1)
    )


def begins(*parts: tuple[Sample, ...]) -> tuple[float, ...]:
    return begins_s(rows_of([sample for part in parts for sample in part]))


def test_a_full_pack_after_a_silence_is_another_discharge() -> None:
    assert begins(flown(), later(flown(), 60.0)) == (FIRST_S + 60.0,)
    assert begins(flown()) == ()


def test_an_autopilot_that_speaks_on_by_usb_shows_no_pack() -> None:
    usb = tuple(Sample(FIRST_S + k, 0.2, 0.0, 25.0, flown()[-1].consumed_Ah) for k in range(1, 60))
    assert begins(flown(), usb, later(flown(), 60.0)) == (FIRST_S + 60.0,)


@pytest.mark.parametrize(("full_V", "again_soc", "is_charged"), [(16.7, 1.0, True), (15.6, 0.65, False)])
def test_a_pack_charged_in_a_dock_is_another_discharge(full_V: float, again_soc: float, is_charged: bool) -> None:
    """The autopilot speaks on all the time; a pack that only rests for so long is the same."""
    risen_V = np.minimum(15.4 + 0.1 * np.exp(-np.arange(1500) / 20.0) + np.arange(1500) / 1000.0, full_V)
    dock = tuple(
        Sample(FIRST_S + 1.0 + k, float(volts), 0.2, 25.0, flown()[-1].consumed_Ah) for k, volts in enumerate(risen_V)
    )
    again = later(flown(again_soc), 1501.0)
    take_off_s = next(row.time_s for row in again if row.current_A > 5.0)
    found = begins(flown(), dock, again)
    assert found == ((pytest.approx(take_off_s - 60.0, abs=1.0),) if is_charged else ())


def in_turn(*parts: tuple[Pack, int, float], digit_V: float = 0.01, cells: int = 4) -> tuple[float, ...]:
    """Where discharges begin in a log of a flight and waits, each of a pack for some seconds under a power [W]."""
    rows = [*drawn(Pack(cells=cells), [75.0 * cells] * 300, 0.0, cutoff_V=2.0 * cells).rows]
    for pack, seconds, power_W in parts:
        rows += drawn(pack, [power_W] * seconds, float(len(rows)), armed=False).rows
    return begins(tuple(replace(row, voltage_V=round(row.voltage_V / digit_V) * digit_V) for row in rows))


@pytest.mark.parametrize("power_W", [0.0, 5.0, 40.0])  # 40 W: half of 1 C
@pytest.mark.parametrize("soc", [0.45, 1.0])
def test_a_pack_connected_before_the_one_before_it_is_taken_off_is_another(soc: float, power_W: float) -> None:
    """A fit took the two flights for one of a pack with twice the charge: its curve was 0.4 V a cell too low."""
    assert in_turn((Pack(soc=0.7), 60, power_W), (Pack(soc=soc), 60, power_W)) == (360.0,)


@pytest.mark.parametrize("every", [2, 7])
def test_it_is_another_in_slow_rows_as_well(every: int) -> None:
    flight = drawn(Pack(), [300.0] * 301, 0.0).rows
    waits = [drawn(Pack(soc=soc), [5.0] * 63, 301.0 + k * 63.0, armed=False).rows for k, soc in enumerate((0.7, 1.0))]
    (begin_s,) = begins(tuple((*flight, *waits[0], *waits[1])[::every]))
    assert 364.0 <= begin_s < 364.0 + every


def test_a_leap_of_the_voltage_where_the_current_is_not_known_is_no_change() -> None:
    flight = drawn(Pack(), [300.0] * 300, 0.0).rows
    blind = [replace(r, current_A=NAN, voltage_V=r.voltage_V - k // 20 % 2) for k, r in enumerate(flight)]
    assert begins(flight, tuple(replace(r, time_s=r.time_s + 300.0) for r in blind)) == ()


@pytest.mark.parametrize("digit_V", [0.001, 0.01, 0.1])
@pytest.mark.parametrize(("cells", "air_C"), [(2, 25.0), (4, -10.0), (12, 25.0)])
def test_avionics_that_are_switched_on_the_ground_change_no_pack(cells: int, air_C: float, digit_V: float) -> None:
    pack = Pack(cells=cells, air_C=air_C, resistance=2.0)
    loads_W = [cells * watts for watts in (1.0, 10.0, 15.0, 2.0, 20.0, 0.0, 5.0, 1.0)]
    landed = drawn(pack, [75.0 * cells] * 300, 0.0, cutoff_V=2.0 * cells).rows
    assert len(landed) == 300
    assert in_turn(*((pack, 40, power_W) for power_W in loads_W), digit_V=digit_V, cells=cells) == ()


def test_a_part_charged_pack_is_told_by_a_counter_that_begins_again() -> None:
    second = later(flown(start_soc=0.8), 120.0)
    assert begins(flown(), rested(60, 0.55), second) == (FIRST_S + 120.0,)
    emptier = later(flown(start_soc=0.3, power_W=150.0), 120.0)
    assert begins(flown(), rested(60, 0.55), emptier) == (FIRST_S + 120.0,)


def going_on(silence_s: float, rise_V: float = 0.0) -> tuple[Sample, ...]:
    """The same pack after a silence: at rest it has risen a little, and its counter goes on."""
    return tuple(
        replace(sample, time_s=sample.time_s + silence_s, voltage_V=sample.voltage_V + rise_V)
        for sample in rested(120, 0.55)
    )


def test_a_pack_as_full_as_at_the_first_take_off_is_another_although_its_log_was_silent_in_flight() -> None:
    """The silence hides the landing, and no counter begins again: a fit took both flights for one of one pack."""
    pack = Pack(5.0, size_Ah=5.0)
    rows = drawn(pack, [5.0] * 20 + [260.0] * 400, 0.0, 0.0, cutoff_V=0.0).rows
    flown_V = rows[-1].voltage_V
    fresh = drawn(Pack(5.0, size_Ah=5.0), [5.0] * 30 + [260.0] * 300, 465.0, rows[-1].consumed_Ah, cutoff_V=0.0).rows
    assert 1.035 < fresh[0].voltage_V / flown_V < 1.1
    assert begins(tuple(rows), tuple(fresh)) == (fresh[0].time_s,)
    same = drawn(pack, [5.0] * 30 + [260.0] * 300, 465.0, rows[-1].consumed_Ah, cutoff_V=0.0).rows
    assert begins(tuple(rows), tuple(same)) == ()


@pytest.mark.parametrize("silence_s", [5.0, 30.0, 3600.0])
def test_the_same_pack_after_a_silence_is_no_other_discharge(silence_s: float) -> None:
    assert begins(flown(), going_on(silence_s)) == ()  # it was silent from the landing on
    assert begins(flown(), rested(40, 0.55), going_on(silence_s + 40.0, rise_V=0.15)) == ()


def test_a_landing_in_a_silence_is_no_change_where_no_current_is_measured() -> None:
    """Nobody knows then that the pack was under load before it, and rises by more than a rested one."""
    landed = tuple(replace(sample, time_s=sample.time_s + 30.0) for sample in rested(60, 0.35))
    blind = [tuple(replace(sample, current_A=NAN) for sample in part) for part in (flown(), landed)]
    ratio = blind[1][0].voltage_V / blind[0][-1].voltage_V
    assert 1.035 < ratio < 1.1
    assert begins(*blind) == ()


def test_a_flight_that_goes_on_through_a_silence_is_one_discharge() -> None:
    parts = flown()
    kept = tuple(sample for sample in parts if not 100.0 < sample.time_s < 160.0)
    assert begins(kept) == ()
    restarted = tuple(
        sample if sample.time_s < 100.0 else replace(sample, consumed_Ah=sample.consumed_Ah - 0.5) for sample in kept
    )
    assert begins(restarted) == ()  # an autopilot that restarts in the air has no rested row


@pytest.mark.parametrize("volts", [0.05, 4.9, NAN], ids=["none", "usb", "unknown"])
def test_a_pack_that_was_taken_out_under_an_autopilot_with_its_own_supply_is_another(volts: float) -> None:
    landed, at_s = rested(30, 0.6), FIRST_S + 30.0
    empty = tuple(replace(landed[-1], time_s=at_s + k, voltage_V=volts, current_A=0.0) for k in range(1, 40))
    again = tuple(replace(sample, time_s=sample.time_s + 70.0) for sample in rested(30, 0.6))  # at the same voltage
    air = tuple(replace(sample, time_s=sample.time_s + 200.0 + FIRST_S) for sample in flown(0.6))
    assert begins(flown(), landed, empty, again, air) == (again[0].time_s,)
    lost = [replace(s, voltage_V=volts) if 100.0 < s.time_s < 130.0 else s for s in flown()]
    assert begins(tuple(lost), landed) == ()  # a voltmeter that fails in the air


def test_a_flight_begins_where_its_pack_is_connected() -> None:
    """On USB power the autopilot tells 4.9 V: `fit` refused such a log, and `plan --like` planned for two cells."""
    usb = tuple(Sample(float(k), 4.9, 0.0, 25.0, 0.0, armed=False) for k in range(20))
    air = tuple(replace(sample, time_s=sample.time_s + 20.0) for sample in flown())
    log = Flight("a.csv", "csv", (*usb, *air), identity=Identity(battery_serial="A", start_utc_s=1.7e9))
    (only,) = of_discharges(log)
    assert (only.source, only.samples) == ("a.csv", air)
    assert only.identity == Identity(battery_serial="A", start_utc_s=1.7e9 + 20.0)
    stated = ((0.0, PackFacts(capacity_Ah=5.0, critical_voltage_V=13.2)),)
    assert describe(replace(log, facts=stated)).reasons == describe(replace(only, facts=stated)).reasons
    for whole in (replace(log, samples=air), replace(log, samples=usb)):
        (same,) = of_discharges(whole)
        assert same is whole


@pytest.mark.parametrize("volts", [4.9, 0.05])
def test_a_flight_ends_where_its_pack_is_taken_out(volts: float) -> None:
    landed = rested(30, 0.6)
    empty = tuple(Sample(FIRST_S + 31.0 + k, volts, 0.0, 25.0, 1.0, armed=False) for k in range(5))
    flight = (*flown(), *landed)
    (only,) = of_discharges(Flight("a.csv", "csv", (*flight, *empty)))
    assert (only.samples, only.duration_s) == (flight, flight[-1].time_s)
    again = tuple(replace(sample, time_s=sample.time_s + 400.0) for sample in (*flight, *empty))
    log = Flight("a.csv", "csv", (*flight, *empty, *again), discharges=((again[0].time_s, ""),))
    assert [part.samples for part in of_discharges(log)] == [flight, again[: -len(empty)]]


def two_flights(tmp_path: Path, *more: tuple[float, bytes], second_V: float = 16.5) -> Flight:
    """Two minutes of hover, eight of silence, and two minutes with another pack; the counter is not sent."""
    again = [
        (600.0 + k, battery_row(600.0 + k, second_V - (0.45 if k > 5 else 0.003), 15.0 if k > 5 else 0.1))
        for k in range(120)
    ]
    return read_log(write_log(tmp_path / "two.tlog", [*hover(120, 14.8, 15.0), *again, *more]))


def test_each_discharge_is_a_flight_of_its_own_with_its_own_pack(tmp_path: Path) -> None:
    log = two_flights(tmp_path, smart(5200, 4, 2.0, b"A1"), smart(5200, 4, 602.0, b"B2"))
    one, two = of_discharges(log)
    assert (one.source, two.source) == (f"{log.source}, flight 1 of 2", f"{log.source}, flight 2 of 2")
    assert (one.identity.battery_serial, two.identity.battery_serial) == ("A1", "B2")
    assert two.identity.start_utc_s == pytest.approx(one.identity.start_utc_s + 600.0)
    assert (len(one.samples), two.samples[0].time_s) == (120, 600.0)
    assert [s for part in (one, two) for s in part.samples] == list(log.samples)
    assert "the pack was changed or charged before 600 s" in log.notes[-1]


def test_a_later_flight_knows_the_mission_and_not_the_way_that_was_flown_before(tmp_path: Path) -> None:
    """The map of the second flight showed the first one's way as well, and its changes of the mode."""
    whole = two_flights(tmp_path)
    (begin_s, _), *_ = whole.discharges
    known = tuple(Navigation(time_s=begin_s + shift_s) for shift_s in (-90.0, -50.0, 0.5, 30.0))
    first, second = of_discharges(replace(whole, navigation=known))
    assert first.navigation == known[:2] and second.navigation == known[1:]


def test_the_silence_of_a_change_is_no_gap_of_the_log(tmp_path: Path) -> None:
    log = two_flights(tmp_path)
    assert not [reason for reason in describe(log).reasons if "over 10 s" in reason]
    holed = replace(log, samples=tuple(s for s in log.samples if not 60.0 < s.time_s < 90.0))
    assert "1 gap over 10 s, the longest 30 s at 60 s" in describe(holed).reasons


def test_who_the_second_pack_is_is_not_known_if_only_the_first_said_so(tmp_path: Path) -> None:
    _, two = of_discharges(two_flights(tmp_path, smart(5200, 4, 2.0, b"A1")))
    assert two.identity.battery_serial == ""


def test_the_serial_alone_tells_a_pack_with_the_same_voltage(tmp_path: Path) -> None:
    told = smart(5200, 4, 2.0, b"A1"), smart(5200, 4, 602.0, b"B2"), smart(5200, 4, 612.0, b"B2")
    assert two_flights(tmp_path, *told, second_V=14.6).discharges == ((600.0, "B2"),)
    assert two_flights(tmp_path, *told[:1], second_V=14.6).discharges == ()


@pytest.mark.parametrize("second_V", [16.5, 14.6])
def test_what_is_stated_before_the_first_row_of_a_pack_is_of_that_pack(second_V: float, tmp_path: Path) -> None:
    """A ground station asks for parameters first: the flight before had the serial and the size of the next pack."""
    stated = [
        (at_s, frame(dialect.MAVLink_param_value_message(name, value, 9, 2, 0), at_s))
        for at_s, serial, capacity_mAh in ((0.0, 7.0, 5000.0), (599.0, 9.0, 6000.0))
        for name, value in ((b"BATT_SERIAL_NUM", serial), (b"BATT_CAPACITY", capacity_mAh))
    ]
    log = two_flights(tmp_path, *stated, second_V=second_V)
    assert log.discharges == ((600.0, "9"),)  # with the same voltage the serial alone tells it
    one, two = of_discharges(log)
    assert (one.identity.battery_serial, two.identity.battery_serial) == ("7", "9")
    assert [part.facts_at(math.inf).capacity_Ah for part in (one, two)] == [5.0, 6.0]


def test_a_part_without_a_flight_is_left_out() -> None:
    idle = tuple(Sample(float(k), 15.0, 0.1, 25.0, 0.0) for k in range(60))
    air = tuple(replace(sample, time_s=sample.time_s + 120.0) for sample in flown())
    log = Flight("a.csv", "csv", (*idle, *air), discharges=((120.0, ""),))
    (only,) = of_discharges(log)
    assert (only.source, only.samples) == ("a.csv", air)


def test_the_logged_load_of_a_flight_ends_with_it() -> None:
    """A forecast of the first flight went on with the load of the second one."""
    time_s = np.concatenate([np.arange(0.0, 300.0), np.arange(900.0, 1200.0)])
    load = LoggedLoad(time_s, np.where(time_s < 600.0, 200.0, 500.0), (900.0,))
    for now_s, watts in ((250.0, 200.0), (950.0, 500.0)):
        now = FlightPoint(now_s, now_s, 0.5, watts, RecentLoad())
        assert load.scenarios(now, 5.0, 200).power_W == pytest.approx(np.full((200, 1), watts))
