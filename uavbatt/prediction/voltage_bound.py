"""The bound by the voltage: the time left at most, from the fall of the measured voltage towards the cut-off.

    V + v_lag = a + b t + c t² - r I    least squares over 40 s and over 60 s, t = 0 now, c <= 0 <= r
    h + b t + c t² = 0                  h: what is left above the cut-off under the window's mean current
    v_lag = R_f I_f + R_s I_s           the lagging overpotentials, as multiples of the lagging currents
    I_f' = (I - I_f) / tau_f            I_s' in the same way

It does not depend on the believed charge. The lagging overpotentials are those of the belief now, so that the sag after
a climb is not taken for an emptying pack. Their course over the window comes from the current alone: the belief may
change its mind about the capacity within a few rows, and with it the overpotentials that it held before. The longer
time of the two windows counts, and only when both falls stand out of their scatter. If they do not, but the fall from
the window's beginning to its end leads to the cut-off in sight, an end that was near (STANDS_S) still stands. On packs
of many makes that time is right to a factor of two in the last 45 s, and too long before: so it can shorten a forecast
and never lengthens one. Rows slower than every three seconds show no such fall. While the current is unknown the
voltage is fitted as it is measured, without sag and lag: there is no time to shorten then, but the crew is told that
the end is near.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array, Parameters
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import SIZE, Belief, X
from uavbatt.notice import Kind, Notice
from uavbatt.prediction.forecast import no_forecast
from uavbatt.records import NAN, Remaining, Sample, Status

WINDOWS_S, LONGEST_WINDOW_S, BIN_S = (40.0, 60.0), 60.0, 1.0
# Bins in a window, and the share of it that they span. With 0.7, a pack of four times the usual ohms was taken for an
# emptying one in its first minute.
FEWEST_BINS, LEAST_SPAN = 12, 0.85
IDLE_SHARE = 0.25  # bins of less than this share of the current now show another sag than the fit can explain
JUDGED_BINS = 5
WITHIN_REACH_V = 0.33  # a cell farther above its cut-off is on its plateau
BLIND_REACH_V = 0.23  # without a current: a climb sags a cell by a tenth of a volt, and looks like the end
# A fall of fewer steps of the voltage's resolution may be one step: half volts show a slow fall as a flat line with a
# cliff in it.
RESOLVED_STEPS = 1.5
SIGHT_S = 190.0  # a fall says little about an end further ahead
LEVEL = 6.0  # times SIGHT_S at the mean slope of the window
OUTSTANDING = 6.0  # standard errors of the slope
# Upper limits of the 5 % point, the alarm's point, the median and the 95 % point, over the time by the voltage.
ALARM_SHARE = 0.63
SHARES = (0.5, ALARM_SHARE, 1.25, 2.5)
SURE_LOOKS = 5  # looks, one a second
# An end farther away does not stand without a fall that shows it: a climb at 6 °C counted down for half a minute from
# 150 s, with 680 s left.
STANDS_S = 60.0
CONTRADICTED_S = 120.0
FALLS_FASTER = Notice(
    "the voltage falls faster than the charge says: an older or smaller pack, or a current sensor that reads low",
    Kind.FALLS_FASTER,
)
AT_CUTOFF = "the pack is at its cut-off"
NO_END = Notice("no end found: the estimated charge and the load do not fit", Kind.NO_END)


class LaggingCurrents(NamedTuple):
    """LaggingCurrents holds the current as it shows in the fast and in the slow lagging overpotential [A].

    Both begin with the first current: a pack that was not seen before is at rest, or was loaded for a while.
    """

    time_s: float = NAN
    fast_A: float = NAN
    slow_A: float = NAN

    def after(self, time_s: float, current_A: float, cell: Parameters) -> LaggingCurrents:
        """Return the currents at a row; one without a current changes nothing."""
        if not math.isfinite(current_A):
            return self
        if not math.isfinite(self.time_s):
            return LaggingCurrents(time_s, current_A, current_A)
        dt_s = max(time_s - self.time_s, 0.0)
        fast = math.exp(-dt_s / float(cell.polarisation_tau_s))
        slow = math.exp(-dt_s / float(cell.diffusion_tau_s))
        fast_A, slow_A = current_A + fast * (self.fast_A - current_A), current_A + slow * (self.slow_A - current_A)
        return LaggingCurrents(time_s, fast_A, slow_A)


class FallBin(NamedTuple):
    """FallBin holds a bin's means: begin [s], voltage [V], current [A], the lagging currents at its begin, rows.

    last_V : of the last row [V]; step_V : smallest change of the voltage from one row to the next, infinite without one
    """

    begin_s: float
    voltage_V: float
    current_A: float
    lagging: LaggingCurrents = LaggingCurrents()
    rows: int = 1
    last_V: float = NAN
    step_V: float = math.inf

    @property
    def is_metered(self) -> bool:
        """Return True if the current is known."""
        return math.isfinite(self.current_A)

    def with_row(self, voltage_V: float, current_A: float) -> FallBin:
        """Return the bin with one more row in its means."""
        share = 1.0 / (self.rows + 1)
        volts = self.voltage_V + share * (voltage_V - self.voltage_V)
        amps = self.current_A + share * (current_A - self.current_A)
        step_V = min(self.step_V, _changed_V(self.last_V, voltage_V))
        return FallBin(self.begin_s, volts, amps, self.lagging, self.rows + 1, voltage_V, step_V)


NO_BIN = FallBin(NAN, NAN, NAN)


def fall_left_s(
    bins: tuple[FallBin, ...], cells: float, cutoff_V: float, fast_V: float = 0.0, slow_V: float = 0.0
) -> float:
    """Return the seconds until the pack's voltage is at `cutoff_V` [V]; infinite where no fall shows it.

    bins : the last minute, the open bin last; fast_V, slow_V : the pack's lagging overpotentials now [V]. NaN means
    that it cannot be told: the voltage falls towards the cut-off, but not clearly enough for a time.
    """
    reach_V = WITHIN_REACH_V if bins[-1].is_metered else BLIND_REACH_V
    if bins[-1].voltage_V - cutoff_V > reach_V * cells:
        return math.inf  # true in most of a flight
    bins = _of_one_kind(bins)
    judged = bins[-JUDGED_BINS:]
    if len(judged) == JUDGED_BINS and sum(row.voltage_V for row in judged) < JUDGED_BINS * cutoff_V:
        return 0.0  # over, by the rule that ends a flight
    least_A = min(IDLE_SHARE * bins[-1].current_A, bins[-1].current_A)
    bins = tuple([row for row in bins if row.current_A >= least_A])
    fallen_V = _mean_fall_V(bins) if len(bins) >= FEWEST_BINS else 0.0
    if fallen_V <= 0.0 or fallen_V < RESOLVED_STEPS * min(row.step_V for row in bins):
        return math.inf
    slope_left_s = _by_mean_slope_s(bins, fallen_V, cutoff_V)
    if slope_left_s > LEVEL * SIGHT_S:
        return math.inf
    rows = np.array([(*row[:3], lag_V) for row, lag_V in zip(bins, _lags_V(bins, fast_V, slow_V), strict=True)])
    rows[:, 0] -= rows[-1, 0]
    left_s = 0.0
    for window_s in WINDOWS_S:
        by_window_s = _fallen_s(rows[rows[:, 0] >= -window_s], window_s, cutoff_V)
        if not by_window_s <= SIGHT_S:
            return NAN if slope_left_s <= SIGHT_S else math.inf
        left_s = max(left_s, by_window_s)
    return left_s


def _last_minute(bins: tuple[FallBin, ...], now_s: float) -> tuple[FallBin, ...]:
    """Return the bins that a window may hold at a time [s]; none after a clock that fell back."""
    if not bins or now_s < bins[-1].begin_s:
        return ()
    first = next((k for k, row in enumerate(bins) if now_s - row.begin_s <= LONGEST_WINDOW_S), len(bins))
    return bins[first:]


def _of_one_kind(bins: tuple[FallBin, ...]) -> tuple[FallBin, ...]:
    """Return the bins with a current, if the last one has it; else all bins, without currents.

    With a current of 0 in every bin the fit has neither sag nor lag.
    """
    if bins[-1].is_metered:
        return tuple([row for row in bins if row.is_metered])
    return tuple(row._replace(current_A=0.0, lagging=LaggingCurrents(NAN, 0.0, 0.0)) for row in bins)


def _lags_V(bins: tuple[FallBin, ...], fast_V: float, slow_V: float) -> list[float]:
    """Return the pack's lagging overpotential in each bin [V], from the two that it has now [V]."""
    now = bins[-1]
    fast, slow = (
        lag_V / lag_A if lag_A > IDLE_SHARE * now.current_A > 0.0 else 0.0
        for lag_V, lag_A in ((fast_V, now.lagging.fast_A), (slow_V, now.lagging.slow_A))
    )
    return [fast * row.lagging.fast_A + slow * row.lagging.slow_A for row in bins]


