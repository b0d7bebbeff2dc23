"""The end of a flight, from its telemetry: the rule, which gives the truth for scores of forecasts.

    the first row under load at which the trailing 5 s mean of the pack's voltage is below the cut-off
    (rows slower than 5 s: the centred median of three rows)

A forecast uses the same rule in steps of seconds, in `prediction.time_to_end` and its compiled twin
`compiled.forecast`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from uavbatt.battery.model import Array
from uavbatt.records import NAN

MEAN_WINDOW_S = 5.0  # part of the definition: a gust or a short climb does not end a flight


def end_of_flight(
    time_s: ArrayLike,
    voltage_V: ArrayLike,
    current_A: ArrayLike | None = None,
    *,
    cutoff_V: float,
    min_current_A: float = -math.inf,
) -> float:
    """Return the first time [s] at which the voltage under load is below `cutoff_V` [V]; NaN if it never is.

    Judged by the trailing 5 s mean, by the centred 3-row median where rows are slower than 5 s, and only at
    rows whose current exceeds `min_current_A`. Rows without a voltage are left out. The first 5 s, and
    the two outermost rows of a slow log, have no full window and are not judged.
    """
    time, volts = np.asarray(time_s, float), np.asarray(voltage_V, float)
    amps = np.full_like(volts, math.inf) if current_A is None else np.asarray(current_A, float)
    finite = np.isfinite(volts) & np.isfinite(time)
    time, volts, amps = time[finite], volts[finite], amps[finite]
    if time.size < 3:
        return NAN
    slow = float(np.median(np.diff(time))) > MEAN_WINDOW_S
    level_V = _median_of_three(volts) if slow else _trailing_mean(time, volts)
    loaded = (amps > min_current_A) | (min_current_A == -math.inf)  # an unknown current is no load
    below = np.flatnonzero((level_V < cutoff_V) & loaded)
    return float(time[below[0]]) if below.size else NAN


def _median_of_three(values: Array) -> Array:
    level = np.full_like(values, NAN)
    level[1:-1] = np.median(np.stack([values[:-2], values[1:-1], values[2:]]), axis=0)
    return level


def _trailing_mean(time_s: Array, values: Array) -> Array:
    """Return the mean of the rows in (t - 5 s, t] at each row; NaN until the first window is full."""
    first = np.searchsorted(time_s, time_s - MEAN_WINDOW_S + 1e-6, side="left")
    sums = np.concatenate([[0.0], np.cumsum(values)])
    count = np.arange(1, time_s.size + 1)
    level = (sums[count] - sums[first]) / (count - first)
    step_s = float(np.median(np.diff(time_s)))
    level[time_s < time_s[0] + MEAN_WINDOW_S - step_s - 1e-6] = NAN
    return np.asarray(level, float)
