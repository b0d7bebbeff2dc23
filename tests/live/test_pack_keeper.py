"""The pack ledger beside the companion process: a flight is saved after its landing, also when a process died in it."""

from __future__ import annotations

import math
import sqlite3
from concurrent.futures import Future
from dataclasses import replace

import pytest

from uavbatt.battery import battery_file
from uavbatt.battery.model import open_circuit_voltage
from uavbatt.battery.scaling import pack_of
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.live.memory.kept_flight import LedgerBattery
from uavbatt.live.memory.pack_keeper import PackKeeper
from uavbatt.packs import airborne
from uavbatt.packs.airborne import ROW_S
from uavbatt.packs.ledger import Ledger
from uavbatt.records import Sample
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, with_effects

BATTERY = battery_file.read_battery("lpab-3s")
OPTIONS = PackOptions(cells=3, capacity_Ah=5.0, cutoff_V=10.0)
FADE = 0.15
UTC_S = 1.79e9


@pytest.fixture(scope="module")
def rows():
    """A flight of an aged pack: 20 s of rest, the flight nearly to its end, and half a minute on the ground."""
    pack = with_effects(pack_of(BATTERY, 3, 5.0, 10.0, math.nan), {"capacity_fade": FADE})
    flown = [
        replace(s, armed=s.current_A > 3.0) for s in simulate_flight(pack, SimulatedFlight(power_W=160.0, rate_Hz=1.0))
    ]
    flown = flown[: int(0.9 * len(flown))]
    last = flown[-1]
    rested_V = 3.0 * float(open_circuit_voltage(pack.cell, 1.0 - last.consumed_Ah / (5.0 * (1.0 - FADE)))) - 0.1
    rest = [replace(last, time_s=last.time_s + k, voltage_V=rested_V, current_A=0.3, armed=False) for k in range(1, 31)]
    return [*flown, *rest]


def keeper(path, stated="", utc=UTC_S):
    return PackKeeper(path, stated, BATTERY, OPTIONS, lambda now_s: utc + now_s)


def flown(kept, rows, serial="A"):
    """Rows as they come; the clock is theirs."""
    for row in rows:
        kept.meet(0, serial, None, row.time_s)
        kept.step(0, row, row.time_s, 3, 5.0)
        kept.look_after(row.time_s)
    return kept


def settled(kept):
    """Wait until all that the keeper has to write is written."""
    kept._worker.submit(lambda: None).result()


def assert_saved_whole(path, rows):
    with Ledger(path) as ledger:
        (found,) = ledger.flights("A")
        assert airborne.left_over(ledger) == []
    assert found.flight.duration_s > 0.95 * (rows[-1].time_s - 40.0)


@pytest.mark.parametrize("thermometer", [True, False])
def test_fast_rows_are_kept_as_means(thermometer: bool) -> None:
    """Two rows a second; a thermometer that has not spoken in a block leaves its temperature unknown."""
    battery = LedgerBattery("A", Future())
    for k in range(1 + int(2.0 * 2.0 * ROW_S)):  # two blocks, with the rows at both of their edges
        temp_C = 20.0 + k % 2 if thermometer else math.nan
        battery.add(Sample(7.0 + 0.5 * k, 16.0 - 0.1 * k, 10.0 + k, temp_C, armed=True), 1000.0 + 0.5 * k)
    first, *_ = battery.rows
    assert len(battery.rows) == 1 and len(battery.block) == int(2.0 * ROW_S)
    assert first.time_s == pytest.approx(1000.0 + ROW_S / 2.0)
    assert first.current_A == pytest.approx(10.0 + ROW_S) and first.voltage_V == pytest.approx(16.0 - 0.1 * ROW_S)
    assert 20.0 < first.temp_C < 21.0 if thermometer else math.isnan(first.temp_C)


def test_of_a_wait_on_the_ground_the_last_half_minute_is_kept() -> None:
    battery = LedgerBattery("A", Future())
    for k in range(300):
        battery.add(Sample(float(k), 16.0, 0.3, 20.0, armed=False), 1000.0 + k)
        battery.settle(False, 1000.0 + k)
    assert 1269.0 <= battery.rows[0].time_s < battery.rows[-1].time_s < 1299.0
    assert battery.disarmed_s == 1000.0