def _changed_V(before_V: float, now_V: float) -> float:
    """Return the change of the voltage between two rows [V]; infinite without one."""
    return abs(now_V - before_V) if now_V != before_V and math.isfinite(before_V) else math.inf


def _mean_fall_V(bins: tuple[FallBin, ...]) -> float:
    """Return the fall of the voltage from the first quarter of the bins to the last [V]."""
    part = len(bins) // 4
    return sum(row.voltage_V for row in bins[:part]) / part - sum(row.voltage_V for row in bins[-part:]) / part


def _by_mean_slope_s(bins: tuple[FallBin, ...], fallen_V: float, cutoff_V: float) -> float:
    """Return the time left [s] if the voltage goes on as from the first quarter of the bins to the last."""
    part = len(bins) // 4
    last_V = sum(row.voltage_V for row in bins[-part:]) / part
    over_s = 0.75 * (bins[-1].begin_s - bins[0].begin_s)
    return max(last_V - cutoff_V, 0.0) * over_s / fallen_V


def _fallen_s(rows: Array, window_s: float, cutoff_V: float) -> float:
    """Return the time left [s] by the fall over one window; infinite beyond SIGHT_S, or if no fall stands out.

    rows : [rows, 4] of time [s] (0 is now), voltage [V], current [A] and lagging overpotential [V].
    """
    t, volts, amps, lag_V = rows.T
    if len(t) < FEWEST_BINS or -t[0] < LEAST_SPAN * window_s:
        return math.inf
    curve = np.stack([np.ones_like(t), t, t * t], axis=1)
    sagging = np.column_stack([curve, np.mean(amps) - amps])
    found, design = np.linalg.lstsq(sagging, volts + lag_V, rcond=None)[0], sagging
    if found[3] < 0.0:  # a sag has the other sign
        found, design = np.linalg.lstsq(curve, volts + lag_V, rcond=None)[0], curve
    left_s = _crossing_s(float(found[0] - lag_V[-1]) - cutoff_V, float(found[1]), min(float(found[2]), 0.0))
    if left_s > SIGHT_S:
        return math.inf
    scatter_V2 = float(np.sum((volts + lag_V - design @ found) ** 2)) / (len(t) - found.size)
    slope_sd = math.sqrt(scatter_V2 * float(np.linalg.pinv(design.T @ design)[1, 1]))
    return math.inf if -found[1] < OUTSTANDING * slope_sd else left_s


