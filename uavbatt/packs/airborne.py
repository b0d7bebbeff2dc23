"""Rows of flights that have not landed yet, kept in the ledger so that a crash in flight loses none of them.

The rows are means over ROW_S (half an hour: 900 rows of 40 bytes) and are deleted after the landing.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from typing import NamedTuple

from uavbatt.packs.ledger import Ledger
from uavbatt.packs.rows import column_value, known_or_nan, reading
from uavbatt.records import Sample

ROW_S = 2.0


class Airborne(NamedTuple):
    """Airborne holds a flight in the air: pack name and size, start [s since 1970], NaN where no clock was set."""

    name: str
    start_utc_s: float
    cells: int
    capacity_Ah: float
    cycles: int | None = None


class UnfinishedFlight(NamedTuple):
    """UnfinishedFlight holds a flight and its rows that an earlier process left open in the ledger."""

    number: int
    flight: Airborne
    rows: tuple[Sample, ...]

    @property
    def last_utc_s(self) -> float:
        """Return the time of its last row [s since 1970]."""
        return self.flight.start_utc_s + (self.rows[-1].time_s if self.rows else 0.0)


def store_flight(ledger: Ledger, flight: Airborne) -> int:
    """Store a flight that has begun; return the number under which it is kept."""
    row = (flight.name, column_value(flight.start_utc_s), flight.cells, flight.capacity_Ah, flight.cycles)
    with ledger.writing() as connection:
        found = connection.execute(
            "INSERT INTO airborne (name, start_utc_s, cells, capacity_Ah, cycles) VALUES (?, ?, ?, ?, ?)", row
        )
    return int(found.lastrowid or 0)


def store_rows(ledger: Ledger, number: int, rows: Sequence[Sample]) -> None:
    """Append rows to a flight; their times count from its start [s]."""
    values = [(number, r.time_s, r.voltage_V, column_value(r.current_A), column_value(r.temp_C)) for r in rows]
    with ledger.writing() as connection:
        connection.executemany("INSERT OR REPLACE INTO rows VALUES (?, ?, ?, ?, ?)", values)


def left_over(ledger: Ledger) -> list[UnfinishedFlight]:
    """Return the flights that are still open in the ledger."""
    with ledger.reading() as connection:
        found = connection.execute("SELECT * FROM airborne ORDER BY id").fetchall()
        return [_left_over(connection, row) for row in found]


def delete_flight(ledger: Ledger, number: int) -> None:
    """Delete an open flight that shows nothing of its pack."""
    with ledger.writing() as connection:
        connection.execute("DELETE FROM airborne WHERE id = ?", (number,))


def _left_over(connection: sqlite3.Connection, row: sqlite3.Row) -> UnfinishedFlight:
    with reading(row):
        pack = Airborne(row["name"], known_or_nan(row["start_utc_s"]), row["cells"], row["capacity_Ah"], row["cycles"])
        return UnfinishedFlight(int(row["id"]), pack, _rows(connection, int(row["id"])))


def _rows(connection: sqlite3.Connection, number: int) -> tuple[Sample, ...]:
    found = connection.execute("SELECT * FROM rows WHERE flight = ? ORDER BY time_s", (number,))
    return tuple(
        Sample(r["time_s"], r["voltage_V"], known_or_nan(r["current_A"]), known_or_nan(r["temp_C"])) for r in found
    )
