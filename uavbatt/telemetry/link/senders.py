"""Choice of the sender that is believed, if frames of one vehicle come from several addresses.

MAVLink frames without a signature do not prove their sender: anybody on the link can send them. One sender is believed
at a time: the first, until it falls silent or sends no more battery messages while another does. The rows of other
senders are compared with its rows, but only in the time in which both send: a sender that begins where another has
ended is the same autopilot on a new connection, and its battery is emptier by then. One autopilot on two ways gives
nearly the same readings within some seconds. If every reading of one sender lies apart from every reading of the other,
they are two batteries, and it cannot be known which of them flies.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

from uavbatt.mavlink.fields import BatteryFields
from uavbatt.telemetry.link.sequence_numbers import Stream

SENDER_SILENT_S = 2.0  # heartbeats come every second; telemetry is stale after 3 s
WORDLESS_S = 10.0  # without a word of batteries, while another has some
WINDOW_S, FEWEST_ROWS = 10.0, 4
HELD_S = 10.0  # a conflict lasts so long after the last row that disagreed
MOST_SENDERS, MOST_BATTERIES, MOST_ROWS = 4, 8, 64
# Readings of one autopilot over two links differ by what changes between their rows; ranges over seconds overlap.
APART_VOLTAGE, APART_CURRENT, APART_CURRENT_A, APART_CHARGE_AH = 0.01, 0.1, 1.0, 0.02


class SenderRow(NamedTuple):
    """A SenderRow holds one sender's readings of a battery; NaN is unknown."""

    time_s: float
    voltage_V: float
    current_A: float
    consumed_Ah: float


class Senders:
    """Senders chooses which sender of a vehicle's frames is believed, and compares the readings of all.

    A sender is an address, or another object that identifies a stream.
    """

    def __init__(self) -> None:
        self._believed: object = self  # no sender yet
        self._heard_s = self._spoke_s = -math.inf
        self._rows: dict[int, dict[object, deque[SenderRow]]] = {}
        self._conflicts: dict[int, tuple[float, str]] = {}

    def admits(self, sender: object, time_s: float, is_battery: bool) -> bool:
        """Return True if a frame of this sender, received at `time_s` [s], counts."""
        if sender != self._believed:
            is_silent = time_s - self._heard_s > SENDER_SILENT_S
            if not (is_silent or (is_battery and time_s - self._spoke_s > WORDLESS_S)):
                return False
            self._believed = sender
        self._heard_s = time_s
        if is_battery:
            self._spoke_s = time_s
        return True

    def compare(self, sender: object, battery: BatteryFields, time_s: float) -> None:
        """Compare a battery's row from any sender with the others, and note if the senders disagree."""
        if battery.id not in self._rows and len(self._rows) >= MOST_BATTERIES:
            return
        by_sender = self._rows.setdefault(battery.id, {})
        if sender not in by_sender:
            for gone in [s for s, rows in by_sender.items() if time_s - rows[-1].time_s > WINDOW_S]:
                del by_sender[gone]
            if len(by_sender) >= MOST_SENDERS:
                return
        own = by_sender.setdefault(sender, deque(maxlen=MOST_ROWS))
        own.append(SenderRow(time_s, battery.voltage_V, battery.current_A, battery.consumed_Ah))
        if len(by_sender) == 1:
            return
        for other, rows in by_sender.items():
            what = "" if other == sender else disagreement(*_together(_recent(own, time_s), _recent(rows, time_s)))
            if what:
                self._conflicts[battery.id] = (rows[-1].time_s, f"{what}{_places(other, sender)}")

    def conflict(self, battery_id: int, time_s: float) -> str:
        """Return in words which senders of a battery disagree, and on what; empty while they agree."""
        at_s, words = self._conflicts.get(battery_id, (-math.inf, ""))
        return words if time_s - at_s <= HELD_S else ""

    def conflicts(self, time_s: float) -> list[tuple[int, str]]:
        """Return the batteries whose senders disagree, with the quantity in words."""
        return [(number, words) for number in self._conflicts if (words := self.conflict(number, time_s))]


def disagreement(one: Iterable[SenderRow], other: Iterable[SenderRow]) -> str:
    """Return in words the quantity that shows that two sources are not one battery; empty if they may be one."""
    a, b = list(one), list(other)
    for name, share, least in (
        ("voltage_V", APART_VOLTAGE, 0.0),
        ("current_A", APART_CURRENT, APART_CURRENT_A),
        ("consumed_Ah", 0.0, APART_CHARGE_AH),
    ):
        left = [v for v in (getattr(row, name) for row in a) if v == v]
        right = [v for v in (getattr(row, name) for row in b) if v == v]
        if len(left) < FEWEST_ROWS or len(right) < FEWEST_ROWS:
            continue
        slack = least + share * max(map(abs, (*left, *right)))
        if min(left) > max(right) + slack or min(right) > max(left) + slack:
            return {"voltage_V": "voltage", "current_A": "current", "consumed_Ah": "charge drawn"}[name]
    return ""


def _recent(rows: Iterable[SenderRow], time_s: float) -> list[SenderRow]:
    return [row for row in rows if time_s - row.time_s <= WINDOW_S]


def _together(one: list[SenderRow], other: list[SenderRow]) -> tuple[list[SenderRow], list[SenderRow]]:
    """Return the rows of two senders from the time in which both were heard."""
    if not one or not other:
        return [], []
    first_s = max(one[0].time_s, other[0].time_s)
    last_s = min(one[-1].time_s, other[-1].time_s)
    a, b = ([row for row in rows if first_s <= row.time_s <= last_s] for rows in (one, other))
    return a, b


def _places(*senders: object) -> str:
    """Return addresses in words, in a fixed order; streams have none."""
    addresses = [s.sender if isinstance(s, Stream) else s for s in senders]
    named = [f"{s[0]}:{s[1]}" if isinstance(s, tuple) else s for s in addresses]
    places = sorted({place for place in named if isinstance(place, str) and ":" in place})
    is_one = addresses[0] == addresses[1]
    words = f"both behind {places[0]}" if is_one and places else "both on one link" if is_one else " and ".join(places)
    return f" ({words})" if words else ""