def test_a_damaged_ledger_is_a_note_and_no_end(tmp_path, rows):
    path = tmp_path / "packs.sqlite"
    flown(keeper(path), rows).close(rows[-1].time_s)
    with Ledger(path) as ledger, ledger.writing() as connection:
        connection.execute("UPDATE flights SET known_covariance = '[1, 2'")
    kept = keeper(path)
    assert kept.meet(0, "A", None, 0.0).result() is None
    assert "rows are whole" in kept.note
    kept.close(0.0)


def test_of_two_batteries_under_one_name_the_first_is_kept(tmp_path):
    kept = keeper(tmp_path / "packs.sqlite", stated="left")
    assert kept.meet(0, "", None, 0.0) is not None
    assert kept.meet(1, "", None, 0.0) is None
    assert "batteries 0 and 1 are both called left" in kept.note
    kept.close(0.0)


def test_a_flight_is_saved_after_its_landing(tmp_path, rows):
    path = tmp_path / "packs.sqlite"
    flown(keeper(path), rows).close(rows[-1].time_s)
    with Ledger(path) as ledger:
        (found,) = ledger.flights("A")
        assert airborne.left_over(ledger) == []
    assert found.flight.start_utc_s == pytest.approx(UTC_S, abs=5.0)
    assert math.exp(found.flight.told.log_Ah) == pytest.approx(5.0 * (1.0 - FADE), rel=0.05)


def test_a_process_that_dies_in_the_air_loses_seconds(tmp_path, rows):
    path, half = tmp_path / "packs.sqlite", len(rows) // 2
    died = flown(keeper(path), rows[:half])
    died._worker.shutdown()  # what it had written is written, the rest is lost
    flown(keeper(path), rows[half + 15 :]).close(rows[-1].time_s)
    assert_saved_whole(path, rows)


@pytest.mark.parametrize("utc_s", (math.nan, UTC_S + 86_400.0), ids=("no_clock", "a_day_later"))
def test_a_flight_that_cannot_be_resumed_keeps_its_rows_apart_from_those_of_the_next(tmp_path, rows, utc_s):
    """The next flight is in the air at the first row, before anything has looked after what was left over."""
    path, half = tmp_path / "packs.sqlite", len(rows) // 2
    flown(keeper(path), rows[:half])._worker.shutdown()
    flown(keeper(path, utc=utc_s), rows[half + 15 :]).close(rows[-1].time_s)
    with Ledger(path) as ledger:
        durations_s = [found.flight.duration_s for found in ledger.flights("A")]
        assert airborne.left_over(ledger) == []
    assert len(durations_s) == 2
    assert max(durations_s) < 0.7 * rows[-1].time_s and sum(durations_s) > 0.9 * rows[-1].time_s


@pytest.mark.parametrize("utc_s", (math.nan, UTC_S), ids=("no_clock", "clock"))
def test_a_flight_that_another_process_still_flies_is_left_to_it(tmp_path, rows, utc_s):
    path = tmp_path / "packs.sqlite"
    first = flown(keeper(path, utc=utc_s), rows[:60])
    settled(first)
    second = keeper(path, utc=utc_s)
    for row in rows[60:]:
        settled(flown(first, [row]))
        second.look_after(row.time_s)
        settled(second)
    first.close(rows[-1].time_s)
    second.close(rows[-1].time_s)
    assert "flight remembered" in first.note and second.note == ""
    assert_saved_whole(path, rows)


