"""Rows on disk as they come, one JSON line a log with the rows of its flights, so that a stopped run can go on.

A later run uses a row only if its key is the same: path, size and time of change of the log, content of battery file
and vehicle file, all options, the pack's health, and the version of uavbatt. Rows with other keys stay in the file
until it is tidied. A damaged row is removed at once, and its log is replayed again.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Generic, TypeVar

import msgspec

from uavbatt import __version__
from uavbatt.battery.battery_file import content_hash
from uavbatt.errors import BadInput
from uavbatt.files import atomic_write
from uavbatt.fleet.fly import Job, RememberedPack
from uavbatt.fleet.lesson import Lesson
from uavbatt.fleet.logs import LogFile
from uavbatt.fleet.row import LOST, FlightRow

Row = TypeVar("Row", FlightRow, Lesson)


def key(log: LogFile, job_key: str, met: Sequence[RememberedPack] = ()) -> str:
    """Return the key under which the rows of a finished log are kept; `met`: the packs of its flights."""
    packs = "\0".join(_health_key(one) for one in met)
    return _digest(f"{log.name}\0{log.size}\0{log.changed}\0{job_key}\0{packs}")


def _health_key(met: RememberedPack) -> str:
    health = met.health
    numbers = [] if health is None else [*health[:2], *health.covariance.ravel(), *health[3:]]
    return " ".join(f"{number:.9g}" for number in numbers) + "\0".join(met.findings)


def job_key(job: Job) -> str:
    """Return a key of all settings of a job that change its rows."""
    vehicle = msgspec.json.encode(job.vehicle).decode()
    content = "\0".join(map(repr, (job.settings, job.load, vehicle, job.by, job.aircraft_pattern)))
    return _digest(f"{lesson_key(job)}\0{content}")


def lesson_key(job: Job) -> str:
    """Return a key of all settings of a job that change the records for the ledger."""
    content = "\0".join(map(repr, (job.options, job.instance, job.join)))
    return _digest(f"{__version__}\0{content_hash(job.battery)}\0{content}")


class Journal(Generic[Row]):
    """Journal is the file of rows in an output folder, open during a run; only the places of the rows are in memory."""

    def __init__(self, path: Path, keys: Mapping[str, int], row_of: Callable[[Mapping[str, Any]], Row]) -> None:
        """Open it; raises BadInput when its folder cannot be written.

        keys : key of every log of this run -> its number; row_of : a row from its plain values, else ValueError.
        """
        self.path, folder = path, path.parent
        self._keys = keys
        self._row_of: Callable[[Mapping[str, Any]], Row] = row_of
        self._places: dict[int, int] = {}
        self._lost: set[int] = set()  # logs that an earlier run could not read; they are tried again
        self.dropped = 0  # damaged rows
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("a+b")
        except OSError as error:
            raise BadInput(folder, "", f"a folder that can be written: {error.strerror}") from None
        if not self._index():
            self._heal()

    def __enter__(self) -> Journal[Row]:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __contains__(self, number: int) -> bool:
        return number in self._places and number not in self._lost

    def __len__(self) -> int:
        return len(self._places) - len(self._lost)

    def add(self, number: int, key: str, rows: Sequence[Row]) -> None:
        """Keep the rows of log `number`; they are on disk when this returns."""
        self._places[number] = self._file.seek(0, os.SEEK_END)
        self._lost.discard(number)
        line = json.dumps({"key": key, "rows": [row.plain() for row in rows]}, allow_nan=False)
        self._file.write(line.encode() + b"\n")  # ASCII: a file name may be no text at all
        self._file.flush()

    def rows(self) -> Iterator[tuple[int, tuple[Row, ...]]]:
        """Yield (number of the log, its rows) of this run in the order of its logs, one log at a time."""
        for number in sorted(self._places):
            self._file.seek(self._places[number])
            yield number, self._rows_in(json.loads(self._file.readline()))

    def _rows_in(self, entry: Mapping[str, Any]) -> tuple[Row, ...]:
        """Return the rows of a line. Raises ValueError for any other."""
        rows = entry.get("rows")
        if not (isinstance(rows, list) and rows and all(isinstance(row, dict) for row in rows)):
            raise ValueError("expected the rows of a log")
        return tuple(map(self._row_of, rows))

    def _index(self) -> bool:
        """Find the rows of this run; return True if none is damaged. A last line that a crash cut short is removed."""
        self._file.seek(0)
        place, end, is_sound = 0, 0, True
        for line in self._file:
            number, is_lost = self._number(line)
            if number is not None and number >= 0:
                self._places[number] = place
                (self._lost.add if is_lost else self._lost.discard)(number)
            place += len(line)
            if line.endswith(b"\n"):
                end, is_sound = place, is_sound and number is not None
        self._file.truncate(end)
        self._places = {number: at for number, at in self._places.items() if at < end}
        self._lost &= self._places.keys()
        return is_sound

    def _number(self, line: bytes) -> tuple[int | None, bool]:
        """Return the number of a line's log in this run, and True if the log could not be read.

        The number is -1 for a row of another run, None for a damaged line.
        """
        entry = _parsed(line)
        if not isinstance(entry.get("key"), str):
            return None, False
        number = self._keys.get(entry["key"])
        if number is None:
            return -1, False  # of another run, perhaps by another version
        try:
            return number, self._rows_in(entry)[0].status == LOST
        except ValueError:
            return None, False

    def _heal(self) -> None:
        """Write the file anew without its damaged rows."""
        self._file.seek(0)
        with atomic_write(self.path, "wb") as healed:
            for line in self._file:
                if self._number(line)[0] is None:
                    self.dropped += 1
                else:
                    healed.write(line)
        self._file.close()
        self._file = self.path.open("a+b")
        self._places, self._lost = {}, set()
        self._index()

    def tidy(self) -> None:
        """Rewrite the file with only this run's rows, if more than half of it is old."""
        self._file.seek(0)
        if sum(1 for _ in self._file) <= 2 * len(self._places):
            return
        with atomic_write(self.path, "wb") as file:
            for number in sorted(self._places):
                self._file.seek(self._places[number])
                file.write(self._file.readline())


def _parsed(line: bytes) -> dict[str, Any]:
    try:
        entry = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return entry if isinstance(entry, dict) else {}


def _digest(text: str) -> str:
    return hashlib.blake2b(text.encode("utf-8", "surrogateescape"), digest_size=16).hexdigest()
