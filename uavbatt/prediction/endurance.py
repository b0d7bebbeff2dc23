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
from uavbatt.battery.equations import Number
from uavbatt.battery.model import Array, Parameters, State
from uavbatt.battery.pack import Installation, metered_voltage, terminal_voltage

MEAN_LAG_S = 2.5
JUDGED_AT_ONCE = 16  # steps; what is judged for many steps in one go costs little
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
    ambient_C: Number,
    dt_s: Array,
    reserve_soc: float = 0.0,
    wander: Wander | None = None,
    by_rows: bool = False,
) -> EndTimes:
    """Run belief columns x [8, batch] under true pack power `power_W` [steps, batch], steps of `dt_s` [steps].

    The end is the first of: metered voltage below pack.cutoff_V, soc below `reserve_soc`. With `by_rows` the steps
    are the telemetry's rows, between which the power goes straight, and the median of three judges. Without `wander`
    the discrepancy decays and rows are exact. Several forecasts fly side by side with `dt_s` [steps, batch] and
    `ambient_C` [batch].
    """
    cell, installation, state = unpack(pack, x)
    steps = power_W.shape[0]
    size = installation.cells * installation.present_capacity_Ah
    harness_ohmAh = installation.harness_ohm * installation.present_capacity_Ah / installation.cells
    memory = np.exp(-dt_s / pack.bias_tau_s)
    kick_V = pack.bias_sd_V * np.sqrt(1.0 - memory**2)
    drawn = power_W / size
    along = np.concatenate([0.5 * (drawn[:-1] + drawn[1:]), drawn[-1:]]) if by_rows else drawn
    at_s = np.concatenate([np.zeros_like(dt_s[:1]), np.cumsum(dt_s, axis=0)])[:-1]
    judge = _median_crossing if by_rows else _mean_crossing
    way = _Way(*(np.empty((steps, x.shape[1])) for _ in _Way._fields))
    margin_V, above_low_V = np.empty_like(way.rate), np.empty_like(way.rate)
    bias_V = x[C.BIAS]
    for k in range(steps):
        r_ohmAh = model.resistance(cell, state.soc, state.core_C)
        emf_V = model.electromotive_force(cell, state) + bias_V
        rate = eq.current_at_power(emf_V, r_ohmAh + harness_ohmAh, drawn[k])
        for row, value in zip(way, (*state[:4], bias_V, rate, r_ohmAh), strict=True):
            row[k] = value
        if (k + 1) % JUDGED_AT_ONCE == 0 or k + 1 == steps:
            part = slice(k - k % JUDGED_AT_ONCE, k + 1)
            volts = _voltages(pack, cell, installation, way, part, wander if by_rows else None)
            margin_V[part], above_low_V[part] = volts - pack.cutoff_V, volts - pack.low_V
            if reserve_soc > 0.0:
                margin_V[part] = np.minimum(margin_V[part], (way.soc[part] - reserve_soc) * SOC_IN_VOLTS)
            if k + 1 == steps or np.isfinite(judge(margin_V[: k + 1], at_s)).all():
                break
        if by_rows:
            rate = eq.current_at_power(emf_V, r_ohmAh + harness_ohmAh, along[k])
        state = model.step_against(cell, state, rate, r_ohmAh, ambient_C, dt_s[k])
        bias_V = memory[k] * bias_V + (0.0 if wander is None else kick_V[k] * wander.bias[k])
    end_s = judge(margin_V[: k + 1], at_s)
    return EndTimes(end_s, np.minimum(judge(above_low_V[: k + 1], at_s), end_s))


class _Way(NamedTuple):
    """What a pack goes through, [steps, batch] each: the cell's state, its wandering error, C-rate, resistance."""

    soc: Array
    polarisation_V: Array
    diffusion_V: Array
    core_C: Array
    bias_V: Array
    rate: Array
    r_ohmAh: Array


def _voltages(
    pack: Pack, cell: Parameters, installation: Installation, way: _Way, part: slice, wander: Wander | None
) -> Array:
    """Metered voltage [V] on a part of the way, with the noise of rows where there is `wander`."""
    core_C = way.core_C[part]
    state = State(way.soc[part], way.polarisation_V[part], way.diffusion_V[part], core_C, sensor_C=core_C)
    rate = way.rate[part]
    true_V = terminal_voltage(installation, cell, state, rate * installation.present_capacity_Ah)
    volts: Array = metered_voltage(installation, true_V + installation.cells * way.bias_V[part])
    if wander is not None:
        new = np.abs(np.diff(way.rate[max(part.start - 1, 0) : part.stop], axis=0))
        noisy = slice(max(part.start, 1), part.stop)
        ohmAh = way.r_ohmAh[noisy] + installation.harness_ohm * installation.present_capacity_Ah / installation.cells
        volts[noisy.start - part.start :] += installation.cells * pack.row_share * new * ohmAh * wander.row[noisy]
    return volts


def _mean_crossing(margin: Array, at_s: Array) -> Array:
    """First fall of each column [steps, batch] through zero, linear between the steps at `at_s`; plus the lag."""
    below = margin < 0.0
    first = np.argmax(below, axis=0)
    columns = np.arange(margin.shape[1])
    last = np.maximum(first - 1, 0)
    above, under = margin[last, columns], margin[first, columns]
    last_s, first_s = (at_s[last], at_s[first]) if at_s.ndim == 1 else (at_s[last, columns], at_s[first, columns])
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(first > 0, above / (above - under), 0.0)
    crossing = last_s + share * (first_s - last_s) + np.where(first > 0, MEAN_LAG_S, 0.0)
    return np.where(below[first, columns], crossing, np.inf)


def _median_crossing(margin: Array, at_s: Array) -> Array:
    """Time of the first row whose centred median of three is below zero; the present row has no row before it."""
    if margin.shape[0] < 3:
        return np.where((margin < 0.0).all(axis=0), 0.0, np.inf)
    below = margin < 0.0
    median_below = (below[:-2] & below[1:-1]) | (below[1:-1] & below[2:]) | (below[:-2] & below[2:])
    first = np.argmax(median_below, axis=0)
    columns = np.arange(margin.shape[1])
    crossing = at_s[first + 1] if at_s.ndim == 1 else at_s[first + 1, columns]
    return np.where(median_below[first, columns], crossing, np.inf)
