"""Closing the loop on one-time tests over ambient temperature shows what an isothermal model leaves, and what mends it.

The isothermal model is gated first, at the temperature that has repeats, and its residual over temperature shown.
Then the terms that could explain the residual are added one by one (`cold_model`): self-heating, a resistance that
grows more steeply in the cold, and, as a nuisance that is no property of a battery, the steps between series of tests
(`series.breaks`). Each is judged on tests that the fit has not seen (every fourth temperature left out in turn; one
at a time where there are fewer than eight; such a fit starts where that of all tests ended, so that it looks for the
same minimum). A gain holds when the squared error falls on held-out tests by more than chance: one-sided paired t over
the temperatures at 5 %, by Holm over the questions. Neighbouring temperatures are not quite independent, so that this
is a lenient test: what fails it has failed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from uavbatt.battery.model import Array
from uavbatt.fitting import prior
from uavbatt.validation.gating import cold_model, gate, heldout
from uavbatt.validation.gating.cold_model import OneTimeTests, Variant
from uavbatt.validation.gating.gate import Claim, Limits
from uavbatt.validation.gating.heldout import HeldOut
from uavbatt.validation.judging.readings import Readings

LEAST_TESTS = 8
COLD_C = -10.0
FOLDS = 4
RISE_S = (60.0, 180.0)
SIGNIFICANT = 0.05
START_FITS = 0.5  # one start of a variant takes about half as long as one fit of the circuit model
TERMS = {(False, False): "isothermal", (False, True): "isothermal, steeper cold resistance",
         (True, False): "self-heating", (True, True): "self-heating, steeper cold resistance"}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Outcome:
    """One variant fitted in one scope ("cold" or "all"): RMSE [V] per group and per test, fitted and held out.

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
    """The gain of `after` over `before` on unseen tests of `group`: RMSE [V], one-sided p; `holds` by Holm."""

    question: str
    scope: str
    group: str
    before_V: float
    after_V: float
    fitted_before_V: float
    fitted_after_V: float
    p_value: float
    holds: bool


@dataclass(frozen=True, slots=True)
class TemperatureLoop:
    """The isothermal model at the gate, its residual over temperature, and what its extensions are worth.

    `series_C` are the temperature ranges of the series, `measured_rise_V` the tests' change from minute 1 to 3.
    """

    ambient_C: Array
    series_C: tuple[tuple[float, float], ...]
    groups: Mapping[str, tuple[float, float]]
    isothermal: HeldOut
    isothermal_claims: tuple[Claim, ...]
    isothermal_rmse_V: Array
    measured_rise_V: Array
    outcomes: tuple[Outcome, ...]
    gains: tuple[Gain, ...]
    conclusions: tuple[str, ...]
    left_out: tuple[str, ...]


def fits(readings: Readings) -> float:
    """Return how much work `close_loop` is, in fits of the circuit model; 0 where it has nothing to do."""
    tests = None if heldout.is_metered(readings.dataset) else one_time_tests(readings)[0]
    if tests is None:
        return 0.0
    variants = [*_variants("cold", _cold(tests)), *_variants("all", tests)]
    return len(heldout.repeats(readings).occasions) + START_FITS * sum(map(_fresh_starts, variants))


def close_loop(
    readings: Readings, limits: Limits, progress: Callable[[float], None] | None = None
) -> TemperatureLoop | None:
    """Gate the isothermal model, add terms one by one, and judge each on tests that the fit has not seen.

    Returns None when fewer than eight temperatures were tested once, or the current was measured. `progress` is called
    with the fits just done, which add up to `fits(readings)`.
    """
    dataset = readings.dataset
    if heldout.is_metered(dataset):
        return None
    tests, left_out = one_time_tests(readings)
    if tests is None:
        return None
    declared, known = limits.for_cells(dataset.cells_series), dataset.uncertainty
    effects = tuple(e for e in prior.BASE_EFFECTS if e != "self_heating")
    held = heldout.circuit(readings, progress, effects=effects, model="circuit without self-heating")
    surface = gate.surface_claim(held, declared, known)
    claims = (
        gate.voltage_claim(held, declared, dataset.cutoff_V, known),
        gate.crossing_claim(held, declared, known),
        gate.knee_claim(held, declared, dataset.cutoff_V, known),
        *(() if surface is None else (surface,)),
    )
    groups = _groups(tests)
    outcomes = (*_outcomes("cold", _cold(tests), groups, progress), *_outcomes("all", tests, groups, progress))
    gains = _gains(outcomes, groups)
    by_ambient = {s.ambient_C: float(np.sqrt(np.mean((s.model_V - s.measured_V) ** 2))) for s in held.singles}
    rise = _rise(tests.time_s, tests.voltage_V)
    return TemperatureLoop(
        ambient_C=tests.ambient_C,
        series_C=tuple(
            (float(np.min(tests.ambient_C[tests.series == k])), float(np.max(tests.ambient_C[tests.series == k])))
            for k in range(int(tests.series.max()) + 1)
        ),
        groups=groups,
        isothermal=held,
        isothermal_claims=claims,
        isothermal_rmse_V=np.array([by_ambient.get(float(t), np.nan) for t in tests.ambient_C]),
        measured_rise_V=rise,
        outcomes=outcomes,
        gains=gains,
        conclusions=_conclusions(gains, outcomes, tests, rise),
        left_out=left_out,
    )


