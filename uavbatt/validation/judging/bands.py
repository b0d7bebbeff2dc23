"""Band factors: how many standard deviations hold a share of curves, at one instant and over a whole record.

Pointwise tolerance factor: Howe (JASA 64 (1969) 610), two-sided. Simultaneous factor: the distribution of
max_j |y_j - ȳ_j|/s_j for a new curve y, simulated from the covariance of the curves with the estimation of mean
and SD repeated in every draw (parametric bootstrap over occasions, seeded).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import stats

from uavbatt.validation.iso5725.cells import LEAST_SAMPLES, Array
from uavbatt.validation.judging.chance import generator

CONTENT, CONFIDENCE = 0.95, 0.95  # share that a band holds, and the certainty that a tolerance band does
DRAWS = 4000  # the share that a 95 % band holds is known to 0.35 % by so many draws


@dataclass(frozen=True, slots=True)
class Components:
    """Components holds the spread of curves as covariances [level, level] of occasion, sample and residual.

    `occasions` and `samples` are the numbers of each that were tested.
    """

    occasion: Array
    sample: Array
    residual: Array
    occasions: int
    samples: int

    @property
    def has_samples(self) -> bool:
        """Return True if enough samples were tested to know how samples differ."""
        return self.samples >= LEAST_SAMPLES

    @property
    def sd(self) -> Array:
        """Return the SD of one new result per level: occasion and residual, and sample where it is known."""
        total = self.occasion + self.residual + (self.sample if self.has_samples else 0.0)
        root: Array = np.sqrt(np.maximum(np.diag(total), 0.0))
        return root


def tolerance_factor(n: float, df: float) -> float:
    """Return k with x̄ ± k·s holding CONTENT of the population with CONFIDENCE γ: z·√(ν(1+1/n)/χ²(1-γ;ν)) (Howe).

    n : number of results behind the mean, df : degrees of freedom ν of s; NaN where they are too few.
    """
    if df < 1 or n <= 0:
        return math.nan
    z = float(stats.norm.ppf((1 + CONTENT) / 2))
    return z * math.sqrt(df * (1 + 1 / n) / float(stats.chi2.ppf(1 - CONFIDENCE, df)))


def components(y: Array) -> Components:
    """Estimate the covariances of `y[occasion, sample, level]` by the crossed model, clipped to >= 0."""
    o, k, levels = y.shape
    d = y - y[0, 0]
    rows, columns, grand = d.mean(axis=1), d.mean(axis=0), d.mean(axis=(0, 1))
    r = rows - grand
    ms_o = k * r.T @ r / (o - 1)
    zero = np.zeros((levels, levels))
    if k == 1:
        return Components(ms_o, zero, zero, o, 1)
    c, e = columns - grand, (d - rows[:, None] - columns + grand).reshape(o * k, levels)
    ms_s, ms_e = o * c.T @ c / (k - 1), e.T @ e / ((o - 1) * (k - 1))
    return Components(_clipped((ms_o - ms_e) / k), _clipped((ms_s - ms_e) / o), ms_e, o, k)


def _clipped(matrix: Array) -> Array:
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    clipped: Array = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return clipped


def _root(matrix: Array) -> Array:
    values, vectors = np.linalg.eigh(matrix)
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0))
    return root


def new_curve_scores(parts: Components) -> tuple[Array, Array]:
    """Simulate |new curve - mean|/s, [draw, level], with s by the crossed model and s the plain SD of all results.

    One draw repeats the whole experiment (occasions x samples), estimates mean and s, and tests one new curve.
    """
    rng = generator()
    o, k = parts.occasions, parts.samples
    occasion, sample, residual = (_root(m) for m in (parts.occasion, parts.sample, parts.residual))
    size = len(occasion)

    def draw(root: Array, *shape: int) -> Array:
        normal: Array = rng.standard_normal((DRAWS, *shape, size)) @ root.T
        return normal

    y = draw(occasion, o, 1) + draw(residual, o, k)
    new = draw(occasion) + draw(residual)
    if parts.has_samples:
        y, new = y + draw(sample, 1, k), new + draw(sample)
    mean = y.mean(axis=(1, 2))
    plain = y.reshape(DRAWS, o * k, size).std(axis=1, ddof=1)
    modelled = np.sqrt(crossed_variance(y))
    gap = np.abs(new - mean)
    return _ratio(gap, modelled), _ratio(gap, plain)


def crossed_variance(y: Array) -> Array:
    """Return s_I² (or s_R²) per draw and level of `y[draw, occasion, sample, level]`."""
    _, o, k, _ = y.shape
    rows, columns, grand = y.mean(axis=2), y.mean(axis=1), y.mean(axis=(1, 2))
    ms_o: Array = k * ((rows - grand[:, None]) ** 2).sum(axis=1) / (o - 1)
    if k == 1:
        return ms_o
    e = y - rows[:, :, None] - columns[:, None] + grand[:, None, None]
    ms_e = (e**2).sum(axis=(1, 2)) / ((o - 1) * (k - 1))
    total: Array = np.maximum((ms_o - ms_e) / k, 0.0) + ms_e
    if k >= LEAST_SAMPLES:
        ms_s = o * ((columns - grand[:, None]) ** 2).sum(axis=1) / (k - 1)
        total = total + np.maximum((ms_s - ms_e) / o, 0.0)
    return total


def _ratio(gap: Array, sd: Array) -> Array:
    """Return gap/sd, 0 where both are zero (a level without spread holds everything)."""
    tiny = 1e-12 * max(float(np.max(sd, initial=0.0)), 1e-300)
    ratio: Array = np.where(sd > tiny, gap / np.maximum(sd, tiny), 0.0)
    return ratio


def simultaneous_factor(scores: Array) -> float:
    """Return the factor that holds a new curve at all levels at once with probability CONTENT."""
    return float(np.quantile(scores.max(axis=1), CONTENT))


def coverage(scores: Array, factor: float) -> tuple[float, float]:
    """Return the probabilities that mean ± factor·s holds a new curve: at one level (average), at all at once."""
    inside = scores <= factor
    return float(inside.mean()), float(inside.all(axis=1).mean())
