"""Trueness of one laboratory against a reference value, ISO 5725-4, and the range of repeats, ISO 5725-6.

Trueness needs a reference μ from elsewhere; ten repeats that do not drift are stable, not true. The factor 2.8 of
a pair of results becomes f(n) for the range of n results (ISO 5725-6 Table 1): with ten results the range passes
2.8σ in 61 % of cases although nothing is wrong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

from numpy.typing import ArrayLike
from scipy import integrate, optimize, stats

from uavbatt.errors import NotEnoughData
from uavbatt.validation.cells import BadCells, numbers, spread
from uavbatt.validation.intervals import Interval


@dataclass(frozen=True, slots=True)
class Bias:
    """Mean less reference with its 95 % interval, in the unit of the results."""

    bias: float
    standard_uncertainty: float
    interval: Interval
    significant: bool
    n: int


@dataclass(frozen=True, slots=True)
class RangeCheck:
    """Range of n results against f(n)·s_r, in the unit of the results."""

    range: float
    factor: float
    critical_range: float
    ok: bool
    pair_share_beyond: float


def laboratory_bias(results: ArrayLike, reference: float, u_reference: float = 0.0) -> Bias:
    """One laboratory: Δ̂ = ȳ - μ ± t(0.975; n-1)·s/√n, the reference's own uncertainty added in squares."""
    values = numbers(results, "results")
    n = len(values)
    if n < 2:
        raise NotEnoughData("a bias with an interval needs two results or more")
    if u_reference < 0:
        raise BadCells(f"expected an uncertainty of at least 0, found {u_reference:g}")
    _, squares = spread(values)
    bias = float(values[0] - reference + (values - values[0]).mean())
    u_mean = math.sqrt(squares / (n - 1) / n)
    half = math.hypot(float(stats.t.ppf(0.975, n - 1)) * u_mean, 1.96 * u_reference)
    return Bias(bias, math.hypot(u_mean, u_reference), (bias - half, bias + half), abs(bias) > half, n)


@cache
def range_factor(n: int, probability: float = 0.95) -> float:
    """f(n): the quantile of the range of n results of unit SD, unrounded (2.77 for n = 2)."""
    if n < 2:
        raise BadCells(f"a range needs two results or more, found {n}")

    def density(x: float, w: float) -> float:  # the largest result at x, the others within w below it
        inside = (math.erf(x / math.sqrt(2)) - math.erf((x - w) / math.sqrt(2))) / 2
        return n * math.exp(-x * x / 2) / math.sqrt(2 * math.pi) * inside ** (n - 1)

    def beyond(w: float) -> float:
        return float(integrate.quad(density, -8, 8 + w, args=(w,), limit=200)[0]) - probability

    return float(optimize.brentq(beyond, 0.01, 12.0, xtol=1e-6))


def range_check(results: ArrayLike, s_r: float) -> RangeCheck:
    """Range of n results <= f(n)·s_r, f rounded to one decimal as in the standard.

    `pair_share_beyond`, the share of pairs beyond 2.8·s_r, is for the record: pairs are dependent, it has no level.
    """
    values = numbers(results, "results")
    factor = round(range_factor(len(values)), 1)
    width = float(values.max() - values.min())
    pairs = [abs(a - b) for i, a in enumerate(values) for b in values[:i]]
    share = sum(bool(p > 2.8 * s_r) for p in pairs) / len(pairs)
    return RangeCheck(width, factor, float(factor * s_r), bool(width <= factor * s_r), share)
