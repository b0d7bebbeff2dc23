"""Announcements of a battery (STATUSTEXT, and on the page): alarms, a lost number, new warnings.

- Alarm: the time left at worst falls below a threshold. It comes once, and again only after the time has risen 20 %
  above the threshold.
- Loss: the time left was known and is not known any more, with the reason. The same loss is announced once a minute at
  most; that the number is back is not announced, and neither is the loss after landing.
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

from uavbatt.live.headline import GIVES_NOTHING
from uavbatt.live.report import LATE, Display, Report
from uavbatt.mavlink.outgoing import LONGEST_TEXT, SEVERITY_CRITICAL, SEVERITY_NOTICE, SEVERITY_WARNING
from uavbatt.prediction.forecaster import JUST_TAKEN_OFF, NOT_FLYING
from uavbatt.records import Status

ALARM_PAUSE_S = 10.0
SAME_LOSS_PAUSE_S = 60.0  # for the same reason: slow or broken telemetry loses a number ten times a minute
REARM = 1.2
CRITICAL_BELOW_S = 90.0
AGAIN_BELOW_S, AGAIN_AFTER_S = 120.0, (5.0, 15.0)
LOST_AFTER_S = 1.0  # one bad row is not a loss
WARNING_GONE_S = 60.0
WITHOUT_AFTER_S = 20.0  # in a flight that has had no number yet
# Part of a warning of the estimate -> its short text behind "Battery N: ", at most 37 characters.
WARNINGS: dict[str, str] = {
    "turn back now": "turn back now",
    LATE: "telemetry comes late",
    "the measured voltage falls to the cut-off": "voltage nears its cut-off: land",
    "nobody states the cells": "cells not stated: another count fits",
    GIVES_NOTHING: "gives nothing, another has the load",
    "the vehicle states": "cells of the vehicle not used",
    " V a cell, expected": "count of cells does not fit the pack",
    "were drawn since: another count": "count of cells does not fit the pack",
    "nearly empty, or another count": "nearly empty, or wrong cell count",
    "fuller than cells are": "too full, or wrong cell count",
    "capacity of the vehicle,": "capacity of the vehicle not used",
    "the stated": "capacity does not fit the flight",
    "critical voltage of the vehicle,": "critical voltage does not fit",
    "low-voltage warning": "low-voltage warning does not fit",
    "cut-off ": "cut-off does not fit the pack",
    "the current flows into the pack": "current flows into the pack",
    "the rows are more than": "time of the rows does not fit",
    "this aircraft draws": "power is not what is stated",
    "the voltage falls faster": "voltage falls faster than charge says",
    "this pack holds less than stated": "pack holds less than stated",
    "this pack holds more than stated": "pack holds more than stated",
    "this pack has the ohms of a far smaller": "ohms of a much smaller pack",
    "the voltage is far off": "voltage is not this battery file's",
    "have not fitted this battery": "voltage and current do not fit",
    "the voltage has not moved": "voltage is stuck",
    "the current has not moved": "current is stuck",
    "the current fell to nothing": "current fell to nothing: sensor?",
}

AT_START = frozenset({"cut-off "})  # must begin the warning or the reason: others have these words further on
CRITICAL = ("turn back now", "the measured voltage falls to the cut-off")

LONGEST_REASON = 23

# Part of the reason of a refusal -> its short text behind "Battery N: time unknown, ".
REASONS: dict[str, str] = {
    "no telemetry": "no telemetry",
    LATE: "telemetry comes late",
    "no current": "no current reading",
    "no voltage": "no voltage reading",
    "time went backwards": "time went backwards",
    "still settling": "charge is uncertain",
    "waiting for take-off": "no load seen",
    "not flying": "no load seen",
    "the load has just come": "the load has just come",
    "beyond six hours": "load is no flight's",
    "state of charge not known": "charge is unknown",
    "no belief": "no estimate yet",
    "two senders": "two senders disagree",
    "in uavbatt itself": "a fault of uavbatt",
    "capacity: neither": "capacity not stated",
    " V a cell, expected": "cell count is wrong",
    "were drawn since: another count": "cell count is wrong",
    "the stated": "capacity is wrong",
    "low-voltage warning": "low voltage is wrong",
    "cut-off ": "cut-off is wrong",
    "the current flows into the pack": "current is negative",
    "the rows are more than": "time is wrong",
    "this pack holds less than stated": "capacity is wrong",
    "this pack holds more than stated": "capacity is wrong",
    "this pack has the ohms of a far smaller": "capacity is wrong",
    "the voltage has not moved": "voltage is stuck",
    "the current has not moved": "current is stuck",
    "the current fell to nothing": "current fell to nothing",
    "the voltage is far off": "voltage does not fit",
    "have not fitted this battery": "voltage does not fit",
    "no end in sight": "charge and load differ",
}


class Repeat(NamedTuple):
    """A Repeat is an announcement to be sent again at `due_s` [s], if it still holds.

    words : the warning it is about; empty for the alarm at `threshold_s` [s]
    """

    severity: int
    words: str
    threshold_s: float
    due_s: float


class Announcer:
    """Announcer decides when a text about one battery is sent, and with which words."""

    def __init__(self, instance: int, thresholds_s: Sequence[float]) -> None:
        self._instance = instance
        self._waiting = dict.fromkeys(sorted(thresholds_s, reverse=True), True)
        self._spoke_s: dict[str, float] = {}  # by subject
        self._warned_s: dict[str, float] = {}  # when each warning was last seen
        self._was_known = self._is_without_said = False
        self._lost_s = math.nan
        self._again: list[Repeat] = []

    def texts(
        self,
        now_s: float,
        report: Report,
        is_armed: bool | None = None,
        is_airborne: bool = False,
        speaks_first: bool = True,
    ) -> list[tuple[int, str]]:
        """Return (severity, text) of all announcements that are due; `now_s` is on the monotonic clock [s].

        is_airborne : the autopilot says that the vehicle is in the air, by other signs than the battery
        speaks_first : this battery speaks for the vehicle (`headline`); of several batteries only this one gives alarms
        """
        shown = report.at(now_s)
        said = self._alarm(now_s, shown) if speaks_first else []
        if is_armed is False:  # the next flight has a warning of its own
            self._is_without_said, self._lost_s = False, self._lost_s if self._was_known else math.nan
        if math.isfinite(shown.remaining_s):
            self._was_known, self._is_without_said, self._lost_s = True, True, math.nan
        elif shown.status is not Status.STALE and _waits_for_load(report, is_airborne and not self._was_known):
            self._lost_s = math.nan
        else:
            said += self._loss(now_s, shown, is_armed)
        if shown.status is not Status.STALE:
            said += self._new_warnings(now_s, report.estimate.warnings)
        return self._named(said)

    def repeats(self, now_s: float, report: Report, speaks_first: bool = True) -> list[tuple[int, str]]:
        """Return (severity, text) of the important announcements that are due again; parameters as in `texts`."""
        shown, said = report.at(now_s), []
        due, self._again = [r for r in self._again if now_s >= r.due_s], [r for r in self._again if now_s < r.due_s]
        for severity, words, threshold_s, _ in due:
            if not words and speaks_first and shown.at_worst_s <= REARM * threshold_s:
                said.append((severity, f"{_minutes(shown.at_worst_s)} left at worst"))
            holds = words and shown.status is not Status.STALE
            if holds and any(_tells(warning, words) for warning in report.estimate.warnings):
                said.append((severity, WARNINGS[words]))
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
            self._again = [r for r in self._again if r.words]  # of the alarm before: this one says more
            self._again += [Repeat(severity, "", min(crossed), now_s + after_s) for after_s in AGAIN_AFTER_S]
        return [(severity, f"{_minutes(left_s)} left at worst")]

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
        made = []
        for words, short in WARNINGS.items():
            if not any(_tells(warning, words) for warning in warnings):
                continue
            if now_s - self._warned_s.get(words, -math.inf) > WARNING_GONE_S:
                made.append((SEVERITY_CRITICAL if words in CRITICAL else SEVERITY_WARNING, short))
                for after_s in AGAIN_AFTER_S if words in CRITICAL else ():
                    self._again.append(Repeat(SEVERITY_CRITICAL, words, math.nan, now_s + after_s))
            self._warned_s[words] = now_s
        return made

    def _may(self, now_s: float, subject: str, pause_s: float = ALARM_PAUSE_S) -> bool:
        return now_s - self._spoke_s.get(subject, -math.inf) >= pause_s


def _waits_for_load(report: Report, is_airborne: bool) -> bool:
    """Return True while there is no number because no load has come yet; in the air a missing load is a loss.

    A battery without load beside another that has it also waits: it has a warning of its own.
    """
    reason = report.remaining.reason
    return reason == JUST_TAKEN_OFF or GIVES_NOTHING in reason or (reason == NOT_FLYING and not is_airborne)


def _short(reason: str) -> str:
    return next((short for words, short in REASONS.items() if _tells(reason, words)), _fitting(reason, LONGEST_REASON))


def _tells(sentence: str, words: str) -> bool:
    return sentence.startswith(words) if words in AT_START else words in sentence


def _fitting(text: str, longest: int) -> str:
    """Return the text cut after the last word that fits; a single longer word is cut itself."""
    if len(text) <= longest:
        return text
    whole = text[: longest + 1].rpartition(" ")[0].rstrip(" ,:;")
    return whole or text[:longest]


def _minutes(left_s: float) -> str:
    return f"{int(left_s) // 60}:{int(left_s) % 60:02d} min"
