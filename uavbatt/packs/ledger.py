"""The pack ledger: one SQLite file with one writer at a time, never left half-written.

One transaction saves a flight together with the beliefs after the later flights of its pack and the pack's outlook. The
slow filter always runs over all flights of a pack in order of time, so that the order of replays changes nothing.
"""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import TracebackType

from uavbatt.battery.remembered import PackHealth
from uavbatt.errors import BadInput
from uavbatt.packs import ageing, rows, schema
from uavbatt.packs.dates import CLOCKS_APART_S
from uavbatt.packs.findings import of_battery_file
from uavbatt.packs.opening import BROKEN, file_identity, open_file, words_of
from uavbatt.packs.outlook import outlook
from uavbatt.packs.records import FlightRecord, LedgerFlight, PackRow

SHOWN_FINDINGS = 5
LONGEST_NAME = 64
OF_PACK = "SELECT flights.* FROM flights JOIN packs ON packs.id = flights.pack WHERE packs.name = :name"
LATEST = "ORDER BY start_utc_s IS NULL DESC, start_utc_s DESC, flights.id DESC LIMIT 1"
# An earlier log of the same flight does not count; without a clock, all flights count that were saved before.
BEFORE = f"""
{OF_PACK} AND CASE WHEN :start IS NOT NULL THEN start_utc_s + 0.9 * duration_s < :start
    ELSE key != :key AND (start_utc_s IS NOT NULL OR flights.id < ifnull(
        (SELECT own.id FROM flights AS own WHERE own.pack = packs.id AND own.key = :key), flights.id + 1)) END
{LATEST}
"""


class AnotherSize(BadInput):
    """AnotherSize says that a flight's pack has another number of cells than the known pack of this name.

    index : the flight's place among those to be saved
    """

    def __init__(self, path: Path, name: str, expected: int, found: int, index: int) -> None:
        words = f"flights of {expected} cells as before, found {found}: another pack under this name?"
        super().__init__(path, f"pack {name}", words)
        self.index = index


