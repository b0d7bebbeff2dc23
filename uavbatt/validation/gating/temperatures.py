"""One-time tests over ambient temperature: the error of an isothermal model, and which extension reduces it.

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
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.model import Array
from uavbatt.fitting import prior
from uavbatt.validation.gating import cold_model, gate, heldout
from uavbatt.validation.gating.cold_model import OneTimeTests, Variant
from uavbatt.validation.gating.gate import Claim, Limits
from uavbatt.validation.gating.heldout import HeldOut
from uavbatt.validation.gating.temperature_gains import TERMS, Gain, VariantOutcome, conclusions_of, gains_of
from uavbatt.validation.judging.readings import Readings
from uavbatt.validation.judging.series import COLD_C, unflagged_voltage

LEAST_TESTS = 8  # temperatures: two for each of the four folds
FOLDS = 4  # every fourth temperature is left out: its neighbours stay, so that nothing is extrapolated far
RISE_S = (60.0, 180.0)  # within the first minute a cold pack falls, by the third its own heat raises the voltage
START_FITS = 0.5  # one start of a variant takes about half as long as one fit of the circuit model


@dataclass(frozen=True, slots=True)
class TemperatureLoop:
    """TemperatureLoop holds the isothermal model's claims, its residual over temperature, and its extensions' worth.

    `series_C` are the temperature ranges of the series, `measured_rise_V` the tests' change from minute 1 to 3.
    """

    ambient_C: Array
    series_C: tuple[tuple[float, float], ...]
    groups: Mapping[str, tuple[float, float]]
    isothermal: HeldOut
    isothermal_claims: tuple[Claim, ...]
    isothermal_rmse_V: Array
    measured_rise_V: Array
    outcomes: tuple[VariantOutcome, ...]
    gains: tuple[Gain, ...]
    conclusions: tuple[str, ...]
    left_out: tuple[str, ...]


def fits(readings: Readings) -> float:
    """Return how much work `close_loop` is, in fits of the circuit model; 0 where it has nothing to do."""
    tests = None if readings.dataset.is_metered else one_time_tests(readings)[0]
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
    if dataset.is_metered:
        return None
    tests, left_out = one_time_tests(readings)
    if tests is None:
        return None
    declared = limits.for_cells(dataset.cells_series)
    effects = tuple(e for e in prior.BASE_EFFECTS if e != "self_heating")
    held_out = heldout.circuit(readings, progress, effects=effects, model="circuit without self-heating")
    claims = gate.equivalence_claims(held_out, declared, dataset.cutoff_V, dataset.uncertainty)
    groups = _groups(tests)
    outcomes = (*_outcomes("cold", _cold(tests), groups, progress), *_outcomes("all", tests, groups, progress))
    gains = gains_of(outcomes, groups)
    by_ambient = {s.ambient_C: float(np.sqrt(np.mean((s.model_V - s.measured_V) ** 2))) for s in held_out.singles}
    rise = _rise(tests.time_s, tests.voltage_V)
    return TemperatureLoop(
        ambient_C=tests.ambient_C,
        series_C=tuple(
            (float(np.min(tests.ambient_C[tests.series == k])), float(np.max(tests.ambient_C[tests.series == k])))
            for k in range(int(np.max(tests.series)) + 1)
        ),
        groups=groups,
        isothermal=held_out,
        isothermal_claims=tuple(claims),
        isothermal_rmse_V=np.array([by_ambient.get(float(t), np.nan) for t in tests.ambient_C]),
        measured_rise_V=rise,
        outcomes=outcomes,
        gains=gains,
        conclusions=conclusions_of(gains, outcomes, tests, rise),
        left_out=left_out,
    )


def one_time_tests(readings: Readings) -> tuple[OneTimeTests | None, tuple[str, ...]]:
    """Put the one-time tests into a table, flagged readings left out and named; None when there are too few."""
    dataset, runs = readings.tests, readings.series
    if len(runs) < LEAST_TESTS or any(not np.array_equal(r.time_s, runs[0].time_s) for r in runs):
        return None, ()
    volts, left_out = unflagged_voltage(runs, dataset.flags)
    T = np.array([r.ambient_C for r in runs])
    edges = sorted(b.high_C for b in readings.broken or ())
    series = np.searchsorted(edges, T, "right").astype(np.intp)
    return OneTimeTests(T, runs[0].time_s, volts, series, dataset.cells_series), left_out


def _cold(tests: OneTimeTests) -> OneTimeTests:
    return tests.of(tests.ambient_C <= COLD_C)


def _groups(tests: OneTimeTests) -> dict[str, tuple[float, float]]:
    """Return the temperature ranges: the cold, the rest of each series, and all."""
    out, T = {}, tests.ambient_C
    for rows in (T <= COLD_C, *((tests.series == k) & (T > COLD_C) for k in range(int(np.max(tests.series)) + 1))):
        if rows.any():
            low, high = float(T[rows].min()), float(T[rows].max())
            out[f"{low:+g} to {high:+g} °C"] = (low, high)
    return {**out, "all": (float(np.min(T)), float(np.max(T)))}


def _rise(time_s: Array, voltage_V: Array) -> Array:
    first, last = (int(np.argmin(np.abs(time_s - t))) for t in RISE_S)
    out: Array = voltage_V[:, last] - voltage_V[:, first]
    return out


def _variants(scope: str, tests: OneTimeTests) -> list[Variant]:
    """Return the models to compare, the simpler ones first; none for fewer than three tests."""
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
    """Return the number of the optimiser's starts besides those from the simpler models."""
    return cold_model.FRESH // 2 if variant.self_heating or variant.steeper_cold else cold_model.FRESH


