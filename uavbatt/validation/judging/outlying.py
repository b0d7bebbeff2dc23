"""Findings about samples and single readings that lie apart from the others (Cochran, Grubbs, neighbours)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uavbatt.dataset import Levels
from uavbatt.validation.iso5725 import outliers
from uavbatt.validation.iso5725.cells import Array
from uavbatt.validation.judging.consistency import inconsistencies, words
from uavbatt.validation.judging.finding import NAMES, UNITS, Finding, minutes
from uavbatt.validation.judging.readings import Readings
from uavbatt.validation.judging.series import quasi_replicates

FEWEST_RUNS = 6  # of a sample in which an outlier is looked for


def inconsistent_samples(levels: Levels) -> Iterator[Finding]:
    """Find samples whose scatter or mean is not that of the others."""
    for f in inconsistencies(levels):
        at = levels.time_s[list(f.instants)]
        when = (minutes(at), f"{levels.time_s[f.worst] / 60:g}")
        title_and_detail = words(f, NAMES[levels.quantity], UNITS[levels.quantity], *when)
        numbers = {"instants": at.size, "statistic": f.statistic, "critical_1": f.critical}
        yield Finding(f"inconsistent_{f.kind}", *title_and_detail, "warning" if f.is_certain else "note", numbers)


def outlying_runs(levels: Levels) -> Iterator[Finding]:
    """Find runs of one sample that lie apart from its other runs (Grubbs, 1 %)."""
    for j, sample in enumerate(levels.samples):
        table = levels.curves(j)
        if len(table) < FEWEST_RUNS:
            continue
        runs = [o for o, row in zip(levels.occasions, levels.values[:, j], strict=True) if not np.isnan(row).any()]
        for i, t in enumerate(levels.time_s):
            for index, side, G, limit in _beyond(table[:, i]):
                place = f"{t / 60:g} min ({NAMES[levels.quantity]})"
                title = f"Run {runs[index]} of sample {sample} is an outlier at {place}"
                value = f"{table[index, i]:g} {UNITS[levels.quantity]}"
                detail = f"{value} is too {side}: Grubbs {G:.3f} > {limit:.3f} (1 %)."
                yield Finding("outlier", title, detail, "note", {"run": runs[index], "minute": t / 60, "G": G})


def likely_misprints(readings: Readings) -> Iterator[Finding]:
    """Find single readings that leave the line through their neighbours in temperature (Grubbs 1 % on residuals)."""
    for group in quasi_replicates(readings.series, readings.broken):
        for i, t in enumerate(group.time_s):
            for index, side, G, limit in _beyond(group.residuals[:, i]):
                T = float(group.ambients_C[index])
                value, off = group.line(T)[i] + group.residuals[index, i], group.residuals[index, i]
                title = f"One reading is likely a misprint: {T:+g} °C, {t / 60:g} min, {value:.2f} V"
                low, high = group.ambients_C[[0, -1]]
                detail = (f"{abs(off):.2f} V too {side} for the line through its neighbours at {low:g} to {high:g} °C "
                          f"(Grubbs {G:.3f} > {limit:.3f}, 1 %). It is flagged, not changed.")  # fmt: skip
                numbers = {"ambient_C": T, "time_s": float(t), "off_V": float(off)}
                yield Finding("likely_misprint", title, detail, "warning", numbers)


def _beyond(values: Array) -> Iterator[tuple[int, str, float, float]]:
    """Return index, side, statistic and critical value of each outlier among the values."""
    g = outliers.grubbs(values)
    if g.verdict_high == "outlier":
        yield g.index_high, "high", g.statistic_high, g.critical_1
    if g.verdict_low == "outlier":
        yield g.index_low, "low", g.statistic_low, g.critical_1
