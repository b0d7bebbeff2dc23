"""Predictions of runs that the model was not fitted to: one occasion (run k of all samples) is left out at a time.

Runs of one occasion share their day and set-up, so that they leave together: what stays would tell about what left.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.dataset import DataSet, Levels, Run, whole_minutes
from uavbatt.errors import NotEnoughData
from uavbatt.fitting import observed, solve, unmetered
from uavbatt.fitting.unmetered import MeanTest

# A run is compared at a whole minute by its mean over this window when it was sampled faster.
WINDOW_S = 20.0


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Measured and predicted [occasion, sample, level] at `time_s`; surface None where it was not measured."""

    model: str
    ambient_C: float
    cells: int
    time_s: Array
    measured_V: Array
    model_V: Array
    measured_C: Array | None = None
    model_C: Array | None = None

    def residual_V(self) -> Array:
        """Model minus measured [occasion, level], the mean over the samples of an occasion."""
        out: Array = np.nanmean(self.model_V - self.measured_V, axis=1)
        return out


def mean_test(dataset: DataSet, runs: list[Run], ambient_C: float) -> MeanTest:
    """The mean of runs that were read at the same instants under one load."""
    grid = min((r.time_s for r in runs), key=len)
    volts = np.array([np.interp(grid, r.time_s, r.voltage_V) for r in runs])
    surfaces = np.array([np.interp(grid, r.time_s, r.surface_C) for r in runs])
    known = surfaces[np.isfinite(surfaces).all(axis=1)]
    return MeanTest(
        time_s=grid,
        voltage_V=volts.mean(axis=0),
        voltage_sd_V=volts.std(axis=0, ddof=1) if len(runs) > 1 else np.zeros(grid.size),
        surface_C=known.mean(axis=0) if len(known) else np.full(grid.size, np.nan),
        cells=dataset.cells_series,
        ambient_C=ambient_C,
    )


def is_metered(dataset: DataSet) -> bool:
    """Whether the current of every run was measured."""
    return all(np.isfinite(r.current_A).all() for r in dataset.runs)


def repeated_ambient(dataset: DataSet) -> float:
    """The ambient temperature with the most runs [°C]: the one that a gate can judge."""
    counts = {t: len(dataset.at(t)) for t in dataset.ambients_C}
    return max(counts, key=lambda t: counts[t])


def circuit(dataset: DataSet, progress: Callable[[int], None] | None = None) -> HeldOut:
    """The circuit model with its effects, each occasion predicted from the others.

    Raises NotEnoughData when nothing is left to fit once an occasion is out.
    """
    ambient_C = repeated_ambient(dataset)
    levels = whole_minutes(dataset, ambient_C)
    if levels is None or len(levels.occasions) < 2:
        raise NotEnoughData(f"{dataset.path}: expected repeated runs at one ambient temperature, to leave one out")
    predict = _metered if is_metered(dataset) else _unmetered
    folds = []
    for occasion in levels.occasions:
        folds.append(predict(dataset, levels, occasion))
        if progress is not None:
            progress(1)
    surface = whole_minutes(dataset, ambient_C, "surface_C")
    measured_C = _aligned(levels, surface)
    return HeldOut(
        model="circuit",
        ambient_C=ambient_C,
        cells=dataset.cells_series,
        time_s=levels.time_s,
        measured_V=levels.values,
        model_V=np.stack([volts for volts, _ in folds]),
        measured_C=measured_C,
        model_C=np.stack([warmth for _, warmth in folds]) if measured_C is not None else None,
    )


def _unmetered(dataset: DataSet, levels: Levels, occasion: int) -> tuple[Array, Array]:
    runs = [r for r in dataset.at(levels.ambient_C) if r.run != occasion and r.sample in levels.samples]
    test = mean_test(dataset, runs, levels.ambient_C)
    found = unmetered.fit(test)
    volts, surface = unmetered.predict(found.slots, found.effects, found.x[None], test, levels.time_s)[:, :, 0]
    shape = (len(levels.samples), levels.time_s.size)
    return np.broadcast_to(volts, shape), np.broadcast_to(surface, shape)


def _metered(dataset: DataSet, levels: Levels, occasion: int) -> tuple[Array, Array]:
    out = [r for r in dataset.at(levels.ambient_C) if r.run == occasion and r.sample in levels.samples]
    kept = replace(dataset, runs=tuple(r for r in dataset.runs if r not in out))
    found = solve.fit(observed.stack(observed.from_dataset(kept)))
    stack = observed.stack(observed.from_dataset(replace(dataset, runs=tuple(out))))
    run = solve.replay(stack, found, np.column_stack([solve.start_guess(stack), np.zeros((len(out), 2))]))
    volts = np.full((len(levels.samples), levels.time_s.size), np.nan)
    surface = volts.copy()
    for j, tested in enumerate(out):
        rows = stack.compare[:, j]
        at = levels.samples.index(tested.sample)
        # The measured current is noisy and so is the voltage predicted from it: compare means around the minute.
        error = run.voltage_V[rows, j] * stack.cells[j] - stack.voltage_V[rows, j]
        measured = levels.values[levels.occasions.index(occasion), at]
        volts[at] = measured + window_mean(levels.time_s, stack.time_s[rows, j], error)
        surface[at] = window_mean(levels.time_s, stack.time_s[rows, j], run.sensor_C[rows, j])
    return volts, surface


def window_mean(at_s: Array, time_s: Array, values: Array) -> Array:
    """Mean of `values` over ± half a window around each instant, the nearest value where the window is empty."""
    near = np.abs(time_s[None, :] - at_s[:, None]) <= WINDOW_S / 2.0
    nearest = np.argmin(np.abs(time_s[None, :] - at_s[:, None]), axis=1)
    near[np.arange(at_s.size), nearest] = True
    out: Array = (near @ values) / near.sum(axis=1)
    return out


def _aligned(levels: Levels, surface: Levels | None) -> Array | None:
    """Surface temperature on the voltage's occasions, samples and instants; None when there is none."""
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
