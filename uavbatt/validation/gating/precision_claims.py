"""Claims about the tests themselves say whether their precision is known well enough and reaches other samples.

Repeatability: s_r with its relative 95 % uncertainty A_r = 1.96/√(2ν) (ISO 5725-1) against a declared bound. Samples
that depend on each other count as one. Drift over the runs is named in the reason.

Reproducibility: the bias with the samples random too, u² = (MS_occasion + MS_sample)/(ok) of the crossed model,
degrees of freedom by Satterthwaite (ISO 5725-3; the residual counted in both on purpose). Three samples or more,
independent of each other, and A_R within its bound; else nothing is known of the next pack.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.dataset import Levels, Uncertainty
from uavbatt.validation.gating import budget, gate
from uavbatt.validation.gating.gate import Claim, Limits, Verdict, claim_without_bias
from uavbatt.validation.gating.heldout import HeldOut
from uavbatt.validation.iso5725 import precision, relative_uncertainty_r
from uavbatt.validation.iso5725.cells import LEAST_SAMPLES
from uavbatt.validation.iso5725.intermediate import crossed
from uavbatt.validation.iso5725.intervals import satterthwaite
from uavbatt.validation.judging.corridor import LEAST_OCCASIONS, shared_table
from uavbatt.validation.judging.finding import Finding
from uavbatt.validation.judging.independence import Dependence, dependence

SAME = "all repeated results are equal: the resolution of the meter hides how they differ"


def repeatability_claim(levels: Levels, limits: Limits, findings: Sequence[Finding], instruments: Uncertainty) -> Claim:
    """Judge whether s_r is known to within `precision_A_r`; drift over the runs is a warning."""
    rows = [precision(levels.cells(i)) for i in range(levels.time_s.size)]
    shared = shared_table(levels).table
    linked = dependence(shared, resolution=instruments.voltage_resolution_V or 0.0).dependent
    df = shared.shape[0] - 1 if linked else sum(len(c) - 1 for c in levels.cells(0))
    A_r = relative_uncertainty_r(df) if df else math.inf
    s_r = max(p.s_r for p in rows)
    verdict: Verdict = "pass" if A_r <= limits.precision_A_r and s_r > 0.0 else "not enough data"
    known_to = f"known to ±{A_r:.0%} (declared: ±{limits.precision_A_r:.0%}), {df} degrees of freedom"
    reason = f"s_r up to {s_r:.3g} V, {known_to}" if s_r > 0.0 else SAME
    reason += "; the samples depend on each other and count as one" if linked else ""
    drifts = [f for f in findings if f.kind == "drift" and "voltage" in f.title]
    reason += f"; warning: {drifts[0].title}" if drifts else ""
    numbers = {"A_r": A_r, "degrees_of_freedom": float(df), "largest_s_r_V": s_r, "drift": float(bool(drifts))}
    return claim_without_bias("repeatability", levels.ambient_C, reason, numbers, verdict=verdict, gates=True,
                              limit=limits.precision_A_r, unit="1")  # fmt: skip


def reproducibility_claim(
    held_out: HeldOut, levels: Levels, limits: Limits, cutoff_V: float, instruments: Uncertainty
) -> Claim:
    """Judge the bias for another sample; it informs, does not gate (a pack of the same make ships without it)."""
    name = "reproducibility"
    not_judged = partial(claim_without_bias, name, held_out.ambient_C)
    shared = shared_table(levels).table
    k, linked = shared.shape[1], dependence(shared, resolution=instruments.voltage_resolution_V or 0.0)
    p_value = {"samples": float(k), "p_dependence": linked.p_value}
    if why_not := _why_not_independent(k, len(levels.samples), linked):
        return not_judged(why_not, p_value)
    at = gate.judged_instants(held_out, limits, cutoff_V)
    if not at.size:
        return not_judged("no instant can be judged", p_value)
    rows = [precision(levels.cells(int(i))) for i in at]
    if not any(p.s_R > 0.0 for p in rows):
        return not_judged(SAME, p_value)
    A_R = max(p.A_R for p in rows if p.s_R > 0.0)
    if not limits.precision_A_R >= A_R:
        reason = f"s_R known to ±{A_R:.0%} only (declared: ±{limits.precision_A_R:.0%}), {k} samples"
        return not_judged(reason, {**p_value, "A_R": A_R})
    table = (held_out.model_V - held_out.measured_V)[:, :, at]
    table = table[np.isfinite(table).all(axis=(1, 2))]
    if len(table) < LEAST_OCCASIONS:
        return not_judged(f"{len(table)} occasions predicted, at least {LEAST_OCCASIONS} are needed", p_value)
    u, df = _random_samples(table)
    guard = budget.voltage_budget(held_out, at, table.mean(axis=1), instruments).guard
    _, df, half = budget.expand(u, df, guard / budget.ONE_SIDED, at.size)
    bias = table.mean(axis=(0, 1))
    verdict, reason = gate.decide(bias, half, limits.voltage_V)
    full_reason = f"{k} samples of one make in one laboratory: {reason}"
    return Claim(name, held_out.ambient_C, verdict, full_reason, False, held_out.time_s[at], bias, half, guard,
                 limits.voltage_V, "V", statistics={**p_value, "A_R": A_R, "least_df": float(np.min(df))})  # fmt: skip


def _why_not_independent(k: int, all_k: int, linked: Dependence) -> str:
    """Return why `k` samples, of `all_k`, tell nothing of another one; empty if they are enough and independent."""
    if k < LEAST_SAMPLES:
        also = ", and they depend on each other" if linked.dependent else ""
        share = f" of {all_k} share their occasions" if k < all_k else ""
        return f"{k} sample(s){share}{also}: at least {LEAST_SAMPLES} are needed"
    if linked.dependent is None:
        return "too few runs to tell whether the samples are independent"
    return f"the samples depend on each other (p = {linked.p_value:.1g})" if linked.dependent else ""


def _random_samples(table: Array) -> tuple[Array, Array]:
    """Return per level the standard uncertainty of the mean and its df, with samples and occasions random."""
    o, k, levels = table.shape
    u, df = np.empty(levels), np.empty(levels)
    for i in range(levels):
        ms_occasion, ms_sample, _ = crossed(table[:, :, i]).mean_squares
        parts = [ms_occasion / (o * k), ms_sample / (o * k)]
        u[i] = math.sqrt(sum(parts))
        df[i] = satterthwaite(parts, (o - 1.0, k - 1.0)) if sum(parts) > 0.0 else o - 1.0
    return u, df
