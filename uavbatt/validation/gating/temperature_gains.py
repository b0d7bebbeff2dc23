"""The worth of each term of the models over ambient temperature, on tests that the fit had not seen.

A gain holds when the squared error falls on held-out tests by more than chance: one-sided paired t over the
temperatures at 5 %, by Holm over the questions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from uavbatt.battery.model import Array
from uavbatt.validation.gating.cold_model import OneTimeTests

SIGNIFICANT = 0.05  # over all questions together (Holm)
TERMS = {(False, False): "isothermal", (False, True): "isothermal, steeper cold resistance",
         (True, False): "self-heating", (True, True): "self-heating, steeper cold resistance"}  # fmt: skip


@dataclass(frozen=True, slots=True)
class VariantOutcome:
    """VariantOutcome holds a variant in one scope ("cold" or "all"): RMSE [V] per group and test, fitted and held out.

    `rise_V` is the model's change from minute 1 to 3 at each test: the recovery by its own heat.
    """

    scope: str
    variant: str
    series: bool
    ambient_C: Array
    fitted_V: Array
    held_out_V: Array
    by_group_fitted_V: Mapping[str, float]
    by_group_held_out_V: Mapping[str, float]
    rise_V: Array
    parameters: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Gain:
    """A gain compares the RMSE [V] without and with a term on unseen tests of `group`; one-sided p, `holds` by Holm."""

    question: str
    scope: str
    group: str
    before_V: float
    after_V: float
    fitted_before_V: float
    fitted_after_V: float
    p_value: float
    holds: bool


def gains_of(outcomes: tuple[VariantOutcome, ...], groups: Mapping[str, tuple[float, float]]) -> tuple[Gain, ...]:
    """List what each term gains on unseen tests, and mark the gains that hold.

    `groups` are the temperature ranges [°C] by name, the coldest first.
    """
    by_model = {(o.scope, o.variant, o.series): o for o in outcomes}
    plain, heat, both = TERMS[False, False], TERMS[True, False], TERMS[True, True]
    cold = next(iter(groups))
    questions = (
        ("self-heating, fitted to the cold tests alone", ("cold", plain, False), ("cold", heat, False), cold),
        ("steeper cold resistance on top", ("cold", heat, False), ("cold", both, False), cold),
        ("both, fitted to the cold tests alone", ("cold", plain, False), ("cold", both, False), cold),
        ("both, over all tests", ("all", plain, False), ("all", both, False), cold),
        ("both, over all tests", ("all", plain, False), ("all", both, False), "all"),
        ("steps between the series", ("all", plain, False), ("all", plain, True), "all"),
        ("both, the steps between the series modelled", ("all", plain, True), ("all", both, True), cold),
        ("both, the steps between the series modelled", ("all", plain, True), ("all", both, True), "all"),
    )
    gains = [
        _gain(question, by_model[before], by_model[after], group, groups[group])
        for question, before, after, group in questions
        if before in by_model and after in by_model
    ]
    return _holm(gains)


def _holm(gains: list[Gain]) -> tuple[Gain, ...]:
    """Mark the gains that hold at 5 % over all questions together (Holm)."""
    order = np.argsort([g.p_value for g in gains])
    holds, still = set(), True
    for rank, i in enumerate(order):
        still = still and gains[i].p_value * (len(gains) - rank) < SIGNIFICANT
        if still:
            holds.add(int(i))
    return tuple(replace(g, holds=i in holds) for i, g in enumerate(gains))


def _gain(question: str, before: VariantOutcome, after: VariantOutcome, group: str, span: tuple[float, float]) -> Gain:
    rows = (before.ambient_C >= span[0]) & (before.ambient_C <= span[1])
    better = before.held_out_V[rows] ** 2 - after.held_out_V[rows] ** 2
    p = float(stats.ttest_1samp(better, 0.0, alternative="greater").pvalue) if better.size > 1 else np.nan
    return Gain(
        question, before.scope, group,
        before.by_group_held_out_V[group], after.by_group_held_out_V[group],
        before.by_group_fitted_V[group], after.by_group_fitted_V[group], p, False,
    )  # fmt: skip


def conclusions_of(
    gains: tuple[Gain, ...], outcomes: tuple[VariantOutcome, ...], tests: OneTimeTests, rise: Array
) -> tuple[str, ...]:
    """Say in one sentence per question what holds on unseen tests and what does not."""
    sentences = []
    for g in gains:
        topic = f"{g.question} ({g.group})"
        numbers = f"{1e3 * g.before_V:.0f} to {1e3 * g.after_V:.0f} mV held out"
        numbers += f" ({1e3 * g.fitted_before_V:.0f} to {1e3 * g.fitted_after_V:.0f} fitted, p = {g.p_value:.2g})"
        sentences.append(f"{topic}: {'holds' if g.holds else 'does not hold'}, {numbers}")
    recovering = rise > 0.0
    for o in outcomes:
        if o.scope == "cold" and recovering.any() and o.variant in (TERMS[False, False], TERMS[True, False]):
            at = [i for i in np.flatnonzero(recovering) if tests.ambient_C[i] in o.ambient_C]
            model = dict(zip(o.ambient_C.tolist(), o.rise_V.tolist(), strict=True))
            pairs = [(float(tests.ambient_C[i]), float(rise[i])) for i in at]
            rises = ", ".join(f"{model[T]:+.2f} V at {T:+g} °C (measured {r:+.2f})" for T, r in pairs)
            sentences.append(f"recovery from minute 1 to 3, {o.variant}: {rises}")
    return tuple(sentences)
