"""The first pass of a fleet with a pack ledger: each flight's own word on its pack, whatever is known of the pack."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from uavbatt.fleet.fly import Job, read
from uavbatt.fleet.logs import LogFile, Unreadable
from uavbatt.fleet.row import BAD, LOST, OK
from uavbatt.packs.exchange import flight_of, plain_flight
from uavbatt.packs.records import FlightRecord
from uavbatt.packs.remembering import key_of, name_of, taught
from uavbatt.records import NAN


@dataclass(frozen=True, slots=True, kw_only=True)
class Lesson:
    """A Lesson holds what a flight says of its pack. `status`: OK, or BAD or LOST where the log could not be read.

    pack : the pack's serial, empty where the log has none; key : what the ledger knows the log by; start_utc_s : when
    the log began [s since 1970], NaN where no clock was set; taught : None where the flight says nothing.
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
    """Return the lesson of a dictionary that `Lesson.plain` made. Raises ValueError when it is none."""
    try:
        found = Lesson(
            file=msgspec.convert(plain["file"], str),
            status=msgspec.convert(plain["status"], str),
            pack=msgspec.convert(plain["pack"], str),
            key=msgspec.convert(plain["log"], str),
            start_utc_s=NAN if plain["start_utc_s"] is None else msgspec.convert(plain["start_utc_s"], float),
            taught=flight_of(plain["taught"]) if plain["taught"] is not None else None,
        )
    except (KeyError, msgspec.ValidationError) as error:
        raise ValueError(str(error)) from None
    if found.status not in (OK, BAD, LOST):
        raise ValueError(f"status `{found.status}`")
    return found


def learn(log: LogFile, job: Job) -> Lesson:
    """Return what the flight of a log says of its pack; never raises for anything that a log can cause."""
    try:
        flight = read(log, job)
        name = name_of(flight)
        found = taught(job.battery, job.options, flight).record if name else None
    except Unreadable as error:
        return no_lesson(log, str(error))
    except Exception:  # whatever it is, the row of the flight will say it
        return Lesson(file=log.name, status=BAD)
    start_utc_s = flight.identity.start_utc_s
    return Lesson(file=log.name, pack=name, key=key_of(flight.samples), start_utc_s=start_utc_s, taught=found)


def no_lesson(log: LogFile, _: str) -> Lesson:
    """Return the lesson of a log that could not be read, or whose worker died; the flight's own row will say why."""
    return Lesson(file=log.name, status=LOST)
