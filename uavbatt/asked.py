"""A row between its two halves: taken in, and said what is known after it.

Taking in depends on no forecast, so that a replay may take many rows in, simulate their forecasts side by side, and say
all in turn; in flight one follows the other at once (`Estimator.step`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from uavbatt.prediction.batch import Question
from uavbatt.prediction.forecaster import Forecaster
from uavbatt.prediction.last_wall import bounded
from uavbatt.prediction.time_to_end import EndTimes
from uavbatt.records import ALARM_RISK, NAN, Estimate, Remaining, Sample, Status

ALARM_S = 120.0
CONTRADICTED_S = 120.0
FALLS_FASTER = (
    "the voltage falls faster than the charge says: an older or smaller pack, or a current sensor that reads low"
)
AT_CUTOFF = "the pack is at its cut-off"
NO_END = "no end in sight: the charge believed and the load do not fit"


class Asked(NamedTuple):
    """A sample taken in, and what is still to be worked out to say all that is known after it."""

    sample: Sample
    estimate: Estimate
    forecaster: Forecaster | None
    refusal: str
    question: Question | None
    wall_s: float = math.inf  # seconds until the measured voltage itself is at the cut-off


def say(asked: Asked, ends: EndTimes | None) -> tuple[Estimate, Remaining]:
    """What is known after a sample, in the order of the samples; `ends` answers the question, if there was one."""
    sample, estimate = asked.sample, asked.estimate
    if asked.forecaster is None:
        return estimate, Remaining(sample.time_s, NAN, NAN, NAN, NAN, Status.REFUSED, asked.refusal)
    answered = (asked.question, ends) if asked.question is not None and ends is not None else None
    remaining = walled(asked.forecaster.say(sample, estimate, asked.refusal, answered), asked.wall_s)
    if remaining.reason == FALLS_FASTER:
        estimate = replace(estimate, warnings=(*estimate.warnings, FALLS_FASTER))
    if remaining.remaining_alarm_s <= ALARM_S:
        alarm = f"two minutes left or less, at a risk of {ALARM_RISK:.1%}"
        estimate = replace(estimate, warnings=(*estimate.warnings, alarm))
    return estimate, remaining


def walled(said: Remaining, wall_s: float) -> Remaining:
    """The measured voltage bounds the time left that is said; a number of no width is never `ok`."""
    if not math.isfinite(said.remaining_s):
        return said
    now = bounded(said, wall_s)
    if wall_s < min(said.remaining_lo_s, CONTRADICTED_S) and now.status is not Status.REFUSED:
        now = replace(now, status=Status.CONVERGING, reason=FALLS_FASTER)
    if now.remaining_hi_s > now.remaining_lo_s:
        return now
    if now.remaining_hi_s <= 0.0:
        return replace(now, status=Status.CONVERGING, reason=AT_CUTOFF)
    return Remaining(now.time_s, NAN, NAN, NAN, NAN, Status.REFUSED, NO_END)


def unknown(sample: Sample) -> Estimate:
    """The estimate after a row that shows nothing, before there was a filter."""
    reason, seen = "no voltage in this row", (sample.current_A, sample.temp_C)
    return Estimate(sample.time_s, NAN, NAN, NAN, *seen, NAN, NAN, NAN, Status.REFUSED, reason)