def one_time_tests(readings: Readings) -> tuple[OneTimeTests | None, tuple[str, ...]]:
    """Put the one-time tests into a table, flagged readings left out and named; None when there are too few."""
    dataset, runs = readings.tests, readings.series
    if len(runs) < LEAST_TESTS or any(not np.array_equal(r.time_s, runs[0].time_s) for r in runs):
        return None, ()
    volts, left_out = np.array([r.voltage_V for r in runs]), []
    for flag in dataset.flags:
        for i, r in enumerate(runs):
            if (flag.sample, flag.run, flag.ambient_C, flag.column) == (r.sample, r.run, r.ambient_C, "voltage_v"):
                volts[i, r.time_s == flag.time_s] = np.nan
                left_out.append(flag.where)
    T = np.array([r.ambient_C for r in runs])
    edges = sorted(b.high_C for b in readings.broken or ())
    series = np.searchsorted(edges, T, "right").astype(np.intp)
    return OneTimeTests(T, runs[0].time_s, volts, series, dataset.cells_series), tuple(left_out)


def _cold(tests: OneTimeTests) -> OneTimeTests:
    return tests.of(tests.ambient_C <= COLD_C)


def _groups(tests: OneTimeTests) -> dict[str, tuple[float, float]]:
    """Temperature ranges: the cold, then what is left of each series; and all."""
    out, T = {}, tests.ambient_C
    for rows in (T <= COLD_C, *((tests.series == k) & (T > COLD_C) for k in range(int(tests.series.max()) + 1))):
        if rows.any():
            low, high = float(T[rows].min()), float(T[rows].max())
            out[f"{low:+g} to {high:+g} °C"] = (low, high)
    return {**out, "all": (float(T.min()), float(T.max()))}


def _rise(time_s: Array, voltage_V: Array) -> Array:
    first, last = (int(np.argmin(np.abs(time_s - t))) for t in RISE_S)
    out: Array = voltage_V[:, last] - voltage_V[:, first]
    return out


def _variants(scope: str, tests: OneTimeTests) -> list[Variant]:
    """The models to compare, what a model contains before itself; none for fewer than three tests."""
    if tests.ambient_C.size < 3:
        return []
    several = len(set(tests.series.tolist())) > 1
    return [
        Variant(name, heat, steep, series)
        for series in ((False, True) if several else (False,))
        for (heat, steep), name in TERMS.items()
        if scope == "cold" or heat == steep
    ]


def _fresh_starts(variant: Variant) -> int:
    """Starts of the optimiser besides those from the smaller models."""
    return cold_model.FRESH // 2 if variant.self_heating or variant.steeper_cold else cold_model.FRESH


def _outcomes(
    scope: str,
    tests: OneTimeTests,
    groups: Mapping[str, tuple[float, float]],
    progress: Callable[[float], None] | None,
) -> list[Outcome]:
    out, fitted = [], list[cold_model.Fit]()
    for variant in _variants(scope, tests):
        smaller = [f for f in fitted if f.variant.series == variant.series]
        outcome, found = _outcome(scope, variant, tests, groups, smaller)
        fitted.append(found)
        out.append(outcome)
        if progress is not None:
            progress(START_FITS * _fresh_starts(variant))
    return out


