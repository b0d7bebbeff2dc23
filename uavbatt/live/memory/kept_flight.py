"""The rows of one battery on their way to the pack ledger.

rows -> means over ROW_S -> the last half minute on the ground, then the flight -> taken by the thread that writes
"""

from __future__ import annotations

import math
from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass, field, replace

from uavbatt.battery.remembered import PackHealth
from uavbatt.packs.airborne import ROW_S, Airborne
from uavbatt.records import NAN, Sample

BEFORE_S = 30.0  # rest before the take-off that is kept, for the rested voltage
MOST_ROWS = 3600  # rows that may wait to be written: two hours


def _waiting() -> deque[Sample]:
    return deque(maxlen=MOST_ROWS)


@dataclass(slots=True)
class FlightInAir:
    """FlightInAir holds a flight in the air: the loop adds rows, the writing thread takes them."""

    flight: Airborne
    start_s: float  # monotonic
    number: int | None = None  # in the ledger; None until it is stored
    ledger: object = None  # the open ledger that holds it under this number
    rows: deque[Sample] = field(default_factory=_waiting)  # not stored yet; times from the start
    writing: Future[None] | None = None

    @property
    def is_to_be_written(self) -> bool:
        """Return True if no write is queued; a queued one will take all rows that are there by then."""
        return self.writing is None or self.writing.running() or self.writing.done()

    def take_rows(self) -> list[Sample]:
        """Remove and return the rows that wait."""
        return [self.rows.popleft() for _ in range(len(self.rows))]

    def give_back(self, rows: list[Sample]) -> None:
        """Put rows back, before those that have come since."""
        self.rows.extendleft(reversed(rows))


@dataclass(slots=True)
class LedgerBattery:
    """LedgerBattery holds the pack name of one battery, its health, its rows on the ground, and its flight."""

    name: str
    health: Future[PackHealth | None]
    cycles: int | None = None
    flying: FlightInAir | None = None
    disarmed_s: float = NAN
    last_s: float = NAN
    block: list[Sample] = field(default_factory=list)
    rows: deque[Sample] = field(default_factory=_waiting)  # before the flight; monotonic times
    flushed_s: float = -math.inf

    def add(self, sample: Sample, now_s: float) -> None:
        """Take in one row at a monotonic time [s]."""
        self.last_s = now_s
        self.block.append(replace(sample, time_s=now_s))
        if now_s - self.block[0].time_s >= ROW_S:
            self.rows.append(mean_row(self.block))
            self.block = []

    def settle(self, is_armed: bool, now_s: float) -> None:
        """Note since when the pack is disarmed, and drop rows that are too old to precede a take-off."""
        self.disarmed_s = NAN if is_armed else self.disarmed_s if math.isfinite(self.disarmed_s) else now_s
        while self.flying is None and self.rows and self.rows[0].time_s < now_s - BEFORE_S:
            self.rows.popleft()

    def hand_over(self, flying: FlightInAir) -> None:
        """Add the rows to the flight."""
        flying.rows.extend(replace(row, time_s=row.time_s - flying.start_s) for row in self.rows)
        self.rows.clear()


def mean_row(block: list[Sample]) -> Sample:
    """Return the mean of several rows as one row."""
    temps = [row.temp_C for row in block if math.isfinite(row.temp_C)]
    count = len(block)
    return Sample(
        time_s=sum(row.time_s for row in block) / count,
        voltage_V=sum(row.voltage_V for row in block) / count,
        current_A=sum(row.current_A for row in block) / count,
        temp_C=sum(temps) / len(temps) if temps else NAN,
        armed=block[-1].armed,
    )
