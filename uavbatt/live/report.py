"""Report of a battery at this moment, for every feed: the last estimate, or the reason why there is none.

The rules are the same for all feeds: after STALE_AFTER_S without telemetry nothing is known; a refused number is NaN; a
known time is reduced by the age of its row.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from uavbatt.nan_equal import nan_equal
from uavbatt.notice import Kind, Notice, kind_of
from uavbatt.output import Line, line, rounded, speaker
from uavbatt.prediction.pending import ALARM_S
from uavbatt.records import NAN, Estimate, Remaining, Route, Status

STALE_AFTER_S = 3.0
LATE_S, TOO_LATE_S = 3.0, 10.0  # delay by the vehicle's clock: from the first it is subtracted, beyond the second stale
LATE_ENDS_SOON = Notice("by late telemetry less than two minutes may be left: land", Kind.MAY_END_SOON)
NOTHING_YET = "no battery telemetry yet"
TREND_PERIOD_S, TREND_S = 5.0, 600.0


@dataclass(frozen=True, slots=True)
class Display:
    """Display holds the values to show now; NaN is unknown."""

    status: Status
    reason: str
    soc: float
    remaining_s: float
    remaining_lo_s: float
    remaining_hi_s: float
    remaining_to_low_s: float
    remaining_alarm_s: float

    @property
    def at_worst_s(self) -> float:
        """Return the time that alarms use [s]: the forecast's alarm point, or its 5 % point if it has none."""
        return self.remaining_alarm_s if math.isfinite(self.remaining_alarm_s) else self.remaining_lo_s


class EnduranceNow(NamedTuple):
    """EnduranceNow tells how long a flight begun now would last [s]: median, 5 % and 95 % point; NaN is unknown."""

    median_s: float = NAN
    lo_s: float = NAN
    hi_s: float = NAN

    @property
    def words(self) -> str:
        """Return it in words for the pilot, in minutes."""
        if not math.isfinite(self.median_s):
            return "waiting for take-off"
        middle, lo, hi = (f"{value_s / 60.0:.0f}" for value_s in self)
        return f"waiting for take-off; about {middle} min ({lo} to {hi}) from this charge"


UNKNOWN = EnduranceNow()


