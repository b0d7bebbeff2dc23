"""Rows whose forecasts are not simulated yet: several are taken in, simulated side by side, and finished in order.

Taking in a row does not depend on a forecast, so that forecasts may wait; in flight each row is finished at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

from uavbatt.notice import Kind, Notice
from uavbatt.prediction.batch import SIDE_BY_SIDE, Answers, Question
from uavbatt.prediction.forecast import no_forecast
from uavbatt.prediction.forecaster import Forecaster
from uavbatt.prediction.simulation.time_to_end import EndTimes
from uavbatt.prediction.voltage_bound import ALARM_SHARE, FALLS_FASTER, bounded
from uavbatt.records import ALARM_RISK, IN_TIME, NAN, Estimate, Remaining, Route, Sample, Status

ALARM_S = 120.0
ALARM = Notice(
    f"about 1 in {1.0 / ALARM_RISK:.0f} chance that less than {ALARM_S / 60.0:.0f} minutes are left", Kind.ALARM
)
ENDS_SOON = Notice(  # used if no time is known
    "the measured voltage falls to the cut-off within about two minutes", Kind.ENDS_SOON
)
TURN_BACK = Notice(
    "turn back now: later the way home may be longer than the charge lasts, at a risk of 5 %", Kind.TURN_BACK
)
MAY_NOT_LAND = Notice(  # instead of it, once the aircraft flies home or lands
    "the flight may end before touchdown, at a risk of 5 % or more", Kind.MAY_NOT_LAND
)


class Pending(NamedTuple):
    """Pending is a row taken in: its estimate is known, its remaining time may wait for a forecast to be simulated.

    refusal : why there can be no forecast; a row without a forecaster is refused for its estimate's reason.
    """

    sample: Sample
    estimate: Estimate
    forecaster: Forecaster | None = None
    refusal: str = ""
    question: Question | None = None
    voltage_left_s: float = math.inf  # time until the measured voltage itself reaches the cut-off

    def finish(self, ends: EndTimes | None) -> tuple[Estimate, Remaining]:
        """Return the estimate and the remaining time; `ends` answers the question, if there is one."""
        sample, found = self.sample, self.estimate
        if self.forecaster is None:
            return found, no_forecast(found.time_s, found.reason)
        answered = (self.question, ends) if self.question is not None and ends is not None else None
        remaining = bounded(self.forecaster.finish(found, self.refusal, answered), self.voltage_left_s)
        added: list[str] = [FALLS_FASTER] if remaining.reason == FALLS_FASTER else []
        if remaining.remaining_alarm_s <= ALARM_S:
            added.append(ALARM)
        if not math.isfinite(remaining.remaining_s) and ends_soon(sample, self.voltage_left_s):
            added.append(ENDS_SOON)
        if remaining.route is not None:
            added += _of_route(remaining.route)
        return replace(found, warnings=(*found.warnings, *added)) if added else found, remaining


def ends_soon(sample: Sample, voltage_left_s: float) -> bool:
    """Return True if the voltage of a row in flight reaches the cut-off, in `voltage_left_s` [s], so soon that the crew
    must hear of it."""
    return sample.armed is not False and ALARM_SHARE * voltage_left_s <= ALARM_S


def _of_route(route: Route) -> tuple[Notice, ...]:
    """Return the warning of a route that may end too early, if there is one."""
    if route.is_returning:
        return (MAY_NOT_LAND,) if route.risk > IN_TIME else ()
    return (TURN_BACK,) if route.must_turn_back_now else ()


def finished(coming: Iterable[Pending], answers: Answers) -> Iterator[tuple[Estimate, Remaining]]:
    """Yield the estimate and the remaining time of each row, in order; `answers` simulates forecasts side by side."""
    waiting: list[Pending] = []
    questions = 0
    for pending in coming:
        waiting.append(pending)
        questions += pending.question is not None
        if questions == SIDE_BY_SIDE:
            yield from _finished(waiting, answers)
            waiting, questions = [], 0
    yield from _finished(waiting, answers)


def _finished(waiting: Sequence[Pending], answers: Answers) -> Iterator[tuple[Estimate, Remaining]]:
    """Yield the results of rows whose forecasts are simulated at once, as `finished` does."""
    ends = iter(answers([row.question for row in waiting if row.question is not None]))
    for row in waiting:
        yield row.finish(next(ends) if row.question is not None else None)


def refused(sample: Sample, reason: str) -> tuple[Estimate, Remaining]:
    """Return an estimate and a remaining time that are refused with a reason."""
    row = (sample.voltage_V, sample.current_A, sample.temp_C, sample.voltage_V * sample.current_A)
    estimate = Estimate(sample.time_s, NAN, NAN, *row, NAN, NAN, Status.REFUSED, reason)
    return estimate, no_forecast(sample.time_s, reason)