def test_a_flight_whose_process_never_came_back_is_saved_by_the_next_one(tmp_path, rows):
    path = tmp_path / "packs.sqlite"
    flown(keeper(path), rows[: 3 * len(rows) // 4])._worker.shutdown()
    later = keeper(path, utc=UTC_S + 86_400.0)
    later.look_after(0.0)
    later.close(0.0)
    with Ledger(path) as ledger:
        assert len(ledger.flights("A")) == 1


def test_every_flight_of_a_pack_that_never_landed_is_saved_by_the_next_process(tmp_path, rows):
    path = tmp_path / "packs.sqlite"
    begun = (UTC_S, UTC_S + 20_000.0)
    with Ledger(path) as ledger:
        for utc_s in begun:
            number = airborne.store_flight(ledger, airborne.Airborne("A", utc_s, 3, 5.0))
            airborne.store_rows(ledger, number, rows)
    later = keeper(path, utc=UTC_S + 86_400.0)
    later.look_after(0.0)
    later.close(0.0)
    with Ledger(path) as ledger:
        assert [found.flight.start_utc_s for found in ledger.flights("A")] == list(begun)
        assert airborne.left_over(ledger) == []


def test_what_a_flight_taught_is_known_when_the_pack_is_met_again(tmp_path, rows):
    path = tmp_path / "packs.sqlite"
    first = keeper(path)
    assert first.meet(0, "A", None, 0.0).result() is None
    flown(first, rows).close(rows[-1].time_s)
    second = keeper(path, utc=UTC_S + 86_400.0)
    health = second.meet(0, "A", None, 0.0).result()
    assert math.exp(health.log_Ah) == pytest.approx(5.0 * (1.0 - FADE), rel=0.05)
    assert "met before" in second.note
    second.close(0.0)


def test_a_pack_that_is_not_what_its_label_says_is_named_and_not_averaged(tmp_path, rows):
    path = tmp_path / "packs.sqlite"
    other = [replace(row, voltage_V=row.voltage_V * 4.0 / 3.0) for row in rows]  # one cell more
    flown(keeper(path), rows).close(rows[-1].time_s)
    second = PackKeeper(path, "", BATTERY, PackOptions(cutoff_V=13.2), lambda now_s: UTC_S + 86_400.0 + now_s)
    for row in other:
        second.meet(0, "A", None, row.time_s)
        second.step(0, row, row.time_s, 4, 5.0)
        second.look_after(row.time_s)
    second.close(other[-1].time_s)
    assert "another pack under this name?" in second.note
    with Ledger(path) as ledger:
        assert ledger.pack("A").outlook.flights == 1
        assert airborne.left_over(ledger) == []


def test_a_pack_without_a_name_is_not_remembered(tmp_path, rows):
    path = tmp_path / "packs.sqlite"
    kept = keeper(path)
    assert kept.meet(0, "", None, 0.0) is None
    flown(kept, rows, serial="").close(rows[-1].time_s)
    with Ledger(path) as ledger:
        assert ledger.packs() == []


@pytest.mark.parametrize("is_vehicle", (True, False), ids=("vehicle", "pack"))
def test_rows_of_another_battery_without_a_name_are_in_no_flight(tmp_path, rows, is_vehicle):
    """The named pack is in the air until its vehicle falls silent, or until it is taken out."""
    path, half = tmp_path / "packs.sqlite", len(rows) // 2
    kept = flown(keeper(path), rows[:half])
    if is_vehicle:
        kept.begin_vehicle()
    flown(kept, [replace(row, voltage_V=16.0) for row in rows[half:]], serial="").close(rows[-1].time_s)
    with Ledger(path) as ledger:
        (found,) = ledger.flights("A")
        assert airborne.left_over(ledger) == []
    assert found.flight.duration_s == pytest.approx(rows[half].time_s - 5.0, abs=10.0)


def test_two_vehicles_one_after_the_other_may_fly_packs_of_one_stated_name(tmp_path):
    kept = keeper(tmp_path / "packs.sqlite", stated="left")
    kept.meet(0, "", None, 0.0)
    kept.begin_vehicle()
    assert kept.meet(1, "", None, 20.0) is not None
    kept.close(20.0)
    assert "both called" not in kept.note


@pytest.fixture
def locked(tmp_path, monkeypatch):
    """The ledger while another program writes for longer than anybody waits; it ends when it is called."""
    monkeypatch.setattr("uavbatt.packs.opening.PATIENCE_S", 0.05)
    Ledger(tmp_path / "packs.sqlite").close()
    other = sqlite3.connect(tmp_path / "packs.sqlite", isolation_level=None)
    yield lambda: other.execute("BEGIN IMMEDIATE"), lambda: other.execute("ROLLBACK")
    other.close()


@pytest.mark.parametrize("begun", (0.0, 0.5, 0.95), ids=("at_the_take_off", "in_the_air", "at_the_landing"))
def test_a_flight_is_saved_whole_though_the_ledger_was_locked(tmp_path, rows, locked, begun):
    path, lock, unlock = tmp_path / "packs.sqlite", *locked
    kept, first = keeper(path), int(begun * len(rows))
    settled(flown(kept, rows[:first]))
    lock()
    last = first + 60 if begun < 0.9 else len(rows)
    settled(flown(kept, rows[first:last]))
    assert "found it locked" in kept.note
    unlock()
    flown(kept, rows[last:]).look_after(rows[-1].time_s)
    kept.close(rows[-1].time_s)
    assert_saved_whole(path, rows)


@pytest.mark.parametrize("back", (0.7, 1.0), ids=("back_in_the_air", "back_after_the_landing"))
def test_a_flight_is_saved_whole_though_the_ledger_was_away(tmp_path, rows, back, capsys):
    """The memory stick is pulled out in the air; what SQLite still wrote went to a file that nobody has."""
    folder, away = tmp_path / "stick", tmp_path / "pocket"
    folder.mkdir()
    kept, first, last = keeper(folder / "packs.sqlite"), int(0.4 * len(rows)), int(back * len(rows))
    settled(flown(kept, rows[:first]))
    folder.rename(away)
    settled(flown(kept, rows[first:last]))
    assert "it is gone" in kept.note
    assert capsys.readouterr().err.count("it is gone") == 1
    assert not (folder / "packs.sqlite").exists()
    away.rename(folder)
    flown(kept, rows[last:]).look_after(rows[-1].time_s)
    kept.close(rows[-1].time_s)
    assert "flight remembered" in kept.note
    assert_saved_whole(folder / "packs.sqlite", rows)


def test_a_ledger_that_is_back_in_the_air_is_not_shown_as_gone(tmp_path, rows, capsys):
    """Page and log said until the landing that the flight waits, and a second loss was not logged."""
    folder, away, part = tmp_path / "stick", tmp_path / "pocket", len(rows) // 6
    folder.mkdir()
    kept = flown(keeper(folder / "packs.sqlite"), rows[:part])
    settled(kept)
    for first in (part, 3 * part):
        folder.rename(away)
        settled(flown(kept, rows[first : first + part]))
        assert "it is gone" in kept.note
        away.rename(folder)
        settled(flown(kept, rows[first + part : first + 2 * part]))
        assert kept.note.endswith("packs.sqlite is back")
    said = capsys.readouterr().err
    assert said.count("it is gone") == said.count("packs.sqlite is back") == 2


def test_a_ledger_that_was_replaced_in_the_air_holds_the_rest_of_the_flight(tmp_path, rows):
    path, half = tmp_path / "packs.sqlite", len(rows) // 2
    kept = flown(keeper(path), rows[:half])
    settled(kept)
    path.rename(tmp_path / "first.sqlite")
    Ledger(path).close()
    flown(kept, rows[half:]).close(rows[-1].time_s)
    with Ledger(path) as ledger:
        (found,) = ledger.flights("A")
    assert found.flight.duration_s == pytest.approx(rows[-1].time_s - rows[half].time_s, abs=30.0)


def test_a_pack_that_is_forgotten_in_the_air_is_not_tried_for_ever(tmp_path, rows):
    path = tmp_path / "packs.sqlite"
    kept = flown(keeper(path), rows[: len(rows) // 2])
    settled(kept)
    with Ledger(path) as ledger:
        assert ledger.forget("A")
    settled(flown(kept, rows[len(rows) // 2 :]))
    assert not kept._landing
    kept.close(rows[-1].time_s)


def test_what_a_flight_taught_is_known_after_its_landing(tmp_path, rows):
    kept = keeper(tmp_path / "packs.sqlite")
    assert kept.meet(0, "A", None, 0.0).result() is None
    flown(kept, rows)
    health = kept.meet(0, "A", None, rows[-1].time_s).result()
    assert math.exp(health.log_Ah) == pytest.approx(5.0 * (1.0 - FADE), rel=0.05)
    kept.close(rows[-1].time_s)
    assert "flight remembered" in kept.note


def test_a_name_that_is_stated_goes_before_the_serial(tmp_path, rows):
    path = tmp_path / "packs.sqlite"
    flown(keeper(path, stated="left"), rows).close(rows[-1].time_s)
    with Ledger(path) as ledger:
        assert [pack.name for pack in ledger.packs()] == ["left"]


def test_a_pack_without_a_name_is_said_once_it_flies(tmp_path, rows):
    kept = flown(keeper(tmp_path / "packs.sqlite"), rows[:5], serial="")
    assert kept.note == ""
    flown(kept, rows[:60], serial="")
    assert "battery 0 tells no serial" in kept.note and "--pack NAME" in kept.note
    kept.close(rows[60].time_s)