def _outcomes(
    scope: str,
    tests: OneTimeTests,
    groups: Mapping[str, tuple[float, float]],
    progress: Callable[[float], None] | None,
) -> list[VariantOutcome]:
    out, fitted = [], list[cold_model.ColdFit]()
    for variant in _variants(scope, tests):
        smaller = [f for f in fitted if f.variant.series == variant.series]
        outcome, fit = _outcome(scope, variant, tests, groups, smaller)
        fitted.append(fit)
        out.append(outcome)
        if progress is not None:
            progress(START_FITS * _fresh_starts(variant))
    return out


def _outcome(
    scope: str,
    variant: Variant,
    tests: OneTimeTests,
    groups: Mapping[str, tuple[float, float]],
    smaller: list[cold_model.ColdFit],
) -> tuple[VariantOutcome, cold_model.ColdFit]:
    T, count = tests.ambient_C, int(np.max(tests.series)) + 1
    inside = tuple(f for f in smaller if f.variant.steeper_cold <= variant.steeper_cold)
    fit = cold_model.fit_cold_model(variant, tests, count, inside, _fresh_starts(variant))
    fitted, unseen = cold_model.residuals(fit, tests), np.empty((T.size, tests.time_s.size))
    folds = FOLDS if T.size >= 2 * FOLDS else T.size
    left_out = [np.arange(T.size) % folds == k for k in range(folds)]
    for out, part in zip(left_out, cold_model.fit_parts(fit, tests, [~out for out in left_out]), strict=True):
        unseen[out] = cold_model.residuals(part, tests.of(out))
    model_V = fitted + tests.voltage_V
    outcome = VariantOutcome(
        scope=scope,
        variant=variant.name,
        series=variant.series,
        ambient_C=T,
        fitted_V=_rms(fitted),
        held_out_V=_rms(unseen),
        by_group_fitted_V=_by_group(fitted, T, groups),
        by_group_held_out_V=_by_group(unseen, T, groups),
        rise_V=_rise(tests.time_s, model_V),
        parameters=fit.values(),
    )
    return outcome, fit


def _rms(residual: Array) -> Array:
    out: Array = np.sqrt(np.nanmean(residual**2, axis=1))
    return out


def _by_group(residual: Array, T: Array, groups: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    rows: dict[str, NDArray[np.bool_]] = {name: (low <= T) & (high >= T) for name, (low, high) in groups.items()}
    return {name: float(np.sqrt(np.nanmean(residual[r] ** 2))) for name, r in rows.items() if r.any()}
