"""The ledger file: counted once, in order of time, whole after a kill, and refused where it cannot be."""

from __future__ import annotations

import itertools
import math
import os
import random
import signal
import sqlite3
import time
from dataclasses import replace
from pathlib import Path

import pytest
from packs.made import flight

from uavbatt.battery.high_voltage import ORDINARY_FULL_V
from uavbatt.errors import BadInput
from uavbatt.packs import airborne, schema
from uavbatt.packs.ledger import AnotherSize, Ledger
from uavbatt.records import Sample

FLIGHTS = [flight(k, 1.0 + 0.02 * k, 1.0 - 0.01 * k) for k in range(4)]
FLYING = airborne.Airborne("A", 1.79e9, 4, 5.0)


def content(path: Path) -> list[tuple[object, ...]]:
    with sqlite3.connect(path) as connection:
        names = [row[1] for row in connection.execute("PRAGMA table_info(flights)") if row[1] not in ("id", "pack")]
        found = list(connection.execute(f"SELECT {', '.join(names)} FROM flights ORDER BY start_utc_s"))
        return found + list(connection.execute("SELECT * FROM packs"))


def test_the_order_of_replay_changes_nothing(tmp_path):
    found = []
    for number, order in enumerate(itertools.permutations(FLIGHTS)):
        path = tmp_path / f"{number}.sqlite"
        with Ledger(path) as ledger:
            for one in order:
                ledger.save("A", one)
        found.append(content(path))
    assert all(one == found[0] for one in found)


def test_a_flight_counts_once_however_often_it_is_replayed(tmp_path):
    path = tmp_path / "packs.sqlite"
    with Ledger(path) as ledger:
        for one in FLIGHTS * 3:
            ledger.save("A", one)
        assert ledger.pack("A").outlook.flights == len(FLIGHTS)


def test_two_logs_of_one_flight_count_once_and_the_longer_one_stays(tmp_path):
    whole = FLIGHTS[0]
    cut = replace(whole, key="cut", start_utc_s=whole.start_utc_s + 30.0, duration_s=300.0)
    for number, order in enumerate(([whole, cut], [cut, whole])):
        with Ledger(tmp_path / f"{number}.sqlite") as ledger:
            for one in order:
                ledger.save("A", one)
            (found,) = ledger.flights("A")
            assert found.flight.key == whole.key


def test_a_flight_without_a_clock_is_none_of_those_that_have_one(tmp_path):
    clockless = replace(FLIGHTS[0], key="clockless", start_utc_s=math.nan, duration_s=300.0)
    for number, order in enumerate(([FLIGHTS[1], clockless], [clockless, FLIGHTS[1]])):
        with Ledger(tmp_path / f"{number}.sqlite") as ledger:
            for one in order:
                ledger.save("A", one)
            assert [found.flight.key for found in ledger.flights("A")] == [FLIGHTS[1].key, "clockless"]


def test_flights_whose_logs_begin_alike_are_two_where_both_have_a_clock(tmp_path):
    """Two full packs at rest give the same first rows."""
    later = replace(FLIGHTS[1], key=FLIGHTS[0].key)
    for number, order in enumerate(([FLIGHTS[0], later, later], [later, FLIGHTS[0], FLIGHTS[0]])):
        with Ledger(tmp_path / f"{number}.sqlite") as ledger:
            for one in order:
                ledger.save("A", one)
            found = [after.flight for after in ledger.flights("A")]
            assert [one.start_utc_s for one in found] == [FLIGHTS[0].start_utc_s, later.start_utc_s]
            assert [one.is_of(later.key, later.start_utc_s) for one in found] == [False, True]
            assert ledger.before("A", later.start_utc_s, later.key).flight.told == FLIGHTS[0].told


def test_a_log_that_begins_like_another_is_replaced_by_itself_alone(tmp_path):
    later = replace(FLIGHTS[1], key=FLIGHTS[0].key)
    with Ledger(tmp_path / "packs.sqlite") as ledger:
        ledger.save_all("A", [FLIGHTS[0], later])
        after = ledger.save("A", replace(later, charge_Ah=4.2))
        assert len(ledger.flights("A")) == 2
    assert after.flight.start_utc_s == later.start_utc_s
    assert after.flight.charge_Ah == 4.2


