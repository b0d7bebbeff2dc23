"""The end of each sample of a forecast, compiled: the twin of `prediction.time_to_end`, equal to it to rounding.

The model's functions are those of `battery`; the walk along the steps stands here a second time, sample by sample, so
that each stops at its own end.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uavbatt.battery import model
from uavbatt.battery import state_space as b
from uavbatt.battery.equations import SECONDS_PER_HOUR
from uavbatt.battery.model import Array
from uavbatt.battery.pack import metered_voltage, series_resistance, weak_lag
from uavbatt.battery.state_space import X
from uavbatt.compiled.jit import as_numbers, compiled
from uavbatt.prediction import sampling
from uavbatt.prediction.batch import Question
from uavbatt.prediction.time_to_end import MEAN_LAG_S, SOC_IN_CELL_V, EndTimes, Flying, Normals, counted


def answers(questions: Sequence[Question]) -> list[EndTimes]:
    """Simulate the forecasts of a window, as `prediction.batch.answers` does; returns the end of each draw."""
    return [compiled_end_times(question.flying) for question in questions]


def compiled_end_times(flying: Flying) -> EndTimes:
    """Simulate one forecast; returns the end of each of its draws."""
    drawn = sampling.wander(flying.dt_s.size, flying.by_rows)
    return counted(EndTimes(*time_to_end(as_numbers(flying), drawn, sampling.least_soc(flying))))


@compiled
def time_to_end(flying: Flying, wander: Normals, least_soc: Array) -> tuple[Array, Array]:
    """Return the end of flight and the low-voltage warning [s] of each draw; inf beyond the horizon."""
    batch = flying.x.shape[1]
    end_s, low_s, gained_V2 = np.empty(batch), np.empty(batch), b.bias_variance(flying.pack, flying.dt_s)
    for j in range(batch):
        end_s[j], low_s[j] = time_to_end_one(flying, wander, least_soc[j], gained_V2, j)
    return end_s, low_s


@compiled
def time_to_end_one(flying: Flying, wander: Normals, least_soc: float, gained_V2: Array, j: int) -> tuple[float, float]:
    """Return the end of flight and the low-voltage warning [s] of draw `j`; inf beyond the horizon.

    least_soc : the charge below which it ends; gained_V2 : the variance [V²] that the discrepancy gains in each step.
    """
    pack, x, power_W, dt_s = flying.pack, flying.x[:, j], flying.power_W[:, j], flying.dt_s
    by_rows = flying.by_rows
    cell, installation, state = b.unpack(pack, x)
    present_Ah, cells = installation.present_capacity_Ah, installation.cells
    size, lags, lags_s = cells * present_Ah, model.lags(cell, dt_s[0]), dt_s[0]
    bias_V, before, at_s, end_s, low_s = x[X.BIAS], 0.0, 0.0, np.inf, np.inf
    last_end, last_low, below_end, below_low = 0.0, 0.0, 0, 0
    for k in range(dt_s.size):
        emf_V, r_ohmAh = model.source(cell, state)
        series_ohmAh, emf_V = series_resistance(installation, r_ohmAh), emf_V + bias_V
        under = model.under_power(cell, emf_V, series_ohmAh, power_W[k] / size)
        rate, cell_V = under.c_rate, model.voltage_under(emf_V, series_ohmAh, under)
        strong_V = cell_V - bias_V + rate * (series_ohmAh - r_ohmAh)
        cell_V += weak_lag(installation, cell, state, rate, strong_V)
        volts = metered_voltage(installation, cells * cell_V)
        if by_rows and k > 0:
            volts += cells * pack.row_share * abs(rate - before) * series_ohmAh * wander.row[k, j]
        before = rate
        margin = min(volts - pack.cutoff_V, (state.soc - least_soc) * SOC_IN_CELL_V * cells)
        above_low = volts - pack.low_V
        earlier_s = at_s - dt_s[k - 1] if k > 0 else 0.0
        end_s, below_end = fallen(by_rows, k, end_s, below_end, last_end, margin, earlier_s, at_s)
        low_s, below_low = fallen(by_rows, k, low_s, below_low, last_low, above_low, earlier_s, at_s)
        if end_s < np.inf:
            break
        last_end, last_low = margin, above_low
        if by_rows:
            mean_W = 0.5 * (power_W[k] + power_W[min(k + 1, dt_s.size - 1)])
            under = model.under_power(cell, emf_V, series_ohmAh, mean_W / size)
        if dt_s[k] != lags_s:
            lags, lags_s = model.lags(cell, dt_s[k]), dt_s[k]
        doubt_V2 = b.ocv_doubt(pack, state.soc, under.c_rate * (dt_s[k] / SECONDS_PER_HOUR))
        state = model.step_cell(cell, state, under, r_ohmAh, flying.ambient_C, dt_s[k], lags)
        bias_V += np.sqrt(gained_V2[k] + doubt_V2) * wander.bias[k, j]
        at_s += dt_s[k]
    return end_s, min(low_s, end_s)


@compiled
def crossing(k: int, above: float, under: float, earlier_s: float, at_s: float) -> float:
    """Return the instant [s] at which the fall from `above` to `under` passed zero (`time_to_end._mean_crossing`)."""
    return earlier_s + above / (above - under) * (at_s - earlier_s) + MEAN_LAG_S if k > 0 else 0.0


@compiled
def fallen(
    by_rows: bool, k: int, known_s: float, below: int, last: float, margin: float, earlier_s: float, at_s: float
) -> tuple[float, int]:
    """Return the instant [s] at which a margin has fallen below zero, inf before, and its last three rows as bits.

    known_s, below : the two before step `k`; last, margin : the margin at the step before and at this one, which
    begin at `earlier_s` and `at_s` [s]. By rows the centred median of three decides.
    """
    if not by_rows:
        is_new = known_s == np.inf and margin < 0.0
        return (crossing(k, last, margin, earlier_s, at_s) if is_new else known_s), below
    below = (2 * below + (margin < 0.0)) % 8
    is_new = known_s == np.inf and k > 1 and below in (3, 5, 6, 7)  # two of the three are below zero
    return (earlier_s if is_new else known_s), below
