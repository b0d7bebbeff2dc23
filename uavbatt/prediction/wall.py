"""The last wall: how soon the measured voltage itself reaches the cut-off, without any model of the battery.

    V = a + b t + c t² - r I        least squares over the last WINDOW_S, t = 0 now, c <= 0 <= r
    h + b t + c t² = 0              h: what is left above the cut-off under the window's mean current

Whatever is believed of the charge, a pack whose voltage falls towards its cut-off is there when it is there. On packs
of many makes the time is right to a factor of two in the last 45 s, and too long before: so it bounds what is said and
never lengthens it. Rows slower than every three seconds show no such fall.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.records import NAN, Remaining

WINDOW_S, BIN_S = 40.0, 1.0
FEWEST_BINS, LEAST_SPAN_S = 12, 28.0
JUDGED_BINS = 5
WITHIN_REACH_V = 0.45  # a cell farther above its cut-off is on its plateau
SIGHT_S = 150.0  # beyond this a fall says little
# The time by the voltage as the 5 % point, the alarm's, the median and the 95 % point may be at most.
SHARES = (0.6, 0.8, 1.25, 2.5)


class Fall(NamedTuple):
    """Means over BIN_S of the last WINDOW_S: rows (time [s], voltage [V], current [A], count), the open one last."""

    bins: tuple[tuple[float, float, float, int], ...] = ()

    @property
    def is_due(self) -> bool:
        """Whether the last row has begun a new bin: once a second is often enough to look."""
        return bool(self.bins) and self.bins[-1][3] == 1

    def after(self, time_s: float, voltage_V: float, current_A: float) -> Fall:
        """The window with one more row; a row before the last one leaves it as it is."""
        if not (math.isfinite(voltage_V) and math.isfinite(current_A)):
            return self
        if self.bins and time_s < self.bins[-1][0]:
            return Fall()
        if self.bins and time_s - self.bins[-1][0] < BIN_S:
            start_s, volts, amps, count = self.bins[-1]
            share = 1.0 / (count + 1)
            blended = (start_s, volts + share * (voltage_V - volts), amps + share * (current_A - amps), count + 1)
            return Fall((*self.bins[:-1], blended))
        kept = tuple(row for row in self.bins if time_s - row[0] <= WINDOW_S)
        return Fall((*kept, (time_s, voltage_V, current_A, 1)))

    def time_left_s(self, cells: float, cutoff_V: float) -> float:
        """Seconds until the pack's voltage is at `cutoff_V`; infinite where no fall tells."""
        judged = self.bins[-JUDGED_BINS:]
        if not judged or judged[-1][1] - cutoff_V > WITHIN_REACH_V * cells:
            return math.inf
        if len(judged) == JUDGED_BINS and sum(row[1] for row in judged) < JUDGED_BINS * cutoff_V:
            return 0.0  # over, by the rule that ends a flight
        if len(self.bins) < FEWEST_BINS or self.bins[-1][0] - self.bins[0][0] < LEAST_SPAN_S:
            return math.inf
        time_s, volts, amps, _ = np.array(self.bins).T
        level_V, slope, bend = _fitted(time_s - time_s[-1], volts, amps - float(np.mean(amps)))
        left_s = _crossing_s(level_V - cutoff_V, slope, min(bend, 0.0))
        return left_s if left_s <= SIGHT_S else math.inf


def _fitted(t: Array, volts: Array, amps: Array) -> tuple[float, float, float]:
    """Level [V], slope [V/s] and bend [V/s²] now, at the mean current; a sag of the wrong sign is left out."""
    curve = np.stack([np.ones_like(t), t, t * t], axis=1)
    found = np.linalg.lstsq(np.column_stack([curve, -amps]), volts, rcond=None)[0]
    if found[3] < 0.0:
        found = np.linalg.lstsq(curve, volts, rcond=None)[0]
    return float(found[0]), float(found[1]), float(found[2])


def _crossing_s(height_V: float, slope: float, bend: float) -> float:
    """First t >= 0 at which height + slope t + bend t² is 0, for bend <= 0; infinite when it never is."""
    if height_V <= 0.0:
        return 0.0
    if bend > -1e-9:
        return height_V / -slope if slope < 0.0 else math.inf
    if slope >= 0.0:
        return math.inf  # it still rises: a bend alone is no fall
    return (slope + math.sqrt(slope * slope - 4.0 * bend * height_V)) / (-2.0 * bend)


def bounded(said: Remaining, left_s: float) -> Remaining:
    """`said` with no point later than the voltage allows, `left_s` from now [s]."""
    if not (math.isfinite(left_s) and math.isfinite(said.remaining_s)):
        return said
    lo, alarm, median, hi = (
        min(value, share * left_s)
        for value, share in zip(
            (said.remaining_lo_s, said.remaining_alarm_s, said.remaining_s, said.remaining_hi_s), SHARES, strict=True
        )
    )
    low_s = min(said.remaining_to_low_s, median) if math.isfinite(said.remaining_to_low_s) else NAN
    return Remaining(said.time_s, median, lo, hi, low_s, said.status, said.reason, alarm)
