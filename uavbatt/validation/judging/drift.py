"""Drift over the order of the runs: the study's rule, von Neumann/Abbe, Mann-Kendall, slope, step.

The study's rule |d̄| < 0.2σ uses only the first and the last run and raises 22 % false alarms on pure noise; it is
kept for the record. The others have p-values: Abbe and the step by permuting the runs (seeded, ties handled by
themselves), Mann-Kendall exactly (also with ties), the slope by Student's t.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from uavbatt.errors import NotEnoughData
from uavbatt.validation.iso5725.cells import Array, numbers, spread
from uavbatt.validation.judging.chance import permutations
from uavbatt.validation.study.paper_equations import DRIFT_LIMIT, drift_ratio

TREND_RUNS = 4  # the six orders of three runs give no p-value below 17 %
LEAST_RUNS = 2  # on each side of a step
STEP_RUNS = 2 * LEAST_RUNS + 1  # so that a step has two places at least
STEP_PERMUTATIONS = 4000  # whole curves: a p-value of 5 % is known to 0.35 %
EXACT_UP_TO = 60  # runs: counting takes n³ steps, and the normal approximation is good for more


@dataclass(frozen=True, slots=True)
class PaperDrift:
    """PaperDrift compares |d̄|/σ (`ratio`) with 0.2, as the study does; `significant` is its verdict."""

    ratio: float
    significant: bool


@dataclass(frozen=True, slots=True)
class Abbe:
    """Abbe holds q²/s², 1 for independent results and small for drift; the permutation p-value is one-sided."""

    statistic: float
    p_value: float


@dataclass(frozen=True, slots=True)
class MannKendall:
    """MannKendall holds S, the number of rises less the number of falls over all pairs; the p-value is two-sided."""

    S: int
    p_value: float
    exact: bool


@dataclass(frozen=True, slots=True)
class Slope:
    """Slope holds the least-squares and the Theil-Sen slope, unit of the results a run, and the first's t-test."""

    per_run: float
    standard_error: float
    p_value: float
    theil_sen: float


@dataclass(frozen=True, slots=True)
class StepTest:
    """StepTest says that the most likely single step comes after `after` runs, where the mean changes by `size`.

    `statistic` is the share of the sum of squares that the step explains.
    `p_value` allows for the choice of the place (permutation); `p_at_place` is Welch's test as if the place
    had been known before.
    """

    after: int
    size: float
    statistic: float
    p_value: float
    p_at_place: float


@dataclass(frozen=True, slots=True)
class Drift:
    """Drift holds all drift tests of one column of results in run order; `step` is None below five runs."""

    paper: PaperDrift
    abbe: Abbe
    mann_kendall: MannKendall
    slope: Slope
    step: StepTest | None


def _in_order(results: ArrayLike, least: int) -> Array:
    values = numbers(results, "results in run order")
    if len(values) < least:
        raise NotEnoughData(f"a drift test needs {least} runs or more, found {len(values)}")
    return values


def paper_rule(results: ArrayLike) -> PaperDrift:
    """Apply the study's rule |d̄| < 0.2σ, equations (1)-(4). Raises NotEnoughData below three runs."""
    ratio = drift_ratio(_in_order(results, 3))
    return PaperDrift(ratio, ratio >= DRIFT_LIMIT)


def abbe_ratio(rows: Array) -> Array:
    """Compute q²/s² = [Σ(x_i-x_(i+1))²/2] / Σ(x_i-x̄)² of each row (von Neumann 1941, Abbe)."""
    centred = rows - rows.mean(axis=-1, keepdims=True)
    ratio: Array = (np.diff(centred, axis=-1) ** 2).sum(axis=-1) / 2 / (centred**2).sum(axis=-1)
    return ratio


def abbe(results: ArrayLike) -> Abbe:
    """Test von Neumann's ratio: the p-value is that of a value as small or smaller under random order.

    Returns NaN for equal results. Raises NotEnoughData below four runs.
    """
    values, squares = spread(_in_order(results, TREND_RUNS))
    if squares == 0:
        return Abbe(math.nan, math.nan)
    observed = float(abbe_ratio(values))
    random = abbe_ratio(values[permutations(len(values))])
    return Abbe(observed, (1 + int(np.sum(random <= observed + 1e-9))) / (len(random) + 1))


def mann_kendall_S(values: Array) -> int:
    """Compute S = Σ sign(x_j - x_i) over i < j."""
    return int(np.sign(values[None, :] - values[:, None])[np.triu_indices(len(values), 1)].sum())


def mann_kendall(results: ArrayLike) -> MannKendall:
    """Test for a trend by Mann-Kendall; exact for up to 60 runs, else normal with continuity and tie corrections.

    Raises NotEnoughData below four runs.
    """
    values = _in_order(results, TREND_RUNS)
    S, n = mann_kendall_S(values), len(values)
    ties = [int(c) for c in np.unique(values, return_counts=True)[1]]
    if n <= EXACT_UP_TO:
        return MannKendall(S, _exact_p(S, ties), True)
    variance = (n * (n - 1) * (2 * n + 5) - sum(t * (t - 1) * (2 * t + 5) for t in ties)) / 18
    z = max(abs(S) - 1, 0) / math.sqrt(variance) if variance > 0 else 0.0
    return MannKendall(S, float(2 * stats.norm.sf(z)), False)


