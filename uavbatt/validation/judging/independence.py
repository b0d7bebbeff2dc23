"""Tests of three assumptions: samples are independent, results of one population, and resolved by the instrument.

Independence: if run k of two samples were unrelated, pairing the runs at random would give as many identical
readings, and residuals as correlated, as the order in the table. Permutation p-values, every order tried up to
seven runs, seeded beyond.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from itertools import permutations as every_order

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavbatt.errors import NotEnoughData
from uavbatt.validation.iso5725.cells import Array, numbers
from uavbatt.validation.judging.chance import generator, permutations

EVERY_ORDER = 7  # runs: their 5040 orders are all tried
TWO_GROUPS_RUNS = 6  # two groups of three: fewer show no scatter of their own
RANDOM_RESULTS = 4000  # sets of results of one population; a p-value of 5 % is known to 0.35 % by so many
RANDOM_PAIRINGS = 20_000  # a p-value of 1 % is known to 0.07 % by so many
DEPENDENT_BELOW = 0.01  # the level at which ISO 5725-2 calls a result an outlier


@dataclass(frozen=True, slots=True)
class Independence:
    """Independence compares run k of one sample with run k of another, for each k.

    `identical` of `compared` readings are equal; random pairings give `expected_identical` on the average and
    `most_identical` at most. `correlation` is of the residuals about each sample's own mean curve; p-values are
    one-sided. `dependent` is None when there are too few runs for p < 0.01.
    """

    identical: int
    compared: int
    expected_identical: float
    most_identical: int
    p_identical: float
    correlation: float
    p_correlation: float
    dependent: bool | None


@dataclass(frozen=True, slots=True)
class Dependence:
    """Dependence compares samples with random pairing of runs; `dependent` is None if p < 0.01 is out of reach."""

    p_value: float
    dependent: bool | None


@dataclass(frozen=True, slots=True)
class Bimodality:
    """Bimodality tells whether results fall into two groups, and how far apart these are.

    `gap` is the largest distance between neighbouring results, `groups` the numbers of results below and above it.
    """

    gap: float
    groups: tuple[int, int]
    bimodal: bool


@dataclass(frozen=True, slots=True)
class Resolution:
    """Resolution holds the step of the readings; `coarse` is True for an SD below two steps.

    Rounding makes a variance of step²/12, 2 % of that of an SD of two steps.
    """

    step: float
    coarse: bool


def _orders(n: int) -> NDArray[np.intp]:
    """Return orders of n runs, one a row: every order of a few runs, else random ones."""
    return np.array(list(every_order(range(n)))) if n <= EVERY_ORDER else permutations(n, RANDOM_PAIRINGS)


def _identical(a: Array, b: Array, resolution: float) -> Array:
    """Return the number of equal readings (to half a `resolution`) of run i of `a` and run j of `b`: [i, j]."""
    out: Array = (np.abs(a[:, None] - b[None]) <= max(resolution / 2.0, 1e-9)).sum(axis=2).astype(float)
    return out


def independence(first: Array, second: Array, resolution: float = 0.0) -> Independence:
    """Compare two tables run x time of equal shape, in the unit of the results.

    Readings within half a `resolution` are identical. Raises NotEnoughData below three runs, ValueError for tables of
    different shape.
    """
    a, b = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    if a.shape != b.shape or a.ndim != 2:
        raise ValueError(f"expected two tables run x time of one shape, found {a.shape} and {b.shape}")
    n = len(a)
    if n < 3:
        raise NotEnoughData(f"pairing runs at random needs three runs or more, found {n}")
    orders = _orders(n)
    same = _identical(a, b, resolution)
    ra, rb = a - a.mean(axis=0), b - b.mean(axis=0)
    scale = math.sqrt(float((ra**2).sum() * (rb**2).sum()))
    product = ra @ rb.T / scale if scale > 0 else np.zeros((n, n))
    rows = np.arange(n)
    random_same, random_r = same[rows, orders].sum(axis=1), product[rows, orders].sum(axis=1)
    observed_same, observed_r = int(np.trace(same)), float(np.trace(product))
    extra = 0 if n <= EVERY_ORDER else 1  # the full set of orders includes the observed one
    total = len(orders) + extra
    p_same = (extra + int(np.sum(random_same >= observed_same))) / total
    p_r = (extra + int(np.sum(random_r >= observed_r - 1e-12))) / total
    enough = 1 / total < DEPENDENT_BELOW
    dependent = min(p_same, p_r) < DEPENDENT_BELOW if enough else None
    counts = (observed_same, a.size, float(random_same.mean()), int(np.max(random_same)))
    return Independence(*counts, p_same, observed_r, p_r, dependent)


def dependence(table: Array, resolution: float = 0.0) -> Dependence:
    """Test whether the runs of `table[occasion, sample, level]` belong together in the order of their numbers.

    Statistics: the sum over pairs of samples of the correlation of their residuals, and of identical readings (within
    half a `resolution`); the smaller p of the two, doubled.
    """
    n, k, _ = table.shape
    if k < 2 or n < 3:
        return Dependence(math.nan, None)
    residual = table - table.mean(axis=0)
    scale = np.sqrt((residual**2).sum(axis=(0, 2)))
    residual = residual / np.where(scale > 0.0, scale, 1.0)[None, :, None]
    orders = [np.tile(np.arange(n), (RANDOM_PAIRINGS, 1))]
    orders += [permutations(n, RANDOM_PAIRINGS, stream=j) for j in range(1, k)]
    together = np.zeros((2, RANDOM_PAIRINGS + 1))
    for i, j in combinations(range(k), 2):
        same = _identical(table[:, i], table[:, j], resolution)
        for s, matrix in enumerate((residual[:, i] @ residual[:, j].T, same)):
            together[s, 0] += np.trace(matrix)
            together[s, 1:] += matrix[orders[i], orders[j]].sum(axis=1)
    reached = (together[:, 1:] >= together[:, :1] - 1e-12).sum(axis=1)
    p = min(1.0, 2.0 * (1.0 + float(np.min(reached))) / (RANDOM_PAIRINGS + 1.0))
    attainable = 2.0 / math.factorial(min(n, 12)) ** (k - 1) < DEPENDENT_BELOW
    return Dependence(p, p < DEPENDENT_BELOW if attainable else None)


def split_share(rows: Array) -> Array:
    """Return the largest between-group share of the sum of squares over all splits of each sorted row in two."""
    ordered = np.sort(rows, axis=-1)
    centred = ordered - ordered.mean(axis=-1, keepdims=True)
    n = rows.shape[-1]
    k = np.arange(1, n)
    heads = np.cumsum(centred, axis=-1)[..., :-1]
    whole = (centred**2).sum(axis=-1)
    best: Array = (heads**2 * (1 / k + 1 / (n - k))).max(axis=-1) / np.where(whole > 0, whole, np.inf)
    return best


def bimodality(results: ArrayLike, step: float | None = None) -> Bimodality:
    """Test whether the results fall into two groups, three steps or more apart, each of two results or more.

    The best split is compared, at 5 %, with that of random results of one normal distribution, rounded to `step`.
    Raises NotEnoughData below six results.
    """
    values = np.sort(numbers(results, "results"))
    n = len(values)
    if n < TWO_GROUPS_RUNS:
        raise NotEnoughData(f"two groups cannot be told from one with {n} results")
    grain = resolution(values).step if step is None else step
    gaps = np.diff(values)
    at = int(np.argmax(gaps)) + 1
    share = float(split_share(values))
    random = generator().normal(values.mean(), max(values.std(ddof=1), 1e-12), (RANDOM_RESULTS, n))
    random = np.round(random / grain) * grain if grain > 0 else random
    p = (1 + int(np.sum(split_share(random) >= share - 1e-9))) / (RANDOM_RESULTS + 1)
    apart = min(at, n - at) >= 2 and float(gaps[at - 1]) >= 3 * grain - 1e-9
    return Bimodality(float(np.max(gaps)), (at, n - at), bool(apart and p < 0.05 and share > 0))


def resolution(results: ArrayLike, step: float | None = None) -> Resolution:
    """Compare the smallest difference between results (or the `step` given) with their SD; coarse below two steps."""
    values = numbers(results, "results")
    distinct = np.unique(np.round(values, 9))
    grain = float(np.min(np.diff(distinct))) if step is None and len(distinct) > 1 else step or 0.0
    sd = float(values.std(ddof=1)) if len(values) > 1 else 0.0
    return Resolution(grain, sd < 2 * grain or sd == 0)
