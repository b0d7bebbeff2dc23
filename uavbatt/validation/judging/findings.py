"""Findings about the tests themselves, computed from the data set, in words that a pilot understands.

Each function looks for one thing in any data set and returns its findings; none uses numbers of the study. `detail` has
the numbers and the statistical test, `numbers` the same for programs.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from uavbatt.dataset import DataSet, Levels
from uavbatt.errors import NotEnoughData
from uavbatt.validation.iso5725.cells import LEAST_SAMPLES
from uavbatt.validation.judging.corridor import Corridor, leave_one_out, occasion_means, shared_table
from uavbatt.validation.judging.drift import abbe, curve_step, line_change, trend_share
from uavbatt.validation.judging.finding import NAMES, UNITS, Finding, minutes
from uavbatt.validation.judging.independence import DEPENDENT_BELOW, bimodality, independence, resolution
from uavbatt.validation.judging.outlying import inconsistent_samples, likely_misprints, outlying_runs, samples_apart
from uavbatt.validation.judging.readings import SURFACE, VOLTAGE, Readings
from uavbatt.validation.judging.same_test import not_the_same_test
from uavbatt.validation.study import paper

# Correlation of two samples: above it the second leaves a third of the variance at most.
ALMOST_ONE = 0.8
DRIFT, SERIOUS_DRIFT = 0.05, 0.01  # levels of ISO 5725-2 for a straggler and an outlier
HELD_WELL = 0.9  # share of whole curves: a corridor that holds so many needs no remark


def findings(readings: Readings, ambient_C: float, band: Corridor | None) -> tuple[Finding, ...]:
    """Judge the tests by themselves, at `ambient_C` [°C] where it is about repeats; the most serious comes first.

    `band` is the corridor of the voltage at that temperature, None where nothing was measured.
    """
    volts, heat = (readings.levels(ambient_C, q) for q in (VOLTAGE, SURFACE))
    dataset, all_findings = readings.tests, list[Finding]()
    if volts is not None and len(volts.occasions) > 1:
        all_findings += [*_dependence(dataset, volts), *_few_samples(volts), *_coverage(volts, band)]
        all_findings += [*_outside(dataset, ambient_C, band), *_paper(dataset.name, volts, heat)]
    for levels in (volts, heat):
        if levels is not None and len(levels.occasions) > 1:
            all_findings += [*_drift(levels), *inconsistent_samples(levels), *outlying_runs(levels)]
            all_findings += samples_apart(readings, levels)
            all_findings += [*_two_groups(dataset, levels), *_coarse(dataset, levels)]
    all_findings += [*likely_misprints(readings), *_breaks(readings), *not_the_same_test(readings, ambient_C)]
    rank = {"serious": 0, "warning": 1, "note": 2}
    return tuple(sorted(all_findings, key=lambda f: rank[f.severity]))


def _dependence(dataset: DataSet, levels: Levels) -> Iterator[Finding]:
    shared = shared_table(levels)
    table = shared.table
    if table.shape[1] < 2 or len(table) < 3:
        return
    step = dataset.uncertainty.voltage_resolution_V or 0.0
    pairs = list(combinations(range(table.shape[1]), 2))
    for i, j in pairs:
        test = independence(table[:, i], table[:, j], resolution=step)
        names = f"samples {shared.samples[i]} and {shared.samples[j]}"
        numbers = {"identical": test.identical, "compared": test.compared, "p_value": test.p_identical,
                   "correlation": test.correlation, "expected": test.expected_identical}  # fmt: skip
        detail = (
            f"{test.identical} of {test.compared} readings are identical; pairing the runs at random gives "
            f"{test.expected_identical:.1f} on average and {test.most_identical} at most (p = "
            f"{test.p_identical:.1g}). The deviations from the mean curve are correlated, r = "
            f"{test.correlation:.2f} (p = {test.p_correlation:.1g})."
        )
        together = test.correlation >= ALMOST_ONE
        if test.dependent and min(test.p_identical, test.p_correlation) < DEPENDENT_BELOW / len(pairs):
            means = "the second adds almost no information" if together else "they share a part of their scatter"
            title = f"The {names} are not independent: {means}"
            yield Finding("dependent_samples", title, detail, "serious" if together else "warning", numbers)
        elif test.dependent is None:
            title = f"Too few runs to tell whether the {names} are independent"
            yield Finding("independence_unknown", title, detail, "note", numbers)


def _few_samples(levels: Levels) -> Iterator[Finding]:
    k = len(levels.samples)
    if k < LEAST_SAMPLES:
        title = "How much one pack differs from another is not known"
        tested = f"{k} sample{'s were' if k > 1 else ' was'} tested repeatedly"
        detail = f"{tested} at {levels.ambient_C:g} °C; ISO 5725 needs at least three, and eight to be useful."
        yield Finding("reproducibility_unknown", title, detail, "warning", {"samples": k})


def _coverage(levels: Levels, band: Corridor | None) -> Iterator[Finding]:
    cross_check = leave_one_out(levels)
    if cross_check is None or band is None or min(cross_check.share_all, band.covers_all) >= HELD_WELL:
        return
    inside, total = int(cross_check.inside.sum()), cross_check.inside.size
    out = [f"run {o} of sample {s}" for o, row in zip(cross_check.occasions, cross_check.inside, strict=True)
           for s, ok in zip(cross_check.samples, row, strict=True) if not ok]  # fmt: skip
    title = f"The ±2S corridor holds only about {cross_check.share_all:.0%} of genuine flights from start to end"
    detail = (
        f"Judged by the corridor of all other occasions, {inside} of {total} curves stay inside at every instant "
        f"(out: {', '.join(out[:8])}{' and more' if len(out) > 8 else ''}); simulated {band.covers_all:.0%}. At one "
        f"instant alone {band.covers_one:.0%}. ±{band.simultaneous_factor:.2f} SD would hold 95 % from start to end."
    )
    numbers = {"held": inside, "total": total, "share": cross_check.share_all, "simulated": band.covers_all}
    # every band that holds 95 % at one instant has this property: the reader must know it, but the tests are not at
    # fault
    yield Finding("corridor_coverage", title, detail, "note", numbers)


def _outside(dataset: DataSet, ambient_C: float, band: Corridor | None) -> Iterator[Finding]:
    if band is None or band.basis != "repeats":
        return
    runs = dataset.at(ambient_C)
    for run in runs:
        if sum(r.sample == run.sample for r in runs) > 1 or run.time_s[-1] < band.at[-1]:
            continue
        values = np.interp(band.at, run.time_s, run.voltage_V)
        out = ~band.inside(values)
        if not out.any():
            continue
        score = (values - band.mean) / np.where(band.S > 0, band.S, np.inf)
        worst = int(np.argmax(np.abs(score)))
        many = f"at {int(out.sum())} of {len(out)} instants"
        title = f"The one-time curve of {run.sample} at {ambient_C:+g} °C lies outside its own corridor {many}"
        detail = (
            f"Outside mean ± 2S at {minutes(band.at[out])}; worst at {band.at[worst] / 60:g} min: "
            f"{values[worst]:.2f} V against {band.mean[worst]:.2f} ± {band.C[worst]:.2f} V "
            f"({values[worst] - band.mean[worst]:+.2f} V, {score[worst]:+.1f} S). "
            f"A model fitted to that curve cannot pass this corridor."
        )
        numbers = {"outside": int(out.sum()), "instants": len(out), "worst_V": float(values[worst] - band.mean[worst])}
        yield Finding("curve_outside_corridor", title, detail, "serious", numbers)


def _paper(name: str, volts: Levels, heat: Levels | None) -> Iterator[Finding]:
    try:
        replay = paper.replay_levels(name, volts, heat)
    except NotEnoughData:
        return
    for quantity, pooled in (("voltage_V", replay.pooled), ("surface_C", replay.pooled_surface)):
        bad = [p for p in pooled if not p.may_pool]
        if bad:
            by_t, by_F = [p for p in bad if p.t > p.t_critical], [p for p in bad if p.t <= p.t_critical]
            reasons = [f"Student's t exceeds its limit at {minutes(p.time_s for p in by_t)}"] * bool(by_t)
            reasons += [f"the variances differ too much (F) at {minutes(p.time_s for p in by_F)}"] * bool(by_F)
            rebuilt = " (figures of sample 2 rebuilt from the printed means and variances)" * bool(replay.agreements)
            title = (f"The {NAMES[quantity]} of the samples may not be pooled at "
                     f"{minutes(p.time_s for p in bad)}, by the study's own rules")  # fmt: skip
            numbers = {f"minute_{p.time_s / 60:g}": p.t for p in bad}
            detail = "; ".join(reasons) + rebuilt * (quantity == "surface_C") + "."
            chance = f" With {len(pooled)} instants and {len(replay.samples)} samples some of that is chance."
            few = len(replay.samples) == 2
            detail += "" if few else chance
            yield Finding("pooling_forbidden", title, detail, "warning" if few else "note", numbers)
    yield from _printed(replay)


def _printed(replay: paper.PaperReplay) -> Iterator[Finding]:
    claim = replay.fisher
    if claim is not None and not claim.reproducible:
        title = f"The printed F_emp = {claim.printed:g} does not follow from the tables"
        sd, variance = claim.at_first_instant
        detail = (
            f"At 0 min the ratio of SDs is {sd:.3f} (as printed) and of variances {variance:.3f}; the nearest of all "
            f"columns is {claim.nearest:.2f}. The limit {claim.critical_printed:g} is right ({claim.critical:.3f})."
        )
        numbers = {"printed": claim.printed, "nearest": claim.nearest}
        yield Finding("F_emp_not_reproducible", title, detail, "warning", numbers)
    slips = [s for a in replay.agreements for s in a.slips]
    if slips:
        score = ", ".join(f"{a.table} {a.agree}/{a.total}" for a in replay.agreements)
        title = (
            f"{len(slips)} printed figure{'s' * (len(slips) > 1)} of the study's tables differ from what its data give"
        )
        yield Finding("printed_slips", title, f"{score}. {'; '.join(slips)}.", "note", {"slips": len(slips)})


def _drift(levels: Levels) -> Iterator[Finding]:
    """Test the occasions for drift by Abbe, Holm over the instants, and describe it over those that drift."""
    occasions, means = occasion_means(levels)
    if len(means) < 6:
        return
    p = np.array([abbe(c).p_value for c in means.T])
    drifting, least = np.flatnonzero(p < DRIFT), np.nanmin(p) * np.sum(~np.isnan(p))
    if not len(drifting) or least > DRIFT:
        return
    step, unit, at = curve_step(means[:, drifting]), UNITS[levels.quantity], levels.time_s[drifting]
    is_steady = trend_share(means[:, drifting]) > step.statistic
    steps = means[step.after :].mean(axis=0) - means[: step.after].mean(axis=0)
    sizes = (line_change(means) if is_steady else steps)[drifting]
    most = int(np.argmax(np.abs(sizes)))
    way, last = "down" if sizes[most] < 0 else "up", occasions[step.after - 1]
    size = f"{sizes[most]:+.3f} {unit} at {at[most] / 60:g} min"
    how = f"it goes {way} from the first run to the last" if is_steady else f"it steps {way} after run {last}"
    found = (
        f"From the first run to the last it changes by {size}; a straight line explains more than a step at any place."
        if is_steady
        else f"The largest step is {size}; p = {step.p_value:.2g} for a step at any place."
    )
    detail = (
        f"Abbe's test finds drift at {minutes(at)} (smallest p = {np.nanmin(p):.1g}). {found} "
        f"The repeats are not one population, and the first-to-last rule does not see it."
    )
    numbers = {"instants": len(drifting), "step": float(sizes[most]), "p_value": step.p_value}
    numbers |= {} if is_steady else {"after_run": last}
    title = f"The {NAMES[levels.quantity]} drifts from run to run: {how}"
    yield Finding("drift", title, detail, "serious" if least <= SERIOUS_DRIFT else "warning", numbers)


def _step(dataset: DataSet, quantity: str) -> float | None:
    u = dataset.uncertainty
    return u.voltage_resolution_V if quantity == "voltage_V" else u.temperature_resolution_C


def _two_groups(dataset: DataSet, levels: Levels) -> Iterator[Finding]:
    for j, sample in enumerate(levels.samples):
        table = levels.curves(j)
        if len(table) < 6:
            continue
        splits = [bimodality(column, _step(dataset, levels.quantity)) for column in table.T]
        split = [i for i, b in enumerate(splits) if b.bimodal]
        if split:
            name, unit, when = NAMES[levels.quantity], UNITS[levels.quantity], minutes(levels.time_s[split])
            title = f"The {name} of sample {sample} falls into two groups at {when}"
            gaps = "; ".join(f"{levels.time_s[i] / 60:g} min: {splits[i].groups[0]} and {splits[i].groups[1]} results "
                             f"{splits[i].gap:.2g} {unit} apart" for i in split)  # fmt: skip
            detail = f"{gaps}. One mean and one SD do not describe that."
            yield Finding("two_groups", title, detail, "note", {"instants": len(split)})


def _coarse(dataset: DataSet, levels: Levels) -> Iterator[Finding]:
    step = _step(dataset, levels.quantity)
    if step is None:
        return
    cells = [np.concatenate(levels.cells(i)) for i in range(len(levels.time_s))]
    coarse = [i for i, c in enumerate(cells) if resolution(c, step).coarse]
    if coarse:
        title = f"The {NAMES[levels.quantity]} was read too coarsely at {minutes(levels.time_s[coarse])}"
        steps = f"two steps of {step:g} {UNITS[levels.quantity]}"
        detail = f"There the spread is below {steps}: it comes from the meter as much as from the pack."
        yield Finding("coarse_resolution", title, detail, "note", {"instants": len(coarse), "step": step})


def _breaks(readings: Readings) -> Iterator[Finding]:
    for b in readings.broken or ():
        title = f"The one-time tests break between {b.low_C:+g} and {b.high_C:+g} °C: two series, not one"
        detail = (
            f"The knee comes {abs(b.jump_s):.0f} s {'later' if b.jump_s > 0 else 'earlier'} at {b.high_C:+g} °C, "
            f"{abs(b.score):.1f} times the usual scatter between neighbours. No battery does that: "
            "fit no law across the break."
        )
        numbers = {"low_C": b.low_C, "high_C": b.high_C, "jump_s": b.jump_s}
        yield Finding("series_break", title, detail, "warning", numbers)