def _outcome(
    scope: str,
    variant: Variant,
    tests: OneTimeTests,
    groups: Mapping[str, tuple[float, float]],
    smaller: list[cold_model.Fit],
) -> tuple[Outcome, cold_model.Fit]:
    T, count = tests.ambient_C, int(tests.series.max()) + 1
    inside = tuple(f for f in smaller if f.variant.steeper_cold <= variant.steeper_cold)
    found = cold_model.fit(variant, tests, count, inside, _fresh_starts(variant))
    fitted, unseen = cold_model.residuals(found, tests), np.empty((T.size, tests.time_s.size))
    folds = FOLDS if T.size >= 2 * FOLDS else T.size
    for k in range(folds):
        out = np.arange(T.size) % folds == k
        part = cold_model.fit(variant, tests.of(~out), count, (found,), fresh=0)
        unseen[out] = cold_model.residuals(part, tests.of(out))
    model_V = fitted + tests.voltage_V
    outcome = Outcome(
        scope=scope,
        variant=variant.name,
        series=variant.series,
        ambient_C=T,
        fitted_V=_rms(fitted),
        held_out_V=_rms(unseen),
        by_group_fitted_V=_by_group(fitted, T, groups),
        by_group_held_out_V=_by_group(unseen, T, groups),
        rise_V=_rise(tests.time_s, model_V),
        parameters=found.values(),
    )
    return outcome, found


def _rms(residual: Array) -> Array:
    out: Array = np.sqrt(np.nanmean(residual**2, axis=1))
    return out


def _by_group(residual: Array, T: Array, groups: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    rows: dict[str, NDArray[np.bool_]] = {name: (low <= T) & (high >= T) for name, (low, high) in groups.items()}
    return {name: float(np.sqrt(np.nanmean(residual[r] ** 2))) for name, r in rows.items() if r.any()}


def _gains(outcomes: tuple[Outcome, ...], groups: Mapping[str, tuple[float, float]]) -> tuple[Gain, ...]:
    found = {(o.scope, o.variant, o.series): o for o in outcomes}
    plain, heat, both = TERMS[False, False], TERMS[True, False], TERMS[True, True]
    cold = next(iter(groups))
    asked = (
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
        _gain(question, found[before], found[after], group, groups[group])
        for question, before, after, group in asked
        if before in found and after in found
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


def _gain(question: str, before: Outcome, after: Outcome, group: str, span: tuple[float, float]) -> Gain:
    rows = (before.ambient_C >= span[0]) & (before.ambient_C <= span[1])
    better = before.held_out_V[rows] ** 2 - after.held_out_V[rows] ** 2
    p = float(stats.ttest_1samp(better, 0.0, alternative="greater").pvalue) if better.size > 1 else np.nan
    return Gain(
        question, before.scope, group,
        before.by_group_held_out_V[group], after.by_group_held_out_V[group],
        before.by_group_fitted_V[group], after.by_group_fitted_V[group], p, False,
    )  # fmt: skip


def _conclusions(
    gains: tuple[Gain, ...], outcomes: tuple[Outcome, ...], tests: OneTimeTests, rise: Array
) -> tuple[str, ...]:
    """Say in one sentence per question what holds on unseen tests and what does not."""
    said = []
    for g in gains:
        where = f"{g.question} ({g.group})"
        numbers = f"{1e3 * g.before_V:.0f} to {1e3 * g.after_V:.0f} mV held out"
        numbers += f" ({1e3 * g.fitted_before_V:.0f} to {1e3 * g.fitted_after_V:.0f} fitted, p = {g.p_value:.2g})"
        said.append(f"{where}: {'holds' if g.holds else 'does not hold'}, {numbers}")
    recovering = rise > 0.0
    for o in outcomes:
        if o.scope == "cold" and recovering.any() and o.variant in (TERMS[False, False], TERMS[True, False]):
            at = [i for i in np.flatnonzero(recovering) if tests.ambient_C[i] in o.ambient_C]
            model = dict(zip(o.ambient_C.tolist(), o.rise_V.tolist(), strict=True))
            pairs = [(float(tests.ambient_C[i]), float(rise[i])) for i in at]
            shown = ", ".join(f"{model[T]:+.2f} V at {T:+g} °C (measured {r:+.2f})" for T, r in pairs)
            said.append(f"recovery from minute 1 to 3, {o.variant}: {shown}")
    return tuple(said)
