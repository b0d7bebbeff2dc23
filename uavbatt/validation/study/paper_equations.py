"""The study's equations (1)-(17) as printed, one function each, and its tables computed again from its data.

This is the literal method. It keeps the study's choices (√2 counted twice in (5)-(7), a ratio of SDs in (11),
no -s_r²/n in (15)) so that its numbers can be checked; `iso5725` is the sound one. Where a formula has a slip
that the study's own numbers contradict (sums that end at n-1 in (4), a divisor n for k after (14)), the function takes
what the numbers follow.
x: results of one column (one sample, one instant) in V or °C.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import stats

from uavbatt.validation.iso5725.cells import Array
from uavbatt.validation.iso5725.precision import LIMIT_FACTOR

DRIFT_LIMIT = 0.2  # the study's own limit, of |d̄|/σ


def eq1_differences(x: Array) -> Array:
    """Return the differences of neighbouring results d_i = x_i - x_(i+1), equation (1)."""
    d: Array = x[:-1] - x[1:]
    return d


def eq2_mean_difference(x: Array) -> float:
    """Return d̄ = Σd_i/(n-1), equation (2); it telescopes to (x_1 - x_n)/(n-1) and sees only the two ends."""
    return float(eq1_differences(x).sum()) / (len(x) - 1)


def eq3_mean(x: Array) -> float:
    """Return the mean x̄ = Σx_i/n, equations (3) and (8)."""
    return float(x[0] + (x - x[0]).sum() / len(x))


def eq4_sd(x: Array) -> float:
    """Return the SD σ = √(Σ(x_i-x̄)²/(n-1)), equations (4) and (9)."""
    return math.sqrt(float(((x - eq3_mean(x)) ** 2).sum()) / (len(x) - 1))


def drift_ratio(x: Array) -> float:
    """Return |d̄|/σ; the study calls drift insignificant below 0.2. NaN if σ is 0."""
    sigma = eq4_sd(x)
    return abs(eq2_mean_difference(x)) / sigma if sigma > 0 else math.nan


def eq5_pair_differences(x: Array) -> Array:
    """Return a = x_j - x_i for all j < i, row by row of the printed triangle: equation (5) and Table 5."""
    a: Array = np.concatenate([x[:i] - x[i] for i in range(1, len(x))])
    return a


def eq6_pair_sd(a: Array) -> float:
    """Return σ_r, the SD of the signed pair differences, equation (6); it already holds the √2 of a difference."""
    return eq4_sd(a)


def eq7_repeatability_limit(sigma_r: float) -> float:
    """Return the repeatability limit r = 2.8·σ_r, equation (7). 2.8 = 1.96·√2, so √2 enters twice."""
    return LIMIT_FACTOR * sigma_r


def share_beyond(values: Array, limit: float) -> float:
    """Return the share of |values| above the limit; the study asks for less than 5 % (printed inverted, no | |)."""
    return float(np.mean(np.abs(values) > limit + 1e-12))


def eq10_student(mean_a: float, var_a: float, mean_b: float, var_b: float, n: int) -> float:
    """Return Student's t = (x̄_max - x̄_min)/√(σ²_max/n + σ²_min/n), equation (10)."""
    below = math.sqrt((var_a + var_b) / n)
    above = abs(mean_a - mean_b)
    return above / below if below > 0 else (0.0 if above == 0 else math.inf)


def eq11_fisher_printed(sd_a: float, sd_b: float) -> float:
    """Return F_emp = σ_max/σ_min, equation (11): a ratio of SDs as printed."""
    low, high = sorted((sd_a, sd_b))
    return high / low if low > 0 else math.inf


def fisher(sd_a: float, sd_b: float) -> float:
    """Return the ratio of variances that F_kr belongs to: the square of (11)."""
    return eq11_fisher_printed(sd_a, sd_b) ** 2


def t_critical(n: int) -> float:
    """Return t_kr at 0.05 two-sided with 2n-2 degrees of freedom."""
    return float(stats.t.ppf(0.975, 2 * n - 2))


def f_critical(n: int) -> float:
    """Return F_kr at 0.05 as the study reads it: upper 5 % point for n-1 and n-1 degrees of freedom."""
    return float(stats.f.ppf(0.95, n - 1, n - 1))


def eq12_grand_mean(means: Array) -> float:
    """Return the mean of the k sample means x̄ = Σx̄_j/k, equation (12)."""
    return eq3_mean(means)


def eq13_deviations(x: Array, grand_mean: float) -> Array:
    """Return the deviations from the mean of all samples b_ij = x_ij - x̄, equation (13)."""
    b: Array = x - grand_mean
    return b


def eq15_between_variance(means: Array) -> float:
    """Return σ_L² = Σ(x̄_j-x̄)²/(k-1), equation (15), without the -s_r²/n of ISO 5725-2."""
    return float(((means - eq12_grand_mean(means)) ** 2).sum()) / (len(means) - 1)


def within_variance(variances: Array) -> float:
    """Return σ_r² after (14): the mean of the k sample variances."""
    return float(variances.sum()) / len(variances)


def eq14_sigma_R(between: float, within: float) -> float:
    """Return the reproducibility SD σ_R = √(σ_L² + σ_r²), equation (14)."""
    return math.sqrt(between + within)


def eq16_reproducibility_limit(sigma_R: float) -> float:
    """Return the reproducibility limit R = 2.8·σ_R, equation (16)."""
    return LIMIT_FACTOR * sigma_R


def eq17_total_variance(means: Array, variances: Array, n: int) -> float:
    """Return the plain variance of all nk results, (17): S² = (n-1)/(nk-1)·ΣS_j² + n/(nk-1)·Σ(x̄_j-x̄)²."""
    below = n * len(means) - 1
    between = float(((means - eq12_grand_mean(means)) ** 2).sum())
    return (n - 1) / below * float(variances.sum()) + n / below * between


def corridor_half_width(S2: float) -> float:
    """Return C = 2·√S²; the corridor is x̄ ± C."""
    return 2 * math.sqrt(S2)
