"""Intermediate precision, ISO 5725-3: fully nested, staggered nested, crossed Sample + Occasion.

The crossed model is ours, for tests that several samples share (side by side in one chamber on one day):

    y = m + Sample + Occasion + e;   s_r² = e;   s_I² = Occasion + e;   s_R² = Sample + Occasion + e

Negative components are set to 0 and named. Intervals are 95 %: Graybill-Wang for sums, chi-square for one mean
square. Reproducibility needs three samples or more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from uavbatt.errors import NotEnoughData
from uavbatt.validation.iso5725.cells import LEAST_SAMPLES, Array, BadCells
from uavbatt.validation.iso5725.intervals import UNKNOWN, Interval, satterthwaite, sd_interval, sum_interval


@dataclass(frozen=True, slots=True)
class Nested:
    """Nested holds the spread of a nested design: laboratory (0), nested factor (1) and repeatability (r).

    The SDs are in the unit of the results.
    s_I² = s_r² + s_1², s_R² = s_I² + s_0²; `raw` are the variances s_0², s_1², s_r² before 0 replaces negatives.
    """

    mean: float
    mean_squares: tuple[float, float, float]
    dfs: tuple[float, float, float]
    raw: tuple[float, float, float]
    s_0: float
    s_1: float
    s_r: float
    s_I: float
    s_R: float
    df_total: float
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Crossed:
    """Crossed holds the Sample + Occasion model fitted at one level, in the unit of the results.

    Mean squares in the order occasion, sample, residual. `u_mean` is the standard uncertainty of the mean over
    these samples with `occasions - 1` degrees of freedom (intermediate precision: no sample part). With one sample
    the residual cannot be told from the occasion: s_r is NaN and s_I holds both.
    """

    mean: float
    occasions: int
    samples: int
    mean_squares: tuple[float, float, float]
    s_r: float
    s_occasion: float
    s_sample: float
    s_I: float
    s_R: float
    s_r_interval: Interval
    s_I_interval: Interval
    s_R_interval: Interval
    p_occasion: float
    p_sample: float
    u_mean: float
    reproducibility: Literal["ok", "not enough data"]
    notes: tuple[str, ...]


def _table(values: ArrayLike, shape: str, *sizes: int | None) -> tuple[Array, float]:
    """Return the table less its first value, and that value."""
    try:
        table = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise BadCells(f"expected a full table {shape} of numbers") from None
    fits = table.ndim == len(sizes) and all(s is None or s == t for s, t in zip(sizes, table.shape, strict=True))
    if not fits or table.size == 0 or not np.all(np.isfinite(table)):
        raise BadCells(f"expected a full table {shape} of finite numbers, found shape {table.shape}")
    reference = float(table.flat[0])
    return table - reference, reference


def nested(results: ArrayLike) -> Nested:
    """Split the spread of a fully nested design, `results[laboratory, setting, repeat]`, into its components.

    ISO 5725-3 has two settings and two repeats.
    MSe within settings, MS1 between settings of a laboratory, MS0 between laboratories;
    s_1² = (MS1-MSe)/n, s_0² = (MS0-MS1)/(an). Raises BadCells for a table with gaps, NotEnoughData below two of each.
    """
    y, reference = _table(results, "laboratory x setting x repeat", None, None, None)
    p, a, n = y.shape
    if min(p, a, n) < 2:
        raise NotEnoughData("a nested design needs two laboratories, settings and repeats or more")
    settings = y.mean(axis=2)
    labs = settings.mean(axis=1)
    ms_e = float(((y - settings[:, :, None]) ** 2).sum()) / (p * a * (n - 1))
    ms_1 = n * float(((settings - labs[:, None]) ** 2).sum()) / (p * (a - 1))
    ms_0 = a * n * float(((labs - labs.mean()) ** 2).sum()) / (p - 1)
    raw = ((ms_0 - ms_1) / (a * n), (ms_1 - ms_e) / n, ms_e)
    weights = (1 / (a * n), 1 / n - 1 / (a * n), 1 - 1 / n)
    dfs = (p - 1.0, p * (a - 1.0), p * a * (n - 1.0))
    return _nested(reference + float(labs.mean()), (ms_0, ms_1, ms_e), dfs, raw, weights)


def staggered(results: ArrayLike) -> Nested:
    """Split the spread of a staggered nested design, `results[laboratory, 3]`, into its components (ISO 5725-3).

    y_1 and y_2 are taken under repeatability, y_3 in the other setting.
    w_1 = |y_1-y_2|, w_2 = |(y_1+y_2)/2 - y_3|; MSe = Σw_1²/(2p), MS1 = 2Σw_2²/(3p), MS0 = 3Σ(ȳ_i-ȳ)²/(p-1);
    s_1² = ¾(MS1-MSe), s_0² = MS0/3 - 5MS1/12 + MSe/12.
    Raises BadCells for a table with gaps, NotEnoughData below two laboratories.
    """
    y, reference = _table(results, "laboratory x 3", None, 3)
    p, labs = len(y), y.mean(axis=1)
    if p < 2:
        raise NotEnoughData("a staggered nested design needs two laboratories or more")
    ms_e = float(((y[:, 0] - y[:, 1]) ** 2).sum()) / (2 * p)
    ms_1 = 2 * float(((y[:, :2].mean(axis=1) - y[:, 2]) ** 2).sum()) / (3 * p)
    ms_0 = 3 * float(((labs - labs.mean()) ** 2).sum()) / (p - 1)
    raw = (ms_0 / 3 - 5 * ms_1 / 12 + ms_e / 12, 0.75 * (ms_1 - ms_e), ms_e)
    weights = (1 / 3, 3 / 4 - 5 / 12, 1 - 3 / 4 + 1 / 12)
    return _nested(reference + float(labs.mean()), (ms_0, ms_1, ms_e), (p - 1.0, float(p), float(p)), raw, weights)


def _nested(
    mean: float,
    mean_squares: tuple[float, float, float],
    dfs: tuple[float, float, float],
    raw: tuple[float, float, float],
    weights: tuple[float, float, float],
) -> Nested:
    v0, v1, vr = (max(v, 0.0) for v in raw)
    names = ("between laboratories", "of the nested factor", "of repeatability")
    notes = tuple(f"variance {w} negative ({v:.3g}), set to 0" for w, v in zip(names, raw, strict=True) if v < 0)
    parts = [w * ms for w, ms in zip(weights, mean_squares, strict=True)]
    sds = (math.sqrt(v0), math.sqrt(v1), math.sqrt(vr), math.sqrt(vr + v1), math.sqrt(vr + v1 + v0))
    return Nested(mean, mean_squares, dfs, raw, *sds, satterthwaite(parts, dfs), notes)


def crossed(table: ArrayLike) -> Crossed:
    """Fit the crossed model to `table[occasion, sample]`; occasions with a gap (NaN) are left out, with a note.

    Raises BadCells for what is no such table, NotEnoughData below two occasions that all samples share.
    """
    try:
        y = np.asarray(table, dtype=np.float64)
    except (TypeError, ValueError):
        raise BadCells("expected a table occasion x sample of numbers, NaN for a gap") from None
    if y.ndim != 2 or y.size == 0 or np.isinf(y).any():
        raise BadCells(f"expected a table occasion x sample, found shape {y.shape}")
    complete = ~np.isnan(y).any(axis=1)
    notes = [f"{int((~complete).sum())} occasions that not all samples share left out"] if not complete.all() else []
    y = y[complete]
    occasions, samples = y.shape
    if occasions < 2:
        raise NotEnoughData("intermediate precision needs two occasions or more that all samples share")
    mean, ms = _crossed_mean_squares(y)
    raw = ((ms[0] - ms[2]) / samples, (ms[1] - ms[2]) / occasions, ms[2])
    raw = (ms[0], math.nan, math.nan) if samples == 1 else _without_dust(raw, ms[2])
    names = ("occasion", "sample", "residual")
    notes += [f"{w} variance negative ({v:.3g}), set to 0" for w, v in zip(names, raw, strict=True) if v < 0]
    if samples < LEAST_SAMPLES:
        notes.append(f"{samples} sample{'s' * (samples > 1)}: too few to speak of reproducibility")
    return _crossed(mean, (occasions, samples), ms, raw, tuple(notes))


def _without_dust(raw: tuple[float, float, float], ms_e: float) -> tuple[float, float, float]:
    """Return differences of equal mean squares as 0, not as -1e-21."""
    a, b, e = (0.0 if abs(v) < 1e-9 * ms_e else v for v in raw)
    return a, b, e


def _crossed_mean_squares(y: Array) -> tuple[float, tuple[float, float, float]]:
    """Return mean and mean squares of occasion, sample, residual (NaN if there are no degrees of freedom)."""
    o, k = y.shape
    d = y - y[0, 0]
    rows, columns, grand = d.mean(axis=1), d.mean(axis=0), float(d.mean())
    ms_o = k * float(((rows - grand) ** 2).sum()) / (o - 1)
    if k == 1:
        return float(y[0, 0]) + grand, (ms_o, math.nan, math.nan)
    ms_s = o * float(((columns - grand) ** 2).sum()) / (k - 1)
    ms_e = float(((d - rows[:, None] - columns + grand) ** 2).sum()) / ((o - 1) * (k - 1))
    return float(y[0, 0]) + grand, (ms_o, ms_s, ms_e)


def _crossed(
    mean: float,
    size: tuple[int, int],
    ms: tuple[float, float, float],
    raw: tuple[float, float, float],
    notes: tuple[str, ...],
) -> Crossed:
    (o, k), (ms_o, ms_s, ms_e) = size, ms
    dfs = (o - 1.0, k - 1.0, (o - 1.0) * (k - 1.0))
    v_o, v_s, v_e = (max(v, 0.0) for v in raw)  # max keeps NaN in the first place
    alone = k == 1
    s_I = math.sqrt(v_o) if alone else math.sqrt(v_o + v_e)
    i_I = sd_interval(s_I, dfs[0]) if alone else sum_interval((ms_o, ms_e), (1 / k, 1 - 1 / k), (dfs[0], dfs[2]))
    i_R = UNKNOWN if alone else sum_interval(ms, (1 / k, 1 / o, 1 - 1 / k - 1 / o), dfs)
    ratio = [x / ms_e if not alone and ms_e > 0 else math.nan for x in (ms_o, ms_s)]
    p_values = [float(stats.f.sf(F, df, dfs[2])) if F == F else math.nan for F, df in zip(ratio, dfs[:2], strict=True)]
    return Crossed(
        mean, o, k, ms, s_r=math.sqrt(v_e), s_occasion=math.nan if alone else math.sqrt(v_o), s_sample=math.sqrt(v_s),
        s_I=s_I, s_R=math.sqrt(v_o + v_s + v_e),
        s_r_interval=UNKNOWN if alone else sd_interval(math.sqrt(ms_e), dfs[2]), s_I_interval=i_I, s_R_interval=i_R,
        p_occasion=p_values[0], p_sample=p_values[1], u_mean=math.sqrt((v_o if alone else v_o + v_e / k) / o),
        reproducibility="ok" if k >= LEAST_SAMPLES else "not enough data", notes=notes,
    )  # fmt: skip
