"""Firmware and time from DataFlash records; labels as in the log's own FMT records.

MSG   Message                       first the firmware's name and version
GPS   Week, TimeMS or GWk, GMS      GPS time of a fix; both are 0 before there is one
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import numpy as np

from uavbatt.records import NAN, Identity
from uavbatt.telemetry.formats.dataflash_rows import Moment, Table
from uavbatt.telemetry.identity import firmware_of, gps_utc_s

TELLING = re.compile(r"(MSG|GPS)$")
_WEEK, _TIME_OF_WEEK = ("GWk", "Week"), ("GMS", "TimeMS")


def identity(tables: Sequence[Table], first: Moment | None, head: Iterable[str] = ()) -> Identity:
    """Read who flew and when from the records of TELLING; `head`: lines before them that may name the firmware."""
    messages = [text for t in tables if t.layout.name == "MSG" for text in t.texts.get("Message", ())]
    starts = [_start_utc_s(t, first) for t in tables if t.layout.name == "GPS"]
    start_utc_s = next((s for s in starts if s == s), NAN)
    return Identity(firmware=firmware_of([*head, *messages]), start_utc_s=start_utc_s)


def _start_utc_s(table: Table, first: Moment | None) -> float:
    """Return the UTC of the log's first record, by the first GPS fix; that of the fix if GPS records carry no time."""
    week = next((table.column(label) for label in _WEEK if label in table.numbers), None)
    time_ms = next((table.column(label) for label in _TIME_OF_WEEK if label in table.numbers), None)
    if week is None or time_ms is None or not (week > 0).any():
        return NAN
    fix = int(np.argmax(week > 0))
    ticks_per_s = table.layout.ticks_per_s
    since_s = table.column(table.layout.labels[0])[fix] / ticks_per_s - first.raw_s if first and ticks_per_s else 0.0
    return gps_utc_s(float(week[fix]), float(time_ms[fix])) - float(since_s)