def _crossing_s(height_V: float, slope: float, bend: float) -> float:
    """Return the first t >= 0 at which height + slope t + bend t² is 0, for bend <= 0; infinite when it never is."""
    if height_V <= 0.0:
        return 0.0
    if bend > -1e-9:
        return height_V / -slope if slope < 0.0 else math.inf
    if slope >= 0.0:
        return math.inf  # it still rises: a bend alone is no fall
    return (slope + math.sqrt(slope * slope - 4.0 * bend * height_V)) / (-2.0 * bend)


class VoltageBound(NamedTuple):
    """VoltageBound holds the fall of the voltage and the ends that it has shown; it is a value, replaced at each row.

    bins : the last minute, the open bin last. One look may be chance: the bound is the latest end of the last
    SURE_LOOKS looks that told one.
    """

    bins: tuple[FallBin, ...] = ()
    ends_s: tuple[float, ...] = (math.inf,) * SURE_LOOKS
    lagging: LaggingCurrents = LaggingCurrents()

    def after(self, sample: Sample, belief: Belief | None, pack: Pack, below_V: float) -> VoltageBound:
        """Return the value after one more sample and the belief that it led to.

        below_V : how far the weakest cell, whose cut-off ends the flight, is below the mean of the cells [V].
        """
        time_s, volts, amps = sample.time_s, sample.voltage_V, sample.current_A
        if not math.isfinite(volts):
            return self
        lagging = self.lagging.after(time_s, amps, pack.cell)
        last = self.bins[-1] if self.bins else NO_BIN
        if 0.0 <= time_s - last.begin_s < BIN_S and math.isfinite(amps) is last.is_metered:
            return VoltageBound((*self.bins[:-1], last.with_row(volts, amps)), self.ends_s, lagging)
        new = FallBin(time_s, volts, amps, lagging, last_V=volts, step_V=_changed_V(last.last_V, volts))
        bins = (*_last_minute(self.bins, time_s), new)
        cells, cutoff_V = float(pack.installation.cells), float(pack.at_weakest_cell(below_V).cutoff_V)
        x = belief.mean if belief is not None else np.zeros(SIZE)
        fast_V, slow_V = cells * float(x[X.POLARISATION]), cells * float(x[X.DIFFUSION])
        left_s = fall_left_s(bins, cells, cutoff_V, fast_V, slow_V)  # once a second is often enough to look
        if math.isnan(left_s) and self.left_s(time_s) <= STANDS_S:
            return VoltageBound(bins, self.ends_s, lagging)
        end_s = math.inf if math.isnan(left_s) else time_s + left_s
        return VoltageBound(bins, (*self.ends_s[1:], end_s), lagging)

    def left_s(self, time_s: float) -> float:
        """Return the seconds until the measured voltage is at the cut-off; infinite where it does not fall."""
        return max(max(self.ends_s) - time_s, 0.0)


