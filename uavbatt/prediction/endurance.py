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
from uavbatt.battery.model import Array, Lags
from uavbatt.battery.pack import Installation, metered_voltage, series_resistance, weak_lag

MEAN_LAG_S = 2.5
JUDGED_AT_ONCE = 16  # steps; what is judged for many steps in one go costs little
# Numbers that meet arrays at every step: as arrays themselves they cost numpy half.
SPREAD = ("polarisation_ratio", "diffusion_ratio", "activation_K", "heat_gain")
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
    own_steps: Number = np.inf,
) -> EndTimes:
    """Run belief columns x [8, batch] under true pack power `power_W` [steps, batch], steps of `dt_s` [steps].

    The end is the first of: metered voltage below pack.cutoff_V, soc below `reserve_soc`. With `by_rows` the steps
    are the telemetry's rows, between which the power goes straight, and the median of three judges. Without `wander`
    the discrepancy decays and rows are exact. Several forecasts fly side by side with a batch of two dimensions, over
    which `dt_s` [steps, ...], `ambient_C` and the pack's limits broadcast; `own_steps` ends each one's sight.
    """
    cell, installation, state = unpack(pack, x)
    cell = cell._replace(**{name: np.full(x.shape[1:], getattr(cell, name)) for name in SPREAD if getattr(cell, name)})
    steps, ones = power_W.shape[0], (1,) * (x.ndim - 1)
    size = installation.cells * installation.present_capacity_Ah
    harness_ohmAh = series_resistance(installation, 0.0)
    memory = np.exp(-dt_s / pack.bias_tau_s)
    kick_V = (pack.bias_sd_V * np.sqrt(1.0 - memory**2)).reshape(steps, *(dt_s.shape[1:] or ones))
    kicks_V = np.zeros((steps, *ones)) if wander is None else kick_V * wander.bias[:steps]
    at_s = np.concatenate([np.zeros_like(dt_s[:1]), np.cumsum(dt_s, axis=0)])[:-1].reshape(
        steps, *(dt_s.shape[1:] or ones)
    )
    judge = _median_crossing if by_rows else _mean_crossing
    rates, recent = np.empty_like(power_W), _Way(*np.empty((len(_Way._fields), JUDGED_AT_ONCE, *x.shape[1:])))
    margin_V, above_low_V = np.empty_like(power_W), np.empty_like(power_W)
    asked_WpAh, bias_V, lags = power_W / size, x[C.BIAS], _by_step(model.lags(cell, dt_s))
    crossed = np.zeros(x.shape[1:], dtype=bool)
    for k in range(steps):
        emf_V, r_ohmAh = model.source(cell, state)
        series_ohmAh, emf_V = r_ohmAh + harness_ohmAh, emf_V + bias_V
        rate = model.rate_at_power(cell, emf_V, series_ohmAh, asked_WpAh[k])
        cell_V = model.loaded_voltage(cell, emf_V, series_ohmAh, rate)
        if eq.acts(installation.deficit):
            strong_V = cell_V - bias_V + rate * harness_ohmAh
            cell_V = cell_V + weak_lag(installation, cell, state, rate, strong_V)
        rates[k], row = rate, k % JUDGED_AT_ONCE
        recent.cell_V[row], recent.soc[row], recent.series_ohmAh[row] = cell_V, state.soc, series_ohmAh
        if row == JUDGED_AT_ONCE - 1 or k == steps - 1:
            part, seen = slice(k - row, k + 1), _Way(*(column[: row + 1] for column in recent))
            volts = metered_voltage(installation, installation.cells * seen.cell_V)
            if by_rows and wander is not None:
                volts += _row_noise(pack, installation, seen, rates, part) * wander.row[part]
            in_sight = np.arange(part.start, part.stop).reshape(-1, *ones) < own_steps
            margin = volts - pack.cutoff_V
            if reserve_soc > 0.0:
                margin = np.minimum(margin, (seen.soc - reserve_soc) * SOC_IN_VOLTS)
            margin_V[part] = np.where(in_sight, margin, np.inf)
            above_low_V[part] = np.where(in_sight, volts - pack.low_V, np.inf)
            new = slice(max(part.start - 2, 0), part.stop)  # a median of three reaches back two rows
            crossed |= np.isfinite(judge(margin_V[new], at_s[new]))
            if crossed.all():
                break
        if by_rows:
            mean_WpAh = 0.5 * (asked_WpAh[k] + asked_WpAh[min(k + 1, steps - 1)])
            rate = model.rate_at_power(cell, emf_V, series_ohmAh, mean_WpAh)
        state = model.unseen_step(cell, state, rate, r_ohmAh, ambient_C, dt_s[k], lags[k])
        bias_V = memory[k] * bias_V + kicks_V[k]
    end_s = judge(margin_V[: k + 1], at_s)
    return EndTimes(end_s, np.minimum(judge(above_low_V[: k + 1], at_s), end_s))


class _Way(NamedTuple):
    """What a pack goes through, [steps, batch] each: mean voltage of a cell with its share of the harness and of the
    model's error, charge, resistance."""

    cell_V: Array
    soc: Array
    series_ohmAh: Array


def _by_step(lags: Lags) -> list[Lags]:
    """The lags of each step."""
    return [Lags(*step) for step in zip(*lags, strict=True)]


def _row_noise(pack: Pack, installation: Installation, way: _Way, rates: Array, part: slice) -> Array:
    """Sd of a row's voltage [V] for what of a change of current it does not show; the first row follows nothing."""
    before = (
        rates[part.start - 1 : part.stop - 1] if part.start else np.concatenate([rates[:1], rates[: part.stop - 1]])
    )
    return np.asarray(installation.cells * pack.row_share * np.abs(rates[part] - before) * way.series_ohmAh)


def _mean_crossing(margin: Array, at_s: Array) -> Array:
    """First fall of each column [steps, batch] through zero, linear between the steps at `at_s`; plus the lag."""
    below = margin < 0.0
    first = np.argmax(below, axis=0)[None]
    last = np.maximum(first - 1, 0)
    above, under = np.take_along_axis(margin, last, 0), np.take_along_axis(margin, first, 0)
    last_s, first_s = np.take_along_axis(at_s, last, 0), np.take_along_axis(at_s, first, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(first > 0, above / (above - under), 0.0)
    crossing = last_s + share * (first_s - last_s) + np.where(first > 0, MEAN_LAG_S, 0.0)
    return np.asarray(np.where(under < 0.0, crossing, np.inf)[0])


def _median_crossing(margin: Array, at_s: Array) -> Array:
    """Time of the first row whose centred median of three is below zero; the present row has no row before it."""
    below = margin < 0.0
    if margin.shape[0] < 3:
        return np.where(below.all(axis=0), 0.0, np.inf)
    median_below = (below[:-2] & below[1:-1]) | (below[1:-1] & below[2:]) | (below[:-2] & below[2:])
    first = np.argmax(median_below, axis=0)[None]
    crossing = np.take_along_axis(at_s, first + 1, 0)
    return np.asarray(np.where(np.take_along_axis(median_below, first, 0), crossing, np.inf)[0])
