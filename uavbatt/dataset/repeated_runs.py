"""Repeated runs at one temperature as a table [occasion, sample, time], on a common time grid."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uavbatt.dataset.discharge_csv import MIN_POINTS
from uavbatt.dataset.records import Array, DataSet

QUANTITIES = ("voltage_V", "surface_C", "current_A")


@dataclass(frozen=True, slots=True)
class Levels:
    """Levels holds repeated runs on a common time grid: `values[occasion, sample, time]`, NaN where there is none."""

    ambient_C: float
    quantity: str
    samples: tuple[str, ...]
    occasions: tuple[int, ...]
    time_s: Array
    values: Array
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def cells(self, level: int) -> list[list[float]]:
        """Return the results of each sample at time index `level`, as `iso5725.precision` takes them."""
        columns = (self.values[:, j, level] for j in range(len(self.samples)))
        cells = ([float(v) for v in c if not math.isnan(v)] for c in columns)
        return [c for c in cells if c]

    def curves(self, sample: int) -> Array:
        """Return the table [occasion, time] of one sample, without occasions that it lacks."""
        table = self.values[:, sample, :]
        kept: Array = table[~np.isnan(table).any(axis=1)]
        return kept


def levels(
    dataset: DataSet, ambient_C: float, quantity: str = "voltage_V", grid_s: Array | None = None
) -> Levels | None:
    """Return the samples repeated at `ambient_C` as a table [occasion, sample, time]; None if nothing was measured.

    Samples with a single run there are left out when others have more, and named in `left_out`. The grid is
    that of the shortest run (or `grid_s` [s] within it); runs on other times are interpolated linearly.
    """
    if quantity not in QUANTITIES:
        raise ValueError(f"quantity {quantity!r}: expected one of {', '.join(QUANTITIES)}")
    runs = [r for r in dataset.at(ambient_C) if np.sum(~np.isnan(getattr(r, quantity))) >= MIN_POINTS]
    counts = {s: sum(r.sample == s for r in runs) for s in dict.fromkeys(r.sample for r in runs)}
    samples = tuple(s for s, n in counts.items() if n > 1) or tuple(counts)
    used = [r for r in runs if r.sample in samples]
    if not used:
        return None
    spans = {id(r): r.time_s[~np.isnan(getattr(r, quantity))][[0, -1]] for r in used}
    shortest = min(used, key=lambda r: float(spans[id(r)][1]))
    begin, end = max(float(s[0]) for s in spans.values()), float(spans[id(shortest)][1])
    grid = shortest.time_s if grid_s is None else np.asarray(grid_s, dtype=float)
    grid = grid[(grid >= begin) & (grid <= end)]
    if not len(grid):
        return None
    occasions = tuple(sorted({r.run for r in used}))
    values = np.full((len(occasions), len(samples), len(grid)), math.nan)
    for run in used:
        y = getattr(run, quantity)
        known = ~np.isnan(y)
        where = (occasions.index(run.run), samples.index(run.sample))
        values[where] = np.interp(grid, run.time_s[known], y[known])
    longest = max(float(s[1]) for s in spans.values())
    uneven = f"runs end between {end:g} s and {longest:g} s; compared up to {end:g} s"
    notes = (uneven,) if longest > end else ()
    left_out = tuple(f"sample {s} (one run)" for s in counts if s not in samples)
    return Levels(ambient_C, quantity, samples, occasions, grid, values, left_out, notes)


def whole_minutes(dataset: DataSet, ambient_C: float, quantity: str = "voltage_V") -> Levels | None:
    """Return `levels` at the whole minutes when the runs were read more often than that, else as read."""
    table = levels(dataset, ambient_C, quantity)
    if table is None or len(table.time_s) < 2 or float(np.median(np.diff(table.time_s))) >= 60:
        return table
    first = math.ceil(float(table.time_s[0]) / 60)
    last = math.floor(float(table.time_s[-1]) / 60)
    minutes = np.array([60.0 * m for m in range(first, last + 1)])
    return levels(dataset, ambient_C, quantity, minutes) if len(minutes) >= MIN_POINTS else table