def test_the_same_log_with_and_without_a_clock_is_one_flight(tmp_path):
    clockless = replace(FLIGHTS[0], start_utc_s=math.nan)
    for number, order in enumerate(([FLIGHTS[0], clockless], [clockless, FLIGHTS[0]])):
        with Ledger(tmp_path / f"{number}.sqlite") as ledger:
            for one in order:
                ledger.save("A", one)
            (found,) = ledger.flights("A")
            assert found.flight.start_utc_s == FLIGHTS[0].start_utc_s


def test_a_log_that_is_dropped_for_a_longer_one_takes_no_other_flight_with_it(tmp_path):
    """The middle one holds all of the first and half of the last: neither of these is of the other's time."""
    start_s = FLIGHTS[0].start_utc_s
    first = replace(FLIGHTS[0], duration_s=40.0)
    last = replace(FLIGHTS[1], start_utc_s=start_s + 45.0, duration_s=155.0)
    middle = replace(FLIGHTS[2], start_utc_s=start_s, duration_s=100.0)
    with Ledger(tmp_path / "packs.sqlite") as ledger:
        ledger.save_all("A", [first, last])
        assert ledger.save("A", middle).flight.key == last.key
        assert [found.flight.key for found in ledger.flights("A")] == [first.key, last.key]


def test_a_flight_comes_back_as_it_was_saved(tmp_path):
    stated = replace(FLIGHTS[0], soc_start=0.97, cycles=12, weak_cell=2, weak_cell_V=0.05, temp_max_C=41.0)
    with Ledger(tmp_path / "packs.sqlite") as ledger:
        after = ledger.save("A", stated)
        (found,) = ledger.flights("A")
    assert found.flight.cycles == 12
    assert repr(found.flight) == repr(stated)  # NaN is not equal to itself
    assert found.known.mean == pytest.approx(after.known.mean)


def test_the_prior_of_a_flight_knows_nothing_of_later_ones_nor_of_itself(tmp_path):
    with Ledger(tmp_path / "packs.sqlite") as ledger:
        ledger.save_all("A", FLIGHTS)
        last = ledger.before("A", FLIGHTS[2].start_utc_s, FLIGHTS[2].key)
        assert last.flight.key == FLIGHTS[1].key
        assert ledger.before("A", FLIGHTS[0].start_utc_s, FLIGHTS[0].key) is None
        assert ledger.before("B", FLIGHTS[2].start_utc_s, FLIGHTS[2].key) is None


def test_flights_without_a_clock_keep_their_places_and_are_before_none_that_has_one(tmp_path):
    clockless = [replace(one, start_utc_s=math.nan) for one in FLIGHTS[:3]]
    with Ledger(tmp_path / "packs.sqlite") as ledger:
        ledger.save_all("A", clockless)
        ledger.save("A", clockless[0])  # replayed again
        assert [found.flight.key for found in ledger.flights("A")] == [one.key for one in clockless]
        assert ledger.before("A", math.nan, clockless[0].key) is None
        assert ledger.before("A", math.nan, clockless[2].key).flight.key == clockless[1].key
        assert ledger.before("A", FLIGHTS[3].start_utc_s, FLIGHTS[3].key) is None
        assert ledger.last("A").flight.key == clockless[2].key


def test_a_log_that_began_in_the_middle_of_another_flight_does_not_know_it(tmp_path):
    whole = FLIGHTS[1]
    with Ledger(tmp_path / "packs.sqlite") as ledger:
        ledger.save_all("A", FLIGHTS[:2])
        assert ledger.before("A", whole.start_utc_s + 0.7 * whole.duration_s, "cut").flight.key == FLIGHTS[0].key


DAMAGE = ["known_covariance = '[1, 2'", "known_covariance = '[]'", "known_log_ohm = 'x'", "told_log_Ah = 'x'"]


@pytest.mark.parametrize("damage", [*DAMAGE, "known_covariance = '[NaN,0,0,0,1,0,0,1,0,1]'", "findings = '{'"])
def test_a_damaged_row_is_named_and_believed_by_nobody(tmp_path, damage):
    path = tmp_path / "packs.sqlite"
    with Ledger(path) as ledger:
        ledger.save("A", FLIGHTS[0])
    with sqlite3.connect(path) as connection:
        connection.execute(f"UPDATE flights SET {damage}")
    with Ledger(path) as ledger, pytest.raises(BadInput, match=r"packs\.sqlite: .*rows are whole, found row 1: "):
        ledger.last("A")


