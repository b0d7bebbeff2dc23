"""One forecast against one truth: the formulas behind `score`, on numbers or arrays of equal length.

A forecast (5, 50 and 95 % point) is read as the split normal distribution through its three points: two half
normals with a common median, `s_lo = (median - lo)/z`, `s_hi = (hi - median)/z`, z = 1.645. Three equal points
are a point mass, so a method without an interval needs no case of its own.

References: Gneiting & Raftery, Strictly proper scoring rules, JASA 102 (2007), eq. 20-21, for CRPS; Clopper &
Pearson, Biometrika 26 (1934), for the binomial interval.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import betaincinv, ndtr

from uavbatt.records import Z90

FloatArray = NDArray[np.float64]
TAIL = 0.5 * (1.0 - 0.95)  # probability beyond each end of a 95 % interval


def crps_quantiles(truth: ArrayLike, lo: ArrayLike, median: ArrayLike, hi: ArrayLike) -> FloatArray:
    """Return the CRPS of the split normal through the 5, 50 and 95 % points; |truth - median| when they coincide.

    integral of (F - step)^2 = s_lo G(-|d|/s_lo) + s_hi G(0) + s_lo (G(|d|/s_lo) - G(0)) for d = truth - median
    below 0, mirrored above; G(z) = z Phi^2 + 2 Phi phi - Phi(z sqrt 2)/sqrt(pi) is the integral of Phi^2.
    """
    s_lo, s_hi = _half_widths(lo, median, hi)
    d = np.asarray(truth, float) - np.asarray(median, float)
    near, far = np.where(d < 0, s_lo, s_hi), np.where(d < 0, s_hi, s_lo)
    z = np.abs(d) / near
    half = float(_integral_of_cdf_squared(np.zeros(())))
    return np.asarray(near * (_integral_of_cdf_squared(z) - half + _integral_of_cdf_squared(-z)) + far * half)


def _integral_of_cdf_squared(z: FloatArray) -> FloatArray:
    """Return the integral of Phi^2 from -inf to z."""
    phi = np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
    cdf = ndtr(z)
    return np.asarray(z * cdf**2 + 2.0 * cdf * phi - ndtr(z * math.sqrt(2.0)) / math.sqrt(math.pi))


def _half_widths(lo: ArrayLike, median: ArrayLike, hi: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the two standard deviations, at least a nanosecond each, so that a point needs no case of its own."""
    middle = np.asarray(median, float)
    s_lo = np.maximum((middle - np.asarray(lo, float)) / Z90, 1e-9)
    s_hi = np.maximum((np.asarray(hi, float) - middle) / Z90, 1e-9)
    return s_lo, s_hi


def mass_within(a: ArrayLike, b: ArrayLike, lo: ArrayLike, median: ArrayLike, hi: ArrayLike) -> FloatArray:
    """Return the probability of the split normal between `a` and `b`; 0 where the median is NaN."""
    s_lo, s_hi = _half_widths(lo, median, hi)

    def cdf(x: ArrayLike) -> FloatArray:
        d = np.asarray(x, float) - np.asarray(median, float)
        return np.asarray(ndtr(d / np.where(d < 0, s_lo, s_hi)))

    return np.nan_to_num(cdf(b) - cdf(a), nan=0.0)


def binomial_interval(hits: int, trials: int) -> tuple[float, float]:
    """Return the 95 % Clopper-Pearson interval of a share of `hits` in `trials`; (0, 1) without trials."""
    low = float(betaincinv(hits, trials - hits + 1, TAIL)) if hits > 0 else 0.0
    high = float(betaincinv(hits + 1, trials - hits, 1.0 - TAIL)) if hits < trials else 1.0
    return low, high


def percentage_interval(truth_s: ArrayLike, forecast_s: ArrayLike, hits: int) -> tuple[float, float]:
    """Return (p, mean width [s]) of a simple interval to compare with: the forecast +- p times itself.

    p is the least share that covers `hits` truths. A forecast of 0 (a refusal) is never covered. Raises ValueError
    unless `hits` is 1 to the number of truths.
    """
    truth, forecast = np.asarray(truth_s, float), np.nan_to_num(np.asarray(forecast_s, float))
    with np.errstate(divide="ignore", invalid="ignore"):
        needed = np.where(forecast > 0.0, np.abs(truth - forecast) / forecast, math.inf)
    if not 0 < hits <= needed.size:
        raise ValueError(f"{hits} hits: expected 1 to {needed.size}")
    share = float(np.sort(needed)[hits - 1])
    width_s = float(np.mean(2.0 * share * forecast)) if math.isfinite(share) else math.inf
    return share, width_s
