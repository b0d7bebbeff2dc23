"""The uncertainty budget of a bias: model minus tests, row by row, as the gate uses it.

    expanded = t(ν)·u,  u² = u_A² + u_B²,  ν = (n-1)·u⁴/u_A⁴          (GUM G.4, Welch-Satterthwaite)

u_A is the scatter of the occasions (type A, n-1 degrees of freedom). u_B is what that scatter cannot show (type B, its
degrees of freedom taken as infinite): calibration, resolution, the instant of reading, and a drift over the runs, as
the next flight may be at either end of it. t is one-sided at 5 %, divided over the instants (Bonferroni). The guard
band of the instruments alone is 1.645·u_B.

With few occasions t(ν)·u has a fault: a small u_B lets ν grow so fast that t falls by more than u rises, so that a
larger uncertainty would turn into a pass. So the half width is never less than that of the scatter alone, t(n-1)·u_A.

Values that the data set does not state are assumed, never left at zero, and their rows say so. A person who reads at
the whole minute is late or early by up to `reading_time_s`: rectangular, u = a/√3. All readings may be late together,
so that it is not divided by √n; the part of it in the scatter is counted twice on purpose. An error of the ammeter has
no row, because the model is fitted with that ammeter and contains its error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from uavbatt.battery.model import Array
from uavbatt.dataset import Uncertainty
from uavbatt.validation.gating.heldout import HeldOut

LEVEL = 0.05  # of each of the two one-sided tests, as usual for equivalence
ONE_SIDED = float(stats.norm.ppf(1.0 - LEVEL))
# Assumed if a data set states nothing: the specification of a battery tester (a limit, so rectangular), a thermocouple,
# readings by hand with a watch.
ASSUMED_CALIBRATION = 0.001  # of the reading, ±
ASSUMED_TEMPERATURE_C = 0.5  # standard uncertainty; the limits of class 1 in IEC 60584 are ±0.5 °C (type T) or more
ASSUMED_READING_S = 5.0  # ±, a glance from the watch to the meter
HAND_READ_S = 30.0  # rows that are further apart were read by a person


@dataclass(frozen=True, slots=True)
class BudgetRow:
    """A BudgetRow is one source of uncertainty: standard uncertainty `u` per instant in the budget's unit, GUM type.

    `how` says in words how it was obtained.
    """

    source: str
    kind: Literal["A", "B"]
    u: Array
    how: str


@dataclass(frozen=True, slots=True)
class Budget:
    """Budget adds rows up to the uncertainty of a claim's bias at `at` (instants [s], voltages [V]); all in `unit`.

    `combined` is the standard uncertainty with `df` degrees of freedom, `factors` its coverage at each instant and
    `coverage` the largest of them, `expanded` the half width that the gate adds to the bias, `guard` 1.645·u_B.
    """

    unit: str
    at: Array
    rows: tuple[BudgetRow, ...]
    combined: Array
    df: Array
    factors: Array
    coverage: float
    guard: Array
    expanded: Array


def coverage_factor(df: Array | float, instants: int) -> Array:
    """Return the one-sided t factor at 5 %, shared out over the instants (Bonferroni), per instant."""
    return np.asarray(stats.t.ppf(1.0 - LEVEL / max(instants, 1), df), dtype=float)


class ExpandedUncertainty(NamedTuple):
    """ExpandedUncertainty holds standard uncertainty `u`, effective freedom `df` and half width `half`, by instant."""

    u: Array
    df: Array
    half: Array


def expand(u_A: Array, df_A: Array | float, u_B: Array, instants: int) -> ExpandedUncertainty:
    """Expand the combined type A and type B uncertainty of a bias to the half width of its one-sided 95 % interval.

    u_A and u_B are standard uncertainties per instant, in the unit of the bias; `df_A` the degrees of freedom of u_A.
    The half width grows with either: see the head of this file.
    """
    u = np.asarray(np.hypot(u_A, u_B))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        df = np.where(u_A > 0.0, np.asarray(df_A) * (u / u_A) ** 4, math.inf)
    return ExpandedUncertainty(
        u, df, np.maximum(coverage_factor(df, instants) * u, coverage_factor(df_A, instants) * u_A)
    )


def add_up(unit: str, at: Array, rows: list[BudgetRow], df_A: float) -> Budget:
    """Add the rows of a budget in squares; `df_A` are the degrees of freedom of the scatter."""

    def root(kind: str) -> Array:
        squares = [r.u**2 for r in rows if r.kind == kind]
        return np.sqrt(np.sum(squares, axis=0)) if squares else np.zeros(at.size)

    u, df, half = expand(root("A"), df_A, root("B"), at.size)
    k = np.divide(half, u, out=coverage_factor(df, at.size), where=u > 0.0)
    largest = float(k.max()) if k.size else math.nan
    return Budget(unit, at, tuple(rows), u, df, k, largest, ONE_SIDED * root("B"), half)


def scatter_rows(residual: Array) -> list[BudgetRow]:
    """Estimate the scatter of the mean, and the drift over the runs, of residuals [occasion, instant] in run order.

    Drift: d = mean of the earlier less the later half of the occasions, rectangular between its ends: |d|/2/√3.
    """
    n = residual.shape[0]
    half = n // 2
    d = np.abs(residual[:half].mean(axis=0) - residual[-half:].mean(axis=0))
    return [
        BudgetRow(
            "scatter of the occasions", "A", residual.std(axis=0, ddof=1) / math.sqrt(n), f"s/√n of {n} occasions"
        ),
        BudgetRow(
            "drift over the runs", "B", d / 2.0 / math.sqrt(3.0), f"first {half} against last {half}, rectangular"
        ),
    ]


def meter_rows(held_out: HeldOut, voltage_V: Array, instruments: Uncertainty) -> list[BudgetRow]:
    """Estimate the calibration and resolution rows [V] of the voltmeter at `voltage_V` [V]."""
    stated_V, step = instruments.voltage_calibration_V, instruments.voltage_resolution_V
    if stated_V is not None:
        calibration, how = np.full(voltage_V.size, stated_V), "stated by the data set"
    else:
        calibration = ASSUMED_CALIBRATION * np.abs(voltage_V) / math.sqrt(3.0)
        how = f"assumed ±{ASSUMED_CALIBRATION:.1%} of reading, rectangular: none stated"
    fine_V = held_out.step_V if step is None else step
    step_words = f"step of {fine_V:.3g} V{' seen in the readings' if step is None else ''}, rectangular"
    return [
        BudgetRow("calibration of the voltmeter", "B", calibration, how),
        BudgetRow("resolution of the voltmeter", "B", np.full(voltage_V.size, fine_V / math.sqrt(12.0)), step_words),
    ]


def reading_half_width_s(held_out: HeldOut, instruments: Uncertainty) -> tuple[float, str]:
    """Return (a, how): readings are off their instant by at most a [s], and where that figure comes from."""
    if instruments.reading_time_s is not None:
        return instruments.reading_time_s, f"stated ±{instruments.reading_time_s:g} s, rectangular"
    if held_out.row_s >= HAND_READ_S:
        return ASSUMED_READING_S, f"assumed ±{ASSUMED_READING_S:g} s, read by hand: none stated"
    return held_out.row_s / 2.0, f"half a row of {held_out.row_s:g} s, rectangular"


def loaded_slope(held_out: HeldOut) -> Array:
    """Return |dV/dt| of the mean test [V/s] by second-order differences, never across the start of the load."""
    mean_V = held_out.mean_V
    out = np.zeros(mean_V.size)
    load = ~held_out.at_rest
    if int(load.sum()) >= 3:
        out[load] = np.abs(np.gradient(mean_V[load], held_out.time_s[load], edge_order=2))
    return out


def voltage_budget(held_out: HeldOut, at: NDArray[np.intp], residual: Array, instruments: Uncertainty) -> Budget:
    """Build the budget of the voltage bias [V] at the instants with indices `at`; `residual` [occasion, instant]."""
    half_s, how = reading_half_width_s(held_out, instruments)
    mean_V = held_out.mean_V[at]
    moment = BudgetRow(
        "instant of reading", "B", loaded_slope(held_out)[at] * half_s / math.sqrt(3.0), f"{how}, times the slope"
    )
    rows = [*scatter_rows(residual), *meter_rows(held_out, mean_V, instruments), moment]
    return add_up("V", held_out.time_s[at], rows, len(residual) - 1.0)


def time_budget(
    held_out: HeldOut, levels_V: Array, residual_s: Array, slope_Vps: float, instruments: Uncertainty
) -> Budget:
    """Build the budget of the bias of a crossing time [s]; `slope_Vps` turns the voltmeter's rows into seconds."""
    half_s, how = reading_half_width_s(held_out, instruments)
    one = np.array([float(np.mean(levels_V))])
    divided = f"over {slope_Vps * 1e3:.3g} mV/s"
    meter = [
        BudgetRow(r.source, r.kind, r.u / slope_Vps, f"{r.how}; {divided}")
        for r in meter_rows(held_out, one, instruments)
    ]
    moment = BudgetRow("instant of reading", "B", np.array([half_s / math.sqrt(3.0)]), how)
    return add_up("s", one, [*scatter_rows(residual_s), *meter, moment], len(residual_s) - 1.0)


def surface_budget(at_s: Array, residual_K: Array, instruments: Uncertainty) -> Budget:
    """Build the budget of the bias of the surface temperature [K]."""
    stated_K = instruments.temperature_calibration_C
    u = ASSUMED_TEMPERATURE_C if stated_K is None else stated_K
    how = "stated by the data set" if stated_K is not None else f"assumed {u:g} K: none stated"
    rows = [*scatter_rows(residual_K), BudgetRow("calibration of the thermometer", "B", np.full(at_s.size, u), how)]
    if instruments.temperature_resolution_C is not None:
        fine = np.full(at_s.size, instruments.temperature_resolution_C / math.sqrt(12.0))
        step = f"{instruments.temperature_resolution_C:g} K step, rectangular"
        rows.append(BudgetRow("resolution of the thermometer", "B", fine, step))
    return add_up("K", at_s, rows, len(residual_K) - 1.0)
