"""Order of the batteries: the first one speaks for the vehicle, on the page, in REM_S and for the service manager.

In flight the batteries that carry it (`carriers`) come first, even while nothing is known of them. Then fresh ones come
before stale ones; in flight those that give current before those that give none; then the one with the least time left;
then the lowest number. Two packs in parallel end within seconds of each other, so the first keeps its place until
another has clearly less time. A first battery that falls silent in flight keeps it as well, its time unknown, while the
other had clearly more time beside it: the longer time of that one would pass for the vehicle's.

If a battery gives nothing in flight while another carries it, a warning says so: its charge does not help the aircraft.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from uavbatt.live.carriers import Carriers
from uavbatt.live.log import tell
from uavbatt.live.report import STALE_AFTER_S, Report
from uavbatt.notice import Kind, Notice, kind_of
from uavbatt.prediction.pending import ALARM_S
from uavbatt.telemetry.builder import CARRYING

NOTHING_SHARE = 0.02  # of the largest current of a battery; electronics alone draw more
NOTHING_AFTER_S = 3.0  # one row without a current does not count
CHANGES_AFTER_S = 1.0  # one row without a number does not change the order
KEEPS_SHARE, KEEPS_S = 0.9, 10.0  # another becomes first with less than this share, or so many seconds less


class Headline:
    """Headline orders the batteries; it remembers which was first, and since when a battery gives nothing."""

    def __init__(self) -> None:
        self._first: int | None = None
        self._better: tuple[int, float] | None = None  # another that should be first, and since when [s]
        self._nothing_since_s: dict[int, float] = {}
        self._told: set[int] = set()
        self._carriers = Carriers()
        self.notes: list[str] = []

    def in_order(self, reports: Mapping[int, Report], now_s: float, is_armed: bool | None = None) -> list[Report]:
        """Return the batteries, the one that speaks for the vehicle first.

        now_s : on the monotonic clock [s]; is_armed : the vehicle's armed flag, None if it is not known
        """
        carriers = self._carriers.after(reports, now_s, is_armed)
        carrying = _carrying([r for i, r in reports.items() if not carriers or i in carriers], now_s)
        idle = self._idle(reports, carrying, now_s)
        self.notes = []
        found = dict(reports)
        if carrying is not None:
            words = Notice(f"gives nothing: battery {carrying.instance} carries the flight", Kind.GIVES_NOTHING)
            self.notes = [f"battery {instance} {words}" for instance in idle]
            found |= {instance: _warned(reports[instance], words) for instance in idle}
        self._tell(idle)
        is_flight = bool(carriers) or carrying is not None

        def rank(report: Report) -> tuple[object, ...]:
            is_other = bool(carriers) and report.instance not in carriers
            return is_other, *self._rank(report, is_flight, report.instance in idle, now_s)

        in_order = sorted(found.values(), key=rank)
        self._lead(in_order, now_s)
        return in_order

    def _lead(self, in_order: list[Report], now_s: float) -> None:
        """Put the one that was first back in front while another has not been better for long enough."""
        first = next((report for report in in_order if report.instance == self._first), None)
        if first is not None and _hides_less_time(first, in_order[0], now_s):
            in_order.remove(first)
            in_order.insert(0, first)
            return
        if first is None or first is in_order[0] or first.is_stale(now_s):
            self._first = in_order[0].instance if in_order else None
            self._better = None
            return
        better = in_order[0].instance
        if self._better is None or self._better[0] != better:
            self._better = (better, now_s)
        if now_s - self._better[1] >= CHANGES_AFTER_S:
            self._first = better
            return
        in_order.remove(first)
        in_order.insert(0, first)

    def _idle(self, reports: Mapping[int, Report], carrying: Report | None, now_s: float) -> list[int]:
        """Note which batteries give nothing now; return those that have given nothing for NOTHING_AFTER_S."""
        for instance, report in reports.items():
            if carrying is None or report.is_stale(now_s) or not _gives_nothing(report, carrying):
                self._nothing_since_s.pop(instance, None)
            else:
                self._nothing_since_s.setdefault(instance, now_s)
        return sorted(i for i, since_s in self._nothing_since_s.items() if now_s - since_s >= NOTHING_AFTER_S)

    def _tell(self, idle: Sequence[int]) -> None:
        """Write the note of each idle battery to the log, once."""
        for instance, note in zip(idle, self.notes, strict=True):
            if instance not in self._told:
                self._told.add(instance)
                tell(note)

    def _rank(self, report: Report, is_flight: bool, is_idle: bool, now_s: float) -> tuple[bool, bool, float, int]:
        """Return the sort key of a battery; the smallest comes first."""
        is_stale, is_first = report.is_stale(now_s), report.instance == self._first
        is_unknown = math.isnan(report.estimate.current_A)
        if is_stale:
            return True, is_unknown, -math.inf if is_first else math.inf, report.instance
        if not is_flight:  # on the ground they are ordered by number
            return False, is_unknown, math.inf, report.instance
        left_s = report.at(now_s).remaining_s
        left_s = left_s if math.isfinite(left_s) else math.inf
        if is_first:
            left_s = _clearly_less(left_s)
        return False, is_idle or is_unknown, left_s, report.instance


def takes_alarms(report: Report, first: Report, now_s: float) -> bool:
    """Return True if a battery gives its last alarms in place of the silent first one, as it carried the flight too."""
    is_carrier = report.flown_J >= CARRYING * first.flown_J > 0.0
    return first.is_stale(now_s) and is_carrier and report.at(now_s).at_worst_s <= ALARM_S


def _hides_less_time(silent: Report, other: Report, now_s: float) -> bool:
    """Return True if a silent battery had clearly less time than another that had carried the flight beside it.

    A battery that has begun only after the silence may be the same pack with another number, or a pack switched on.
    """
    silence_s, gone, left = silent.silent_s(now_s), silent.remaining, other.at(now_s)
    was_beside = other.flown_s > silence_s > STALE_AFTER_S
    return was_beside and gone.remaining_s - silence_s < _clearly_less(left.remaining_s)


def _clearly_less(time_s: float) -> float:
    return min(KEEPS_SHARE * time_s, time_s - KEEPS_S)


def _carrying(reports: Sequence[Report], now_s: float) -> Report | None:
    """Return the fresh battery with the largest current in flight; None on the ground, or if none gives current."""
    fresh = [r for r in reports if not r.is_stale(now_s)]
    flying = [r for r in fresh if math.isfinite(r.flying_since_s) and r.estimate.current_A > 0.0]
    return max(flying, key=lambda report: report.estimate.current_A, default=None)


def _gives_nothing(report: Report, carrying: Report) -> bool:
    return report.estimate.current_A < NOTHING_SHARE * carrying.estimate.current_A


def _warned(report: Report, words: Notice) -> Report:
    """Return the report with these words as a warning, and as the reason if it has seen no load."""
    estimate = replace(report.estimate, warnings=(*report.estimate.warnings, words))
    is_without_load = kind_of(report.remaining.reason) in (Kind.NOT_FLYING, Kind.NO_LOAD_ALOFT)
    reason = words if is_without_load else report.remaining.reason
    return replace(report, estimate=estimate, remaining=replace(report.remaining, reason=reason))
