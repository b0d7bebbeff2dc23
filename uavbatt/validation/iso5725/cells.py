"""Cells of test results, checked and reduced without losing digits.

Voltages of 12.5 V with millivolts of spread, or a certified set with a mean of 1e12, lose their digits in the
sums T1..T5 of ISO 5725-2. Everything here works on deviations from one result of the set, exact for
neighbouring numbers, and in two passes. A cell holds the results of one sample (laboratory) at one level.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavbatt.errors import UavbattError

Array: TypeAlias = NDArray[np.float64]
Cells: TypeAlias = Sequence[ArrayLike] | Array
LEAST_SAMPLES = 3  # fewer say nothing of reproducibility
LARGEST = 1e150  # squares of larger results overflow
DUST = 4.0 * np.finfo(np.float64).eps  # numbers nearer than that share of the largest differ by their rounding alone


class BadCells(UavbattError, ValueError):
    """BadCells says that cells hold no usable results: they are empty, not numbers, or of the wrong shape."""


@dataclass(frozen=True, slots=True)
class Summary:
    """Summary reduces each cell to its number of results, its mean less `reference` and its variance.

    Means are in the unit of the results, variances in its square; the variance of a single result is NaN.
    """

    reference: float
    counts: Array
    offsets: Array
    variances: Array

    @property
    def means(self) -> Array:
        """Return the cell means in the unit of the results."""
        return self.reference + self.offsets

    @property
    def p(self) -> int:
        """Return the number of cells (samples, laboratories)."""
        return len(self.counts)

    @property
    def within_df(self) -> float:
        """Return the degrees of freedom within cells: sum of n_i - 1."""
        return float(np.sum(self.counts - 1))

    @property
    def within_ss(self) -> float:
        """Return the sum of squares within cells."""
        repeated = self.counts > 1
        return math.fsum((self.counts[repeated] - 1) * self.variances[repeated])

    @property
    def typical_n(self) -> int:
        """Return the number of results in most cells that have two or more (ISO 5725-2 for unequal n)."""
        counts = [int(c) for c in self.counts if c > 1]
        return max(set(counts), key=lambda c: (counts.count(c), c)) if counts else 1


def numbers(values: ArrayLike, name: str) -> Array:
    """Return a flat array of finite results. Raises BadCells naming `name`."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise BadCells(f"{name}: expected numbers") from None
    if array.ndim != 1:
        raise BadCells(f"{name}: expected a flat sequence of results, found {array.ndim} dimensions")
    if array.size == 0:
        raise BadCells(f"{name}: expected at least one result, it is empty")
    bad = np.flatnonzero(~np.isfinite(array))
    if bad.size:
        raise BadCells(f"{name}, result {bad[0] + 1}: expected a finite number, found {array[bad[0]]}")
    return array


def summarise(cells: Cells) -> Summary:
    """Reduce cells to counts, means and variances, in two passes about the first result. Raises BadCells.

    Results that are equal have a variance of exactly 0, and means that are equal in decimals are equal here: else the
    rounding of binary numbers is all that a test for outliers sees, and it finds outliers in it.
    """
    if isinstance(cells, str) or not hasattr(cells, "__len__") or len(cells) == 0:
        raise BadCells("cells: expected one sequence of results per sample, there is none")
    arrays = [numbers(c, f"cell {i + 1}") for i, c in enumerate(cells)]
    reference, largest = float(arrays[0][0]), max(float(np.max(np.abs(a))) for a in arrays)
    if not largest < LARGEST:
        raise BadCells(f"cells: expected results below {LARGEST:g}, found {largest:g}")
    offsets, variances = [], []
    for array in arrays:
        deviations = without_dust(array - reference, largest)
        mean = math.fsum(deviations) / len(array)
        offsets.append(mean)
        variances.append(_variance(deviations, mean) if len(array) > 1 else math.nan)
    counts = np.array([len(a) for a in arrays], dtype=float)
    return Summary(reference, counts, without_dust(np.array(offsets), largest), np.array(variances))


def _variance(deviations: Array, mean: float) -> float:
    """Return the variance of two or more deviations from the reference; exactly 0 if all are equal."""
    if np.ptp(deviations) == 0.0:
        return 0.0
    return math.fsum((deviations - mean) ** 2) / (len(deviations) - 1)


def without_dust(values: Array, largest: float) -> Array:
    """Return the values, those made equal that differ only by the rounding of numbers as large as `largest`."""
    order, out = np.argsort(values, kind="stable"), values.copy()
    for before, after in pairwise(order):
        if values[after] - values[before] <= DUST * largest:
            out[after] = out[before]
    return out


def from_statistics(means: ArrayLike, sds: ArrayLike, counts: ArrayLike) -> Summary:
    """Make a summary from printed cell means, standard deviations and numbers of results. Raises BadCells."""
    m, s, n = (numbers(v, w) for v, w in ((means, "means"), (sds, "SDs"), (counts, "counts")))
    if not len(m) == len(s) == len(n):
        raise BadCells(f"expected as many means, SDs and counts, found {len(m)}, {len(s)} and {len(n)}")
    if np.any(s < 0) or np.any(n < 1) or np.any(n != np.round(n)):
        raise BadCells("expected SDs of at least 0 and whole counts of at least 1")
    offsets = without_dust(m - m[0], float(np.max(np.abs(m))))
    return Summary(float(m[0]), n, offsets, np.where(n > 1, s**2, math.nan))


def spread(values: Array) -> tuple[Array, float]:
    """Return the deviations from the mean and their sum of squares, without losing digits to a large mean."""
    offsets = values - values[0]
    deviations = offsets - math.fsum(offsets) / len(offsets)
    return deviations, math.fsum(deviations**2)
