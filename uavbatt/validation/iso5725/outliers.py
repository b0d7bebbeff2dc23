"""Consistency and outliers, ISO 5725-2 section 7: Mandel's h and k, Cochran, Grubbs single and double.

Critical values in closed form for any p, n and α (Wilrich, AStA 97 (2013) 1): h and k are exact, Cochran and
single Grubbs are Bonferroni bounds that agree with the standard's tables to a unit of their third digit. Double
Grubbs has no closed form: simulated values are packaged for p = 4..40 at 1 % and 5 %.
Within the 5 % value "ok"; between 5 % and 1 % "straggler"; beyond 1 % "outlier".
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from uavbatt.errors import NotEnoughData
from uavbatt.validation.iso5725.cells import Array, Cells, numbers, spread, summarise, without_dust

Verdict = Literal["ok", "straggler", "outlier"]


@dataclass(frozen=True, slots=True)
class Cochran:
    """Cochran holds Cochran's statistic, the largest variance over the sum of variances.

    `index` is the cell with the largest, `p` the number of cells compared, `n` the results per cell that are assumed.
    """

    statistic: float
    critical_5: float
    critical_1: float
    index: int
    verdict: Verdict
    p: int
    n: int
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Grubbs:
    """Grubbs holds the distances of the largest and the smallest value from the mean, in SDs."""

    statistic_high: float
    statistic_low: float
    critical_5: float
    critical_1: float
    verdict_high: Verdict
    verdict_low: Verdict
    index_high: int
    index_low: int

    @property
    def ends(self) -> list[tuple[float, int, Verdict]]:
        """Return statistic, index and verdict of both ends, the farther one first."""
        high = (self.statistic_high, self.index_high, self.verdict_high)
        return sorted([high, (self.statistic_low, self.index_low, self.verdict_low)], reverse=True)


@dataclass(frozen=True, slots=True)
class DoubleGrubbs:
    """DoubleGrubbs holds the sum of squares without the two largest (smallest) values over the whole: small = outlying.

    The critical values are NaN and the verdicts None where they are not tabulated (p > 40).
    """

    statistic_high: float
    statistic_low: float
    critical_5: float
    critical_1: float
    verdict_high: Verdict | None
    verdict_low: Verdict | None
    indices_high: tuple[int, int]
    indices_low: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Mandel:
    """Mandel holds h, the consistency of the cell means, and k, that of the cell SDs; NaN = not defined."""

    h: Array
    k: Array
    h_critical_5: float
    h_critical_1: float
    k_critical_5: float
    k_critical_1: float
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Scrutiny:
    """Scrutiny holds the results of the tests for outliers in the standard's order.

    `grubbs` is None below three cells; `double` runs only if the single test finds nothing; `retest` tests the
    other end after one value was found and dropped.
    """

    mandel: Mandel
    cochran: Cochran | None
    grubbs: Grubbs | None
    double: DoubleGrubbs | None
    retest: Grubbs | None


def cochran_critical(p: int, n: float, alpha: float) -> float:
    """Return Cochran's critical value 1/(1+(p-1)/F), F = F(1-α/p; n-1, (p-1)(n-1)); exact above one half."""
    if p < 2 or n < 2:
        return math.nan
    return variance_share_critical(n - 1, (p - 1) * (n - 1), p, alpha)


def variance_share_critical(df: float, others_df: float, p: int, alpha: float) -> float:
    """Return the critical value of one sample's share in the sum of squares of `p` samples, 1/(1+(f'/f)/F).

    df, others_df : degrees of freedom f of the sample and f' of the others together; F = F(1-α/p; f, f'). For equal
    numbers it is Cochran's, for others that of 't Lam 2010, Analytica Chimica Acta 659, 68.
    """
    F = float(stats.f.ppf(1 - alpha / p, df, others_df))
    return 1 / (1 + others_df / df / F)


def grubbs_critical(p: int, alpha: float) -> float:
    """Return Grubbs' critical value (p-1)/√p·√(t²/(p-2+t²)), t = t(1-α/(2p); p-2): two-sided, ISO 5725-2 Table 5."""
    if p < 3:
        return math.nan
    t2 = float(stats.t.ppf(1 - alpha / (2 * p), p - 2)) ** 2
    return (p - 1) / math.sqrt(p) * math.sqrt(t2 / (p - 2 + t2))


