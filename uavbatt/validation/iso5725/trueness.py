"""Trueness against a reference value, ISO 5725-4, and the use of precision limits, ISO 5725-6.

Trueness needs a reference μ from elsewhere; ten repeats that do not drift are stable, not true. The factor 2.8 of
a pair of results becomes f(n) for the range of n results (ISO 5725-6 Table 1): with ten results the range passes
2.8σ in 61 % of cases although nothing is wrong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import integrate, optimize, stats

from uavbatt.errors import NotEnoughData
from uavbatt.validation.iso5725.cells import BadCells, Cells, numbers, spread, summarise
from uavbatt.validation.iso5725.intervals import Interval
from uavbatt.validation.iso5725.precision import LIMIT_FACTOR, precision_of


@dataclass(frozen=True, slots=True)
class Bias:
    """A bias is the mean less the reference, with its 95 % interval, in the unit of the results."""

    bias: float
    standard_uncertainty: float
    interval: Interval
    significant: bool
    n: int
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PrecisionCheck:
    """PrecisionCheck compares observed variances with claimed ones: ratios C_r, C_R and their limits (ISO 5725-4)."""

    C_r: float
    limit_r: float
    C_R: float
    limit_R: float
    ok: bool


@dataclass(frozen=True, slots=True)
class RangeCheck:
    """RangeCheck compares the range of n results with f(n)·s_r, in the unit of the results."""

    range: float
    factor: float
    critical_range: float
    ok: bool
    pair_share_beyond: float


def laboratory_bias(results: ArrayLike, reference: float, u_reference: float = 0.0) -> Bias:
    """Estimate the bias of one laboratory: Δ̂ = ȳ - μ ± t(0.975; n-1)·s/√n (ISO 5725-4).

    `reference` is μ in the unit of the results; its own uncertainty `u_reference` is added in squares.
    Raises NotEnoughData below two results.
    """
    values = numbers(results, "results")
    n = len(values)
    if n < 2:
        raise NotEnoughData("a bias with an interval needs two results or more")
    _check_reference(reference)
    if not 0 <= u_reference < math.inf:
        raise BadCells(f"expected an uncertainty of at least 0, found {u_reference:g}")
    _, squares = spread(values)
    bias = float(values[0] - reference + (values - values[0]).mean())
    u_mean = math.sqrt(squares / (n - 1) / n)
    half = math.hypot(float(stats.t.ppf(0.975, n - 1)) * u_mean, 1.96 * u_reference)
    return Bias(bias, math.hypot(u_mean, u_reference), (bias - half, bias + half), abs(bias) > half, n)


def method_bias(cells: Cells, reference: float, sigma_r: float | None = None, sigma_R: float | None = None) -> Bias:
    """Estimate the bias of a method in several laboratories: δ̂ = ȳ - μ, σ_δ² = [σ_R² - (1-1/n)σ_r²]/p (ISO 5725-4).

    With known σ_r and σ_R the factor is 1.96; estimated from the cells it is t with p-1 degrees of freedom.
    Raises BadCells, also for one σ without the other, and NotEnoughData below two laboratories.
    """
    _check_reference(reference)
    if (sigma_r is None) != (sigma_R is None):
        raise BadCells("expected both sigma_r and sigma_R, or neither")
    summary = summarise(cells)
    estimate = precision_of(summary)
    if summary.p < 2:
        raise NotEnoughData("the bias of a method needs two laboratories or more; use laboratory_bias for one")
    has_sigmas = sigma_r is not None and sigma_R is not None
    s_r, s_R = estimate.s_r, estimate.s_R
    if sigma_r is not None and sigma_R is not None:
        s_r, s_R = _checked_sigmas(sigma_r, sigma_R)
    u = bias_uncertainty(s_r, s_R, estimate.n_bar, summary.p)
    half = (1.96 if has_sigmas else float(stats.t.ppf(0.975, summary.p - 1))) * u
    bias = estimate.mean - reference
    few = () if summary.p >= 3 else ("fewer than three laboratories: the interval says little",)
    return Bias(bias, u, (bias - half, bias + half), abs(bias) > half, estimate.n_total, few)


def _check_reference(reference: float) -> None:
    if not math.isfinite(reference):
        raise BadCells(f"expected a finite reference value, found {reference:g}")


def _checked_sigmas(sigma_r: float, sigma_R: float) -> tuple[float, float]:
    """Return claimed SDs. Raises BadCells unless 0 < σ_r <= σ_R: reproducibility contains repeatability."""
    if not 0.0 < sigma_r <= sigma_R < math.inf:
        raise BadCells(f"expected 0 < sigma_r <= sigma_R, found {sigma_r:g} and {sigma_R:g}")
    return sigma_r, sigma_R


def bias_uncertainty(sigma_r: float, sigma_R: float, n: float, p: int) -> float:
    """Compute the standard uncertainty of a method's bias: σ_δ = √([σ_R² - (1-1/n)σ_r²]/p)."""
    return math.sqrt(max(sigma_R**2 - (1 - 1 / n) * sigma_r**2, 0.0) / p)


