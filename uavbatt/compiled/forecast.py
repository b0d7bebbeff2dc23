"""The end of each sample of a forecast, compiled: the twin of `prediction.time_to_end`, equal to it to rounding.

The model's functions are those of `battery`; the walk along the steps stands here a second time, sample by sample, so
that each stops at its own end.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from uavbatt.battery import model
from uavbatt.battery import state_space as b
from uavbatt.battery.equations import SECONDS_PER_HOUR
from uavbatt.battery.model import Array
from uavbatt.battery.pack import metered_voltage, series_resistance, weak_lag
from uavbatt.battery.spreads import ROW_SHARE
from uavbatt.battery.state_space import X
from uavbatt.compiled.jit import as_numbers, compiled, compiled_numbers
from uavbatt.prediction.batch import Question
from uavbatt.prediction.simulation import sampling
from uavbatt.prediction.simulation.draws import Flying
from uavbatt.prediction.simulation.sampling import Normals
from uavbatt.prediction.simulation.time_to_end import MEAN_LAG_S, SOC_IN_CELL_V, EndTimes, counted


class MarginFall(NamedTuple):
    """MarginFall follows one margin over the steps of a draw.

    at_s : when it has fallen below zero [s], inf before; last : its value at the last step; below : bits of its last
    three rows, set where it was below zero.
    """

    at_s: float
    last: float
    below: int


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


@compiled_numbers
def time_to_end_one(flying: Flying, wander: Normals, least_soc: float, gained_V2: Array, j: int) -> tuple[float, float]:
    """Return the end of flight and the low-voltage warning [s] of draw `j`; inf beyond the horizon.

    least_soc : the charge below which it ends; gained_V2 : the variance [V²] that the discrepancy gains in each step.
    """
    pack, power_W, dt_s, by_rows = flying.pack, flying.power_W[:, j], flying.dt_s, flying.by_rows
    cell, installation, state = b.unpack(pack, flying.x[:, j])
    cells, size = installation.cells, installation.cells * installation.present_capacity_Ah
    lags, lags_s = model.lags(cell, dt_s[0]), dt_s[0]
    bias_V, before, at_s = flying.x[X.BIAS, j], 0.0, 0.0
    end, low = MarginFall(np.inf, 0.0, 0), MarginFall(np.inf, 0.0, 0)
    for k in range(dt_s.size):
        emf_V, r_ohmAh = model.source(cell, state)
        series_ohmAh, emf_V = series_resistance(installation, r_ohmAh), emf_V + bias_V
        under = model.under_power(cell, emf_V, series_ohmAh, power_W[k] / size)
        rate, cell_V = under.c_rate, model.voltage_under(emf_V, series_ohmAh, under)
        strong_V = cell_V - bias_V + rate * (series_ohmAh - r_ohmAh)
        cell_V += weak_lag(installation, cell, state, rate, strong_V)
        volts = metered_voltage(installation, cells * cell_V)
        if by_rows and k > 0:
            volts += cells * ROW_SHARE * abs(rate - before) * series_ohmAh * wander.row[k, j]
        before = rate
        margin = min(volts - pack.cutoff_V, (state.soc - least_soc) * SOC_IN_CELL_V * cells)
        earlier_s = at_s - dt_s[k - 1] if k > 0 else 0.0
        end = fallen(by_rows, k, end, margin, earlier_s, at_s)
        low = fallen(by_rows, k, low, volts - pack.low_V, earlier_s, at_s)
        if end.at_s < np.inf:
            break
        if by_rows:
            mean_W = 0.5 * (power_W[k] + power_W[min(k + 1, dt_s.size - 1)])
            under = model.under_power(cell, emf_V, series_ohmAh, mean_W / size)
        if dt_s[k] != lags_s:
            lags, lags_s = model.lags(cell, dt_s[k]), dt_s[k]
        doubt_V2 = b.ocv_doubt(pack, state.soc, under.c_rate * (dt_s[k] / SECONDS_PER_HOUR))
        state = model.step_cell(cell, state, under, r_ohmAh, flying.ambient_C, dt_s[k], lags)
        bias_V += np.sqrt(gained_V2[k] + doubt_V2) * wander.bias[k, j]
        at_s += dt_s[k]
    return end.at_s, min(low.at_s, end.at_s)


@compiled_numbers
def fallen(by_rows: bool, k: int, before: MarginFall, margin: float, earlier_s: float, at_s: float) -> MarginFall:
    """Return the fall of a margin after step `k`, from that `before` it.

    margin : its value at this step; earlier_s, at_s : when the step before and this one begin [s]. By rows the centred
    median of three decides.
    """
    below = (2 * before.below + (margin < 0.0)) % 8
    if before.at_s < np.inf:
        return MarginFall(before.at_s, margin, below)
    if by_rows:
        is_new = k > 1 and below in (3, 5, 6, 7)  # two of the three are below zero
        return MarginFall(earlier_s if is_new else np.inf, margin, below)
    return MarginFall(crossing(k, before.last, margin, earlier_s, at_s) if margin < 0.0 else np.inf, margin, below)


@compiled_numbers
def crossing(k: int, above: float, under: float, earlier_s: float, at_s: float) -> float:
    """Return the instant [s] at which the fall from `above` to `under` passed zero (`time_to_end._mean_crossing`)."""
    return earlier_s + above / (above - under) * (at_s - earlier_s) + MEAN_LAG_S if k > 0 else 0.0
