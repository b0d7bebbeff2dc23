"""Simulation of samples of a pack in long steps under a given power: charge left, and distance to the cut-off.

The equations are those of `time_to_end`, which looks for the end every few seconds. Here the duration is given and the
charge at its end is wanted, so that a pack is simulated on even after it has reached its cut-off.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery import model
from uavbatt.battery.equations import SECONDS_PER_HOUR, is_on
from uavbatt.battery.model import Array, Parameters, State, UnderLoad
from uavbatt.battery.pack import Installation, metered_voltage, series_resistance, weak_lag
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import X, bias_variance, drift_variance, unpack
from uavbatt.prediction.curves import curve_tables, looked_up
from uavbatt.prediction.sampling import wander

STEP_S = 20.0
LONGEST_STEP_S = 2.0 * STEP_S  # longest step if only the charge is needed, not the sag of each step


class FlyingDraws(NamedTuple):
    """FlyingDraws holds draws of a pack on their way: cell, installation, state, and the model's error [V] of each."""

    pack: Pack
    ambient_C: float
    cell: Parameters
    installation: Installation
    state: State
    bias_V: Array
    tables: Array  # `curves.curve_tables`

    def of(self, which: NDArray[Any] | slice) -> FlyingDraws:
        """Return the draws of some of several beginnings [beginnings, draws] that go on side by side."""
        return self._replace(state=State(*(column[which] for column in self.state)), bias_V=self.bias_V[which])


class Source(NamedTuple):
    """Source is the voltage source that a load meets in each cell now, as `model.source` has it.

    emf_V holds the model's error as well; drift_sd_V is how fast that error changes at this charge.
    """

    emf_V: Array
    r_ohmAh: Array
    drift_sd_V: Array


def start_draws(pack: Pack, x: Array, ambient_C: float) -> FlyingDraws:
    """Return the draws at the start of their way, from the belief columns x [9, draws]."""
    return FlyingDraws(pack, ambient_C, *unpack(pack, x), x[X.BIAS], curve_tables(pack))


def source_of(draws: FlyingDraws) -> Source:
    """Return the voltage source that a load meets in each draw now."""
    charged_V, new_ohmAh, drift_sd_V = looked_up(draws.tables, draws.state.soc)
    emf_V, r_ohmAh = model.source_from(draws.cell, draws.state, charged_V, new_ohmAh)
    return Source(emf_V + draws.bias_V, r_ohmAh, drift_sd_V)


def step_draws(draws: FlyingDraws, at: Source, power_W: Array, dt_s: Array | float, normals: Array) -> FlyingDraws:
    """Return the draws after `dt_s` [s] of `power_W` [W]; `at` is their source now, `normals` kick the model error."""
    cell, state, pack, under = draws.cell, draws.state, draws.pack, _under(draws, at, power_W)
    later = model.step_cell(cell, state, under, at.r_ohmAh, draws.ambient_C, dt_s, model.cell_lags(cell, dt_s))
    doubt_V2 = drift_variance(at.drift_sd_V, under.c_rate * (dt_s / SECONDS_PER_HOUR))
    kick_V = np.sqrt(bias_variance(pack, dt_s) + doubt_V2) * normals
    return draws._replace(state=later, bias_V=draws.bias_V + kick_V)


def edges_through(times_s: Array) -> Array:
    """Return times from now, 0, through all of these [s, ascending], with gaps of at most LONGEST_STEP_S."""
    parts = [np.linspace(a, b, 1 + math.ceil((b - a) / LONGEST_STEP_S)) for a, b in pairwise([0.0, *times_s])]
    return np.unique(np.concatenate(parts))


def fly_draws(draws: FlyingDraws, power_W: Array, dt_s: Array, edges_s: Array) -> FlyingDraws:
    """Return the draws at `edges_s` [edges, draws], the first is now, under a power in steps of `dt_s` [steps]."""
    ends_s = np.concatenate([[0.0], np.cumsum(dt_s)])
    drawn_J = np.concatenate([np.zeros_like(power_W[:1]), np.cumsum(power_W * dt_s[:, None], axis=0)])
    passed, lengths_s = [draws], np.diff(edges_s)
    mean_W = np.diff(_between(drawn_J, ends_s, edges_s), axis=0) / lengths_s[:, None]
    for length_s, watts, normals in zip(lengths_s, mean_W, wander(lengths_s.size).bias, strict=True):
        passed.append(step_draws(passed[-1], source_of(passed[-1]), watts, float(length_s), normals))
    columns = zip(*(now.state for now in passed), strict=True)
    state = State(*map(np.stack, columns))
    return draws._replace(state=state, bias_V=np.stack([now.bias_V for now in passed]))


def charge_at(passed: FlyingDraws, edges_s: Array, at_s: Array) -> Array:
    """Return the charge of each draw at its own time [draws], from the draws at edges [edges, draws] (`fly_draws`)."""
    soc = np.asarray(passed.state.soc)
    own = (np.interp(own_s, edges_s, column) for own_s, column in zip(at_s, soc.T, strict=True))
    return np.asarray(np.maximum(np.fromiter(own, float, at_s.size), 0.0))


def _between(values: Array, edges_s: Array, at_s: Array) -> Array:
    """Return rows of `values` [edges, draws] at these times, linear between edges and straight on beyond the last."""
    right = np.clip(np.searchsorted(edges_s, at_s), 1, edges_s.size - 1)
    share = (at_s - edges_s[right - 1]) / (edges_s[right] - edges_s[right - 1])
    return np.asarray(values[right - 1] + share[:, None] * (values[right] - values[right - 1]))


def above_cutoff_V(draws: FlyingDraws, at: Source, power_W: Array) -> Array:
    """Return how far the metered voltage of the pack is above its cut-off under a power [W]; negative below it."""
    installation, under = draws.installation, _under(draws, at, power_W)
    series_ohmAh = series_resistance(installation, at.r_ohmAh)
    cell_V = model.voltage_under(at.emf_V, series_ohmAh, under)
    if is_on(installation.deficit):
        strong_V = cell_V - draws.bias_V + under.c_rate * (series_ohmAh - at.r_ohmAh)
        cell_V = cell_V + weak_lag(installation, draws.cell, draws.state, under.c_rate, strong_V)
    return np.asarray(metered_voltage(installation, installation.cells * cell_V) - draws.pack.cutoff_V)


def _under(draws: FlyingDraws, at: Source, power_W: Array) -> UnderLoad:
    """Return the load of the cells under a power.

    A pack far beyond empty, with a reversed voltage, gives nothing: the simulation must not charge it.
    """
    installation = draws.installation
    size = installation.cells * installation.present_capacity_Ah
    under = model.under_power(draws.cell, at.emf_V, series_resistance(installation, at.r_ohmAh), power_W / size)
    return UnderLoad(np.maximum(under.c_rate, 0.0), np.maximum(under.transfer_V, 0.0))
