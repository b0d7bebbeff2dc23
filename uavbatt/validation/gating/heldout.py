"""Predictions of runs that the model was not fitted to: one occasion (run k of all samples) is left out at a time.

Runs of one occasion share their day and set-up, so that they are left out together: otherwise the others would contain
information about them. The single runs at other ambient temperatures are divided over the same folds, so that each of
them is also predicted by a fit without it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.model import Array
from uavbatt.dataset import DataSet, Levels, Run
from uavbatt.errors import NotEnoughData
from uavbatt.fitting import observed, prior, solve, unmetered
from uavbatt.fitting.prior import Posterior
from uavbatt.fitting.unmetered import MeanTest
from uavbatt.validation.judging import fast_records
from uavbatt.validation.judging.readings import SURFACE, Readings

Effects = tuple[str, ...]
LeftOut = tuple[int, list[Run]]  # an occasion, and the runs at other temperatures that go with it


@dataclass(frozen=True, slots=True)
class Curve:
    """A curve is one held-out run in full, read at each of its rows (`fast_records`); [s], [V]."""

    occasion: int
    sample: int
    time_s: Array
    measured_V: Array
    model_V: Array


@dataclass(frozen=True, slots=True)
class HeldOutRun:
    """A HeldOutRun is a run at another ambient temperature, predicted by a fit without it; [s], [V]."""

    ambient_C: float
    sample: str
    time_s: Array
    measured_V: Array
    model_V: Array


@dataclass(frozen=True, slots=True)
class HeldOut:
    """HeldOut sets measured and predicted values side by side, [occasion, sample, level] at `time_s`.

    The surface temperatures are None where they were not measured. `at_rest` marks the instants before the load,
    `row_s` and `step_V` are the spacing of the original rows and the smallest step between their voltages, `curves`
    are the records in full (none for tables read each minute), `singles` the runs at other temperatures.
    """

    model: str
    ambient_C: float
    cells: int
    time_s: Array
    measured_V: Array
    model_V: Array
    measured_C: Array | None = None
    model_C: Array | None = None
    row_s: float = 60.0
    step_V: float = 0.0
    rest: tuple[bool, ...] = ()
    curves: tuple[Curve, ...] = ()
    singles: tuple[HeldOutRun, ...] = ()

    def residual_V(self) -> Array:
        """Return model minus measured [V], [occasion, level], the mean over the samples of an occasion."""
        return known_mean(self.model_V - self.measured_V, axis=1)

    @property
    def mean_V(self) -> Array:
        """Return the mean of the measured voltages [V] at each level."""
        return known_mean(self.measured_V, axis=(0, 1))

    @property
    def at_rest(self) -> NDArray[np.bool_]:
        """Return the marks of the instants before the load; unless `rest` tells them, of the one at 0 s."""
        return np.asarray(self.rest, dtype=bool) if self.rest else self.time_s <= 0.0

    def runs(self) -> list[Curve]:
        """Return the held-out runs: the full records where there are any, else the readings."""
        if self.curves:
            return list(self.curves)
        grid = np.ndindex(self.measured_V.shape[:2])
        return [Curve(i, j, self.time_s, self.measured_V[i, j], self.model_V[i, j]) for i, j in grid]


def known_mean(table: Array, axis: int | tuple[int, ...]) -> Array:
    """Return the mean of the known values of a table over one or more axes; NaN where none is known."""
    known = np.isfinite(table)
    count = known.sum(axis=axis)
    total = np.where(known, table, 0.0).sum(axis=axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def mean_test(dataset: DataSet, runs: list[Run], ambient_C: float) -> MeanTest:
    """Average runs under one load, at the instants of the shortest."""
    grid = min((r.time_s for r in runs), key=len)
    volts = np.array([np.interp(grid, r.time_s, r.voltage_V) for r in runs])
    surfaces = np.array([np.interp(grid, r.time_s, r.surface_C) for r in runs])
    complete = surfaces[np.isfinite(surfaces).all(axis=1)]
    occasions = len({r.run for r in runs})  # runs of one occasion are not independent
    return MeanTest(
        time_s=grid,
        voltage_V=volts.mean(axis=0),
        voltage_sd_V=volts.std(axis=0, ddof=1) / np.sqrt(occasions) if len(runs) > 1 else np.zeros(grid.size),
        surface_C=complete.mean(axis=0) if len(complete) else np.full(grid.size, np.nan),
        cells=dataset.cells_series,
        ambient_C=ambient_C,
    )


def repeats(readings: Readings) -> Levels:
    """Return the repeated runs at the whole minutes. Raises NotEnoughData when there are fewer than two occasions."""
    levels = readings.levels(readings.ambient_C)
    if levels is None or len(levels.occasions) < 2:
        raise NotEnoughData(
            f"{readings.dataset.path}: expected repeated runs at one ambient temperature, to leave one out"
        )
    return levels


def other_runs(dataset: DataSet, levels: Levels) -> list[Run]:
    """List the runs at other ambient temperatures than the repeated one."""
    return [r for r in dataset.runs if r not in dataset.at(levels.ambient_C)]


def circuit(
    readings: Readings,
    progress: Callable[[float], None] | None = None,
    effects: Effects = prior.BASE_EFFECTS,
    model: str = "circuit",
) -> HeldOut:
    """Predict each occasion by the circuit model with its effects, fitted to the other occasions.

    `effects` are the names of the effects that are on; `progress` is called with 1 after each fit.
    Raises NotEnoughData when nothing is left to fit once an occasion is out.
    """
    dataset, levels = readings.dataset, repeats(readings)
    others = other_runs(dataset, levels)
    left_out = [(occasion, others[k :: len(levels.occasions)]) for k, occasion in enumerate(levels.occasions)]
    predict = _metered if dataset.is_metered else _unmetered
    folds = []
    for fold in predict(dataset, levels, left_out, effects):
        folds.append(fold)
        if progress is not None:
            progress(1.0)
    surface = readings.levels(levels.ambient_C, SURFACE)
    measured_C = _aligned(levels, surface)
    return HeldOut(
        model=model,
        ambient_C=levels.ambient_C,
        cells=dataset.cells_series,
        time_s=levels.time_s,
        measured_V=levels.values,
        model_V=np.stack([f.volts for f in folds]),
        measured_C=measured_C,
        model_C=np.stack([f.surface for f in folds]) if measured_C is not None else None,
        row_s=float(np.median(np.diff(dataset.at(levels.ambient_C)[0].time_s))),
        step_V=smallest_step(dataset.at(levels.ambient_C)),
        rest=rest_at(dataset, levels),
        curves=tuple(c for f in folds for c in f.curves),
        singles=tuple(s for f in folds for s in f.singles),
    )


@dataclass(frozen=True, slots=True)
class _Fold:
    volts: Array
    surface: Array
    curves: list[Curve]
    singles: list[HeldOutRun]


def smallest_step(runs: tuple[Run, ...]) -> float:
    """Return the smallest step between two voltages [V]: what the meter resolves, if nothing is stated."""
    distinct = np.unique(np.round(np.concatenate([r.voltage_V for r in runs]), 6))
    return float(np.diff(distinct).min()) if distinct.size > 1 else 0.0


def rest_at(dataset: DataSet, levels: Levels) -> tuple[bool, ...]:
    """Mark the instants of the levels that come before the load: by the measured current, else the one at 0 s."""
    run = next((r for r in dataset.at(levels.ambient_C) if r.is_metered), None)
    if run is None:
        return tuple(bool(t <= 0.0) for t in levels.time_s)
    phase = fast_records.phases(run.current_A)
    rested = run.current_A[0] < fast_records.rest_limit_A(run.current_A)
    at = np.searchsorted(run.time_s, levels.time_s, side="right") - 1
    return tuple(bool(rested and phase[max(i, 0)] == 0) for i in at)


def _unmetered(dataset: DataSet, levels: Levels, left_out: list[LeftOut], effects: Effects) -> Iterator[_Fold]:
    runs = [r for r in dataset.at(levels.ambient_C) if r.sample in levels.samples]
    tests = [mean_test(dataset, [r for r in runs if r.run != out], levels.ambient_C) for out, _ in left_out]
    for test, fit, (_, others) in zip(tests, unmetered.fit_each(tests, effects), left_out, strict=True):
        yield _unmetered_fold(levels, test, fit, others)


def _unmetered_fold(levels: Levels, test: MeanTest, fit: Posterior, others: list[Run]) -> _Fold:
    def predicted(ambient_C: float, time_s: Array) -> Array:
        there = replace(test, ambient_C=ambient_C)
        return unmetered.predict_unmetered(fit.slots, fit.effects, fit.x[None], there, time_s)[:, :, 0]

    volts, surface = predicted(levels.ambient_C, levels.time_s)
    shape = (len(levels.samples), levels.time_s.size)
    singles = [
        HeldOutRun(r.ambient_C, r.sample, r.time_s, r.voltage_V, predicted(r.ambient_C, r.time_s)[0]) for r in others
    ]
    return _Fold(np.broadcast_to(volts, shape), np.broadcast_to(surface, shape), [], singles)


def _metered(dataset: DataSet, levels: Levels, left_out: list[LeftOut], effects: Effects) -> Iterator[_Fold]:
    return (_metered_fold(dataset, levels, *out, effects) for out in left_out)


def _metered_fold(dataset: DataSet, levels: Levels, occasion: int, others: list[Run], effects: Effects) -> _Fold:
    out = [r for r in dataset.at(levels.ambient_C) if r.run == occasion and r.sample in levels.samples]
    training = replace(dataset, runs=tuple(r for r in dataset.runs if r not in out and r not in others))
    fit = solve.fit_cell(observed.stack(observed.from_dataset(training)), effects)
    tested = [run for run in (*out, *others) if run.is_metered]
    volts = np.full((len(levels.samples), levels.time_s.size), np.nan)
    surface, curves, singles = volts.copy(), list[Curve](), list[HeldOutRun]()
    if not tested:
        return _Fold(volts, surface, curves, singles)
    stack = observed.stack(observed.from_dataset(replace(dataset, runs=tuple(tested))))
    run = solve.replay_fit(stack, fit, np.column_stack([solve.start_guess(stack), np.zeros((len(tested), 2))]))
    k = levels.occasions.index(occasion)
    for j, test in enumerate(tested):
        rows = stack.compare[:, j]
        time_s, measured = stack.time_s[rows, j], stack.voltage_V[rows, j]
        model, phase = run.voltage_V[rows, j] * stack.cells[j], fast_records.phases(stack.current_A[rows, j])
        own = fast_records.weights(time_s, phase, time_s)
        if test in others:
            singles.append(HeldOutRun(test.ambient_C, test.sample, time_s, own @ measured, own @ model))
            continue
        at, w = levels.samples.index(test.sample), fast_records.weights(time_s, phase, levels.time_s)
        volts[at] = levels.values[k, at] + w @ (model - measured)
        surface[at] = w @ run.sensor_C[rows, j]
        if fast_records.is_finer_than_minutes(test):
            curves.append(Curve(k, at, time_s, own @ measured, own @ model))
    return _Fold(volts, surface, curves, singles)


def _aligned(levels: Levels, surface: Levels | None) -> Array | None:
    """Return the surface temperature at the occasions, samples and instants of the voltage; None if not measured."""
    if surface is None:
        return None
    out = np.full(levels.values.shape, np.nan)
    shared = np.flatnonzero(np.isin(levels.time_s, surface.time_s))
    from_time = np.searchsorted(surface.time_s, levels.time_s[shared])
    for i, occasion in enumerate(surface.occasions):
        for j, sample in enumerate(surface.samples):
            if occasion in levels.occasions and sample in levels.samples:
                at = (levels.occasions.index(occasion), levels.samples.index(sample))
                out[at][shared] = surface.values[i, j, from_time]
    return out
