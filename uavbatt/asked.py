"""A row between its two halves: taken in, and said what is known after it.

Taking in depends on no forecast, so that a replay may take many rows in, simulate their forecasts side by side, and say
all in turn; in flight one follows the other at once (`Estimator.step`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from uavbatt.prediction.endurance import EndTimes
from uavbatt.prediction.forecaster import Forecaster
from uavbatt.prediction.questions import Question
from uavbatt.records import ALARM_RISK, NAN, Estimate, Remaining, Sample, Status

ALARM_S = 120.0


class Asked(NamedTuple):
    """A sample taken in, and what is still to be worked out to say all that is known after it."""

    sample: Sample
    estimate: Estimate
    forecaster: Forecaster | None
    refusal: str
    question: Question | None


def say(asked: Asked, ends: EndTimes | None) -> tuple[Estimate, Remaining]:
    """What is known after a sample, in the order of the samples; `ends` answers the question, if there was one."""
    sample, estimate = asked.sample, asked.estimate
    if asked.forecaster is None:
        return estimate, Remaining(sample.time_s, NAN, NAN, NAN, NAN, Status.REFUSED, asked.refusal)
    answered = (asked.question, ends) if asked.question is not None and ends is not None else None
    remaining = asked.forecaster.say(sample, estimate, asked.refusal, answered)
    if remaining.remaining_alarm_s <= ALARM_S:
        alarm = f"two minutes left or less, at a risk of {ALARM_RISK:.1%}"
        estimate = replace(estimate, warnings=(*estimate.warnings, alarm))
    return estimate, remaining


def unknown(sample: Sample) -> Estimate:
    """The estimate after a row that shows nothing, before there was a filter."""
    reason, seen = "no voltage in this row", (sample.current_A, sample.temp_C)
    return Estimate(sample.time_s, NAN, NAN, NAN, *seen, NAN, NAN, NAN, Status.REFUSED, reason)