def h_critical(p: int, alpha: float) -> float:
    """Return the critical value of Mandel's h: (p-1)t/√(p(t²+p-2)), t = t(1-α/2; p-2); NaN below three cells."""
    if p < 3:
        return math.nan
    t = float(stats.t.ppf(1 - alpha / 2, p - 2))
    return (p - 1) * t / math.sqrt(p * (t * t + p - 2))


def k_critical(p: int, n: float, alpha: float) -> float:
    """Return the critical value of Mandel's k: √(p/(1+(p-1)/F)), F = F(1-α; n-1, (p-1)(n-1))."""
    if p < 2 or n < 2:
        return math.nan
    F = float(stats.f.ppf(1 - alpha, n - 1, (p - 1) * (n - 1)))
    return math.sqrt(p / (1 + (p - 1) / F))


@cache
def _double_table() -> dict[int, tuple[float, float]]:
    file = resources.files("uavbatt") / "data" / "critical" / "grubbs_double.csv"
    lines = [line for line in file.read_text("utf-8").splitlines() if not line.startswith("#")]
    return {int(r["p"]): (float(r["crit_1pct"]), float(r["crit_5pct"])) for r in csv.DictReader(lines)}


def double_grubbs_critical(p: int, alpha: float) -> float:
    """Return the packaged critical value for p = 4..40 and α = 0.01 or 0.05; NaN elsewhere."""
    one, five = _double_table().get(p, (math.nan, math.nan))
    return one if alpha == 0.01 else five if alpha == 0.05 else math.nan


def _verdict(statistic: float, critical_5: float, critical_1: float) -> Verdict:
    return "outlier" if statistic > critical_1 else "straggler" if statistic > critical_5 else "ok"


def cochran(cells: Cells) -> Cochran:
    """Test the largest variance, C = s²_max/Σs² over the cells with two results or more.

    For unequal n the n of most cells is used. A single variance that is not zero gives C = 1 at any size, which is
    noted. Raises BadCells, and NotEnoughData below two such cells.
    """
    summary = summarise(cells)
    repeated = np.flatnonzero(summary.counts > 1)
    p, n = len(repeated), summary.typical_n
    if p < 2:
        raise NotEnoughData("Cochran's test needs two samples with two results or more each")
    variances = summary.variances[repeated]
    total = math.fsum(variances)
    index = int(repeated[int(np.argmax(variances))])
    statistic = float(np.max(variances)) / total if total > 0 else math.nan
    critical_5, critical_1 = cochran_critical(p, n, 0.05), cochran_critical(p, n, 0.01)
    notes = [f"unequal numbers of results: n = {n} used"] if np.ptp(summary.counts[repeated]) else []
    if total == 0:
        notes.append("all standard deviations are zero: nothing to compare")
    elif np.count_nonzero(variances) == 1:
        notes.append("all standard deviations but one are zero: the resolution of the results decides")
    verdict = _verdict(statistic, critical_5, critical_1)
    return Cochran(statistic, critical_5, critical_1, index, verdict, p, n, tuple(notes))


def grubbs(means: ArrayLike) -> Grubbs:
    """Test the largest and the smallest of three values or more: G = (x_max - x̄)/s and (x̄ - x_min)/s.

    Of three values of which two are equal the third is 1.155 SDs off, however near it is. That says nothing, and the
    verdict is "ok", as by the standard's table (1.155 at both levels).
    Raises BadCells for what is no flat sequence of numbers, NotEnoughData below three values.
    """
    values = _means(means)
    p = len(values)
    if p < 3:
        raise NotEnoughData(f"Grubbs' test needs three values or more, found {p}")
    deviations, squares = spread(values)
    sd = math.sqrt(squares / (p - 1))
    high, low = (float(np.max(deviations)) / sd, -float(np.min(deviations)) / sd) if sd > 0 else (0.0, 0.0)
    critical_5, critical_1 = grubbs_critical(p, 0.05), grubbs_critical(p, 0.01)
    is_tie = p == 3 and np.unique(values).size < 3
    verdicts: list[Verdict] = ["ok" if is_tie else _verdict(g, critical_5, critical_1) for g in (high, low)]
    places = int(np.argmax(values)), int(np.argmin(values))
    return Grubbs(high, low, critical_5, critical_1, verdicts[0], verdicts[1], *places)


