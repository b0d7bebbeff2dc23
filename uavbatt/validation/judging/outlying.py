"""Findings about samples and single readings that lie apart from the others (Cochran, Grubbs, neighbours)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np

from uavbatt.dataset import Levels
from uavbatt.validation.iso5725 import outliers
from uavbatt.validation.iso5725.cells import Array
from uavbatt.validation.judging.consistency import FAR_SDS, Apart, inconsistencies, sample_apart, words
from uavbatt.validation.judging.finding import NAMES, UNITS, Finding, minutes
from uavbatt.validation.judging.readings import VOLTAGE, Readings
from uavbatt.validation.judging.series import quasi_replicates

FEWEST_RUNS = 6  # of a sample in which an outlier is looked for
AT_REST = 0.05  # of the largest current: less is no load


def inconsistent_samples(levels: Levels) -> Iterator[Finding]:
    """Find samples whose scatter or mean is not that of the others."""
    for f in inconsistencies(levels):
        at = levels.time_s[list(f.instants)]
        when = (minutes(at), f"{levels.time_s[f.worst] / 60:g}")
        title_and_detail = words(f, NAMES[levels.quantity], UNITS[levels.quantity], *when)
        numbers = {"instants": at.size, "statistic": f.statistic, "critical_1": f.critical}
        yield Finding(f"inconsistent_{f.kind}", *title_and_detail, "warning" if f.is_certain else "note", numbers)


def samples_apart(readings: Readings, levels: Levels) -> Iterator[Finding]:
    """Find the sample whose mean is far from that of all others, and say whether it is so before the load."""
    apart = sample_apart(levels)
    if apart is None:
        return
    worst = int(np.argmax(np.abs(apart.off)))
    name, unit = NAMES[levels.quantity], UNITS[levels.quantity]
    way = "lower" if apart.off[worst] < 0 else "higher"
    most, median = abs(apart.off[worst]), float(np.median(np.abs(apart.off / apart.s_r)))
    title = f"The {name} of sample {apart.sample} is up to {most:.2g} {unit} {way} than that of the others"
    detail = (
        f"Half of the instants differ by more than {median:.0f} times the scatter of repeated runs (s_r); most at "
        f"{levels.time_s[worst] / 60:g} min. With few samples Grubbs' test cannot show it."
        f"{_before_load(readings, levels, apart) if levels.quantity == VOLTAGE else ''} "
        "It counts in all results: look for the cause."
    )
    numbers = {"off": float(apart.off[worst]), "minute": float(levels.time_s[worst] / 60), "times_s_r": median}
    yield Finding("sample_apart", title, detail, "warning", numbers)


def _before_load(readings: Readings, levels: Levels, apart: Apart) -> str:
    """Return what the voltage at rest tells of the cause; empty if the runs do not begin at rest."""
    runs = [run for run in readings.tests.at(levels.ambient_C) if run.sample == apart.sample]
    if levels.time_s[0] > 0.0 or any(
        not run.current_A[0] < AT_REST * np.max(np.nan_to_num(run.current_A)) for run in runs
    ):
        return ""
    rested, unit = apart.off[0], UNITS[levels.quantity]
    if abs(rested) > FAR_SDS * apart.s_r[0]:
        return (
            f" Before the load it is {rested:+.2g} {unit} already: compare the voltmeters and the charge at the start."
        )
    return f" Before the load it is {rested:+.2g} {unit}: contacts, leads and the resistance of the cells come first."


def outlying_runs(levels: Levels) -> Iterator[Finding]:
    """Find runs of one sample that lie apart from its other runs (Grubbs, 1 %); each is told once."""
    for j, sample in enumerate(levels.samples):
        table = levels.curves(j)
        if len(table) < FEWEST_RUNS:
            continue
        runs = [o for o, row in zip(levels.occasions, levels.values[:, j], strict=True) if not np.isnan(row).any()]
        found = [(i, *one) for i in range(levels.time_s.size) for one in _beyond(table[:, i])]
        for index in sorted({index for _, index, *_ in found}):
            own = [(i, side, G, limit) for i, k, side, G, limit in found if k == index]
            worst, side, G, limit = max(own, key=lambda one: one[2])
            at = levels.time_s[[i for i, *_ in own]]
            title = f"Run {runs[index]} of sample {sample} is an outlier at {minutes(at)} ({NAMES[levels.quantity]})"
            value = f"{table[index, worst]:.4g} {UNITS[levels.quantity]} at {levels.time_s[worst] / 60:g} min"
            detail = f"{value} is too {side}: Grubbs {G:.3f} > {limit:.3f} (1 %)."
            severity: Literal["warning", "note"] = "warning" if len(own) > levels.time_s.size / 2 else "note"
            numbers = {"run": runs[index], "minute": levels.time_s[worst] / 60, "G": G, "instants": len(own)}
            yield Finding("outlier", title, detail, severity, numbers)


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
