"""Claims at the ambient temperatures that are not gated.

One run has no dispersion, so that it decides nothing: its bias is shown and the verdict is not enough data. Runs one
degree apart are nearly repeats (`series`): their scatter about a line in temperature gives the bias an interval. That
scatter is of one series of one pack. The distance of that series from the repeats, at the temperature where both were
tested, enters the guard band (rectangular, per instant); without such a test nothing can be said. Repeats at a second
temperature are one claim without a verdict, because their runs were not held out by occasion.
"""

from __future__ import annotations

import math

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.dataset import DataSet
from uavbatt.validation.gating import budget
from uavbatt.validation.gating.budget import ONE_SIDED, meter_rows
from uavbatt.validation.gating.gate import Claim, Limits, Verdict, before_limiter
from uavbatt.validation.gating.heldout import HeldOut, HeldOutRun
from uavbatt.validation.judging.readings import Readings
from uavbatt.validation.judging.series import QuasiReplicates

NAME = "voltage bias at this temperature"
SEVERAL_RUNS = 3  # as many as a corridor needs: fewer tell nothing of their dispersion


def ambient_claims(readings: Readings, held_out: HeldOut, limits: Limits) -> list[Claim]:
    """Make one claim for each other ambient temperature, ascending; none of them gates."""
    dataset = readings.dataset
    claims = []
    for ambient_C in sorted({s.ambient_C for s in held_out.singles}):
        runs = [s for s in held_out.singles if s.ambient_C == ambient_C]
        if len(runs) >= SEVERAL_RUNS:
            claims.append(_without_verdict(dataset, runs, limits))
        else:
            claims += [_single(single, readings, held_out, limits) for single in runs]
    return claims


def _single(single: HeldOutRun, readings: Readings, held_out: HeldOut, limits: Limits) -> Claim:
    """Return the claim of one run: together with its near repeats if it has some, else alone."""
    dataset, group = readings.dataset, readings.near_repeats_at(single.ambient_C)
    if group is None or not np.array_equal(group.time_s, single.time_s):
        return _without_verdict(dataset, [single], limits)
    return _near_repeats(dataset, held_out, single, group, limits, bool(readings.broken))


def _without_verdict(dataset: DataSet, runs: list[HeldOutRun], limits: Limits) -> Claim:
    """Return the claim of one run, or of repeats at a temperature that is not gated: their mean bias, no verdict."""
    time_s = runs[0].time_s
    differences = np.array([np.interp(time_s, s.time_s, s.model_V - s.measured_V) for s in runs])
    mean_V = np.mean([np.interp(time_s, s.time_s, s.measured_V) for s in runs], axis=0)
    at = before_limiter(mean_V, limits, dataset.cutoff_V)
    bias, unknown = differences.mean(axis=0)[at], np.full(at.size, math.nan)
    largest = float(bias[np.argmax(np.abs(bias))]) if bias.size else math.nan
    rmse = float(np.sqrt(np.mean(differences[:, at] ** 2))) if bias.size else math.nan
    if len(runs) == 1:
        why, name = "one run: nothing tells its dispersion", "largest difference"
    else:
        why = f"{len(runs)} runs; of the repeated temperatures one is gated, and this is another"
        name = "largest mean difference"
    reason = f"{why} ({name} {largest:+.3f} V, RMSE {rmse:.3f} V)"
    return Claim(NAME, runs[0].ambient_C, "not enough data", reason, False, time_s[at], bias, unknown, unknown,
                 limits.voltage_V, "V", statistics={"rmse_V": rmse, "largest_bias": largest})  # fmt: skip


def _near_repeats(
    dataset: DataSet, held_out: HeldOut, single: HeldOutRun, group: QuasiReplicates, limits: Limits, broken: bool
) -> Claim:
    line = group.line(single.ambient_C)
    at = before_limiter(line, limits, dataset.cutoff_V)
    bias = (single.model_V - line)[at]
    rows = [r.u for r in meter_rows(held_out, line[at], dataset.uncertainty)]
    step = _series_offset(dataset, held_out, single)
    guard = ONE_SIDED * np.sqrt(sum((u**2 for u in rows), start=(step[at] / math.sqrt(3.0)) ** 2))
    scatter = group.sd[at] * math.sqrt(group.leverage(single.ambient_C))
    half = budget.expand(scatter, group.df[at], guard / ONE_SIDED, at.size).half
    verdict, reason = _shown(bias, half, limits.voltage_V)
    if broken and not np.isfinite(half).all():
        reason = "one series, and series of these tests differ by an amount that is not known"
    reason = f"{group.ambients_C.size} one-time runs a degree apart as near repeats: {reason}"
    rmse = float(np.sqrt(np.mean(bias**2))) if at.size else math.nan
    return Claim(NAME, single.ambient_C, verdict, reason, False, single.time_s[at], bias, half, guard, limits.voltage_V,
                 "V", statistics={"rmse_V": rmse})  # fmt: skip


def _shown(bias: Array, half: Array, limit: float) -> tuple[Verdict, str]:
    """Decide a claim that does not gate: it fails only where the whole interval lies beyond the limit."""
    outside = np.abs(bias) - half > limit
    if outside.any():
        worst = int(np.argmax(np.where(outside, np.abs(bias), 0.0)))
        return "fail", f"bias {bias[worst]:+.3g} ± {half[worst]:.2g} beyond ±{limit:g} at {int(outside.sum())}"
    if bias.size and (np.abs(bias) + half <= limit).all():
        return "pass", f"the interval of the bias is inside ±{limit:g} at all {bias.size}"
    largest = float(bias[np.argmax(np.abs(bias))]) if bias.size else math.nan
    reason = f"the interval of the bias is neither inside nor outside ±{limit:g} (largest {largest:+.3g})"
    return "not enough data", reason


def _series_offset(dataset: DataSet, held_out: HeldOut, single: HeldOutRun) -> Array:
    """Return how far the series of a one-time test lies from the repeats where both were tested [V] per instant.

    0 for a sample that was itself repeated; NaN when the series has no test at the repeated temperature.
    """
    home = [r for r in dataset.at(held_out.ambient_C) if r.sample == single.sample]
    if len(home) > 1:
        return np.zeros(single.time_s.size)
    if not home:
        return np.full(single.time_s.size, math.nan)
    repeats = np.interp(single.time_s, held_out.time_s, held_out.mean_V)
    return np.abs(np.interp(single.time_s, home[0].time_s, home[0].voltage_V) - repeats)
