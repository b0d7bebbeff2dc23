"""The first pass of a fleet with a pack ledger: the record of each flight, independent of all others."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from uavbatt.fleet.fly import Job, read
from uavbatt.fleet.logs import LogFile, Unreadable
from uavbatt.fleet.row import BAD, LOST, OK
from uavbatt.nan_equal import nan_equal
from uavbatt.packs.exchange import flight_of, plain_flight
from uavbatt.packs.records import FlightRecord
from uavbatt.packs.remembering import flight_for_ledger, key_of, name_of
from uavbatt.records import NAN, Flight
from uavbatt.telemetry.discharges import of_discharges


@nan_equal
@dataclass(frozen=True, slots=True, kw_only=True)
class Lesson:
    """A Lesson holds the record of a flight for the ledger. `status`: OK, or BAD or LOST if its log could not be read.

    pack : the pack's serial, empty if the log has none; key : the flight's key in the ledger; start_utc_s : its
    start [s since 1970], NaN if no clock was set; taught : the record, None if the flight shows nothing
    """

    file: str
    status: str = OK
    pack: str = ""
    key: str = ""
    start_utc_s: float = NAN
    taught: FlightRecord | None = None

    def plain(self) -> dict[str, Any]:
        """Return it as a dictionary of plain values; NaN becomes None."""
        return {
            "file": self.file,
            "status": self.status,
            "pack": self.pack,
            "log": self.key,
            "start_utc_s": self.start_utc_s if math.isfinite(self.start_utc_s) else None,
            "taught": plain_flight(self.taught) if self.taught is not None else None,
        }


def lesson_of(plain: Mapping[str, Any]) -> Lesson:
    """Return the lesson of a dictionary that `Lesson.plain` made. Raises ValueError for any other."""
    try:
        lesson = Lesson(
            file=msgspec.convert(plain["file"], str),
            status=msgspec.convert(plain["status"], str),
            pack=msgspec.convert(plain["pack"], str),
            key=msgspec.convert(plain["log"], str),
            start_utc_s=NAN if plain["start_utc_s"] is None else msgspec.convert(plain["start_utc_s"], float),
            taught=flight_of(plain["taught"]) if plain["taught"] is not None else None,
        )
    except (KeyError, msgspec.ValidationError) as error:
        raise ValueError(str(error)) from None
    if lesson.status not in (OK, BAD, LOST):
        raise ValueError(f"status `{lesson.status}`")
    return lesson


def learn(log: LogFile, job: Job) -> tuple[Lesson, ...]:
    """Return the lesson of each flight of a log; no content of the log makes it raise an error."""
    try:
        return tuple(_lesson(flight, log, job) for flight in of_discharges(read(log, job)))
    except Unreadable as error:
        return lost_lessons(log, str(error))
    except Exception:  # whatever it is, the row of the flight will say it
        return (Lesson(file=log.name, status=BAD),)


def _lesson(flight: Flight, log: LogFile, job: Job) -> Lesson:
    name, start_utc_s = name_of(flight), flight.identity.start_utc_s
    record = flight_for_ledger(job.battery, job.options, flight, now_utc_s=time.time()).record if name else None
    return Lesson(file=log.name, pack=name, key=key_of(flight.samples), start_utc_s=start_utc_s, taught=record)


def lost_lessons(log: LogFile, _: str) -> tuple[Lesson]:
    """Return the lesson of a log that could not be read, or whose worker died; the log's row will say why."""
    return (Lesson(file=log.name, status=LOST),)
