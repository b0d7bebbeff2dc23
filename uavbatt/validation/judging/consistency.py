"""Consistency of the samples with each other, instant by instant: Cochran's and Grubbs' tests of ISO 5725-2."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from uavbatt.dataset import Levels
from uavbatt.validation.iso5725 import outliers
from uavbatt.validation.iso5725.cells import LEAST_SAMPLES, Array

# Grubbs' test of three means sees a far one only if the other two are equal. A mean as far off as this is told, too:
# in s_r of single results, and in ranges of the other means, at more than half of the instants. Sound sets: 1.5 s_r.
FAR_SDS, FAR_RANGES = 4.0, 2.0
LEAST_S_R = 1e-6  # readings that all show the same scatter by the rounding of their sums at most
OUTLIER = 0.01  # the level at which ISO 5725-2 calls a sample an outlier, for one instant

Inconsistent = Literal["scatter", "mean"]


@dataclass(frozen=True, slots=True)
class Inconsistency:
    """Inconsistency says that a sample is an outlier among the samples, by its scatter or by its mean.

    `instants` are the indices at which it is one, `worst` the index at which most. `own` and `others` are the SD of the
    sample and the pooled SD of the others there, or the mean of the sample and of the others, in the unit of the
    results. `is_certain` tells that it passes the limit even if that is divided among all instants.
    """

    kind: Inconsistent
    sample: str
    instants: tuple[int, ...]
    worst: int
    own: float
    others: float
    statistic: float
    critical: float
    is_certain: bool


class _Found(NamedTuple):
    sample: int
    own: float
    others: float
    statistic: float
    critical: float
    strict: float


def inconsistencies(levels: Levels) -> Iterator[Inconsistency]:
    """Find the samples that are outliers among the samples at one or more instants, each once for each kind.

    Cochran's test compares the variances of two samples or more, Grubbs' test the means of three or more. Where all
    samples but one show no scatter at all, the resolution of the meter decides, and nothing is said.
    """
    instants = range(levels.time_s.size)
    kinds: tuple[Inconsistent, ...] = ("scatter", "mean")
    for kind in kinds:
        test = _scatter if kind == "scatter" else _mean
        by_instant = {i: one for i in instants if (one := test(_cells(levels, i), len(instants))) is not None}
        for sample in sorted({f.sample for f in by_instant.values()}):
            of_sample = {i: f for i, f in by_instant.items() if f.sample == sample}
            worst = max(of_sample, key=lambda i: of_sample[i].statistic / of_sample[i].critical)
            is_certain = any(f.statistic > f.strict for f in of_sample.values())
            yield Inconsistency(
                kind, str(levels.samples[sample]), tuple(of_sample), worst, *of_sample[worst][1:-1], is_certain
            )


def words(sample: Inconsistency, name: str, unit: str, minutes: str, worst_minute: str) -> tuple[str, str]:
    """Return a title and a detail; `name` and `unit` are of what was measured, the minutes are when."""
    does, of, test = {
        "scatter": ("scatters more than the others", "SD", "Cochran"),
        "mean": ("lies apart from the others", "mean", "Grubbs"),
    }[sample.kind]
    detail = (
        f"At {worst_minute} min its {of} is {sample.own:.4g} {unit}, that of the others {sample.others:.4g} {unit}: "
        f"{test} {sample.statistic:.3f} > {sample.critical:.3f} (1 %). It counts in all results: look for the cause."
    )
    return f"The {name} of sample {sample.sample} {does} at {minutes}", detail


def _cells(levels: Levels, instant: int) -> list[Array]:
    """Return the results of each sample at one instant; empty for a sample without one."""
    columns = levels.values[:, :, instant].T
    return [column[~np.isnan(column)] for column in columns]


def _scatter(cells: list[Array], instants: int) -> _Found | None:
    """Return the sample with an outlying variance at one instant, if there is one.

    Numbers of results may differ: the share of a sample in the sum of squares is compared with its own critical value.
    For equal numbers that is Cochran's test.
    """
    df = np.array([len(c) - 1.0 for c in cells])
    squares = np.array([float(np.sum((c - np.mean(c)) ** 2)) if len(c) > 1 else 0.0 for c in cells])
    whole, all_df, repeated = float(np.sum(squares)), float(np.sum(df[df > 0.0])), np.flatnonzero(df > 0.0)
    if repeated.size < 2 or np.count_nonzero(squares > 1e-12 * whole) < 2:
        return None

    def critical(j: int, level: float) -> float:
        return outliers.variance_share_critical(df[j], all_df - df[j], repeated.size, level)

    j = max((int(j) for j in repeated), key=lambda j: squares[j] / whole / critical(j, OUTLIER))
    share, limit = squares[j] / whole, critical(j, OUTLIER)
    if share <= limit:
        return None
    own, others = np.sqrt(squares[j] / df[j]), np.sqrt((whole - squares[j]) / (all_df - df[j]))
    return _Found(j, float(own), float(others), float(share), limit, critical(j, OUTLIER / instants))


def _mean(cells: list[Array], instants: int) -> _Found | None:
    """Return the sample with an outlying mean at one instant, if there is one: the farther end, if both are.

    Means of the others that are equal to the last digit are so by the resolution of the meter: any fourth one would be
    an outlier beside them, and nothing is said.
    """
    measured = [j for j, c in enumerate(cells) if len(c)]
    if len(measured) < LEAST_SAMPLES:
        return None
    means = np.array([float(np.mean(cells[j])) for j in measured])
    test = outliers.grubbs(means)
    statistic, index, verdict = test.ends[0]
    others = np.delete(means, index)
    if verdict != "outlier" or np.ptp(others) <= 1e-9 * np.max(np.abs(others)):
        return None
    strict = outliers.grubbs_critical(means.size, OUTLIER / instants)
    return _Found(measured[index], float(means[index]), float(np.mean(others)), statistic, test.critical_1, strict)


class Apart(NamedTuple):
    """Apart says that the mean of a sample differs from the others' by much more than its runs scatter.

    `off` [instants] is the mean of the sample less that of the other samples, `s_r` [instants] the pooled SD of
    repeated results, both in the unit of the results.
    """

    sample: str
    off: Array
    s_r: Array


def sample_apart(levels: Levels) -> Apart | None:
    """Return the one sample of three or more that is far from all others at most instants; None if there is none."""
    if len(levels.samples) < LEAST_SAMPLES:
        return None
    by_sample = np.moveaxis(levels.values, 1, 0)  # [sample, occasion, instant]
    count = np.sum(~np.isnan(by_sample), axis=1)
    if np.any(count < 1) or np.any(np.sum(count - 1, axis=0) < 1):
        return None
    means = np.nanmean(by_sample, axis=1)
    s_r = np.sqrt(np.nansum((by_sample - means[:, None]) ** 2, axis=(0, 1)) / np.sum(count - 1, axis=0))
    s_r = np.maximum(s_r, LEAST_S_R)
    for j, sample in enumerate(levels.samples):
        others = np.delete(means, j, axis=0)
        off = means[j] - others.mean(axis=0)
        far = (np.abs(off) > FAR_SDS * s_r) & (np.abs(off) > FAR_RANGES * np.ptp(others, axis=0))
        if np.mean(far) > 0.5:
            return Apart(sample, off, s_r)
    return None
