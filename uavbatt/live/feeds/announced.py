"""Announcements of a battery (STATUSTEXT, and on the page): alarms, a lost number, new warnings.

- Alarm: the time left at worst falls below a threshold. It comes once, and again only after the time has risen 20 %
  above the threshold.
- Loss: the time left was known and is not known any more, with the reason. The same loss is announced once a minute at
  most; that the number is back is not announced, and neither is the loss after landing. While the vehicle is armed and
  does not say that it has landed, a load that is not seen any more is a loss, too.
- No number at all: the vehicle is armed and no number has come for WITHOUT_AFTER_S. It comes once a flight. Waiting for
  the load before take-off does not count, unless the autopilot says that the vehicle is in the air.
- Warning: a warning of the estimate that is listed in WARNINGS. It comes once, and again only after it has been gone
  for a minute.

Pauses apply only between two texts about the same thing: no text waits for another. A text that falls into a pause and
still holds at its end is sent then.

Nobody acknowledges a STATUSTEXT, and a radio loses some. Alarms of two minutes and less and the warnings in CRITICAL
are therefore sent again, AGAIN_AFTER_S later, if they still hold, with the time as it is then.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from uavbatt.live.report import STALE_AFTER_S, Display, Report
from uavbatt.mavlink.outgoing import LONGEST_TEXT, SEVERITY_CRITICAL, SEVERITY_NOTICE, SEVERITY_WARNING
from uavbatt.notice import Kind, kind_of
from uavbatt.records import Status

ALARM_PAUSE_S = 10.0
SAME_LOSS_PAUSE_S = 60.0  # between losses for the same reason, which slow telemetry may bring often
REARM = 1.2
CRITICAL_BELOW_S = 90.0
AGAIN_BELOW_S, AGAIN_AFTER_S = 120.0, (5.0, 15.0)
LOST_AFTER_S = 1.0  # one bad row is not a loss
WARNING_GONE_S = 60.0
WITHOUT_AFTER_S = 20.0  # in a flight that has had no number yet
# Kind of a warning of the estimate -> its short text behind "Battery N: ", at most 37 characters.
WARNINGS: dict[Kind, str] = {
    Kind.TURN_BACK: "turn back now",
    Kind.MAY_NOT_LAND: "may end before touchdown",
    Kind.LATE: "telemetry comes late",
    Kind.ENDS_SOON: "voltage nears its cut-off: land",
    Kind.MAY_END_SOON: "may end within 2 min: land",
    Kind.ACTS_SOON: "autopilot will act by its own count",
    Kind.CELLS_NOT_STATED: "cells not stated: another count fits",
    Kind.GIVES_NOTHING: "gives nothing, another has the load",
    Kind.CELLS_OF_VEHICLE: "cells of the vehicle not used",
    Kind.CELLS: "count of cells does not fit the pack",
    Kind.NEARLY_EMPTY: "nearly empty, or wrong cell count",
    Kind.TOO_FULL: "too full, or wrong cell count",
    Kind.CAPACITY_OF_VEHICLE: "capacity of the vehicle not used",
    Kind.CAPACITY: "capacity does not fit the flight",
    Kind.CRITICAL_VOLTAGE: "critical voltage does not fit",
    Kind.LOW_VOLTAGE: "low-voltage warning does not fit",
    Kind.CUTOFF: "cut-off does not fit the pack",
    Kind.CHARGING: "current flows into the pack",
    Kind.SLOW_ROWS: "time of the rows does not fit",
    Kind.POWER: "power is not what is stated",
    Kind.FALLS_FASTER: "voltage falls faster than charge says",
    Kind.SMALL_PACK: "pack holds less than stated",
    Kind.LARGE_PACK: "pack holds more than stated",
    Kind.MANY_OHMS: "ohms of a much smaller pack",
    Kind.FAR_OFF: "voltage is not this battery file's",
    Kind.UNFITTING: "voltage and current do not fit",
    Kind.STUCK_VOLTAGE: "voltage is stuck",
    Kind.STUCK_CURRENT: "current is stuck",
    Kind.DEAD_CURRENT: "current fell, voltage did not rise",
    Kind.FELL_ALONE: "voltage fell alone: a wire or a cell?",
    Kind.ROSE_ALONE: "voltage rose alone: a voltmeter?",
    Kind.TWO_BATTERIES: "two batteries under one id?",
    Kind.COARSE: "voltage is read too coarsely",
}

CRITICAL = (Kind.TURN_BACK, Kind.ENDS_SOON, Kind.MAY_END_SOON)

LONGEST_REASON = 23

# Kind of the reason of a refusal -> its short text behind "Battery N: time unknown, ".
REASONS: dict[Kind, str] = {
    Kind.NO_TELEMETRY: "no telemetry",
    Kind.LATE: "telemetry comes late",
    Kind.NO_CURRENT: "no current reading",
    Kind.NO_VOLTAGE: "no voltage reading",
    Kind.TIME_BACKWARDS: "time went backwards",
    Kind.SETTLING: "charge is uncertain",
    Kind.NOT_FLYING: "no load seen",
    Kind.NO_LOAD_ALOFT: "no load seen",
    Kind.JUST_TAKEN_OFF: "the load has just begun",
    Kind.BEYOND_SIX_HOURS: "load too low for flight",
    Kind.NO_CHARGE: "charge is unknown",
    Kind.NO_BELIEF: "no estimate yet",
    Kind.TWO_SENDERS: "two senders disagree",
    Kind.FAULT: "a fault of uavbatt",
    Kind.CAPACITY_NOT_STATED: "capacity not stated",
    Kind.CELLS: "cell count is wrong",
    Kind.CAPACITY: "capacity is wrong",
    Kind.LOW_VOLTAGE: "low voltage is wrong",
    Kind.CUTOFF: "cut-off is wrong",
    Kind.CHARGING: "current is negative",
    Kind.SLOW_ROWS: "time is wrong",
    Kind.SMALL_PACK: "capacity is wrong",
    Kind.LARGE_PACK: "capacity is wrong",
    Kind.MANY_OHMS: "capacity is wrong",
    Kind.STUCK_VOLTAGE: "voltage is stuck",
    Kind.STUCK_CURRENT: "current is stuck",
    Kind.DEAD_CURRENT: "current does not fit",
    Kind.FELL_ALONE: "voltage does not fit",
    Kind.ROSE_ALONE: "voltage does not fit",
    Kind.TWO_BATTERIES: "two under one id",
    Kind.COARSE: "voltage is too coarse",
    Kind.FAR_OFF: "voltage does not fit",
    Kind.UNFITTING: "voltage does not fit",
    Kind.NO_END: "charge and load differ",
}


class Repeat(NamedTuple):
    """A Repeat is an announcement to be sent again at `due_s` [s], if it still holds.

    kind : of the warning; None for the alarm at `threshold_s` [s]
    """

    severity: int
    kind: Kind | None
    threshold_s: float
    due_s: float


class Announcer:
    """Announcer decides when a text about one battery is sent, and with which words."""

    def __init__(self, instance: int, thresholds_s: Sequence[float]) -> None:
        self._instance = instance
        self._waiting = dict.fromkeys(sorted(thresholds_s, reverse=True), True)
        self._spoke_s: dict[str, float] = {}  # by subject
        self._warned_s: dict[Kind, float] = {}  # when each warning was last seen
        self._was_known = self._is_without_said = False
        self._lost_s = math.nan
        self._again: list[Repeat] = []

    def texts(
        self,
        now_s: float,
        report: Report,
        is_armed: bool | None = None,
        is_airborne: bool | None = None,
        speaks_first: bool = True,
    ) -> list[tuple[int, str]]:
        """Return (severity, text) of all announcements that are due; `now_s` is on the monotonic clock [s].

        is_airborne : the autopilot says that the vehicle is in the air, or on the ground, by other signs than the
        battery; None if it does not say
        speaks_first : this battery speaks for the vehicle (`headline`); of several batteries only this one gives alarms
        """
        shown = report.at(now_s)
        said = self._alarm(now_s, shown) if speaks_first else []
        if is_armed is False:  # the next flight has a warning of its own
            self._is_without_said, self._lost_s = False, self._lost_s if self._was_known else math.nan
        may_fly = is_armed is True and is_airborne is not False
        is_in_the_air = may_fly if self._was_known else is_airborne is True
        if math.isfinite(shown.remaining_s):
            self._was_known, self._is_without_said, self._lost_s = True, True, math.nan
        elif shown.status is not Status.STALE and _waits_for_load(report, is_in_the_air):
            self._lost_s, self._was_known = math.nan, self._was_known and is_armed is not False
        else:
            said += self._loss(now_s, shown, is_armed)
        said += self._new_warnings(now_s, _warnings(now_s, report))
        return self._named(said)

    def repeats(self, now_s: float, report: Report, speaks_first: bool = True) -> list[tuple[int, str]]:
        """Return (severity, text) of the important announcements that are due again; parameters as in `texts`."""
        shown, said = report.at(now_s), []
        due, self._again = [r for r in self._again if now_s >= r.due_s], [r for r in self._again if now_s < r.due_s]
        held = {kind_of(warning) for warning in _warnings(now_s, report)}
        for severity, kind, threshold_s, _ in due:
            if kind is None and speaks_first and shown.at_worst_s <= REARM * threshold_s:
                said.append((severity, _left(shown.at_worst_s)))
            if kind is not None and kind in held:
                said.append((severity, WARNINGS[kind]))
        return self._named(said)

    def _named(self, said: list[tuple[int, str]]) -> list[tuple[int, str]]:
        return [(severity, _fitting(f"Battery {self._instance}: {text}", LONGEST_TEXT)) for severity, text in said]

    def _alarm(self, now_s: float, shown: Display) -> list[tuple[int, str]]:
        left_s = shown.at_worst_s
        for threshold_s in self._waiting:
            if left_s > REARM * threshold_s:
                self._waiting[threshold_s] = True
        crossed = [t for t, waiting in self._waiting.items() if waiting and left_s <= t and self._may(now_s, f"{t}")]
        if not crossed:
            return []
        for threshold_s in crossed:
            self._waiting[threshold_s] = False
            self._spoke_s[f"{threshold_s}"] = now_s
        severity = SEVERITY_CRITICAL if min(crossed) < CRITICAL_BELOW_S else SEVERITY_WARNING
        if min(crossed) <= AGAIN_BELOW_S:
            self._again = [r for r in self._again if r.kind is not None]  # this alarm replaces the one before
            self._again += [Repeat(severity, None, min(crossed), now_s + after_s) for after_s in AGAIN_AFTER_S]
        return [(severity, _left(left_s))]

    def _loss(self, now_s: float, shown: Display, is_armed: bool | None) -> list[tuple[int, str]]:
        if math.isnan(self._lost_s):
            self._lost_s = now_s
        if not self._was_known:
            return self._never_known(now_s, shown, is_armed)
        is_stale = shown.status is Status.STALE  # this has already lasted for 3 s
        if not (is_stale or now_s - self._lost_s >= LOST_AFTER_S):
            return []
        if is_armed is False and not is_stale:
            self._was_known = False
            return []
        subject = f"loss, {_short(shown.reason)}"
        if not (self._may(now_s, "loss") and self._may(now_s, subject, SAME_LOSS_PAUSE_S)):
            return []
        self._was_known = False
        self._spoke_s["loss"] = self._spoke_s[subject] = now_s
        return [(SEVERITY_WARNING if is_armed else SEVERITY_NOTICE, f"time unknown, {_short(shown.reason)}")]

    def _never_known(self, now_s: float, shown: Display, is_armed: bool | None) -> list[tuple[int, str]]:
        """Announce once a flight that no number has come since its start."""
        if is_armed is not True:
            self._lost_s = math.nan
            return []
        if self._is_without_said or now_s - self._lost_s < WITHOUT_AFTER_S or shown.status is not Status.REFUSED:
            return []
        self._is_without_said = True
        return [(SEVERITY_WARNING, f"time unknown, {_short(shown.reason)}")]

    def _new_warnings(self, now_s: float, warnings: Sequence[str]) -> list[tuple[int, str]]:
        made, held = [], {kind_of(warning) for warning in warnings}
        for kind in (kind for kind in WARNINGS if kind in held):
            if now_s - self._warned_s.get(kind, -math.inf) > WARNING_GONE_S:
                made.append((SEVERITY_CRITICAL if kind in CRITICAL else SEVERITY_WARNING, WARNINGS[kind]))
                for after_s in AGAIN_AFTER_S if kind in CRITICAL else ():
                    self._again.append(Repeat(SEVERITY_CRITICAL, kind, math.nan, now_s + after_s))
            self._warned_s[kind] = now_s
        return made

    def _may(self, now_s: float, subject: str, pause_s: float = ALARM_PAUSE_S) -> bool:
        return now_s - self._spoke_s.get(subject, -math.inf) >= pause_s


def _waits_for_load(report: Report, is_in_the_air: bool) -> bool:
    """Return True while there is no number because no load has come yet; in the air a missing load is a loss.

    A battery without load beside another that has it also waits: it has a warning of its own.
    """
    kind = kind_of(report.remaining.reason)
    return kind in (Kind.JUST_TAKEN_OFF, Kind.GIVES_NOTHING) or (kind is Kind.NOT_FLYING and not is_in_the_air)


def _warnings(now_s: float, report: Report) -> Sequence[str]:
    """Return the warnings that hold now: the critical ones alone of rows that come too late, none in a silence."""
    if report.silent_s(now_s) > STALE_AFTER_S:
        return ()
    held = report.estimate.warnings
    return [warning for warning in held if kind_of(warning) in CRITICAL] if report.is_stale(now_s) else held


def _short(reason: str) -> str:
    return REASONS.get(kind_of(reason)) or _fitting(reason, LONGEST_REASON)


def _fitting(text: str, longest: int) -> str:
    """Return the text cut after the last word that fits; a single longer word is cut itself."""
    if len(text) <= longest:
        return text
    whole = text[: longest + 1].rpartition(" ")[0].rstrip(" ,:;")
    return whole or text[:longest]


def _left(left_s: float) -> str:
    return f"{int(left_s) // 60}:{int(left_s) % 60:02d} min left at worst"
