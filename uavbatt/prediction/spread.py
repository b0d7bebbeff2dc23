"""From the spread of what is uncertain to the points of the time that remains.

What is uncertain of the battery is small and nearly linear in time: sigma points one standard deviation along each
axis of the belief's covariance give its variance. What is uncertain of the load is large and of any shape: scenarios.
The distribution is the mixture over scenarios k of normals with mean t_k and the battery's spread at that length.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from uavbatt.battery.belief import SIZE, Belief, C
from uavbatt.battery.build import Pack
from uavbatt.battery.model import Array

LEVELS = (0.05, 0.5, 0.95)


def sigma_points(pack: Pack, belief: Belief, horizon_s: float) -> Array:
    """Columns [8, 17]: the mean, then mean ± each column of the root of the covariance.

    The discrepancy at the end is not that of now: over `horizon_s` it forgets its value and regains its full
    spread (Ornstein-Uhlenbeck), which is put into the points since the forecast holds it constant.
    """
    memory = np.exp(-horizon_s / pack.bias_tau_s)
    keep = np.eye(SIZE)
    keep[C.BIAS, C.BIAS] = memory
    mean = keep @ belief.mean
    covariance = keep @ belief.covariance @ keep.T
    covariance[C.BIAS, C.BIAS] += pack.bias_sd_V**2 * (1.0 - memory**2)
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    points = np.concatenate([mean[:, None], mean[:, None] + root, mean[:, None] - root], axis=1)
    points[C.SOC] = np.clip(points[C.SOC], 0.0, 1.02)
    return points


def relative_sd(end_s: Array) -> float:
    """Relative standard deviation of the time from the ends [s] of `sigma_points`: Σ ((t₊ - t₋)/2)²."""
    plus, minus = end_s[1 : SIZE + 1], end_s[SIZE + 1 :]
    return float(np.sqrt(np.sum(((plus - minus) / 2.0) ** 2)) / max(end_s[0], 1.0))


def mixture_points(center_s: Array, sd_s: Array, weight: Array, levels: tuple[float, ...] = LEVELS) -> list[float]:
    """Quantiles of a mixture of normals, by bisection; never below zero."""
    low, high = np.min(center_s - 8.0 * sd_s), np.max(center_s + 8.0 * sd_s)
    points = []
    for level in levels:
        left, right = float(low), float(high)
        for _ in range(50):
            middle = 0.5 * (left + right)
            if float(weight @ ndtr((middle - center_s) / sd_s)) < level:
                left = middle
            else:
                right = middle
        points.append(max(right, 0.0))
    return points
