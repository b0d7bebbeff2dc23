"""A forecast as a value: the ends of its samples, their quantiles, and its countdown."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.records import ALARM_RISK, NAN, Estimate, Remaining, Route, Status

# Forecasts are averaged over 20 s, so that a person can read them, and near the end over a tenth of the time left: in
# the last minute the lag of a 20 s average was a large part of the error.
STEADY_TAU_S, STEADY_SHARE = 20.0, 0.1
LARGEST_JITTER_S, LARGEST_JITTER = 30.0, 0.2
LARGEST_FALL_S, LARGEST_FALL = 10.0, 0.5  # of the early ends: a motor that starts may end the flight within seconds
LEVELS = (0.05, ALARM_RISK, 0.5, 0.95)


class Forecast(NamedTuple):
    """Forecast holds the quantiles of one forecast's simulated ends, in seconds from `time_s`, when it was made.

    lo_s, hi_s : 5 % and 95 % point; low_warning_s : until the low-voltage warning, NaN where the pack has none;
    alarm_s : the point at ALARM_RISK, by which alarms go; ends_s : all ends.
    """

    time_s: float
    median_s: float
    lo_s: float
    hi_s: float
    low_warning_s: float
    alarm_s: float
    ends_s: Array  # sorted
    route: Route | None = None

    def counted_down(self, estimate: Estimate) -> Remaining:
        """Return the remaining time at a later estimate, with its status and reason."""
        age_s = estimate.time_s - self.time_s
        return Remaining(  # max() keeps NaN, the first of the two
            time_s=estimate.time_s,
            remaining_s=max(self.median_s - age_s, 0.0),
            remaining_lo_s=max(self.lo_s - age_s, 0.0),
            remaining_hi_s=max(self.hi_s - age_s, 0.0),
            remaining_to_low_s=max(self.low_warning_s - age_s, 0.0),
            status=estimate.status,
            reason=estimate.reason,
            remaining_alarm_s=max(self.alarm_s - age_s, 0.0),
            route=self.route and self.route.later(age_s),
        )

    def steadied(self, fresh_s: Array, time_s: float) -> Array:
        """Return fresh ends [s, sorted] blended, rank by rank, with these less their age, so that it is readable.

        A large change of the median, or a large fall of an early end, is a change of load, and is shown at once.
        """
        age_s = time_s - self.time_s
        aged_s = np.maximum(self.ends_s - age_s, 0.0)
        aged_median_s = quantile(aged_s, 0.5)
        for level in LEVELS[:2]:
            early_s = quantile(aged_s, level)
            if early_s - quantile(fresh_s, level) > max(LARGEST_FALL_S, LARGEST_FALL * early_s):
                return fresh_s
        if abs(quantile(fresh_s, 0.5) - aged_median_s) > max(LARGEST_JITTER_S, LARGEST_JITTER * aged_median_s):
            return fresh_s
        tau_s = min(STEADY_TAU_S, STEADY_SHARE * aged_median_s)
        keep = math.exp(-age_s / tau_s) if tau_s > 0.0 else 0.0
        return np.asarray(keep * aged_s + (1.0 - keep) * fresh_s)


def quantile(ordered: Array, level: float) -> float:
    """Return the quantile of values in ascending order, linear between them, as numpy's: which sorts anew each time."""
    position = level * (ordered.size - 1)
    below = int(position)
    above = min(below + 1, ordered.size - 1)
    return float(ordered[below] + (position - below) * (ordered[above] - ordered[below]))


def no_forecast(time_s: float, reason: str) -> Remaining:
    """Return the remaining time of a row at `time_s` [s] that says only why there is none."""
    return Remaining(time_s, NAN, NAN, NAN, NAN, Status.REFUSED, reason)
