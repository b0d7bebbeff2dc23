"""The rules of `LogBuilder` for whole columns at once, for the readers of big logs.

A test keeps both the same. No rule looks ahead.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uavbatt.telemetry.builder import IMPOSSIBLE_CURRENTS, MAX_CURRENT_A, MAX_VOLTAGE_V, REBOOT_STEP_S, LogBuilder
from uavbatt.telemetry.columns import Column, Columns, distinct


def times_s(log: LogBuilder, raw_s: Column) -> Column:
    """Return the times since the first record [s] of readings of the log's own clock [s], as `LogBuilder.time_s`."""
    if not len(raw_s):
        return raw_s
    first_s = log.time_s(float(raw_s[0]))
    highest_s = np.maximum.accumulate(raw_s)
    step_s = raw_s[1:] - highest_s[:-1]
    if not (np.all(np.isfinite(raw_s)) and np.all((step_s > -REBOOT_STEP_S) & (step_s <= log.longest_step_s))):
        # a reboot, a leap or an unknown time is rare: work row by row
        return np.array([first_s, *(log.time_s(t) for t in raw_s[1:].tolist())])
    offset_s = log.offset_s
    log.time_s(float(highest_s[-1]))
    return np.round(raw_s + offset_s, 6)


def add_rows(log: LogBuilder, instance: NDArray[np.int64], rows: Columns) -> None:
    """Add the rows in their order; drop and correct the same rows as `LogBuilder.add`."""
    with np.errstate(invalid="ignore"):
        possible = (rows.voltage_V > 0) & (rows.voltage_V <= MAX_VOLTAGE_V)
    kept = possible.copy()
    time_s = rows.time_s.copy()
    for number in distinct(instance[possible]):
        own = np.flatnonzero(possible & (instance == number))
        time_s[own[0]] = max(time_s[own[0]], 0.0)
        kept[own] = time_s[own] >= np.maximum.accumulate(time_s[own])
    with np.errstate(invalid="ignore"):
        wild = kept & (np.abs(rows.current_A) > MAX_CURRENT_A)
    _count(log, ("rows without a possible voltage dropped", ~possible), ("rows out of order dropped", possible & ~kept),
           (IMPOSSIBLE_CURRENTS, wild))  # fmt: skip
    current_A = np.where(wild, np.nan, rows.current_A)
    cleaned = Columns(
        time_s, rows.voltage_V, current_A, rows.temp_C, rows.consumed_Ah, rows.reported_soc, rows.armed, rows.cells_V
    )
    for number in distinct(instance[kept]):
        log.columns[number] = cleaned.at(kept & (instance == number))


def _count(log: LogBuilder, *found: tuple[str, NDArray[np.bool_]]) -> None:
    """Count the dropped rows of each kind, in the order of the first row of each."""
    present = [(int(np.argmax(mask)), what, int(np.count_nonzero(mask))) for what, mask in found if mask.any()]
    for _, what, number in sorted(present):
        log.counts[what] += number
