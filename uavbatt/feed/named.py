"""The feed that never puts anybody wrong: NAMED_VALUE_FLOAT of every battery, and alarms as STATUSTEXT.

Names: REM_S, REM_LO_S, REM_HI_S [s] and SOC [0..1] of the first battery; `_N` behind it for battery N. What is not
known is NaN, never 0. An alarm speaks once when the time left falls through a threshold, again only after the
time had risen 20 % above it, and never two texts of one battery within ALARM_PAUSE_S.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from uavbatt.feed.now import Report, Shown
from uavbatt.mavlink.outgoing import SEVERITY_CRITICAL, SEVERITY_NOTICE, SEVERITY_WARNING, Outgoing
from uavbatt.records import Status

ALARM_PAUSE_S = 10.0
REARM = 1.2
CRITICAL_BELOW_S = 90.0


class NamedFeed:
    """Values at `rate_Hz` at most, alarms at the thresholds [s]."""

    def __init__(self, rate_Hz: float, thresholds_s: Sequence[float]) -> None:
        self._period_s = 1.0 / rate_Hz
        self._next_s = -math.inf
        self._alarms: dict[int, Alarm] = {}
        self._thresholds_s = thresholds_s

    def frames(self, now_s: float, reports: Sequence[Report], out: Outgoing) -> list[bytes]:
        """The frames that are due."""
        if now_s < self._next_s:
            return []
        self._next_s = now_s + self._period_s
        made = []
        for place, report in enumerate(reports):
            shown = report.at(now_s)
            tail = "" if place == 0 else f"_{report.instance}"
            values = {
                "REM_S": shown.remaining_s,
                "REM_LO_S": shown.remaining_lo_s,
                "REM_HI_S": shown.remaining_hi_s,
                "SOC": shown.soc,
            }
            made += [out.named_value(name + tail, value, int(now_s * 1000)) for name, value in values.items()]
            alarm = self._alarms.setdefault(report.instance, Alarm(report.instance, self._thresholds_s))
            text = alarm.text(now_s, shown)
            if text is not None:
                made.append(out.text(*text))
        return made


class Alarm:
    """When to speak of one battery."""

    def __init__(self, instance: int, thresholds_s: Sequence[float]) -> None:
        self._instance = instance
        self._waiting = dict.fromkeys(sorted(thresholds_s, reverse=True), True)
        self._spoke_s = -math.inf
        self._status = Status.CONVERGING

    def text(self, now_s: float, shown: Shown) -> tuple[int, str] | None:
        """(severity, text) when there is something to say now."""
        left_s = shown.remaining_alarm_s if math.isfinite(shown.remaining_alarm_s) else shown.remaining_lo_s
        for threshold_s in self._waiting:
            if left_s > REARM * threshold_s:
                self._waiting[threshold_s] = True
        if now_s - self._spoke_s < ALARM_PAUSE_S:
            return None
        crossed = [t for t, waiting in self._waiting.items() if waiting and left_s <= t]
        lost = shown.status is Status.STALE and self._status is Status.OK
        self._status = shown.status
        if crossed:
            self._waiting.update(dict.fromkeys(crossed, False))
            severity = SEVERITY_CRITICAL if min(crossed) < CRITICAL_BELOW_S else SEVERITY_WARNING
            self._spoke_s = now_s
            return severity, f"Battery {self._instance}: {_minutes(left_s)} left at worst"
        if lost:
            self._spoke_s = now_s
            return SEVERITY_NOTICE, f"Battery {self._instance}: time left unknown, no telemetry"
        return None


def _minutes(left_s: float) -> str:
    return f"{int(left_s) // 60}:{int(left_s) % 60:02d} min"
