"""Endurance of packs under power to come: the simulation behind every forecast.

The end of flight is the forecast form of the rule in `scoring.end_of_flight`: the 5 s mean lags a falling voltage by
half its window, so that it crosses the cut-off MEAN_LAG_S after the voltage does; if telemetry rows are slower than
that, the steps are the rows, and the centred median of three of them, with their noise, decides. A charge below the
least one ends a flight as well. The discrepancy does not decay to zero as in the filter, but walks on from its present
value: nothing shows that a voltage which a pack lacks now will come back before the end.

`compiled.forecast` is the same compiled; a test holds the two equal to 1e-9.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uavbatt.battery import model
from uavbatt.battery.equations import Number
from uavbatt.battery.model import Array
from uavbatt.battery.pack import metered_voltage
from uavbatt.battery.spreads import ROW_SHARE
from uavbatt.prediction.simulation.draws import Flying, mean_cell_V, source_of, start_draws, step_over, stepped
from uavbatt.prediction.simulation.sampling import Normals

MEAN_LAG_S = 2.5  # half of MEAN_WINDOW_S of that rule
JUDGED_AT_ONCE = 16  # steps; what is judged for many steps in one go costs little
JUDGED_BEFORE = 2  # steps that are needed once more: a median of three reaches back so far
SOC_IN_CELL_V = 2.5  # 1 % of charge weighs as 25 mV of a cell, so that one crossing rule serves both limits
# Share of the draws that is simulated to the end; the 95 % point lies among their ends. The last few would cost a fifth
# of all steps, and count as ending with the last of these.
COUNTED = 0.96


class EndTimes(NamedTuple):
    """EndTimes holds the seconds until end of flight and low-voltage warning, per column; inf is beyond the horizon."""

    end_s: Array
    low_s: Array


def time_to_end(
    flying: Flying,
    wander: Normals,
    least_soc: Number = -np.inf,
    own_steps: Number = np.inf,
    enough: float = 1.0,
) -> EndTimes:
    """Return when each draw's flight ends: metered voltage below the pack's cut-off or charge below `least_soc`.

    own_steps : steps after which each forecast's horizon ends. The simulation is over when a share `enough` of each
    forecast's draws has ended; the others are inf.
    """
    draws, count = start_draws(flying), flying.power_W.shape[0]
    installation, batch = draws.installation, draws.bias_V.shape
    asked_WpAh = flying.power_W / (installation.cells * installation.present_capacity_Ah)
    limits = _Limits(flying, least_soc, _times(flying.dt_s, len(batch)), own_steps, float(np.min(own_steps)))
    recent = _Recent(*np.zeros((len(_Recent._fields), JUDGED_BEFORE + JUDGED_AT_ONCE, *batch)))
    ends, steps, before = EndTimes(*np.full((2, *batch), np.inf)), step_over(draws, flying.dt_s), None
    for k in range(count):
        at = source_of(draws)
        under = model.under_power(draws.cell, at.emf_V, at.series_ohmAh, asked_WpAh[k])
        row = JUDGED_BEFORE + k % JUDGED_AT_ONCE
        recent.cell_V[row], recent.soc[row] = mean_cell_V(draws, at, under), draws.state.soc
        if flying.by_rows and before is not None:
            change_V = np.abs(under.c_rate - before) * at.series_ohmAh
            recent.noise_V[row] = installation.cells * ROW_SHARE * change_V * wander.row[k]
        before = under.c_rate
        if row == recent.soc.shape[0] - 1 or k == count - 1:
            ends = _judged(limits, ends, recent, k)
            if np.min(np.isfinite(ends.end_s).mean(axis=-1)) >= enough:
                break
        if flying.by_rows:
            mean_WpAh = 0.5 * (asked_WpAh[k] + asked_WpAh[min(k + 1, count - 1)])
            under = model.under_power(draws.cell, at.emf_V, at.series_ohmAh, mean_WpAh)
        draws = stepped(draws, at, under, steps.at(k), wander.bias[k])
    return EndTimes(ends.end_s, np.minimum(ends.low_s, ends.end_s))


def counted(ends: EndTimes, enough: float = COUNTED) -> EndTimes:
    """Return the ends [draws] [s], the latest moved to the last one within a share `enough` of them.

    So the result is the same however many of the latest are known.
    """
    last = math.ceil(enough * ends.end_s.shape[-1]) - 1
    latest = np.partition(ends, last, axis=-1)[..., last : last + 1]
    return EndTimes(*np.minimum(ends, latest))


class _Recent(NamedTuple):
    """_Recent holds the last steps of the packs, [steps, batch]: mean cell voltage, charge, noise of a row."""

    cell_V: Array
    soc: Array
    noise_V: Array


class _Limits(NamedTuple):
    """_Limits holds the limits by which steps are judged; `at_s` are the times of all steps."""

    flying: Flying
    least_soc: Number
    at_s: Array
    own_steps: Number
    fewest_steps: float


def _times(dt_s: Array, dimensions: int) -> Array:
    """Return when each step begins [s], to broadcast over a batch of so many dimensions."""
    at_s = np.concatenate([np.zeros_like(dt_s[:1]), np.cumsum(dt_s, axis=0)[:-1]])
    return at_s.reshape(at_s.shape + (1,) * (1 + dimensions - at_s.ndim))


def _judged(limits: _Limits, ends: EndTimes, recent: _Recent, k: int) -> EndTimes:
    """Return the ends that are known after step `k`; the last steps are kept for the next ones."""
    pack, installation = limits.flying.pack, limits.flying.pack.installation
    new = k % JUDGED_AT_ONCE + 1
    known = JUDGED_BEFORE if k >= JUDGED_AT_ONCE else 0
    part, steps = slice(JUDGED_BEFORE - known, JUDGED_BEFORE + new), slice(k + 1 - new - known, k + 1)
    volts = metered_voltage(installation, installation.cells * recent.cell_V[part])
    if limits.flying.by_rows:
        volts += recent.noise_V[part]
    margin_V, above_low_V = volts - pack.cutoff_V, volts - pack.low_V
    margin_V = np.minimum(margin_V, (recent.soc[part] - limits.least_soc) * SOC_IN_CELL_V * installation.cells)
    if k >= limits.fewest_steps:
        within = np.arange(steps.start, steps.stop).reshape(-1, *(1,) * (volts.ndim - 1)) < limits.own_steps
        margin_V, above_low_V = np.where(within, margin_V, np.inf), np.where(within, above_low_V, np.inf)
    for column in recent:
        column[:JUDGED_BEFORE] = column[new : new + JUDGED_BEFORE]
    return EndTimes(_crossed(limits, ends.end_s, margin_V, steps), _crossed(limits, ends.low_s, above_low_V, steps))


def _crossed(limits: _Limits, known_s: Array, margin: Array, steps: slice) -> Array:
    """Return the times `known_s` [batch], with those of columns whose `margin` [steps, batch] is below zero now."""
    is_new = ((margin < 0.0) & (known_s == np.inf)).any(axis=0)
    if not is_new.any():
        return known_s
    judge = _median_crossing if limits.flying.by_rows else _mean_crossing
    at_s, crossed_s = np.broadcast_to(limits.at_s[steps], margin.shape), known_s.copy()
    crossed_s[is_new] = judge(margin[:, is_new], at_s[:, is_new])
    return crossed_s


def _mean_crossing(margin: Array, at_s: Array) -> Array:
    """Return the first fall of each column [steps, columns] through zero, linear between steps at `at_s`, plus the lag.

    Each column must have a step below zero.
    """
    first, column = np.argmax(margin < 0.0, axis=0), np.arange(margin.shape[1])
    last = np.maximum(first - 1, 0)
    above, under = margin[last, column], margin[first, column]
    last_s, first_s = at_s[last, column], at_s[first, column]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(first > 0, above / (above - under), 0.0)
    return np.asarray(last_s + share * (first_s - last_s) + np.where(first > 0, MEAN_LAG_S, 0.0))


def _median_crossing(margin: Array, at_s: Array) -> Array:
    """Return the time of the first row whose centred median of three is below zero; no row precedes the present."""
    below, column = margin < 0.0, np.arange(margin.shape[1])
    if margin.shape[0] < 3:
        return np.where(below.all(axis=0), 0.0, np.inf)
    median_below = (below[:-2] & below[1:-1]) | (below[1:-1] & below[2:]) | (below[:-2] & below[2:])
    first = np.argmax(median_below, axis=0)
    return np.where(median_below[first, column], at_s[first + 1, column], np.inf)
