"""Identity and size of smart batteries in PX4 logs: serial, count of cycles, cells, capacity.

The serial is a number in `battery_status`; since PX4 1.16 it is a text, there or in `battery_info`, which has the id of
the battery. 0 and 65535 mean that a number is not known.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from uavbatt.mavlink.fields import PackIdentity, known_serial
from uavbatt.records import NAN

OF_PACKS = ("battery_status", "battery_info")
_SERIAL_LETTERS = 32
_UNKNOWN = (0, 65535)


def packs(ulog: Any) -> Iterator[tuple[int, PackIdentity]]:
    """Yield the time of the first row of each battery [us], and what the pack states of itself."""
    told = [topic for topic in ulog.data_list if topic.name in OF_PACKS and len(topic.data["timestamp"])]
    serials = {_first(t.data, "id"): _text(t.data) for t in reversed(told) if t.name == "battery_info"}
    for topic in told:
        if topic.name == "battery_status":
            data = topic.data
            number = _number(data, "serial_number")
            texts = (_text(data), serials.get(_first(data, "id"), ""), "" if number is None else f"{number}")
            capacity_mAh, health = _number(data, "capacity"), _number(data, "state_of_health")
            capacity_Ah = NAN if capacity_mAh is None else capacity_mAh / 1000.0
            yield (
                int(data["timestamp"][0]),
                PackIdentity(
                    topic.multi_id,
                    known_serial(next(filter(None, texts), "")),
                    _number(data, "cycle_count"),
                    _number(data, "cell_count"),
                    capacity_Ah,
                    NAN if health is None else capacity_Ah * health / 100.0,
                ),
            )


def _first(columns: Any, name: str) -> int:
    """Return the first value of a column; 0 if there is no such column."""
    return int(columns[name][0]) if name in columns else 0


def _number(columns: Any, name: str) -> int | None:
    """Return what a pack states in a column at first; None where it states nothing."""
    first = _first(columns, name)
    return None if first in _UNKNOWN else first


def _text(columns: Any) -> str:
    """Return the serial number that a topic holds as text at first; empty where it holds none."""
    letters = (_first(columns, f"serial_number[{k}]") & 0xFF for k in range(_SERIAL_LETTERS))
    return bytes(letters).split(b"\0")[0].decode("latin-1")