def bounded(said: Remaining, left_s: float) -> Remaining:
    """Return `said` with no point later than the voltage allows; an interval without width is never `ok`.

    left_s : seconds until the measured voltage is at the cut-off, infinite where it does not fall.
    """
    if not math.isfinite(said.remaining_s):
        return said
    now = _at_most(said, left_s) if left_s < math.inf else said
    if left_s < min(said.remaining_lo_s, CONTRADICTED_S) and now.status is not Status.REFUSED:
        now = replace(now, status=Status.CONVERGING, reason=FALLS_FASTER)
    if now.remaining_hi_s > now.remaining_lo_s:
        return now
    if now.remaining_hi_s <= 0.0:
        return replace(now, status=Status.CONVERGING, reason=AT_CUTOFF)
    return no_forecast(now.time_s, NO_END)


def _at_most(said: Remaining, left_s: float) -> Remaining:
    """Return `said` with each point at most its share of `left_s` [s]."""
    points_s = (said.remaining_lo_s, said.remaining_alarm_s, said.remaining_s, said.remaining_hi_s)
    lo, alarm, median, hi = (min(point_s, share * left_s) for point_s, share in zip(points_s, SHARES, strict=True))
    low_s = min(said.remaining_to_low_s, median) if math.isfinite(said.remaining_to_low_s) else NAN
    return Remaining(said.time_s, median, lo, hi, low_s, said.status, said.reason, alarm, said.route)
