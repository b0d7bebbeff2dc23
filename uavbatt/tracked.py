"""One battery in flight: its estimator, and what of it survives a crash.

Resuming: the saved belief, and what the forecaster and the intake remember, are put at their own time, before the first
row of the new process. The charge that was drawn meanwhile is the difference of the autopilot's counter where it has
one; else the load is taken to have gone on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from uavbatt.battery.belief import SIZE, Belief
from uavbatt.battery.file import BatteryFile
from uavbatt.errors import UavbattError
from uavbatt.pipeline import Estimator, PackOptions, Past, Resolved
from uavbatt.records import NAN, Estimate, PackFacts, Remaining, Sample, Status

COUNTER_SLACK_AH = 0.02


@dataclass(frozen=True, slots=True)
class Saved:
    """One battery in the saved state: the belief `since_row_s` before the last row, and what goes with it."""

    since_row_s: float
    means: list[list[float]]
    covariances: list[list[list[float]]]
    weights: list[float]
    ambient_C: float
    resolved: Resolved
    facts: PackFacts
    consumed_Ah: float
    current_A: float
    past: Past


class TrackedBattery:
    """Rows of one battery in, estimates out; never raises for what a vehicle may say."""

    def __init__(
        self,
        battery: BatteryFile,
        options: PackOptions,
        saved: Mapping[str, Any] | None = None,
        max_age_s: float = math.inf,
    ) -> None:
        self._battery, self._options = battery, options
        self.estimator = Estimator(battery, options)
        self._saved, self._max_age_s = saved, max_age_s
        self._last: Sample | None = None

    def step(self, sample: Sample, facts: PackFacts, gap_s: float = NAN) -> tuple[Estimate, Remaining]:
        """One row; `gap_s` is the age of the saved state at this row [s]."""
        if self._saved is not None:
            self._resume(self._saved, sample, gap_s)
            self._saved = None
        self._last = sample
        try:
            self.estimator.update_facts(facts)
            return self.estimator.step(sample)
        except (UavbattError, ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
            self.estimator = Estimator(self._battery, self._options)
            return refused(sample, str(error))

    def saved(self, facts: PackFacts) -> dict[str, Any] | None:
        """What is worth saving; None before the first estimate."""
        belief, resolved, last = self.estimator.belief, self.estimator.resolved, self._last
        past = self.estimator.past
        if belief is None or resolved is None or last is None or past is None:
            return None
        made = Saved(
            since_row_s=last.time_s - belief.time_s,
            means=belief.means.tolist(),
            covariances=belief.covariances.tolist(),
            weights=belief.weights.tolist(),
            ambient_C=belief.ambient_C,
            resolved=resolved,
            facts=facts,
            consumed_Ah=last.consumed_Ah,
            current_A=last.current_A,
            past=past.moved(-belief.time_s),
        )
        content: dict[str, Any] = msgspec.to_builtins(made)
        return content

    def _resume(self, saved: Mapping[str, Any], sample: Sample, gap_s: float) -> None:
        """Start from the saved belief; one that is damaged, or too old by now, is left alone."""
        if not 0.0 < gap_s <= self._max_age_s:
            return
        try:
            was = msgspec.convert(saved, Saved)
            at_s = sample.time_s - gap_s - was.since_row_s
            members, weights = len(was.weights), np.array(was.weights)
            belief = Belief(at_s, np.array(was.means), np.array(was.covariances), weights, was.ambient_C)
            if belief.means.shape != (members, SIZE) or belief.covariances.shape != (members, SIZE, SIZE):
                return
            if not all(np.isfinite(part).all() for part in (belief.means, belief.covariances, weights)):
                return
            if members == 0 or (weights <= 0.0).any():
                return
            before_A = _current_at_belief(was.current_A, sample.current_A, sample.consumed_Ah - was.consumed_Ah, gap_s)
            self.estimator.restore(belief, was.resolved, was.facts, before_A, was.past.moved(at_s))
        except (msgspec.ValidationError, ValueError, UavbattError):
            self.estimator = Estimator(self._battery, self._options)


def _current_at_belief(saved_A: float, now_A: float, drawn_Ah: float, gap_s: float) -> float:
    """The current [A] at the start of the gap for which the trapezium over the gap holds the charge drawn."""
    if math.isfinite(now_A) and math.isfinite(drawn_Ah) and drawn_Ah > -COUNTER_SLACK_AH:
        return 2.0 * max(drawn_Ah, 0.0) * 3600.0 / gap_s - now_A
    return saved_A if math.isfinite(saved_A) else max(now_A, 0.0) if math.isfinite(now_A) else 0.0


def refused(sample: Sample, reason: str) -> tuple[Estimate, Remaining]:
    """An estimate that says only why there is none."""
    row = (sample.voltage_V, sample.current_A, sample.temp_C, sample.voltage_V * sample.current_A)
    estimate = Estimate(sample.time_s, NAN, NAN, *row, NAN, NAN, Status.REFUSED, reason)
    return estimate, Remaining(sample.time_s, NAN, NAN, NAN, NAN, Status.REFUSED, reason)