def test_forgetting_a_pack_leaves_the_others(tmp_path):
    with Ledger(tmp_path / "packs.sqlite") as ledger:
        ledger.save("A", FLIGHTS[0])
        ledger.save("B", FLIGHTS[1])
        assert ledger.forget("A")
        assert not ledger.forget("A")
        assert [p.name for p in ledger.packs()] == ["B"]
        assert ledger.flights("A") == []


@pytest.mark.parametrize("landed", [True, False])
def test_forgetting_a_pack_forgets_its_flight_that_never_landed(tmp_path, landed):
    with Ledger(tmp_path / "packs.sqlite") as ledger:
        if landed:
            ledger.save("A", FLIGHTS[0])
        for name in "AB":
            number = airborne.store_flight(ledger, airborne.Airborne(name, 1.79e9, 4, 5.0))
            airborne.store_rows(ledger, number, [Sample(0.0, 16.0, 12.0, 25.0)])
        assert ledger.forget("A")
        assert [left.flight.name for left in airborne.left_over(ledger)] == ["B"]
        assert ledger._connection.execute("SELECT count(*) FROM rows").fetchone()[0] == 1


def test_a_pack_of_another_size_is_another_pack(tmp_path):
    with Ledger(tmp_path / "packs.sqlite") as ledger:
        ledger.save("A", FLIGHTS[0])
        with pytest.raises(AnotherSize, match="pack A: expected flights of 4 cells as before, found 6") as caught:
            ledger.save_all("A", [FLIGHTS[1], replace(FLIGHTS[2], cells=6)])
        assert caught.value.index == 1
        assert ledger.pack("A").outlook.flights == 1


def test_a_full_disk_changes_nothing_and_is_said(tmp_path):
    path = tmp_path / "packs.sqlite"
    with Ledger(path) as ledger:
        ledger.save("A", FLIGHTS[0])
        before = content(path)
        pages = ledger._connection.execute("PRAGMA page_count").fetchone()[0]
        ledger._connection.execute(f"PRAGMA max_page_count = {pages}")
        with pytest.raises(BadInput, match="found it full: nothing was changed"):
            for k in range(1, 200):
                ledger.save("A", flight(k))
        assert ledger.pack("A").outlook.flights == len(ledger.flights("A"))
    assert content(path)[: len(before) - 1] == before[:-1]


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda path: path.write_bytes(b"time_s,voltage_V\n" * 100), "found a file of another kind"),
        (lambda path: sqlite3.connect(path).execute("CREATE TABLE notes (x)"), "found another SQLite database"),
    ],
)
def test_another_file_is_refused_and_left_as_it_is(tmp_path, made, words):
    path = tmp_path / "packs.sqlite"
    made(path)
    with pytest.raises(BadInput, match=words):
        Ledger(path)


def used(path):
    """All that a command or `live` does with a ledger."""
    for only_read in (True, False):
        with Ledger(path, only_read=only_read) as ledger:
            ledger.packs(), ledger.flights("A"), ledger.before("A", 1.8e9, "k"), airborne.left_over(ledger)
            if not only_read:
                ledger.save("A", FLIGHTS[1])
                airborne.store_rows(ledger, airborne.store_flight(ledger, FLYING), [Sample(0.0, 15.0)])
                ledger.forget("A")


def test_bytes_that_are_damaged_are_named_or_do_no_harm(tmp_path):
    """Names of columns and text that are no text any more ended commands in a traceback."""
    path, dice, told = tmp_path / "packs.sqlite", random.Random(4), 0
    with Ledger(path) as ledger:
        ledger.save("A", FLIGHTS[0])
        airborne.store_rows(ledger, airborne.store_flight(ledger, FLYING), [Sample(0.0, 15.0)])
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA journal_mode = DELETE")
    whole = path.read_bytes()
    for _ in range(150):
        damaged = bytearray(whole)
        for _ in range(dice.choice((3, 40, 200))):
            damaged[dice.randrange(100, len(damaged))] = dice.randrange(256)
        path.write_bytes(damaged)
        try:
            used(path)
        except BadInput as error:
            told += 1
            assert str(path) in str(error) and "\n" not in str(error)
        for left in (path, *tmp_path.glob("packs.sqlite-*")):
            left.unlink()
    assert told > 30


