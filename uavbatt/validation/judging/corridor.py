"""The corridor of permissible dispersion: mean of repeated tests with its limits, per instant or per voltage.

Three half-widths about one mean: the study's C = 2S, pointwise; the 95/95 tolerance band, pointwise; and the
simultaneous band that holds a new curve at all instants at once with 95 %. The spread is that of one new result
under intermediate precision (occasion and residual of the crossed model); with three samples or more the sample
part is added. In time at fixed voltage the same is done with crossing times, the natural axis of a flight.

Where a temperature was tested once, near repeats one degree apart stand in (`series.quasi_replicates`); where
there are none the mean is the single run and every width is NaN: not enough data.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from uavbatt.dataset import DataSet, Levels
from uavbatt.validation.iso5725.cells import LEAST_SAMPLES, Array
from uavbatt.validation.iso5725.intervals import satterthwaite
from uavbatt.validation.judging import bands
from uavbatt.validation.judging.chance import generator
from uavbatt.validation.judging.crossing import crossing_time
from uavbatt.validation.judging.readings import VOLTAGE, Readings
from uavbatt.validation.judging.series import QuasiReplicates

LEAST_OCCASIONS = 3  # two leave one degree of freedom, whose 95 % interval for the SD spans a factor of 70
NDBool = NDArray[np.bool_]
Basis = Literal["repeats", "quasi-replicates", "one run"]


@dataclass(frozen=True, slots=True)
class Corridor:
    """A corridor is a mean with its half-widths at `at` (instants [s] for values, voltages [V] for crossing times).

    `quantity` is voltage_V, surface_C or crossing_s and gives the unit of mean, s and widths. `S` is the plain SD
    of all results (equation 17); `s_r`, `s_occasion`, `s_sample` are the parts, `s` the SD of one new result.
    `n_effective` and `df` belong to the mean and to `s`. `covers_one`, `covers_all` are the probabilities that
    mean ± C holds a new curve at one instant and at all at once. NaN = not known.
    """

    ambient_C: float
    quantity: str
    at: Array
    mean: Array
    u_mean: Array
    S: Array
    s_r: Array
    s_occasion: Array
    s_sample: Array
    s: Array
    C: Array
    tolerance: Array
    simultaneous: Array
    n_effective: Array
    df: Array
    simultaneous_factor: float
    covers_one: float
    covers_all: float
    occasions: int
    samples: int
    basis: Basis
    status: Literal["ok", "not enough data"]
    notes: tuple[str, ...]

    def inside(self, values: Array, half_width: Array | None = None) -> NDBool:
        """Mark the `values` that lie within the mean ± `half_width` (default C)."""
        width = self.C if half_width is None else half_width
        within: NDBool = np.abs(values - self.mean) <= width + 1e-9
        return within


@dataclass(frozen=True, slots=True)
class SharedTable:
    """SharedTable holds `table[occasion, sample, level]` without gaps; `notes` name what was left out for that."""

    table: Array
    occasions: tuple[int, ...]
    samples: tuple[str, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class LeaveOneOut:
    """LeaveOneOut judges each occasion by the corridor of the others: `inside[occasion, sample]` at all instants.

    `share_all` is the share of whole curves that lie inside.
    """

    occasions: tuple[int, ...]
    samples: tuple[str, ...]
    inside: NDBool
    share_all: float


def shared_table(levels: Levels) -> SharedTable:
    """Cut repeated runs to the occasions that all samples share, and name what was left out to get there.

    A sample with less than half of the runs of the longest is left out rather than the occasions it lacks; samples
    that share no two occasions are put side by side in the order of their runs.
    """
    present: NDBool = np.asarray(~np.isnan(levels.values).any(axis=2))
    runs = [int(n) for n in present.sum(axis=0)]
    most = max(runs)
    columns = [j for j, n in enumerate(runs) if n >= max(min(2, most), most / 2)]
    names = tuple(levels.samples[j] for j in columns)
    dropped = [j for j in range(len(runs)) if j not in columns]
    notes = [f"sample {levels.samples[j]} left out: {runs[j]} of {most} occasions" for j in dropped]
    complete = np.flatnonzero(present[:, columns].all(axis=1))
    if len(complete) >= 2 or len(columns) == 1:
        missed = len(levels.occasions) - len(complete)
        notes += [f"{missed} occasions left out that not all samples share"] * bool(missed)
        occasions = tuple(levels.occasions[i] for i in complete)
        return SharedTable(levels.values[complete][:, columns], occasions, names, tuple(notes))
    tables = [levels.curves(j) for j in columns]
    n = min(len(t) for t in tables)
    notes.append("the samples share no occasions: their runs are taken in order")
    return SharedTable(np.stack([t[:n] for t in tables], axis=1), tuple(range(1, n + 1)), names, tuple(notes))


def occasion_means(levels: Levels) -> tuple[tuple[int, ...], Array]:
    """Return the occasions and their means over the samples [occasion, time], each sample at its own level.

    Samples with fewer runs count where they were tested: value = sample + occasion + error, by least squares. A mean
    of the occasions that all samples share would not see a drift in the others. If no two occasions are shared, the
    runs are taken in order, as in `shared_table`.
    """
    run, sample = np.nonzero(~np.isnan(levels.values).any(axis=2))
    shared = shared_table(levels)
    if set(shared.occasions) - set(levels.occasions) or len(run) == shared.table[:, :, 0].size:
        return shared.occasions, shared.table.mean(axis=1)
    tested = np.unique(run)
    design = np.column_stack([run[:, None] == tested, sample[:, None] == np.arange(len(levels.samples))]).astype(float)
    effects = np.linalg.lstsq(design, levels.values[run, sample], rcond=None)[0]
    means: Array = effects[: len(tested)] + effects[len(tested) :].mean(axis=0)
    return tuple(levels.occasions[i] for i in tested), means


def corridor(readings: Readings, ambient_C: float, quantity: str = VOLTAGE) -> Corridor | None:
    """Build the corridor at one ambient temperature [°C], at fixed times; None if `quantity` was not measured there."""
    levels = readings.levels(ambient_C, quantity)
    if levels is None:
        return None
    shared = shared_table(levels)
    table, notes = shared.table, levels.left_out + levels.notes + shared.notes
    if len(table) >= LEAST_OCCASIONS:
        return from_table(ambient_C, quantity, levels.time_s, table, notes)
    group = readings.near_repeats_at(ambient_C) if quantity == VOLTAGE else None
    if group is not None:
        return from_quasi_replicates(ambient_C, group, notes)
    return _unknown(ambient_C, quantity, levels.time_s, table, notes)


def corridors(readings: Readings, quantity: str = VOLTAGE) -> dict[float, Corridor]:
    """Build the corridor of every ambient temperature at which `quantity` was measured."""
    bands = ((t, corridor(readings, t, quantity)) for t in readings.dataset.ambients_C)
    return {t: c for t, c in bands if c is not None}


def crossing_levels(dataset: DataSet, levels: Levels) -> Array:
    """List the voltages [V] that every run falls through after the first reading: steps of 0.1 V for three cells."""
    step = round(0.1 * dataset.cells_series / 3, 2)
    curves = np.concatenate([levels.curves(j) for j in range(len(levels.samples))])
    if not len(curves):
        return np.array([])
    late = curves[:, 1:] if len(levels.time_s) > 2 else curves
    high, low = float(late[:, 0].min()), float(curves.min(axis=1).max())
    low = max(low, dataset.cutoff_V)
    return np.array([i * step for i in range(math.ceil(low / step + 1e-6), math.floor(high / step + 1e-6) + 1)])


def time_corridor(readings: Readings, ambient_C: float) -> Corridor | None:
    """Build the corridor of the first falls [s] through fixed voltages; None if every run crosses none of them."""
    levels = readings.levels(ambient_C)
    if levels is None:
        return None
    volts = crossing_levels(readings.tests, levels)
    if not len(volts):
        return None
    values = np.full((*levels.values.shape[:2], len(volts)), math.nan)
    for run in readings.tests.at(ambient_C):
        if run.sample in levels.samples and run.run in levels.occasions:
            cell = (levels.occasions.index(run.run), levels.samples.index(run.sample))
            values[cell] = [crossing_time(run.time_s, run.voltage_V, float(v)) for v in volts]
    timed = Levels(ambient_C, "crossing_s", levels.samples, levels.occasions, volts, values)
    shared = shared_table(timed)
    table, notes = shared.table, levels.left_out + shared.notes
    if len(table) >= LEAST_OCCASIONS:
        return from_table(ambient_C, "crossing_s", volts, table, notes)
    return _unknown(ambient_C, "crossing_s", volts, table, notes)


def from_table(ambient_C: float, quantity: str, at: Array, table: Array, notes: tuple[str, ...] = ()) -> Corridor:
    """Build the corridor from `table[occasion, sample, level]` of repeats, three occasions or more, at `at`.

    `at` holds the instants [s] (or voltages [V] for crossing times) of the levels; `quantity` gives the
    unit of the table.
    """
    o, k, levels = table.shape
    parts = bands.components(table)
    s = parts.sd
    s_r, s_o, s_s = (np.sqrt(np.maximum(np.diag(m), 0.0)) for m in (parts.residual, parts.occasion, parts.sample))
    if k == 1:
        s_r = np.full(levels, math.nan)
    u2 = s_o**2 / o + np.nan_to_num(s_r) ** 2 / (o * k) + (s_s**2 / k if parts.has_samples else 0.0)
    df = _effective_df(parts)
    n_eff = np.divide(s**2, u2, out=np.full(levels, float(o)), where=u2 > 0)
    by_model, by_plain = bands.new_curve_scores(parts)
    factor = bands.simultaneous_factor(by_model)
    tolerance = np.array([bands.tolerance_factor(n, d) for n, d in zip(n_eff, df, strict=True)])
    one, every = bands.coverage(by_plain, 2.0)
    flat = table - table[0, 0]
    S = flat.reshape(o * k, levels).std(axis=0, ddof=1)
    few = (f"{k} sample{'s' * (k > 1)}: the corridor says nothing of other packs",) if k < LEAST_SAMPLES else ()
    return Corridor(
        ambient_C, quantity, at, table[0, 0] + flat.mean(axis=(0, 1)), np.sqrt(u2), S, s_r, s_o, s_s, s,
        2 * S, tolerance * s, factor * s, n_eff, df, factor, one, every, o, k, "repeats", "ok", notes + few,
    )  # fmt: skip


def _effective_df(parts: bands.Components) -> Array:
    """Return the Satterthwaite degrees of freedom of s² per level."""
    o, k = parts.occasions, parts.samples
    if k == 1:
        return np.full(len(parts.occasion), o - 1.0)
    v_o, v_s, v_e = (np.maximum(np.diag(m), 0.0) for m in (parts.occasion, parts.sample, parts.residual))
    dfs = (o - 1.0, (o - 1.0) * (k - 1.0), k - 1.0)
    df = []
    for a, b, e in zip(v_o, v_s, v_e, strict=True):
        rest = 1 - 1 / k - (1 / o if parts.has_samples else 0.0)
        terms = [(k * a + e) / k, rest * e, (o * b + e) / o if parts.has_samples else 0.0]
        df.append(satterthwaite(terms, dfs) if sum(terms) > 0 else float(o - 1))
    return np.array(df)


def from_quasi_replicates(ambient_C: float, group: QuasiReplicates, notes: tuple[str, ...]) -> Corridor:
    """Build the corridor about a line in temperature through one-time curves one degree apart."""
    m, levels = group.residuals.shape
    covariance = group.residuals.T @ group.residuals / (m - 2)
    t = group.ambients_C - group.ambients_C.mean()
    design = np.column_stack([np.ones(m), t])
    hat = design @ np.linalg.pinv(design)
    at = np.array([1.0, ambient_C - float(group.ambients_C.mean())]) @ np.linalg.pinv(design)
    root = np.linalg.eigh(covariance)
    rng = generator()
    half = root.eigenvectors * np.sqrt(np.maximum(root.eigenvalues, 0.0))
    y = rng.standard_normal((bands.DRAWS, m, levels)) @ half.T
    sd = np.sqrt(((y - hat @ y) ** 2).sum(axis=1) / (m - 2))
    scores = np.abs(rng.standard_normal((bands.DRAWS, levels)) @ half.T - at @ y) / np.where(sd > 0, sd, np.inf)
    factor = bands.simultaneous_factor(scores)
    one, every = bands.coverage(scores, 2.0)
    n_eff = np.full(levels, 1 / group.leverage(ambient_C))
    tolerance = np.array([bands.tolerance_factor(n, d) for n, d in zip(n_eff, group.df, strict=True)])
    s, unknown = group.sd, np.full(levels, math.nan)
    low, high = float(np.min(group.ambients_C)), float(np.max(group.ambients_C))
    source = f"scatter of {m} one-time curves about a line from {low:g} to {high:g} °C, one series of one pack"
    remarks = (source, *(f"left out: {reading}" for reading in group.left_out))
    return Corridor(
        ambient_C, "voltage_V", group.time_s, group.line(ambient_C), s / np.sqrt(n_eff), s, unknown, unknown, unknown,
        s, 2 * s, tolerance * s, factor * s, n_eff, group.df, factor, one, every, m, 1, "quasi-replicates", "ok",
        notes + remarks,
    )  # fmt: skip


def _unknown(ambient_C: float, quantity: str, at: Array, table: Array, notes: tuple[str, ...]) -> Corridor:
    nan, mean = np.full(len(at), math.nan), np.full(len(at), math.nan) if table.size == 0 else table.mean(axis=(0, 1))
    runs = f"{len(table)} run{'s' * (len(table) != 1)}"
    remarks = (f"{runs} at {ambient_C:g} °C: a corridor needs {LEAST_OCCASIONS} repeats",)
    return Corridor(
        ambient_C, quantity, at, mean, nan, nan, nan, nan, nan, nan, nan, nan, nan, nan, nan, math.nan, math.nan,
        math.nan, len(table), table.shape[1], "one run", "not enough data", notes + remarks,
    )  # fmt: skip


def leave_one_out(levels: Levels) -> LeaveOneOut | None:
    """Judge each occasion by mean ± 2S of all the others; None with fewer than four shared occasions."""
    shared = shared_table(levels)
    table = shared.table
    o, k, size = table.shape
    if o < LEAST_OCCASIONS + 1:
        return None
    inside = np.empty((o, k, size), dtype=bool)
    for i in range(o):
        rest = np.delete(table, i, axis=0).reshape(-1, size) - table[0, 0]
        gap = np.abs(table[i] - table[0, 0] - rest.mean(axis=0))
        inside[i] = gap <= 2 * rest.std(axis=0, ddof=1) + 1e-9
    every: NDBool = np.asarray(inside.all(axis=2))
    return LeaveOneOut(shared.occasions, shared.samples, every, float(every.mean()))