def precision_check(cells: Cells, sigma_r: float, sigma_R: float, alpha: float = 0.05) -> PrecisionCheck:
    """Check a claimed σ_r and σ_R against results (ISO 5725-4).

    C' = s_r²/σ_r² <= χ²(1-α;ν)/ν, C'' = [s_R²-(1-1/n)s_r²]/[σ_R²-(1-1/n)σ_r²] <= χ²(1-α;p-1)/(p-1).
    Raises BadCells, also unless 0 < σ_r <= σ_R, and NotEnoughData below two laboratories.
    """
    sigma_r, sigma_R = _checked_sigmas(sigma_r, sigma_R)
    summary = summarise(cells)
    estimate, df, p = precision_of(summary), summary.within_df, summary.p
    if p < 2:
        raise NotEnoughData("the check of a known reproducibility needs two laboratories or more")
    share = 1 - 1 / estimate.n_bar
    C_r = estimate.s_r**2 / sigma_r**2
    C_R = (estimate.s_R**2 - share * estimate.s_r**2) / (sigma_R**2 - share * sigma_r**2)
    limits = float(stats.chi2.ppf(1 - alpha, df)) / df, float(stats.chi2.ppf(1 - alpha, p - 1)) / (p - 1)
    return PrecisionCheck(C_r, limits[0], C_R, limits[1], bool(np.all(np.array([C_r, C_R]) <= limits)))


@cache
def range_factor(n: int, probability: float = 0.95) -> float:
    """Compute f(n), the quantile of the range of n results of unit SD, unrounded (2.77 for n = 2). Raises BadCells."""
    if n < 2:
        raise BadCells(f"a range needs two results or more, found {n}")

    def density(x: float, w: float) -> float:  # the largest result at x, the others within w below it
        inside = (math.erf(x / math.sqrt(2)) - math.erf((x - w) / math.sqrt(2))) / 2
        return n * math.exp(-x * x / 2) / math.sqrt(2 * math.pi) * inside ** (n - 1)

    def beyond(w: float) -> float:
        return float(integrate.quad(density, -8, 8 + w, args=(w,), limit=200)[0]) - probability

    return float(optimize.brentq(beyond, 0.01, 12.0, xtol=1e-6))


def range_check(results: ArrayLike, s_r: float) -> RangeCheck:
    """Check the range of n results against f(n)·s_r, f rounded to one decimal as in the standard (ISO 5725-6).

    `pair_share_beyond`, the share of pairs beyond 2.8·s_r, is for the record: pairs are dependent, it has no level.
    Raises BadCells below two results and for an s_r that is no SD.
    """
    values = numbers(results, "results")
    if not 0 <= s_r < math.inf:
        raise BadCells(f"expected an s_r of at least 0, found {s_r:g}")
    factor = round(range_factor(len(values)), 1)
    width = float(np.max(values) - np.min(values))
    pairs = [abs(a - b) for i, a in enumerate(values) for b in values[:i]]
    share = sum(bool(p > LIMIT_FACTOR * s_r) for p in pairs) / len(pairs)
    return RangeCheck(width, factor, float(factor * s_r), bool(width <= factor * s_r), share)