def _exact_p(S: int, ties: list[int]) -> float:
    """Return P(|S| >= |S observed|), by counting inversions of a multiset with products of Gaussian binomials."""
    counts, placed = [1], 0
    for t in ties:
        for i in range(1, t + 1):  # times (1-q^(placed+i)) / (1-q^i)
            counts = _times_one_minus(counts, placed + i)
            counts = _over_one_minus(counts, i)
        placed += t
    pairs = len(counts) - 1
    extreme = sum(c for inversions, c in enumerate(counts) if abs(pairs - 2 * inversions) >= abs(S))
    return extreme / sum(counts)


def _times_one_minus(a: list[int], m: int) -> list[int]:
    product = a + [0] * m
    for i, c in enumerate(a):
        product[i + m] -= c
    return product


def _over_one_minus(a: list[int], m: int) -> list[int]:
    quotient = a[: len(a) - m]
    for i in range(m, len(quotient)):
        quotient[i] += quotient[i - m]
    return quotient


def slope(results: ArrayLike) -> Slope:
    """Fit a straight line through results against run number, by least squares and by Theil-Sen.

    Raises NotEnoughData below four runs.
    """
    values, _ = spread(_in_order(results, TREND_RUNS))
    n = len(values)
    runs = np.arange(n) - (n - 1) / 2
    per_run = float(runs @ values / (runs @ runs))
    residual_variance = float(((values - per_run * runs) ** 2).sum()) / (n - 2)
    error = math.sqrt(residual_variance / float(runs @ runs))
    p = float(2 * stats.t.sf(abs(per_run) / error, n - 2)) if error > 0 else (0.0 if per_run else 1.0)
    return Slope(per_run, error, p, float(stats.theilslopes(values).slope))


def step_share(tables: Array) -> Array:
    """Compute the share of a column's sum of squares that a step after run k explains, [..., k - LEAST_RUNS].

    `tables[..., run, column]` is centred per column; the share is averaged over the columns that vary.
    """
    n = tables.shape[-2]
    whole = (tables**2).sum(axis=-2)
    ends = np.cumsum(tables, axis=-2)[..., LEAST_RUNS - 1 : n - LEAST_RUNS, :]
    k = np.arange(LEAST_RUNS, n - LEAST_RUNS + 1)[:, None]
    share = ends**2 * (1 / k + 1 / (n - k)) / np.where(whole > 0, whole, np.inf)[..., None, :]
    mean: Array = share.sum(axis=-1) / max(int((whole.reshape(-1, whole.shape[-1])[0] > 0).sum()), 1)
    return mean


def line_change(table: Array) -> Array:
    """Compute the change of a straight line from the first run to the last, [time]; `table[run, time]`."""
    slope, _ = _line(table)
    return (len(table) - 1) * slope


def trend_share(table: Array) -> float:
    """Compute the share of a column's sum of squares that a straight line over the runs explains: the mean share.

    `table[run, time]`; columns that do not vary are left out, and a table without any has 0.
    """
    whole = ((table - table.mean(axis=0)) ** 2).sum(axis=0)
    varies = whole > 0
    if not varies.any():
        return 0.0
    _, explained = _line(table)
    return float(np.mean(explained[varies] / whole[varies]))


def _line(table: Array) -> tuple[Array, Array]:
    """Return the slope of a straight line over the runs, and the sum of squares that it explains, [time] each."""
    runs = np.arange(len(table)) - (len(table) - 1) / 2
    along: Array = runs @ (table - table.mean(axis=0))
    return along / (runs @ runs), along**2 / (runs @ runs)


def curve_step(table: Array) -> StepTest:
    """Find the most likely step of whole curves, `table[run, time]`; every column counts alike.

    `size` and `p_at_place` are of the mean over the columns (unit of the results).
    Raises NotEnoughData below five runs.
    """
    n = len(table)
    if n < STEP_RUNS:
        raise NotEnoughData(f"a step needs {STEP_RUNS} runs or more to be seen, found {n}")
    centred = table - table[0]
    centred = centred - centred.mean(axis=0)
    shares = step_share(centred)
    best, after = float(np.max(shares)), int(np.argmax(shares)) + LEAST_RUNS
    random = step_share(centred[permutations(n, STEP_PERMUTATIONS)]).max(axis=-1)
    mean = np.round(centred.mean(axis=1), 12)  # equal means stay equal
    size = float(mean[after:].mean() - mean[:after].mean())
    p = (1 + int(np.sum(random >= best - 1e-9))) / (len(random) + 1)
    flat = float(np.ptp(mean[:after]) * np.ptp(mean[after:])) == 0
    welch = math.nan if flat else float(stats.ttest_ind(mean[:after], mean[after:], equal_var=False).pvalue)
    return StepTest(after, size, best, p, welch)


def drift(results: ArrayLike) -> Drift:
    """Run every drift test on one column of results in run order. Raises NotEnoughData below four runs."""
    values = _in_order(results, TREND_RUNS)
    step = curve_step(values[:, None]) if len(values) >= STEP_RUNS else None
    return Drift(paper_rule(values), abbe(values), mann_kendall(values), slope(values), step)
