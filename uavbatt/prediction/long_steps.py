"""Draws of a pack walked on in long steps under a power to come: the charge left, and how far above its cut-off it is.

The same equations as in `time_to_end`, which judges every few seconds where the end is. Here the way is given and the
charge at its end is asked, so that a pack that would have been at its cut-off on the way is walked on all the same.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uavbatt.battery import model
from uavbatt.battery.equations import SECONDS_PER_HOUR
from uavbatt.battery.model import Array, Parameters, State
from uavbatt.battery.pack import Installation, metered_voltage, series_resistance, weak_lag
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import X, ocv_doubt, unpack

STEP_S = 20.0


class Going(NamedTuple):
    """Draws of a pack on their way: the cell, its installation, its state, the model's error [V] of each."""

    pack: Pack
    ambient_C: float
    cell: Parameters
    installation: Installation
    state: State
    bias_V: Array


def begun(pack: Pack, x: Array, ambient_C: float) -> Going:
    """Return the belief columns x [8, draws] before their way."""
    return Going(pack, ambient_C, *unpack(pack, x), x[X.BIAS])


def walked(going: Going, power_W: Array, dt_s: Array | float, normals: Array) -> Going:
    """Return the draws after `dt_s` [s] of `power_W` [W]; `normals` kick the model's error."""
    cell, state, pack = going.cell, going.state, going.pack
    _, r_ohmAh, rate = _drawn(going, power_W)
    later = model.step_cell(cell, state, rate, r_ohmAh, going.ambient_C, dt_s, model.lags(cell, dt_s))
    memory = np.exp(-np.asarray(dt_s) / pack.bias_tau_s)
    doubt_V2 = ocv_doubt(pack, state.soc, rate * (np.asarray(dt_s) / SECONDS_PER_HOUR))
    kick_V = np.sqrt(pack.bias_sd_V**2 * (1.0 - memory**2) + doubt_V2) * normals
    return going._replace(state=later, bias_V=memory * going.bias_V + kick_V)


def above_cutoff_V(going: Going, power_W: Array) -> Array:
    """Return by how much the metered voltage of the pack is above its cut-off under a power [W]."""
    installation = going.installation
    emf_V, r_ohmAh, rate = _drawn(going, power_W)
    series_ohmAh = series_resistance(installation, r_ohmAh)
    cell_V = model.loaded_voltage(going.cell, emf_V, series_ohmAh, rate)
    strong_V = cell_V - going.bias_V + rate * (series_ohmAh - r_ohmAh)
    cell_V = cell_V + weak_lag(installation, going.cell, going.state, rate, strong_V)
    return np.asarray(metered_voltage(installation, installation.cells * cell_V) - going.pack.cutoff_V)


def _drawn(going: Going, power_W: Array) -> tuple[Array, Array, Array]:
    """Open-circuit voltage with the model's error, resistance [ohm·Ah] and C-rate under a power.

    A pack far beyond empty, whose voltage has turned round, gives nothing: it must not be charged by the way.
    """
    installation = going.installation
    emf_V, r_ohmAh = model.source(going.cell, going.state)
    emf_V = emf_V + going.bias_V
    size = installation.cells * installation.present_capacity_Ah
    rate = model.rate_at_power(going.cell, emf_V, series_resistance(installation, r_ohmAh), power_W / size)
    return emf_V, r_ohmAh, np.maximum(rate, 0.0)