class Ledger:
    """A Ledger is an open file of packs and their flights. Reading makes no file; the first flight saved does."""

    def __init__(self, path: str | Path, *, only_read: bool = False) -> None:
        self.path = Path(path)
        self._connection = open_file(self.path, only_read)
        try:
            with self._named_errors():
                now = schema.check_schema(self._connection, self.path)
            if only_read and now == 0:
                raise BadInput(self.path, "", "a pack ledger, found an empty file")
            if not only_read and now < len(schema.MIGRATIONS):
                with self.writing() as connection:
                    schema.migrate(connection)
        except BaseException:
            self._connection.close()
            raise
        self._identity = file_identity(self.path)

    def __enter__(self) -> Ledger:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    @property
    def is_gone(self) -> bool:
        """Return True if the file is not at its path any more: what is written now would be lost."""
        return file_identity(self.path) != self._identity

    def close(self) -> None:
        """Close the file; what was saved is saved."""
        self._connection.close()

    @contextmanager
    def _named_errors(self) -> Iterator[None]:
        """Turn errors of SQLite and damaged rows into one line that names the file."""
        try:
            yield
        except rows.DamagedRow as error:
            raise BadInput(self.path, "", f"a pack ledger whose rows are whole, found {error}") from None
        except BROKEN as error:
            raise BadInput(self.path, "", words_of(error)) from None

    @contextmanager
    def reading(self) -> Iterator[sqlite3.Connection]:
        """Yield the connection, for reading. Raises BadInput for a damaged or locked file."""
        with self._named_errors():
            yield self._connection

    @contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """Yield the connection inside one transaction: everything done with it is saved, or nothing."""
        with self._named_errors():
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield self._connection
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise

    def packs(self) -> list[PackRow]:
        """Return all packs, by name."""
        with self._named_errors():
            return [rows.pack_of(row) for row in self._connection.execute("SELECT * FROM packs ORDER BY name")]

    def pack(self, name: str) -> PackRow | None:
        """Return the pack of that name; None if there is none."""
        with self._named_errors():
            row = self._connection.execute("SELECT * FROM packs WHERE name = ?", (name,)).fetchone()
            return rows.pack_of(row) if row is not None else None

    def flights(self, name: str) -> list[LedgerFlight]:
        """Return the flights of a pack in order of time, each with the belief after it."""
        with self._named_errors():
            found = self._connection.execute(OF_PACK, {"name": name})
            return [rows.remembered_of(row) for row in sorted(found, key=_moment)]

    def last(self, name: str, now_utc_s: float = math.inf) -> LedgerFlight | None:
        """Return the last flight of a pack with the belief after it; None without one.

        now_utc_s : the time now [s since 1970]; flights dated in the future do not count. NaN is unknown.
        """
        latest = now_utc_s + CLOCKS_APART_S
        return self._one(f"{OF_PACK} AND ifnull(start_utc_s <= :latest, 1) {LATEST}", {"name": name, "latest": latest})

    def before(self, name: str, start_utc_s: float, key: str) -> LedgerFlight | None:
        """Return the last flight of a pack before the flight with that key and start.

        start_utc_s : [s since 1970]; NaN if no clock was set. Such flights come after all others, in the order in which
        they were saved.
        """
        return self._one(BEFORE, {"name": name, "key": key, "start": rows.column_value(start_utc_s)})

    def _one(self, query: str, values: dict[str, object]) -> LedgerFlight | None:
        with self._named_errors():
            row = self._connection.execute(query, values).fetchone()
            return rows.remembered_of(row) if row is not None else None

    def save(self, name: str, flight: FlightRecord, landed: int | None = None) -> LedgerFlight:
        """Save a flight of a pack, and return it with the belief after it.

        A shorter record of the same flight is replaced. `landed` is the number of the open flight that ends with this
        one. Raises AnotherSize for a pack of another number of cells.
        """
        return self.save_all(name, [flight], landed)[-1]

    def save_all(self, name: str, flights: Sequence[FlightRecord], landed: int | None = None) -> list[LedgerFlight]:
        """Save many flights of one pack at once, as one by one; return those that stand in the ledger now."""
        check_name(name, self.path, "pack")
        with self.writing() as connection:
            pack = _pack_id(connection, self.path, name, flights)
            kept = [_write_flight(connection, pack, flight) for flight in flights]
            every = _work_out(connection, pack, name)
            if landed is not None:
                connection.execute("DELETE FROM airborne WHERE id = ?", (landed,))
        after = {found.flight.key: found for found in every}
        return [after[key] for key in kept if key in after]

    def forget(self, name: str) -> bool:
        """Delete a pack with all its flights, open ones too; return False if there is no pack of that name."""
        with self.writing() as connection:
            connection.execute("DELETE FROM flights WHERE pack = (SELECT id FROM packs WHERE name = ?)", (name,))
            tables = ("packs", "airborne")
            return sum(connection.execute(f"DELETE FROM {t} WHERE name = ?", (name,)).rowcount for t in tables) > 0


def check_name(name: str, path: Path, place: str) -> None:
    """Raise BadInput for a name that no pack can have; `path` and `place` say where it was found."""
    if not 0 < len(name) <= LONGEST_NAME or not name.isprintable():
        raise BadInput(path, place, f"a name of 1 to {LONGEST_NAME} printable characters, found {name!r}")


def prior(last: LedgerFlight, start_utc_s: float, battery_sha256: str) -> PackHealth:
    """Return the prior of a flight that begins at a time [s since 1970], from the belief after the flight before it."""
    days = ageing.days_between(last.flight, start_utc_s)
    health = ageing.prior(
        last.known,
        days,
        other_file=battery_sha256 != last.flight.battery_sha256,
        has_thermometer=last.flight.has_thermometer,
    )
    return health._replace(cells=last.flight.cells, fullest_cell_V=last.fullest_cell_V)


