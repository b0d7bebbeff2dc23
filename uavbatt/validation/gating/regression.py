"""The regression model: voltage against time and ambient temperature, without a circuit behind it.

    s      = t/t_k(T),  t_k(T) = t_0·exp(c₁θ + c₂θ²),  θ = (T - 25 °C)/25 K          time in units of the knee
    p(t,T) = p₀ + p₁θ + p₂θ² + a·exp(-t/τ) - q₁s - q₂s²                              plateau
    V(t,T) = f + h·ln(1 + exp((p - d·w·ln(1 + exp((s-1)/w)) - f)/h))                 knee, then the limiter's floor

t counts from the start of the load; before it the voltage is e₀. The model contains neither current nor heat: it holds
for the load of the tests only. It is compared with the circuit model on the same held-out occasions, and does not ship.
One-time curves of other series than the repeats have a level and a knee time of their own, so that a step between
series does not look like an effect of temperature. The breaks between the series are found from all tests.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from uavbatt.battery.equations import REFERENCE_TEMP_C
from uavbatt.battery.model import Array
from uavbatt.dataset import Levels, Run
from uavbatt.validation.gating.heldout import Curve, HeldOut, HeldOutRun, other_runs, repeats, rest_at, smallest_step
from uavbatt.validation.judging import fast_records
from uavbatt.validation.judging.readings import Readings

READING_SD_V, TIMING_SD_S = 0.02, 6.0  # a voltmeter read by hand, at a time taken from a watch
FLOOR_WIDTH_V = 0.02  # a cell
STEP_K = 25.0  # of theta: the study's ambient temperatures lie about so far apart
SAME_AMBIENT_K = 0.25  # chambers are set to half a degree
# A series of tests differs from another by its level [V a cell] and by ln of its knee time: sds of both.
SERIES_LEVEL_SD_V, SERIES_KNEE_SD = 0.1, 0.2
ROBUST_SDS = 3.0  # a residual beyond counts less than its square
EVALUATIONS, CLOSE_ENOUGH = 60, 1e-5  # of the fit, at most; relative change of the cost at which it ends
NAMES = ("p0", "p1", "p2", "a", "ln_tau", "q1", "q2", "ln_t0", "c1", "c2", "d", "ln_w", "f", "e0")


@dataclass(frozen=True, slots=True)
class RunTable:
    """RunTable holds the readings of many runs in one table, one a row.

    Time under load [s] (negative at rest), ambient temperature [°C], voltage [V], series and reading SD `sigma_V` [V].
    """

    time_s: Array
    ambient_C: Array
    voltage_V: Array
    series: NDArray[np.intp]
    sigma_V: Array


@dataclass(frozen=True, slots=True)
class Regression:
    """Regression holds fitted coefficients in the order of NAMES, and per series (level [V], ln of knee time)."""

    coefficients: Array
    series: Array
    cells: int

    def voltage(self, time_s: Array, ambient_C: Array, series: NDArray[np.intp] | int = 0) -> Array:
        """Return the pack voltage [V] at `time_s` [s] under load; negative times are before the load."""
        nuisance = np.vstack([np.zeros((1, 2)), self.series])[series]
        return curve(self.coefficients, time_s, ambient_C, nuisance[..., 0], nuisance[..., 1], self.cells)


def curve(x: Array, time_s: Array, ambient_C: Array, level_V: Array, ln_knee: Array, cells: int) -> Array:
    """Compute V(t, T) [V] of the coefficients x by the equations of the module; times [s], temperatures [°C]."""
    p0, p1, p2, a, ln_tau, q1, q2, ln_t0, c1, c2, d, ln_w, f, e0 = x
    theta, w, h = (ambient_C - REFERENCE_TEMP_C) / STEP_K, math.exp(ln_w), FLOOR_WIDTH_V * cells
    t = np.maximum(time_s, 0.0)
    s = t / np.exp(ln_t0 + ln_knee + c1 * theta + c2 * theta**2)
    plateau = p0 + level_V + p1 * theta + p2 * theta**2 + a * np.exp(-t / math.exp(ln_tau)) - q1 * s - q2 * s**2
    free = plateau - d * w * np.logaddexp(0.0, (s - 1.0) / w)
    out: Array = np.where(time_s < 0.0, e0, f + h * np.logaddexp(0.0, (free - f) / h))
    return out


def load_start_s(run: Run) -> float:
    """Return when the load begins [s]: by the measured current, else just after the first reading."""
    phase = fast_records.phases(run.current_A)
    rested = phase[-1] > 0 and run.current_A[0] < fast_records.rest_limit_A(run.current_A)
    return float(run.time_s[np.argmax(phase > 0)]) if rested else float(run.time_s[0]) + 1e-6


def rows_of(runs: list[Run], starts_s: list[float], series: list[int]) -> RunTable:
    """Put the readings of runs into one table."""
    slopes = [np.abs(np.gradient(r.voltage_V, r.time_s)) for r in runs]
    early = [np.where(r.time_s <= t, 0.0, s) for r, t, s in zip(runs, starts_s, slopes, strict=True)]
    return RunTable(
        time_s=np.concatenate([r.time_s - t for r, t in zip(runs, starts_s, strict=True)]),
        ambient_C=np.concatenate([np.full(r.time_s.size, r.ambient_C) for r in runs]),
        voltage_V=np.concatenate([r.voltage_V for r in runs]),
        series=np.concatenate([np.full(r.time_s.size, k) for r, k in zip(runs, series, strict=True)]).astype(np.intp),
        sigma_V=np.hypot(READING_SD_V, TIMING_SD_S * np.concatenate(early)),
    )


def guess(rows: RunTable, cells: int) -> tuple[Array, Array]:
    """Return (start, prior sd) of the coefficients from the readings at 25 °C or nearest to it."""
    distance_C = np.abs(rows.ambient_C - REFERENCE_TEMP_C)
    near = distance_C <= np.min(distance_C) + SAME_AMBIENT_K
    load = near & (rows.time_s >= 0.0)
    first, last = float(np.max(rows.voltage_V[load])), float(np.min(rows.voltage_V[load]))
    end_s = float(np.max(rows.time_s[load]))
    rest = rows.voltage_V[rows.time_s < 0.0]
    e0 = float(np.mean(rest)) if rest.size else first
    # Sizes of the study's 3S curves, and sds so wide that they only keep a coefficient finite that nothing shows.
    c = cells / 3.0
    prior = {
        "p0": (first, 1.0 * c),
        "p1": (0.0, 0.5 * c),
        "p2": (0.0, 0.3 * c),
        "a": (0.2 * c, 0.4 * c),
        "ln_tau": (math.log(60.0), 0.7),
        "q1": (0.5 * c, 1.0 * c),
        "q2": (0.2 * c, 1.0 * c),
        "ln_t0": (math.log(0.8 * end_s), 0.3),
        "c1": (0.0, 0.3),
        "c2": (0.0, 0.2),
        "d": (6.0 * c, 4.0 * c),
        "ln_w": (math.log(0.05), 0.7),
        "f": (last, 0.05 * c),
        "e0": (e0, 0.1 * c),
    }
    start, sd = zip(*(prior[name] for name in NAMES), strict=True)
    return np.array(start), np.array(sd)


def fit_regression(rows: RunTable, cells: int) -> Regression:
    """Fit the most probable coefficients under wide priors; outliers beyond ROBUST_SDS count less."""
    start, sd = guess(rows, cells)
    others, n = int(np.max(rows.series)), len(NAMES)
    spread = np.concatenate([sd, np.tile([SERIES_LEVEL_SD_V * cells, SERIES_KNEE_SD], others)])

    def unpacked(u: Array) -> Regression:
        x = spread * u
        return Regression(start + x[:n], x[n:].reshape(-1, 2), cells)

    def objective(u: Array) -> Array:
        misfit = (unpacked(u).voltage(rows.time_s, rows.ambient_C, rows.series) - rows.voltage_V) / rows.sigma_V
        return np.concatenate([misfit, u])

    solution = least_squares(
        *(objective, np.zeros(spread.size)),
        loss="soft_l1",
        f_scale=ROBUST_SDS,
        max_nfev=EVALUATIONS,
        ftol=CLOSE_ENOUGH,
    )
    return unpacked(np.asarray(solution.x))


def series_of(readings: Readings, levels: Levels) -> Callable[[Run], int]:
    """Return a function that gives the number of a run's series.

    0 stands for the repeated samples, 1, 2, ... for the one-time runs between breaks, ascending in temperature.
    """
    edges = sorted(b.high_C for b in readings.broken or ())
    return lambda run: 0 if run.sample in levels.samples else 1 + int(np.searchsorted(edges, run.ambient_C, "right"))


def held_out(readings: Readings) -> HeldOut:
    """Predict each occasion, and its share of the one-time runs, by a regression fitted to the others."""
    dataset, levels = readings.dataset, repeats(readings)
    number, others = series_of(readings, levels), other_runs(readings.tests, levels)
    home = [r for r in readings.tests.at(levels.ambient_C) if r.sample in levels.samples]
    volts, curves, singles = np.full(levels.values.shape, np.nan), list[Curve](), list[HeldOutRun]()
    for k, occasion in enumerate(levels.occasions):
        out = others[k :: len(levels.occasions)]
        training = [r for r in home if r.run != occasion] + [r for r in others if r not in out]
        series = [number(r) for r in training]
        starts_s = [load_start_s(r) for r in training]
        fit = fit_regression(rows_of(training, starts_s, _consecutive(series)), dataset.cells_series)
        for run in dataset.at(levels.ambient_C):
            if run.sample in levels.samples and run.run == occasion:
                at = levels.samples.index(run.sample)
                volts[k, at] = _voltage(fit, run, levels.time_s)
                if fast_records.is_fast(run):
                    curves.append(_curve(fit, run, k, at))
        known = sorted({0, *series})
        for run in out:
            block = known.index(number(run)) if number(run) in known else 0
            model_V = _voltage(fit, run, run.time_s, block)
            singles.append(HeldOutRun(run.ambient_C, run.sample, run.time_s, run.voltage_V, model_V))
    runs = dataset.at(levels.ambient_C)
    return HeldOut(
        model="regression", ambient_C=levels.ambient_C, cells=dataset.cells_series, time_s=levels.time_s,
        measured_V=levels.values, model_V=volts, row_s=float(np.median(np.diff(runs[0].time_s))),
        step_V=smallest_step(runs), rest=rest_at(dataset, levels), curves=tuple(curves), singles=tuple(singles),
    )  # fmt: skip


def _voltage(fit: Regression, run: Run, time_s: Array, series: int = 0) -> Array:
    """Return the voltage [V] of a run at `time_s` [s] of its record, as a run of this series in the fit."""
    return fit.voltage(time_s - load_start_s(run), np.full(time_s.size, run.ambient_C), series)


def _consecutive(series: list[int]) -> list[int]:
    """Return the numbers of the series, counted without gaps: 0, which is always there, then the others in order."""
    order = sorted({0, *series})
    return [order.index(s) for s in series]


def _curve(fit: Regression, run: Run, occasion: int, sample: int) -> Curve:
    """Return a fast record and its prediction, both smoothed; `occasion` and `sample` are their places in the table."""
    own = fast_records.weights(run.time_s, fast_records.phases(run.current_A), run.time_s)
    return Curve(occasion, sample, run.time_s, own @ run.voltage_V, own @ _voltage(fit, run, run.time_s))
