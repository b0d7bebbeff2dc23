"""Simulation of samples of a pack in long steps under a given power: charge left, and distance to the cut-off.

Here the duration is given and the charge at its end is wanted, so that a pack is simulated on even after it has reached
its cut-off; `time_to_end` looks for the end every few seconds.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from uavbatt.battery import model
from uavbatt.battery.model import Array, State, UnderLoad
from uavbatt.battery.pack import metered_voltage
from uavbatt.prediction.simulation.draws import (
    Draws,
    Flying,
    Source,
    mean_cell_V,
    source_of,
    start_draws,
    step_over,
    stepped,
)
from uavbatt.prediction.simulation.sampling import wander

STEP_S = 20.0
LONGEST_STEP_S = 2.0 * STEP_S  # longest step if only the charge is needed, not the sag of each step


def step_draws(draws: Draws, at: Source, power_W: Array, dt_s: Array | float, normals: Array) -> Draws:
    """Return the draws after `dt_s` [s] of `power_W` [W]; `at` is their source now, `normals` kick the model error."""
    return stepped(draws, at, _under(draws, at, power_W), step_over(draws, dt_s), normals)


def edges_through(times_s: Array) -> Array:
    """Return times from now, 0, through all of these [s, ascending], with gaps of at most LONGEST_STEP_S."""
    parts = [np.linspace(a, b, 1 + math.ceil((b - a) / LONGEST_STEP_S)) for a, b in pairwise([0.0, *times_s])]
    return np.unique(np.concatenate(parts))


def fly_draws(flying: Flying, edges_s: Array) -> Draws:
    """Return the draws of a forecast at `edges_s` [edges, draws]; the first edge is now."""
    power_W, dt_s = flying.power_W, flying.dt_s
    ends_s = np.concatenate([[0.0], np.cumsum(dt_s)])
    drawn_J = np.concatenate([np.zeros_like(power_W[:1]), np.cumsum(power_W * dt_s[:, None], axis=0)])
    draws, lengths_s = start_draws(flying), np.diff(edges_s)
    passed = [draws]
    mean_W = np.diff(_between(drawn_J, ends_s, edges_s), axis=0) / lengths_s[:, None]
    for length_s, watts, normals in zip(lengths_s, mean_W, wander(lengths_s.size).bias, strict=True):
        passed.append(step_draws(passed[-1], source_of(passed[-1]), watts, float(length_s), normals))
    columns = zip(*(now.state for now in passed), strict=True)
    state = State(*map(np.stack, columns))
    return draws._replace(state=state, bias_V=np.stack([now.bias_V for now in passed]))


def charge_at(passed: Draws, edges_s: Array, at_s: Array) -> Array:
    """Return the charge of each draw at its own time [draws], from the draws at edges [edges, draws] (`fly_draws`)."""
    soc = np.asarray(passed.state.soc)
    own = (np.interp(own_s, edges_s, column) for own_s, column in zip(at_s, soc.T, strict=True))
    return np.asarray(np.maximum(np.fromiter(own, float, at_s.size), 0.0))


def _between(values: Array, edges_s: Array, at_s: Array) -> Array:
    """Return rows of `values` [edges, draws] at these times, linear between edges and straight on beyond the last."""
    right = np.clip(np.searchsorted(edges_s, at_s), 1, edges_s.size - 1)
    share = (at_s - edges_s[right - 1]) / (edges_s[right] - edges_s[right - 1])
    return np.asarray(values[right - 1] + share[:, None] * (values[right] - values[right - 1]))


def above_cutoff_V(draws: Draws, at: Source, power_W: Array) -> Array:
    """Return how far the metered voltage of the pack is above its cut-off under a power [W]; negative below it."""
    installation, cell_V = draws.installation, mean_cell_V(draws, at, _under(draws, at, power_W))
    return np.asarray(metered_voltage(installation, installation.cells * cell_V) - draws.pack.cutoff_V)


def _under(draws: Draws, at: Source, power_W: Array) -> UnderLoad:
    """Return the load of the cells under a power.

    A pack far beyond empty, with a reversed voltage, gives nothing: the simulation must not charge it.
    """
    installation = draws.installation
    size = installation.cells * installation.present_capacity_Ah
    under = model.under_power(draws.cell, at.emf_V, at.series_ohmAh, power_W / size)
    return UnderLoad(np.maximum(under.c_rate, 0.0), np.maximum(under.transfer_V, 0.0))
