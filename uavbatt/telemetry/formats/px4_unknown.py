"""The values by which PX4 says in battery_status that it does not know, in ULog files and in tables of `ulog2csv`."""

from __future__ import annotations

from uavbatt.records import NAN

_UNKNOWN = {
    "current_a": -1.0,
    "current_filtered_a": -1.0,
    "discharged_mah": -1.0,
    "remaining": -1.0,
    "temperature": 0.0,
}


def px4_value(column: str, value: float) -> float:
    """Return the value that a column of battery_status holds, NaN where it stands for unknown; the unit is PX4's."""
    return NAN if value == _UNKNOWN.get(column) else value