@nan_equal
@dataclass(frozen=True, slots=True)
class Report:
    """Report holds the last estimate of one battery. received_s is on the monotonic clock; cells 0 is unknown."""

    instance: int
    system: int
    component: int
    estimate: Estimate
    remaining: Remaining
    received_s: float
    rows: int = 0
    cells: int = 0
    battery: str = ""
    certificate: str = ""
    flying_since_s: float = NAN  # on the monotonic clock; NaN on the ground
    endurance: EnduranceNow = UNKNOWN  # before take-off
    flown_J: float = 0.0  # energy given since take-off
    flown_s: float = 0.0  # time of that
    late_s: float = 0.0  # delay of the row beyond the usual, as far as it is known

    def late_by(self, late_s: float) -> Report:
        """Return the report of a row that came `late_s` [s] late, with a warning; up to LATE_S it is unchanged."""
        if not late_s > LATE_S:
            return self
        ends_soon = late_s > TOO_LATE_S and self.remaining.remaining_alarm_s - late_s <= ALARM_S
        warnings = (*self.estimate.warnings, _late_notice(late_s), *(LATE_ENDS_SOON,) * ends_soon)
        return replace(self, late_s=late_s, estimate=replace(self.estimate, warnings=warnings))

    def silent_s(self, now_s: float) -> float:
        """Return the seconds since the row was received."""
        return max(now_s - self.received_s, 0.0)

    def age_s(self, now_s: float) -> float:
        """Return the seconds since the row was sent, as far as that is known."""
        return self.silent_s(now_s) + self.late_s

    def is_stale(self, now_s: float) -> bool:
        """Return True if the last row is so old, or came so late, that nothing is known any more."""
        return self.silent_s(now_s) > STALE_AFTER_S or self.late_s > TOO_LATE_S

    def _why_stale(self, now_s: float) -> Notice:
        silent_s = self.silent_s(now_s)
        if silent_s > STALE_AFTER_S:
            return Notice(f"no telemetry for {silent_s:.0f} s", Kind.NO_TELEMETRY)
        return _late_notice(self.late_s)

    @property
    def is_waiting(self) -> bool:
        """Return True before a flight, while there is no number because there is no load yet."""
        return kind_of(self.remaining.reason) is Kind.NOT_FLYING and self.estimate.status is not Status.REFUSED

    def at(self, now_s: float) -> Display:
        """Return the values that may be shown at `now_s` on the monotonic clock [s]."""
        age_s = self.age_s(now_s)
        if self.is_stale(now_s):
            return Display(Status.STALE, self._why_stale(now_s), *(NAN,) * 6)
        said = speaker(self.estimate, self.remaining)
        refused = said.status is Status.REFUSED

        def left(value_s: float) -> float:
            return max(value_s - age_s, 0.0) if math.isfinite(value_s) and not refused else NAN

        r = self.remaining
        return Display(
            said.status,
            Notice(self.endurance.words, Kind.NOT_FLYING) if self.is_waiting else said.reason,
            NAN if self.estimate.status is Status.REFUSED else self.estimate.soc,
            left(r.remaining_s),
            left(r.remaining_lo_s),
            left(r.remaining_hi_s),
            left(r.remaining_to_low_s),
            left(r.remaining_alarm_s),
        )

    def route_at(self, now_s: float) -> Route | None:
        """Return route and way home at `now_s`, all unknown if the telemetry is stale; None without a route."""
        route, age_s = self.remaining.route, self.age_s(now_s)
        if route is None or not self.is_stale(now_s):
            return route and route.later(age_s)
        return Route(route.load, reason=self._why_stale(now_s))

    def as_line(self, now_s: float) -> Line:
        """Return the output line's keys as they stand now, with the identity and the age of the row."""
        shown = self.at(now_s)
        made: Line = dict(line(self.estimate, replace(self.remaining, route=self.route_at(now_s))))
        stale = shown.status is Status.STALE
        for key in ("remaining_s", "remaining_lo_s", "remaining_hi_s", "remaining_to_low_s"):
            made[key] = rounded(getattr(shown, key), 1)
        if stale:
            made |= dict.fromkeys(("soc", "soc_sd", "voltage_V", "current_A", "temp_C", "power_W", "innovation_V"))
        made |= {"status": shown.status.value, "reason": str(shown.reason)}
        endurance = UNKNOWN if stale else self.endurance
        volts = made["voltage_V"]
        return made | {
            "instance": self.instance,
            "age_s": rounded(self.age_s(now_s), 2),
            "waiting": self.is_waiting and not stale,
            "returning": bool(self.remaining.route and self.remaining.route.is_returning) and not stale,
            "plan_s": rounded(endurance.median_s, 1),
            "plan_lo_s": rounded(endurance.lo_s, 1),
            "plan_hi_s": rounded(endurance.hi_s, 1),
            "flight_s": rounded(now_s - self.flying_since_s, 1),
            "cells": self.cells or None,
            "cell_voltage_V": round(volts / self.cells, 3) if self.cells > 0 and isinstance(volts, float) else None,
            "battery": self.battery,
            "certificate": self.certificate,
        }


def _late_notice(late_s: float) -> Notice:
    return Notice(f"the telemetry comes late: {late_s:.0f} s, by the vehicle's own clock", Kind.LATE)


class Trend:
    """Trend keeps the time left of each battery over the last ten minutes, a point every five seconds."""

    def __init__(self) -> None:
        self._points: dict[int, tuple[tuple[float, Display], ...]] = {}
        self._next_s = -math.inf

    def forget(self) -> None:
        """Forget all points, as another vehicle is followed from now on."""
        self._points = {}

    def look(self, now_s: float, reports: Sequence[Report]) -> None:
        """Take a point of each battery when one is due."""
        if now_s < self._next_s:
            return
        self._next_s = now_s + TREND_PERIOD_S
        for report in reports:
            kept = tuple(p for p in self._points.get(report.instance, ()) if now_s - p[0] <= TREND_S)
            self._points[report.instance] = (*kept, (now_s, report.at(now_s)))

    def lines(self, now_s: float) -> dict[int, list[list[float | None]]]:
        """Return for each battery its points [age, median, 5 %, 95 %] [s], oldest first; None is unknown."""
        return {
            instance: [
                [
                    rounded(now_s - at_s, 1),
                    *(rounded(v, 1) for v in (shown.remaining_s, shown.remaining_lo_s, shown.remaining_hi_s)),
                ]
                for at_s, shown in points
            ]
            for instance, points in list(self._points.items())
        }


@dataclass(slots=True)
class Board:
    """Board is what other threads read: the loop replaces it as a whole, and appends to `trend`."""

    reports: tuple[Report, ...] = ()
    notes: tuple[str, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)
    trend: Trend = field(default_factory=Trend)
    problem: str = ""  # why the autopilot's link is not open
    announcements: tuple[tuple[float, str], ...] = ()  # (monotonic time [s], text)
