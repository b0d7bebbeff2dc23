"""One telemetry row of a battery in flight, the messages that it is read from, and when it counts."""

from __future__ import annotations

from typing import Any, NamedTuple

from uavbatt.mavlink import fields
from uavbatt.records import Sample

CONFIRMED_WITHIN_S = 60.0
BATTERY_IDS = (fields.BATTERY_STATUS, fields.SYS_STATUS, fields.BATTERY2)


class LiveRow(NamedTuple):
    """A LiveRow is one telemetry row of one battery."""

    instance: int
    sample: Sample


def battery_fields(message_id: int, message: Any) -> fields.BatteryFields:
    """Return a battery message (one of BATTERY_IDS) in SI units."""
    if message_id == fields.BATTERY_STATUS:
        return fields.battery_status(message)
    return fields.sys_status(message) if message_id == fields.SYS_STATUS else fields.battery2(message)


def heard_twice(row: LiveRow, known: set[int], first_rows: dict[int, LiveRow]) -> list[LiveRow]:
    """Return the rows to use: none at the first row of a battery, both rows at its second, then each row.

    known : the batteries that were heard twice; first_rows : the first rows of others. Both are updated.
    """
    if row.instance in known:
        return [row]
    first = first_rows.pop(row.instance, None)
    if first is None or row.sample.time_s - first.sample.time_s > CONFIRMED_WITHIN_S:
        first_rows[row.instance] = row
        return []
    known.add(row.instance)
    return [first, row]
