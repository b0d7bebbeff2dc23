"""Order and cleaning of the rows of every log format, in one place.

A reader adds the rows that it decodes, in log order. No rule looks ahead, so that a log cut at any instant gives the
same rows up to it.

Time is seconds from the first record with a time. If a vehicle's clock falls back by 1 s or more, the vehicle was
rebooted. How long it was off and whether its pack was changed is unknown, so time goes on after a gap that counts as a
silence, and the same rules hold as in flight (`estimation.pack_change`). If a ground clock is set again (`.tlog`), or
any clock leaps a day ahead, there was no silence: time goes on after 1 s. A monotonic clock, live or in a recording of
`live`, cannot leap: a step of days is a silence of days (`longest_step_s`).

These are the rules for one row. `column_rules` has the same rules for whole columns, for the readers of big logs.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from uavbatt.mavlink.fields import PackIdentity
from uavbatt.navigation import Navigation
from uavbatt.records import NAN, Identity, Sample

if TYPE_CHECKING:
    from uavbatt.telemetry.columns import Columns

REBOOT_STEP_S = 1.0
LEAP_S = 86_400.0  # no flight log spans a day; a clock without battery backup leaps years
CLOCK_GAP_S, REBOOT_GAP_S = 1.0, 10.0  # a longer gap would count charge that was not drawn, after a reboot in the air
MAX_VOLTAGE_V = 200.0
MAX_CURRENT_A = 2000.0
IMPOSSIBLE_CURRENTS = "impossible currents set to unknown"
# Rules for MAVLink, the same in flight and in a tlog (`link.vehicle` explains them).
FALLBACK_AFTER_S = 5.0  # until it is clear that no better source of a battery comes
ALONE_AFTER_S = 5.05  # no multiple of a usual period, so that rounding does not decide
LONGEST_ALONE_S = 2.0  # the longest time that one SYS_STATUS counts for
BEATING_S = 3.0  # two heartbeats this close are in a row
CARRYING = 0.4  # share of the strongest battery's energy; two in parallel give about the same


@dataclass(slots=True)
class LogBuilder:
    """LogBuilder collects what was read of one file so far; it is mutable, and is used by the file's reader only."""

    rows: dict[int, list[Sample]] = field(default_factory=dict)
    columns: dict[int, Columns] = field(default_factory=dict)  # readers of big logs fill these instead of `rows`
    parameters: list[tuple[float, str, float]] = field(default_factory=list)
    armed: bool | None = None
    notes: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    skipped_bytes: int = 0
    identity: Identity = field(default_factory=Identity)
    packs: dict[int, PackIdentity] = field(default_factory=dict)  # by number of the battery
    serials: dict[int, list[tuple[float, str]]] = field(default_factory=dict)  # of each battery's packs, with time [s]
    navigation: tuple[Navigation, ...] = ()
    now_s: float = 0.0
    longest_step_s: float = LEAP_S  # a longer step ahead is a leap of the clock
    reboot_gap_s: float = REBOOT_GAP_S  # gap after a clock that fell back
    forecast_period_s: float = NAN  # period of the process that made the recording
    _raw_s: float = NAN
    _offset_s: float = NAN

    @property
    def offset_s(self) -> float:
        """Return the offset that is now added to the log's own clock [s]; NaN before the first reading."""
        return self._offset_s

    def time_s(self, raw_s: float) -> float:
        """Return the time since the first record [s] of a reading of the log's own clock [s]; update `now_s`."""
        if not math.isfinite(raw_s):
            return self.now_s
        if math.isnan(self._raw_s):
            self._raw_s, self._offset_s = raw_s, -raw_s
            return 0.0
        step_s = raw_s - self._raw_s
        if step_s <= -REBOOT_STEP_S or step_s > self.longest_step_s:
            what, gap_s = ("reboot", self.reboot_gap_s) if step_s < 0 else ("clock leap", CLOCK_GAP_S)
            self.notes.append(f"{what} at {self.now_s:.1f} s: time goes on after a gap of {gap_s:g} s")
            self._offset_s = self.now_s + gap_s - raw_s
            self._raw_s = raw_s
        self._raw_s = max(self._raw_s, raw_s)
        time_s = round(raw_s + self._offset_s, 6)  # microseconds are what the logs hold
        self.now_s = max(self.now_s, time_s)
        return time_s

    def add(self, instance: int, sample: Sample) -> bool:
        """Add a row, unless its voltage is impossible or it is earlier than the last row; return True if it was added.

        A first row from just before the log's first record gets the time of that record.
        """
        kept = self.rows.get(instance, [])
        if not 0 < sample.voltage_V <= MAX_VOLTAGE_V:
            self.counts["rows without a possible voltage dropped"] += 1
            return False
        if sample.time_s < 0 and not kept:
            sample = replace(sample, time_s=0.0)
        if kept and sample.time_s < kept[-1].time_s:
            self.counts["rows out of order dropped"] += 1
            return False
        if abs(sample.current_A) > MAX_CURRENT_A:
            self.counts[IMPOSSIBLE_CURRENTS] += 1
            sample = replace(sample, current_A=NAN)
        self.rows.setdefault(instance, kept).append(sample)
        return True

    def add_parameter(self, time_s: float, name: str, value: float) -> None:
        """Add a vehicle parameter, which is in force from `time_s` [s] on."""
        if self.parameters:
            time_s = max(time_s, self.parameters[-1][0])
        self.parameters.append((max(time_s, 0.0), name, finite_or_nan(value)))

    def all_notes(self) -> list[str]:
        """Return the notes in the order of reading, then the counts."""
        counted = [f"{n} {what}" for what, n in self.counts.items()]
        damaged = [f"{self.skipped_bytes} bytes not readable, skipped"] if self.skipped_bytes else []
        return self.notes + damaged + counted


def finite_or_nan(value: float) -> float:
    """Return `value`, or NaN if it is infinite."""
    return value if math.isfinite(value) else NAN


def default_instance(log: LogBuilder) -> int:
    """Return the battery that carries the flight: of those that give most of the energy, the first to report a current.

    If none reports a current, it is the first with a voltage.
    """
    from uavbatt.telemetry.columns import rows_of
    from uavbatt.telemetry.quality.drawn import given_J

    if len(log.columns or log.rows) == 1:
        return next(iter(log.columns or log.rows))
    there = log.columns or {number: rows_of(rows) for number, rows in log.rows.items()}
    # min() takes the first of equals, and a dict keeps the order of the log: of equals the earlier battery is taken.
    first_s = {number: rows.first_current_s for number, rows in there.items() if not math.isnan(rows.first_current_s)}
    given = {number: given_J(there[number]) for number in first_s}
    most_J = max(given.values(), default=0.0)
    carrying = [number for number, energy_J in given.items() if energy_J >= CARRYING * most_J]
    return min(carrying or first_s or there, key=lambda number: first_s.get(number, 0.0))
