"""The rows of a flight as columns, thinned for charts without hiding anything.

Of each interval of time, the rows with the least and the greatest value of each column are kept, so that no sag or
spike is lost. A band is thinned to its outer edges, so that it never becomes narrower.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.log_replay.run import ReplayedRow
from uavbatt.records import Status

Array = NDArray[np.float64]
BUCKETS = 360  # of a curve: about one for every px of a panel
MOST_STRETCHES = 24  # rows of a table that a person may read
# A step this many times the usual one, and this long, is a gap: nothing is drawn across it.
GAP_STEPS, GAP_S = 8.0, 5.0
GAP = "no row in the log"
SHORT_BREAK_S = 10.0  # a warning that is away for less goes on: a refusal between two loads


@dataclass(frozen=True, slots=True)
class FlightSeries:
    """FlightSeries holds the columns of a flight; a refused number is NaN.

    The filter takes rows in blocks and has one innovation a block: `innovation_V` is NaN at the rows between.
    `innovation_sd_V` is what it expected of it, recovered from its NIS: exact where only voltage was measured; with
    a temperature beside it a lower bound, raised to the greatest one nearby.
    """

    time_s: Array
    voltage_V: Array
    predicted_V: Array
    innovation_V: Array
    innovation_sd_V: Array
    current_A: Array
    temp_C: Array
    core_C: Array
    soc: Array
    soc_sd: Array
    remaining_s: Array
    lo_s: Array
    hi_s: Array


@dataclass(frozen=True, slots=True)
class Stretch:
    """A Stretch is a sequence of rows that were refused or still converging, with the first and the last reason.

    A gap between rows is a stretch too: `stale`, with no rows.
    """

    begin_s: float
    end_s: float
    status: Status
    reason: str
    last_reason: str
    rows: int

    @property
    def duration_s(self) -> float:
        """Return the duration [s]."""
        return self.end_s - self.begin_s


class WarningSpan(NamedTuple):
    """WarningSpan holds when a warning held: first and last time [s], begin of the last stretch [s], number of rows.

    A break shorter than SHORT_BREAK_S ends no stretch.
    """

    since_s: float
    until_s: float
    again_s: float
    rows: int


def warnings_of(steps: Sequence[ReplayedRow]) -> dict[str, WarningSpan]:
    """Return every warning of a replay with its span, in order of time."""
    spans: dict[str, WarningSpan] = {}
    gone_s: dict[str, float] = {}
    for estimate in (step.estimate for step in steps):
        now_s = estimate.time_s
        for words in estimate.warnings:
            before = spans.get(words, WarningSpan(now_s, now_s, now_s, 0))
            again_s = before.again_s if now_s - gone_s.pop(words, now_s) < SHORT_BREAK_S else now_s
            spans[words] = WarningSpan(before.since_s, now_s, again_s, before.rows + 1)
        for words in spans:
            if words not in estimate.warnings:
                gone_s.setdefault(words, now_s)
    return spans


def is_gap(time_s: Array) -> NDArray[np.bool_]:
    """Mark the rows that are followed by a gap."""
    steps = np.diff(time_s)
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else math.inf
    gaps: NDArray[np.bool_] = np.append(steps > max(GAP_STEPS * usual, GAP_S), False)
    return gaps


def with_gaps(rows: FlightSeries) -> FlightSeries:
    """Add an empty row after each row before a gap, so that no line crosses it."""
    after = np.flatnonzero(is_gap(rows.time_s)) + 1
    if not after.size:
        return rows
    empty = {
        f.name: np.insert(getattr(rows, f.name), after, math.nan) for f in fields(FlightSeries) if f.name != "time_s"
    }
    return FlightSeries(time_s=np.insert(rows.time_s, after, rows.time_s[after - 1]), **empty)


def rows(steps: Sequence[ReplayedRow]) -> FlightSeries:
    """Turn the rows of a replay into columns."""
    e, r = [s.estimate for s in steps], [s.remaining for s in steps]
    blind = np.array([x.status is Status.REFUSED for x in e], dtype=bool)
    mute = blind | np.array([x.status is Status.REFUSED for x in r], dtype=bool)

    def column(values: list[float], hidden: NDArray[np.bool_] | None = None) -> Array:
        array = np.array(values, dtype=float)
        return array if hidden is None else np.where(hidden, math.nan, array)

    nis = column([x.nis for x in e])
    innovation = column([x.innovation_V for x in e], np.isnan(nis))
    return FlightSeries(
        time_s=column([x.time_s for x in e]),
        voltage_V=column([x.voltage_V for x in e]),
        predicted_V=column([x.predicted_voltage_V for x in e]),
        innovation_V=innovation,
        innovation_sd_V=innovation_sd(innovation, nis, column([x.temp_C for x in e])),
        current_A=column([x.current_A for x in e]),
        temp_C=column([x.temp_C for x in e]),
        core_C=column([x.core_temp_C for x in e]),
        soc=column([x.soc for x in e], blind),
        soc_sd=column([x.soc_sd for x in e], blind),
        remaining_s=column([x.remaining_s for x in r], mute),
        lo_s=column([x.remaining_lo_s for x in r], mute),
        hi_s=column([x.remaining_hi_s for x in r], mute),
    )


def innovation_sd(innovation_V: Array, nis: Array, temp_C: Array, reach: int = 15) -> Array:
    """Recover the expected SD of the innovation [V] from the NIS: |ν|/√NIS for one measurement.

    If a temperature was measured too, this is a lower bound of the SD: the greatest value within `reach` rows is used.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        least = np.where(nis > 0.0, np.abs(innovation_V) / np.sqrt(nis), math.nan)
    if not np.isfinite(temp_C).any() or not np.isfinite(least).any():
        return least
    padded = np.pad(np.nan_to_num(least, nan=0.0), reach, mode="edge")
    greatest = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1).max(axis=1)
    return np.where(np.isfinite(innovation_V) & (greatest > 0.0), greatest, math.nan)


