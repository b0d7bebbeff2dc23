"""Precision of a measurement method, ISO 5725-2: repeatability and reproducibility.

Model y = m + B + e (ISO 5725-1). With p cells (samples, laboratories) of n_i results, cell means ȳ_i, SDs s_i:

    s_r² = Σ(n_i-1)s_i² / Σ(n_i-1)              s_d² = Σ n_i(ȳ_i-m)² / (p-1),  m = Σ n_i ȳ_i / Σ n_i
    n̄    = [Σn_i - Σn_i²/Σn_i] / (p-1)          s_L² = (s_d² - s_r²)/n̄, 0 if negative
    s_R² = s_r² + s_L²                          r = 2.8 s_r,  R = 2.8 s_R  (2.8 = 1.96·√2 rounded)

Unequal n_i are allowed. With fewer than three cells the between-cell part says nothing (its 95 %
interval spans a factor of 70) and is not called reproducibility.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import optimize, stats

from uavbatt.errors import NotEnoughData
from uavbatt.validation.iso5725.cells import LEAST_SAMPLES, Cells, Summary, summarise
from uavbatt.validation.iso5725.intervals import UNKNOWN, Interval, between_interval, sd_interval, sum_interval

LIMIT_FACTOR = 2.8  # 1.96·√2 as ISO 5725-6 rounds it
Method = Literal["anova", "reml"]


@dataclass(frozen=True, slots=True)
class Precision:
    """Precision holds the precision at one level; everything is in the unit of the results.

    `s_L2_raw` is the between-cell variance before a negative value is set to 0 (`negative_between`).
    `reproducibility` is "ok" or "not enough data" (fewer than three cells). `A_r`, `A_R` are the relative 95 %
    uncertainties of s_r and s_R (ISO 5725-1); the intervals are 95 % confidence intervals.
    """

    mean: float
    s_r: float
    s_L: float
    s_R: float
    r: float
    R: float
    p: int
    n_total: int
    n_bar: float
    ms_between: float
    ms_within: float
    F: float
    p_value: float
    s_L2_raw: float
    negative_between: bool
    A_r: float
    A_R: float
    s_r_interval: Interval
    s_L_interval: Interval
    s_R_interval: Interval
    reproducibility: Literal["ok", "not enough data"]
    method: Method
    notes: tuple[str, ...]


def precision(cells: Cells, method: Method = "anova") -> Precision:
    """Compute the precision from one sequence of results per sample; lengths may differ (ISO 5725-2).

    `method` "anova" is the standard's; "reml" (restricted maximum likelihood) differs for unequal numbers of
    results and at a between-cell variance of zero. Everything is in the unit of the results.
    Raises BadCells for what is no result, NotEnoughData when every sample has a single one.
    """
    return precision_of(summarise(cells), method)


def precision_of(summary: Summary, method: Method = "anova") -> Precision:
    """Compute the precision from cell means, variances and numbers of results. Raises NotEnoughData as `precision`."""
    if method not in ("anova", "reml"):
        raise ValueError(f"method {method!r}: expected 'anova' or 'reml'")
    if summary.within_df < 1:
        raise NotEnoughData("repeatability needs a sample with two results or more; every one has a single result")
    ms_b, ms_w = between_mean_square(summary), summary.within_ss / summary.within_df
    n_bar = mean_count(summary)
    raw = (ms_b - ms_w) / n_bar if summary.p > 1 else math.nan
    offset, within, between = _grand_mean_offset(summary), ms_w, max(raw, 0.0) if summary.p > 1 else math.nan
    if method == "reml" and summary.p > 1:
        offset, within, between = reml(summary)
    s_r, s_R = math.sqrt(within), math.sqrt(within + between)
    dfs = (summary.p - 1.0, summary.within_df)
    F = ms_b / ms_w if ms_w > 0 else math.inf if ms_b > 0 else math.nan
    return Precision(
        mean=summary.reference + offset, s_r=s_r, s_L=math.sqrt(between), s_R=s_R,
        r=LIMIT_FACTOR * s_r, R=LIMIT_FACTOR * s_R,
        p=summary.p, n_total=int(summary.counts.sum()), n_bar=n_bar, ms_between=ms_b, ms_within=ms_w,
        F=F, p_value=float(stats.f.sf(F, *dfs)) if summary.p > 1 else math.nan,
        s_L2_raw=raw, negative_between=bool(raw < 0),
        A_r=relative_uncertainty_r(summary.within_df),
        A_R=relative_uncertainty_R(summary.p, n_bar, s_R / s_r if s_r > 0 else math.inf if s_R > 0 else math.nan),
        s_r_interval=sd_interval(math.sqrt(ms_w), dfs[1]),
        s_L_interval=between_interval(ms_b, ms_w, dfs, n_bar) if summary.p > 1 else UNKNOWN,
        s_R_interval=sum_interval((ms_b, ms_w), (1 / n_bar, max(1 - 1 / n_bar, 0)), dfs) if summary.p > 1 else UNKNOWN,
        reproducibility="ok" if summary.p >= LEAST_SAMPLES else "not enough data",
        method=method, notes=_notes(summary, raw),
    )  # fmt: skip


def _grand_mean_offset(summary: Summary) -> float:
    """Return m = Σn_iȳ_i/Σn_i, less the reference."""
    return math.fsum(summary.counts * summary.offsets) / float(summary.counts.sum())


def between_mean_square(summary: Summary) -> float:
    """Return s_d² = Σn_i(ȳ_i - m)²/(p-1), the centred form of [T2 - m²T3]/(p-1); NaN of a single cell."""
    if summary.p < 2:
        return math.nan
    deviations = summary.offsets - _grand_mean_offset(summary)
    return math.fsum(summary.counts * deviations**2) / (summary.p - 1)


def mean_count(summary: Summary) -> float:
    """Return n̄ = [Σn_i - Σn_i²/Σn_i]/(p-1), the n that the between-cell variance is weighted with."""
    total = float(summary.counts.sum())
    if summary.p < 2:
        return total
    return (total - float(np.sum(summary.counts**2)) / total) / (summary.p - 1)


def relative_uncertainty_r(within_df: float) -> float:
    """Compute A_r = 1.96·√(1/(2ν)), ν = p(n-1): the relative 95 % uncertainty of s_r (ISO 5725-1)."""
    return 1.96 * math.sqrt(1 / (2 * within_df))


def relative_uncertainty_R(p: int, n: float, gamma: float) -> float:
    """Compute A_R = 1.96·√{(p[1+n(γ²-1)]² + (n-1)(p-1)) / (2γ⁴n²(p-1)p)}, γ = σ_R/σ_r (ISO 5725-1).

    For an infinite γ (σ_r = 0) it is the limit, 1.96·√(1/(2(p-1))).
    """
    if p < 2 or math.isnan(gamma):
        return math.nan
    if math.isinf(gamma):
        return 1.96 * math.sqrt(1 / (2 * (p - 1)))
    above = p * (1 + n * (gamma**2 - 1)) ** 2 + (n - 1) * (p - 1)
    return 1.96 * math.sqrt(above / (2 * gamma**4 * n**2 * (p - 1) * p))


def reml(summary: Summary) -> tuple[float, float, float]:
    """Return (mean less the reference, within and between variance) by restricted maximum likelihood.

    Profiled over ρ = σ_L²/σ_r² >= 0 (Searle, Casella, McCulloch 1992, section 6.6).
    """
    n, y, ssw = summary.counts, summary.offsets, summary.within_ss
    df = float(n.sum()) - 1

    def fit(rho: float) -> tuple[float, float, float]:
        weights = n / (1 + n * rho)
        mean = float(np.sum(weights * y) / np.sum(weights))
        within = (ssw + float(np.sum(weights * (y - mean) ** 2))) / df
        deviance = df * math.log(within) + float(np.sum(np.log1p(n * rho)) + math.log(np.sum(weights)))
        return mean, within, deviance

    if ssw + float(np.ptp(y)) == 0:
        return float(y[0]), 0.0, 0.0
    grid = np.concatenate([[0.0], np.logspace(-6, 6, 121)]) if ssw > 0 else np.array([0.0])
    best = int(np.argmin([fit(r)[2] for r in grid]))
    rho = float(grid[best])
    if best > 0:
        ends = (float(grid[best - 1]), float(grid[min(best + 1, len(grid) - 1)]))
        minimum = optimize.minimize_scalar(lambda r: fit(r)[2], bounds=ends, method="bounded", options={"xatol": 1e-12})
        rho = float(minimum.x)
    mean, within, _ = fit(rho)
    return mean, within, rho * within


def _notes(summary: Summary, raw: float) -> tuple[str, ...]:
    notes = []
    if summary.p == 1:
        notes.append("one sample: nothing is known of the spread between samples")
    elif summary.p < LEAST_SAMPLES:
        notes.append(f"{summary.p} samples: too few to call the between-sample spread reproducibility")
    if raw < 0:
        notes.append(f"the between-sample variance came out negative ({raw:.3g}) and is set to 0: no sign of it")
    if summary.within_ss == 0:
        notes.append("all results within samples are equal: the resolution hides the repeatability")
    return tuple(notes)