def double_grubbs(means: ArrayLike) -> DoubleGrubbs:
    """Test the two largest and the two smallest of four values or more: s²(without the two)/s0².

    Of four values, two that are equal make the statistic of the others 0, however near these are: that says nothing,
    and the verdict is "ok".
    Raises BadCells for what is no flat sequence of numbers, NotEnoughData below four values.
    """
    values = _means(means)
    p = len(values)
    if p < 4:
        raise NotEnoughData(f"the double Grubbs test needs four values or more, found {p}")
    order = np.argsort(values, kind="stable")
    _, whole = spread(values)
    high, low = (spread(values[rest])[1] / whole if whole > 0 else 1.0 for rest in (order[:-2], order[2:]))
    critical_5, critical_1 = double_grubbs_critical(p, 0.05), double_grubbs_critical(p, 0.01)
    is_judged = not math.isnan(critical_5)
    verdicts = [_double_verdict(p, g, critical_5, critical_1) if is_judged else None for g in (high, low)]
    ends = (int(order[-1]), int(order[-2])), (int(order[0]), int(order[1]))
    return DoubleGrubbs(high, low, critical_5, critical_1, verdicts[0], verdicts[1], *ends)


def _double_verdict(p: int, statistic: float, critical_5: float, critical_1: float) -> Verdict:
    return "ok" if p == 4 and statistic == 0.0 else _verdict(-statistic, -critical_5, -critical_1)


def _means(means: ArrayLike) -> Array:
    """Return the means to test; those that are equal in decimals are equal. Raises BadCells."""
    values = numbers(means, "means")
    return without_dust(values, float(np.max(np.abs(values))))


def mandel(cells: Cells, pooling: Literal["df", "equal"] = "df") -> Mandel:
    """Compute Mandel's h_i = (ȳ_i - ȳ)/s(ȳ) and k_i = s_i/s_r; a cell with one result has no k.

    s_r pools the variances by their degrees of freedom, as precision does; `pooling="equal"` is the standard's
    s_i√p/√Σs², the same for equal numbers of results. Below three cells h has no critical value (|h| is always
    0.707); with equal means h is 0. Raises BadCells, and NotEnoughData below two cells.
    """
    summary = summarise(cells)
    p, repeated = summary.p, summary.counts > 1
    if p < 2:
        raise NotEnoughData("Mandel's h and k compare samples, found one")
    deviations, squares = spread(summary.offsets)
    h = deviations / math.sqrt(squares / (p - 1)) if squares > 0 else np.zeros(p)
    with_k, n = int(repeated.sum()), summary.typical_n
    weights = summary.counts[repeated] - 1 if pooling == "df" else np.ones(with_k)
    total = math.fsum(weights * summary.variances[repeated])
    pooled = total / math.fsum(weights) if with_k else 0.0
    k = np.sqrt(summary.variances / pooled) if pooled > 0 else np.where(repeated, 0.0, math.nan)
    notes = ["fewer than three samples: h says nothing"] if p < 3 else []
    if total == 0:
        notes.append("all standard deviations are zero: k says nothing")
    criticals = (h_critical(p, 0.05), h_critical(p, 0.01), k_critical(with_k, n, 0.05), k_critical(with_k, n, 0.01))
    return Mandel(h, k, *criticals, tuple(notes))


def scrutinise(cells: Cells) -> Scrutiny:
    """Run the tests for outliers in the order of ISO 5725-2, 7.3.4: Mandel's h and k, Cochran, then Grubbs.

    Grubbs is single at both ends; if a value is found it is dropped (the farther one, if both ends are found) and the
    other end tested, if none is found pairs are tested. Raises BadCells, and NotEnoughData below two cells.
    """
    summary = summarise(cells)
    variance_test = cochran(cells) if np.sum(summary.counts > 1) > 1 else None
    means = summary.offsets
    if summary.p < 3:
        return Scrutiny(mandel(cells), variance_test, None, None, None)
    single = grubbs(means)
    outlying = [index for _, index, verdict in single.ends if verdict != "ok"]
    retest = grubbs(np.delete(means, outlying[0])) if outlying and summary.p > 3 else None
    double = double_grubbs(means) if not outlying and summary.p > 3 else None
    return Scrutiny(mandel(cells), variance_test, single, double, retest)