def test_a_ledger_of_a_later_version_is_left_alone(tmp_path):
    path = tmp_path / "packs.sqlite"
    Ledger(path).close()
    with sqlite3.connect(path) as connection:
        connection.execute(f"PRAGMA user_version = {len(schema.MIGRATIONS) + 1}")
    with pytest.raises(BadInput, match="update uavbatt"):
        Ledger(path)


@pytest.fixture
def of_the_first_version(tmp_path):
    """A ledger with a flight, as the first version had it: without the columns and tables that came later."""
    path = tmp_path / "packs.sqlite"
    with Ledger(path) as ledger:
        ledger.save("A", FLIGHTS[0])
    with sqlite3.connect(path) as connection:
        for column in ("fullest_cell_V", "known_fullest_cell_V"):
            connection.execute(f"ALTER TABLE flights DROP COLUMN {column}")
        connection.executescript("DROP TABLE rows; DROP TABLE airborne; PRAGMA user_version = 1")
    return path


def test_a_ledger_of_the_first_version_is_read_as_it_is(of_the_first_version):
    with Ledger(of_the_first_version, only_read=True) as ledger:
        assert ledger.last("A").fullest_cell_V == ORDINARY_FULL_V
        assert math.isnan(ledger.flights("A")[0].flight.fullest_cell_V)


def test_a_ledger_of_the_first_version_is_brought_up_with_its_flights(of_the_first_version):
    with Ledger(of_the_first_version) as ledger:
        assert schema.version(ledger._connection) == len(schema.MIGRATIONS)
        ledger.save("A", FLIGHTS[1])
        assert ledger.pack("A").outlook.flights == 2


def test_reading_makes_no_file(tmp_path):
    with pytest.raises(BadInput, match="found no such file"):
        Ledger(tmp_path / "none.sqlite", only_read=True)
    assert list(tmp_path.iterdir()) == []


def write_until_killed(path: Path, first: int, saved: int) -> None:
    """Save flight after flight, and say so after each."""
    with Ledger(path) as ledger:
        for number in range(first, 10_000):
            ledger.save("A", flight(number))
            os.write(saved, b"%d\n" % number)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills a forked writer")
def test_a_kill_at_any_moment_loses_nothing_that_was_said_to_be_saved(tmp_path):
    path, chance, last = tmp_path / "packs.sqlite", random.Random(7), -1
    for _ in range(50):
        heard, saved = os.pipe()
        writer = os.fork()
        if writer == 0:
            os.close(heard)
            write_until_killed(path, last + 1, saved)
        os.close(saved)
        with os.fdopen(heard) as stream:
            stream.readline()
            time.sleep(0.02 * chance.random())
            os.kill(writer, signal.SIGKILL)
            os.waitpid(writer, 0)
            last = max([last + 1, *(int(line) for line in stream if line.endswith("\n"))])
        with Ledger(path) as ledger:
            found = [int(f.flight.key, 16) for f in ledger.flights("A")]
            assert found[: last + 1] == list(range(last + 1))
            assert len(found) <= last + 2  # saved, and killed before it could say so
            assert ledger.pack("A").outlook.flights == len(found)
            last = len(found) - 1


def test_a_flight_of_the_future_that_a_ledger_holds_is_not_the_last(tmp_path):
    """Until its date has come. A clock that is not known makes no flight one of the future."""
    yesterday_s = FLIGHTS[1].start_utc_s + 86_400.0
    with Ledger(tmp_path / "packs.sqlite") as ledger:
        ledger.save_all("A", FLIGHTS)
        assert ledger.last("A", yesterday_s).flight.key == FLIGHTS[1].key
        assert ledger.last("A", FLIGHTS[3].start_utc_s).flight.key == FLIGHTS[3].key
        assert ledger.last("A", math.nan).flight.key == FLIGHTS[3].key
        assert ledger.last("A", FLIGHTS[0].start_utc_s - 1e6) is None
