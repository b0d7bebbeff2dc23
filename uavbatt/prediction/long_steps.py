"""Draws of a pack walked on in long steps under a power to come: the charge left, and how far above its cut-off it is.

The same equations as in `time_to_end`, which judges every few seconds where the end is. Here the way is given and the
charge at its end is asked, so that a pack that would have been at its cut-off on the way is walked on all the same.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery import model
from uavbatt.battery.equations import SECONDS_PER_HOUR, is_on
from uavbatt.battery.model import Array, Parameters, State
from uavbatt.battery.pack import Installation, metered_voltage, series_resistance, weak_lag
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import X, drift_variance, unpack
from uavbatt.prediction.curves import curve_tables, looked_up

STEP_S = 20.0


class Going(NamedTuple):
    """Draws of a pack on their way: the cell, its installation, its state, the model's error [V] of each."""

    pack: Pack
    ambient_C: float
    cell: Parameters
    installation: Installation
    state: State
    bias_V: Array
    tables: Array  # `curves.curve_tables`

    def of(self, which: NDArray[Any]) -> Going:
        """Return some of several beginnings [beginnings, draws] that go on side by side."""
        return self._replace(state=State(*(column[which] for column in self.state)), bias_V=self.bias_V[which])


class Source(NamedTuple):
    """The voltage source that a load meets in each cell now, as `model.source` has it.

    emf_V holds the model's error as well; drift_sd_V is how fast that error changes at this charge.
    """

    emf_V: Array
    r_ohmAh: Array
    drift_sd_V: Array


def begun(pack: Pack, x: Array, ambient_C: float) -> Going:
    """Return the belief columns x [8, draws] before their way."""
    return Going(pack, ambient_C, *unpack(pack, x), x[X.BIAS], curve_tables(pack))


def source(going: Going) -> Source:
    """Return the draws as a load meets them."""
    charged_V, new_ohmAh, drift_sd_V = looked_up(going.tables, going.state.soc)
    emf_V, r_ohmAh = model.source_from(going.cell, going.state, charged_V, new_ohmAh)
    return Source(emf_V + going.bias_V, r_ohmAh, drift_sd_V)


def walked(going: Going, at: Source, power_W: Array, dt_s: Array | float, normals: Array) -> Going:
    """Return the draws, which are `at` now, after `dt_s` [s] of `power_W` [W]; `normals` kick the model's error."""
    cell, state, pack, rate = going.cell, going.state, going.pack, _rate(going, at, power_W)
    later = model.step_cell(cell, state, rate, at.r_ohmAh, going.ambient_C, dt_s, model.cell_lags(cell, dt_s))
    memory = np.exp(-np.asarray(dt_s) / pack.bias_tau_s)
    doubt_V2 = drift_variance(at.drift_sd_V, rate * (np.asarray(dt_s) / SECONDS_PER_HOUR))
    kick_V = np.sqrt(pack.bias_sd_V**2 * (1.0 - memory**2) + doubt_V2) * normals
    return going._replace(state=later, bias_V=memory * going.bias_V + kick_V)


def above_cutoff_V(going: Going, at: Source, power_W: Array) -> Array:
    """Return by how much the metered voltage of the pack is above its cut-off under a power [W]."""
    installation, rate = going.installation, _rate(going, at, power_W)
    series_ohmAh = series_resistance(installation, at.r_ohmAh)
    cell_V = model.loaded_voltage(going.cell, at.emf_V, series_ohmAh, rate)
    if is_on(installation.deficit):
        strong_V = cell_V - going.bias_V + rate * (series_ohmAh - at.r_ohmAh)
        cell_V = cell_V + weak_lag(installation, going.cell, going.state, rate, strong_V)
    return np.asarray(metered_voltage(installation, installation.cells * cell_V) - going.pack.cutoff_V)


def _rate(going: Going, at: Source, power_W: Array) -> Array:
    """C-rate [1/h] under a power.

    A pack far beyond empty, whose voltage has turned round, gives nothing: it must not be charged by the way.
    """
    installation = going.installation
    size = installation.cells * installation.present_capacity_Ah
    rate = model.rate_at_power(going.cell, at.emf_V, series_resistance(installation, at.r_ohmAh), power_W / size)
    return np.asarray(np.maximum(rate, 0.0))
