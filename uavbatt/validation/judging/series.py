"""A series of one-time tests over ambient temperature: where it breaks, and what its near repeats say of scatter.

Tests one degree apart are nearly repeats: about a straight line in temperature their residuals show run-to-run
scatter (quasi-replicates). A line must not cross a break between series of tests, which shows as a jump of the knee
time that no battery makes between neighbouring temperatures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uavbatt.dataset import DataSet, Flag, Run
from uavbatt.fitting.observed import MAD_TO_SD
from uavbatt.validation.iso5725.cells import Array
from uavbatt.validation.judging.crossing import crossing_time

KNEE_CELL_V = np.linspace(0.2, 0.9, 8) / 3  # above the cut-off, a cell; 9.5 to 10.2 V on the study's pack
COLD_C = -10.0  # below, cold resistance and self-heating bend the law by themselves
BREAK_SCORE = 5.0  # robust sds: one in a million by chance, for normal scatter
MIN_CURVES = 5  # three degrees of freedom beside the two of the line


@dataclass(frozen=True, slots=True)
class Break:
    """A Break is a jump of the mean knee time by `jump_s` [s] between two neighbouring ambient temperatures [°C].

    `score` is the jump less the usual slope, over the usual scatter between neighbours.
    """

    low_C: float
    high_C: float
    jump_s: float
    score: float


@dataclass(frozen=True, slots=True)
class QuasiReplicates:
    """QuasiReplicates holds one-time curves that are near repeats, about a line in ambient temperature per instant.

    `line(T)` [V], residual `sd` [V] with `df` degrees of freedom per instant, `residuals` [curve, instant] [V].
    `left_out` names flagged readings that took no part.
    """

    ambients_C: Array
    time_s: Array
    centre: Array
    slope: Array
    sd: Array
    df: Array
    residuals: Array
    left_out: tuple[str, ...]

    def line(self, ambient_C: float) -> Array:
        """Return the voltage on the line at `ambient_C` [°C], in V per instant."""
        mean: Array = self.centre + self.slope * (ambient_C - self.ambients_C.mean())
        return mean

    def leverage(self, ambient_C: float) -> float:
        """Return 1/n for the n results that the line at `ambient_C` [°C] is worth: 1/m + (T-T̄)²/Σ(T-T̄)²."""
        t = self.ambients_C - self.ambients_C.mean()
        return 1 / len(t) + (ambient_C - float(self.ambients_C.mean())) ** 2 / float((t**2).sum())


def single_series(dataset: DataSet) -> tuple[Run, ...]:
    """List the runs of the sample with the most ambient temperatures tested once, ascending in temperature."""
    by_sample: dict[str, list[Run]] = {}
    for run in dataset.runs:
        twins = [r for r in dataset.at(run.ambient_C) if r.sample == run.sample]
        if len(twins) == 1:
            by_sample.setdefault(run.sample, []).append(run)
    longest = max(by_sample.values(), key=len, default=[])
    return tuple(sorted(longest, key=lambda r: r.ambient_C))


def knee_time(run: Run, dataset: DataSet) -> float:
    """Return the mean time [s] of the first falls through eight voltages just above the cut-off, else NaN."""
    volts = dataset.cutoff_V + dataset.cells_series * KNEE_CELL_V
    return float(np.mean([crossing_time(run.time_s, run.voltage_V, float(v)) for v in volts]))


def breaks(dataset: DataSet, series: tuple[Run, ...]) -> tuple[Break, ...] | None:
    """Find the breaks in a series of one-time tests (`single_series`) at -10 °C and above.

    Returns None with fewer than eight temperatures.
    Score: knee-time difference of neighbours less the median slope, over the robust scatter (MAD_TO_SD times the MAD).
    """
    runs = [r for r in series if r.ambient_C >= COLD_C]
    knee = np.array([knee_time(r, dataset) for r in runs])
    T = np.array([r.ambient_C for r in runs])[~np.isnan(knee)]
    knee = knee[~np.isnan(knee)]
    if len(T) < 8:
        return None
    dT, dk = np.diff(T), np.diff(knee)
    excess = dk - float(np.median(dk / dT)) * dT
    scatter = MAD_TO_SD * float(np.median(np.abs(excess - np.median(excess))))
    if scatter == 0:
        return ()
    score = excess / scatter
    return tuple(
        Break(float(T[i]), float(T[i + 1]), float(dk[i]), float(score[i]))
        for i in np.flatnonzero(np.abs(score) > BREAK_SCORE).tolist()
    )


def quasi_replicates(
    series: tuple[Run, ...], broken: tuple[Break, ...] | None, flags: tuple[Flag, ...] = ()
) -> tuple[QuasiReplicates, ...]:
    """Group a series of one-time tests into near repeats: five curves or more, a degree apart, no break between.

    Readings that `flags` name take no part; the groups say which were left out.
    """
    divided = {b.high_C for b in broken or ()}
    groups: list[list[Run]] = []
    for run in series:
        near = groups and run.ambient_C - groups[-1][-1].ambient_C <= 1.01 and run.ambient_C not in divided
        if near and np.array_equal(run.time_s, groups[-1][-1].time_s):
            groups[-1].append(run)
        else:
            groups.append([run])
    return tuple(_line(group, flags) for group in groups if len(group) >= MIN_CURVES)


def unflagged_voltage(runs: Sequence[Run], flags: tuple[Flag, ...]) -> tuple[Array, tuple[str, ...]]:
    """Return the voltages [run, instant] [V] of runs on one grid, NaN where a flag names the reading, and those flags.

    A flag that names no one reading of them leaves nothing out.
    """
    volts, left_out = np.array([r.voltage_V for r in runs]), list[str]()
    for flag in flags:
        for i, run in enumerate(runs):
            same = (flag.sample, flag.run, flag.ambient_C) == (run.sample, run.run, run.ambient_C)
            if same and flag.column == "voltage_v" and flag.time_s in run.time_s:
                volts[i, run.time_s == flag.time_s] = math.nan
                left_out.append(flag.where)
    return volts, tuple(left_out)


def _line(group: list[Run], flags: tuple[Flag, ...]) -> QuasiReplicates:
    T = np.array([r.ambient_C for r in group])
    y, left_out = unflagged_voltage(group, flags)
    t = T - T.mean()
    fits = [_fit(t, column) for column in y.T]
    centre, slope, sd, df = np.array([f[:4] for f in fits], dtype=float).T
    residuals = np.array([f[4] for f in fits]).T
    return QuasiReplicates(T, group[0].time_s, centre, slope, sd, df, residuals, left_out)


def _fit(t: Array, y: Array) -> tuple[float, float, float, float, Array]:
    """Return centre, slope, residual SD, degrees of freedom, residuals (0 for a reading that is left out)."""
    measured = ~np.isnan(y)
    slope, centre = np.polyfit(t[measured], y[measured], 1)
    residuals = np.where(measured, y - centre - slope * t, 0.0)
    df = int(measured.sum()) - 2
    return float(centre), float(slope), math.sqrt(float((residuals**2).sum()) / df), float(df), residuals
