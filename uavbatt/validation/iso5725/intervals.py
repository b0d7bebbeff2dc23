"""Confidence intervals of variance components.

One mean square: chi-square. A sum of mean squares with positive weights: the modified large-sample interval of
Graybill and Wang (JASA 75 (1980) 869). A between-cell variance, a difference of mean squares: Williams-Tukey
(Searle, Casella, McCulloch, Variance Components, 1992, section 3.6).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy import stats

Interval = tuple[float, float]
UNKNOWN: Interval = (math.nan, math.nan)
UPPER, LOWER = 0.975, 1 - 0.975  # probabilities of the ends of a 95 % interval


def sd_interval(sd: float, df: float) -> Interval:
    """Return the interval of a standard deviation with `df` degrees of freedom: s·√(ν/χ²); NaN if it is unknown."""
    if df < 1 or math.isnan(sd):
        return UNKNOWN
    high, low = (float(stats.chi2.ppf(q, df)) for q in (UPPER, LOWER))
    return sd * math.sqrt(df / high), sd * math.sqrt(df / low)


def sum_interval(mean_squares: Sequence[float], weights: Sequence[float], dfs: Sequence[float]) -> Interval:
    """Return the interval of √(Σ c·MS), all c >= 0 (Graybill-Wang), as a standard deviation; NaN if it is unknown."""
    ms, c, df = (np.asarray(v, dtype=float) for v in (mean_squares, weights, dfs))
    if np.any(df < 1) or np.any(np.isnan(ms)) or np.any(c < 0):
        return UNKNOWN
    parts = c * ms
    g = 1 - df / stats.chi2.ppf(UPPER, df)
    h = df / stats.chi2.ppf(LOWER, df) - 1
    low = float(parts.sum() - np.sqrt(np.sum((g * parts) ** 2)))
    high = float(parts.sum() + np.sqrt(np.sum((h * parts) ** 2)))
    return math.sqrt(max(low, 0.0)), math.sqrt(high)


def between_interval(ms_between: float, ms_within: float, dfs: tuple[float, float], n_bar: float) -> Interval:
    """Return the interval of s_L, with s_L² = (MS_b - MS_w)/n̄ (Williams-Tukey); 0 where the limit is negative."""
    df_b, df_w = dfs
    if df_b < 1 or df_w < 1:
        return UNKNOWN
    ends = []
    for q in (UPPER, LOWER):
        excess = ms_between - ms_within * stats.f.ppf(q, df_b, df_w)
        ends.append(math.sqrt(max(float(df_b * excess / (n_bar * stats.chi2.ppf(q, df_b))), 0.0)))
    return ends[0], ends[1]


def satterthwaite(parts: Sequence[float], dfs: Sequence[float]) -> float:
    """Return the effective degrees of freedom of Σ parts, each part c·MS with its own df (Satterthwaite 1946)."""
    total = math.fsum(parts)
    below = math.fsum(part**2 / df for part, df in zip(parts, dfs, strict=True))
    return total**2 / below if below > 0 else math.nan
