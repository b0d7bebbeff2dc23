"""How long packs last under power to come: the simulation behind every forecast.

Constant power within a step, not constant current: a sinking voltage draws more current, which is what empties a
pack sooner than charge counting says. Each step solves V I = P and advances the model exactly.

The end is found as it will be judged (DESIGN, "end of flight"): by the 5 s mean, whose fall lags the voltage by
half its window, or, where telemetry rows are slower than that, by the centred median of three rows with their noise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uavbatt.battery import equations as eq
from uavbatt.battery import model
from uavbatt.battery.belief import C, unpack
from uavbatt.battery.build import Pack
from uavbatt.battery.model import Array
from uavbatt.battery.pack import metered_voltage, terminal_voltage

MEAN_LAG_S = 2.5
SOC_IN_VOLTS = 10.0  # 1 % of charge weighs as 0.1 V, so that one crossing rule serves both limits


class EndTimes(NamedTuple):
    """Seconds until the end of flight and until the low-voltage warning, per column; inf = beyond the horizon."""

    end_s: Array
    low_s: Array


class Wander(NamedTuple):
    """Standard normals [steps, batch]: of the model's wandering error and of the rows' own noise."""

    bias: Array
    row: Array


def time_to_end(
    pack: Pack,
    x: Array,
    power_W: Array,
    ambient_C: float,
    dt_s: Array,
    reserve_soc: float = 0.0,
    wander: Wander | None = None,
    by_rows: bool = False,
) -> EndTimes:
    """Run belief columns x [8, batch] under true pack power `power_W` [steps, batch], steps of `dt_s` [steps].

    The end is the first of: metered voltage below pack.cutoff_V, soc below `reserve_soc`. With `by_rows` the steps
    are the telemetry's rows, between which the power goes straight, and the median of three judges. Without `wander`
    the discrepancy decays and rows are exact.
    """
    cell, installation, state = unpack(pack, x)
    size = installation.cells * installation.present_capacity_Ah
    harness_ohmAh = installation.harness_ohm * installation.present_capacity_Ah / installation.cells
    memory = np.exp(-dt_s / pack.bias_tau_s)
    kick_V = pack.bias_sd_V * np.sqrt(1.0 - memory**2)
    along_W = np.concatenate([0.5 * (power_W[:-1] + power_W[1:]), power_W[-1:]]) if by_rows else power_W
    bias_V, before = x[C.BIAS], None
    to_end, to_low = [], []
    ended = np.zeros(x.shape[1], dtype=int)
    for k, power in enumerate(power_W):
        series_ohmAh = model.resistance(cell, state.soc, state.core_C) + harness_ohmAh
        emf_V = model.electromotive_force(cell, state) + bias_V
        rate = eq.current_at_power(emf_V, series_ohmAh, power / size)
        true_V = terminal_voltage(installation, cell, state, rate * installation.present_capacity_Ah)
        volts = metered_voltage(installation, true_V + installation.cells * bias_V)
        if by_rows and wander is not None and before is not None:
            volts = volts + installation.cells * pack.row_share * np.abs(rate - before) * series_ohmAh * wander.row[k]
        before = rate
        margin = volts - pack.cutoff_V
        if reserve_soc > 0.0:
            margin = np.minimum(margin, (state.soc - reserve_soc) * SOC_IN_VOLTS)
        to_end.append(margin)
        to_low.append(volts - pack.low_V)
        ended = np.where(margin < 0.0, ended + 1, np.where(ended >= 3, ended, 0))
        if (ended >= (3 if by_rows else 1)).all():
            break
        mean_rate = eq.current_at_power(emf_V, series_ohmAh, along_W[k] / size) if by_rows else rate
        state = model.step(cell, state, mean_rate, ambient_C, dt_s[k])
        bias_V = memory[k] * bias_V + (0.0 if wander is None else kick_V[k] * wander.bias[k])
    judge = _median_crossing if by_rows else _mean_crossing
    at_s = np.concatenate([[0.0], np.cumsum(dt_s)])[: len(to_end)]
    end_s = judge(np.array(to_end), at_s)
    return EndTimes(end_s, np.minimum(judge(np.array(to_low), at_s), end_s))


def _mean_crossing(margin: Array, at_s: Array) -> Array:
    """First fall of each column [steps, batch] through zero, linear between the steps at `at_s`; plus the lag."""
    below = margin < 0.0
    first = np.argmax(below, axis=0)
    columns = np.arange(margin.shape[1])
    last = np.maximum(first - 1, 0)
    above, under = margin[last, columns], margin[first, columns]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(first > 0, above / (above - under), 0.0)
    crossing = at_s[last] + share * (at_s[first] - at_s[last]) + np.where(first > 0, MEAN_LAG_S, 0.0)
    return np.where(below.any(axis=0), crossing, np.inf)


def _median_crossing(margin: Array, at_s: Array) -> Array:
    """Time of the first row whose centred median of three is below zero; the present row has no row before it."""
    if margin.shape[0] < 3:
        return np.where((margin < 0.0).all(axis=0), 0.0, np.inf)
    median = np.median(np.stack([margin[:-2], margin[1:-1], margin[2:]]), axis=0)
    below = median < 0.0
    return np.where(below.any(axis=0), at_s[np.argmax(below, axis=0) + 1], np.inf)