def thinned(time_s: Array, *columns: Array) -> tuple[Array, ...]:
    """Thin `time_s` and `columns` to the rows with each column's first, least, greatest and last value per bucket."""
    count = time_s.size
    if count <= 4 * BUCKETS:
        return (time_s, *columns)
    mask = np.zeros(count, dtype=bool)
    for piece in np.array_split(np.arange(count), BUCKETS):
        mask[piece[[0, -1]]] = True
        for values in columns:
            finite = piece[np.isfinite(values[piece])]
            if finite.size:
                mask[finite[[np.argmin(values[finite]), np.argmax(values[finite])]]] = True
            gaps = piece[np.isnan(values[piece])]
            mask[gaps[:1]] = True
    return (time_s[mask], *(c[mask] for c in columns))


def outer(time_s: Array, low: Array, high: Array) -> tuple[Array, Array, Array]:
    """Thin a band to one value a bucket: the least of `low`, the greatest of `high`, gaps where all is NaN."""
    if time_s.size <= 2 * BUCKETS:
        return time_s, low, high
    pieces = np.array_split(np.arange(time_s.size), BUCKETS)
    middle = np.array([time_s[p].mean() for p in pieces])
    lows = np.array([np.min(low[p], initial=math.inf, where=np.isfinite(low[p])) for p in pieces])
    highs = np.array([np.max(high[p], initial=-math.inf, where=~np.isnan(high[p])) for p in pieces])
    unknown = np.isinf(lows)
    return middle, np.where(unknown, math.nan, lows), np.where(unknown, math.nan, highs)


def stretches(steps: Sequence[ReplayedRow]) -> list[Stretch]:
    """List the stretches that were refused, converging or without rows; near neighbours are joined if there are
    many."""
    spans: list[Stretch] = []
    gap = is_gap(np.array([s.estimate.time_s for s in steps], dtype=float))
    for i, step in enumerate(steps):
        speaker = step.estimate if step.estimate.status is Status.REFUSED else step.remaining
        begin_s = step.estimate.time_s
        after_s = steps[i + 1].estimate.time_s if i + 1 < len(steps) else begin_s
        end_s = begin_s if gap[i] else after_s
        if speaker.status in (Status.REFUSED, Status.CONVERGING):
            _extend(spans, Stretch(begin_s, end_s, speaker.status, speaker.reason, speaker.reason, 1))
        if gap[i]:
            spans.append(Stretch(begin_s, after_s, Status.STALE, GAP, GAP, 0))
    whole_s = steps[-1].estimate.time_s - steps[0].estimate.time_s if steps else 0.0
    share = 0.002
    while len(spans) > MOST_STRETCHES and share < 1.0:
        spans, share = _run_together(spans, share * whole_s), share * 2.0
    return spans


def _extend(spans: list[Stretch], row: Stretch) -> None:
    """Add the stretch of one row, or extend the last stretch if it continues."""
    last = spans[-1] if spans else None
    if last and last.end_s == row.begin_s and _alike(last, row.status, row.reason):
        spans[-1] = replace(last, end_s=row.end_s, last_reason=row.reason, rows=last.rows + 1)
    else:
        spans.append(row)


def _alike(stretch: Stretch, status: Status, reason: str) -> bool:
    """Return True if status and reason are the same, apart from numbers in the reason."""
    return stretch.status is status and _wordless(stretch.last_reason) == _wordless(reason)


def _wordless(reason: str) -> str:
    return re.sub(r"[\d.,]+", "#", reason)


def _run_together(spans: list[Stretch], gap_s: float) -> list[Stretch]:
    """Return the stretches with neighbours of one kind joined if less than `gap_s` [s] lies between them."""
    out: list[Stretch] = []
    latest: dict[tuple[str, str], int] = {}
    for stretch in spans:
        kind = (stretch.status.value, _wordless(stretch.reason))
        at = latest.get(kind)
        if at is not None and stretch.begin_s - out[at].end_s <= gap_s:
            out[at] = replace(
                out[at], end_s=stretch.end_s, last_reason=stretch.last_reason, rows=out[at].rows + stretch.rows
            )
        else:
            latest[kind] = len(out)
            out.append(stretch)
    return out
