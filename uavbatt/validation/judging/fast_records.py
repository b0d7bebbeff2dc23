"""Reading of fast records at whole minutes, so that one noisy row does not decide.

A record sampled faster than once a minute is read at the whole minutes by a straight line through the rows within
±WINDOW_S/2, or by their mean if there are fewer than four. A window never includes both sides of a load step, because
the mean of rest and load has no meaning. An instant without a row on its own side of the step is left out of every run
at that temperature. Measured and predicted voltage are read with the same weights, so that reading cannot make a bias.
Tables that were read by hand are unchanged.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.model import Array
from uavbatt.dataset import DataSet, Run

WINDOW_S = 20.0
MINUTE_S = 60.0
LINE_ROWS = 4  # a line through three rows leaves one degree of freedom to their noise
REST_SHARE = 0.2  # a test discharges by some C, and electronics at rest draw a few per cent of that


def is_fast(run: Run) -> bool:
    """Return True if the rows come so fast that a window (WINDOW_S) holds several."""
    return bool(np.median(np.diff(run.time_s)) < WINDOW_S / 2.0)


def is_finer_than_minutes(run: Run) -> bool:
    """Return True if the record has rows between the whole minutes, so that it shows what happens there."""
    return bool(np.median(np.diff(run.time_s)) < MINUTE_S)


def rest_limit_A(current_A: Array) -> float:
    """Return the current [A] below which a row is at rest: REST_SHARE of the record's upper current (90 % point)."""
    return REST_SHARE * float(np.quantile(current_A, 0.9))


def phases(current_A: Array) -> NDArray[np.intp]:
    """Number the phase (rest, load, rest, ...) of each row from 0 by `current_A` [A]; all 0 if it was not measured."""
    if not np.isfinite(current_A).all() or np.max(current_A) <= 0.0:
        return np.zeros(current_A.size, dtype=np.intp)
    loaded = current_A > rest_limit_A(current_A)
    return np.concatenate([[0], np.cumsum(loaded[1:] != loaded[:-1])])


def weights(time_s: Array, phase: NDArray[np.intp], at_s: Array) -> Array:
    """Compute the matrix [instants, rows] that reads a record at `at_s` [s]; a row of NaN where nothing may be read.

    time_s : times of the rows [s], phase : their phases (`phases`).
    """
    out = np.zeros((at_s.size, time_s.size))
    for i, t in enumerate(at_s):
        near = np.abs(time_s - t) <= WINDOW_S / 2.0 + 1e-9
        before = np.searchsorted(time_s, t, side="right") - 1
        near &= phase == phase[max(before, 0)]
        x = time_s[near] - t
        if not near.any():
            out[i] = math.nan
        elif x.size < LINE_ROWS:
            out[i, near] = 1.0 / x.size
        else:
            out[i, near] = np.linalg.pinv(np.column_stack([np.ones(x.size), x]))[0]
    return out


def at_minutes(dataset: DataSet) -> DataSet:
    """Read the fast runs of a data set at the whole minutes; hand-read runs stay unchanged."""
    runs = list(dataset.runs)
    for ambient_C in dataset.ambients_C:
        fast = [i for i, r in enumerate(runs) if r.ambient_C == ambient_C and is_fast(r)]
        minute_runs = {i: _at_minutes(runs[i]) for i in fast}
        barred = {float(t) for r in minute_runs.values() for t in r.time_s[np.isnan(r.voltage_V)]}
        for i, run in minute_runs.items():
            runs[i] = _kept(run, ~np.isin(run.time_s, list(barred)))
    return replace(dataset, runs=tuple(runs))


def _at_minutes(run: Run) -> Run:
    first, last = math.ceil(run.time_s[0] / MINUTE_S), math.floor(run.time_s[-1] / MINUTE_S)
    at_s = MINUTE_S * np.arange(first, last + 1)
    w = weights(run.time_s, phases(run.current_A), at_s)
    return replace(
        run,
        time_s=at_s,
        voltage_V=w @ run.voltage_V,
        current_A=w @ run.current_A,
        surface_C=np.array([row[row != 0.0] @ run.surface_C[row != 0.0] for row in w]),
    )


def _kept(run: Run, keep: NDArray[np.bool_]) -> Run:
    return replace(
        run,
        time_s=run.time_s[keep],
        voltage_V=run.voltage_V[keep],
        current_A=run.current_A[keep],
        surface_C=run.surface_C[keep],
    )