def _pack_id(connection: sqlite3.Connection, path: Path, name: str, flights: Sequence[FlightRecord]) -> int:
    """Return the number of the pack; add the pack if it is new."""
    flight = flights[0]
    row = connection.execute("SELECT id, cells FROM packs WHERE name = ?", (name,)).fetchone()
    cells = flight.cells
    if row is not None:
        with rows.reading(row):
            number, cells = int(row["id"]), int(row["cells"])
    for index, other in enumerate(flights):
        if other.cells != cells:
            raise AnotherSize(path, name, cells, other.cells, index)
    if row is None:
        nothing = outlook(ageing.first_known(flight), flight.rated_Ah, 0, flight.battery)
        pack = PackRow(name, flight.cells, flight.rated_Ah, flight.type_ohm, math.nan, nothing, ())
        found = connection.execute(*inserted("packs", rows.pack_row(pack)))
        number = int(found.lastrowid or 0)
    return number


def _write_flight(connection: sqlite3.Connection, pack: int, flight: FlightRecord) -> str:
    """Write a flight, unless a longer record of it is there; return the key of the record that stays.

    The new record takes the number of the one it replaces, because the number orders flights without a clock.
    """
    found = connection.execute("SELECT * FROM flights WHERE pack = ?", (pack,)).fetchall()
    every = {int(row["id"]): rows.flight_of(row) for row in found}
    same = {number: other for number, other in every.items() if other.is_same_as(flight)}
    own = {number for number, other in same.items() if other.is_of(flight.key, flight.start_utc_s)}
    others = [other for number, other in same.items() if number not in own]
    longest = max([flight, *others], key=lambda one: (one.duration_s, one.key))
    gone = own if longest is not flight else set(same)
    connection.executemany("DELETE FROM flights WHERE id = ?", [(number,) for number in gone])
    if longest is not flight:
        return longest.key
    for other in same.values():
        if math.isnan(flight.start_utc_s):
            flight = replace(flight, start_utc_s=other.start_utc_s)
    if any(other.key == flight.key for number, other in every.items() if number not in gone):
        flight = flight.with_own_key()
    values = {**rows.flight_row(flight), "id": min(gone, default=None), "pack": pack, "findings": ""}
    connection.execute(*inserted("flights", values))
    return flight.key


def _work_out(connection: sqlite3.Connection, pack: int, name: str) -> list[LedgerFlight]:
    """Run the slow filter over the pack's flights, and write what has changed."""
    found = sorted(connection.execute("SELECT * FROM flights WHERE pack = ?", (pack,)).fetchall(), key=_moment)
    every = ageing.history([rows.flight_of(row) for row in found])
    for row, after in zip(found, every, strict=True):
        now = rows.remembered_row(after)
        if any(row[column] != value for column, value in now.items()):
            connection.execute(*_update("flights", now, int(row["id"])))
    last = every[-1].flight
    findings = tuple(f for after in every for f in after.findings)[-SHOWN_FINDINGS:] + of_battery_file(last.battery)
    size = (name, last.cells, last.rated_Ah, last.type_ohm, last.start_utc_s)
    state = PackRow(*size, outlook(every[-1].known, last.rated_Ah, len(every), last.battery), findings)
    connection.execute(*_update("packs", rows.pack_row(state), pack))
    return every


def _moment(row: sqlite3.Row) -> tuple[float, int]:
    """Return the sort key of a flight: its start; flights without a clock come last, in the order they were saved."""
    with rows.reading(row):
        return (math.inf if row["start_utc_s"] is None else float(row["start_utc_s"]), int(row["id"]))


def inserted(table: str, row: dict[str, object]) -> tuple[str, dict[str, object]]:
    """Return the SQL statement that inserts a row into a table, and its values."""
    names = ", ".join(row)
    return f"INSERT INTO {table} ({names}) VALUES ({', '.join(':' + name for name in row)})", row


def _update(table: str, row: dict[str, object], number: int) -> tuple[str, dict[str, object]]:
    settings = ", ".join(f"{name} = :{name}" for name in row)
    return f"UPDATE {table} SET {settings} WHERE id = :number", {**row, "number": number}
