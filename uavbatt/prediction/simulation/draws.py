"""The packs of a forecast in flight: draws of a belief under power to come, and one step of theirs.

Constant power within a step, not constant current: a sinking voltage draws more current, which is what empties a pack
sooner than charge counting says. Each step solves V I = P and advances the model exactly. `time_to_end` flies the draws
to their end, `long_steps` over a given time. `Flying` is what a forecast is asked to fly; `Draws` are on their way.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery import equations as eq
from uavbatt.battery import model
from uavbatt.battery.equations import Number
from uavbatt.battery.model import GRID_STEP, LOWEST_SOC, Array, Lags, Parameters, State, UnderLoad
from uavbatt.battery.pack import Installation, series_resistance, weak_lag
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import X, bias_variance, drift_variance, unpack

# Constants that are combined with arrays at every step: numpy works a third faster with 0-d arrays than with floats.
MET_AT_EVERY_STEP = ("polarisation_ratio", "diffusion_ratio", "activation_K", "heat_gain", "charge_gain")


class Flying(NamedTuple):
    """Flying holds the packs of a forecast, drawn from a belief, and the power that each will fly.

    pack : with the limits of its weakest cell; x : the draws [9, draws]; power_W : true power [W], [steps, draws];
    ambient_C : temperature of the air [°C]; dt_s : lengths of the steps [s], [steps]; reserve_soc : charge that shall
    be left at the end; by_rows : the steps are the telemetry's rows, between which the power goes straight, and the
    median of three of them judges. Several forecasts fly side by side with a batch of two dimensions, over which
    `dt_s`, `ambient_C` and the pack's limits broadcast.
    """

    pack: Pack
    x: Array
    power_W: Array
    ambient_C: Number
    dt_s: Array
    reserve_soc: float = 0.0
    by_rows: bool = False


class Draws(NamedTuple):
    """Draws holds the draws of a forecast on their way: cells, installations, states, and the model's errors [V]."""

    pack: Pack
    ambient_C: Number
    cell: Parameters
    installation: Installation
    harness_ohmAh: Number  # a cell's share of it
    state: State
    bias_V: Array
    tables: Array  # `curve_tables`

    def of(self, which: NDArray[Any] | slice) -> Draws:
        """Return the draws of some of several beginnings [beginnings, draws] that go on side by side."""
        return self._replace(state=State(*(column[which] for column in self.state)), bias_V=self.bias_V[which])


class Source(NamedTuple):
    """Source is the voltage source that a load meets in each cell now, as `model.source` has it.

    emf_V holds the model's error as well, series_ohmAh the harness; drift_sd_V is how fast that error changes at this
    charge.
    """

    emf_V: Array
    r_ohmAh: Array
    series_ohmAh: Array
    drift_sd_V: Array


class Step(NamedTuple):
    """Step holds the length of a step [s], the lags of the cell over it, and the variance the model's error gains [V²].

    It holds those of many steps as well, [steps] each.
    """

    dt_s: Number
    lags: Lags
    gained_V2: Number

    def at(self, k: int) -> Step:
        """Return step `k` of many, as 0-d arrays like MET_AT_EVERY_STEP."""
        return Step(self.dt_s[k], Lags(*(lag[k, ...] for lag in self.lags)), self.gained_V2[k, ...])


def start_draws(flying: Flying) -> Draws:
    """Return the draws of a forecast at the start of their way."""
    pack = flying.pack
    cell, installation, state = unpack(pack, flying.x)
    cell = cell._replace(**{name: np.asarray(getattr(cell, name)) for name in MET_AT_EVERY_STEP if getattr(cell, name)})
    harness_ohmAh = series_resistance(installation, 0.0)
    bias_V, tables = flying.x[X.BIAS], curve_tables(pack)
    return Draws(pack, flying.ambient_C, cell, installation, harness_ohmAh, state, bias_V, tables)


def source_of(draws: Draws) -> Source:
    """Return the voltage source that a load meets in each draw now."""
    charged_V, new_ohmAh, drift_sd_V = looked_up(draws.tables, draws.state.soc)
    emf_V, r_ohmAh = model.source_from(draws.cell, draws.state, charged_V, new_ohmAh)
    return Source(emf_V + draws.bias_V, r_ohmAh, r_ohmAh + draws.harness_ohmAh, drift_sd_V)


def mean_cell_V(draws: Draws, at: Source, under: UnderLoad) -> Array:
    """Return the mean voltage of the cells [V] with their share of the harness; `at` is their source now."""
    cell_V: Array = model.voltage_under(at.emf_V, at.series_ohmAh, under)
    if eq.is_on(draws.installation.deficit):
        strong_V = cell_V - draws.bias_V + under.c_rate * draws.harness_ohmAh
        cell_V = cell_V + weak_lag(draws.installation, draws.cell, draws.state, under.c_rate, strong_V)
    return cell_V


def step_over(draws: Draws, dt_s: Number) -> Step:
    """Return the step of `dt_s` [s], or many of them, [steps]."""
    return Step(dt_s, model.lags(draws.cell, dt_s), bias_variance(draws.pack, dt_s))


def stepped(draws: Draws, at: Source, under: UnderLoad, step: Step, normals: Array) -> Draws:
    """Return the draws after a step under a load; `at` is their source before it, `normals` kick the model's error."""
    state = model.step_cell(draws.cell, draws.state, under, at.r_ohmAh, draws.ambient_C, step.dt_s, step.lags)
    doubt_V2 = drift_variance(at.drift_sd_V, under.c_rate * (step.dt_s / eq.SECONDS_PER_HOUR))
    return draws._replace(state=state, bias_V=draws.bias_V + np.sqrt(step.gained_V2 + doubt_V2) * normals)


def curve_tables(pack: Pack) -> Array:
    """Return `ocv_V`, `r0_ohmAh` and `ocv_drift_sd_V` of a pack as [left end or rise, curve, segment of SOC_GRID].

    In one array a step looks all of them up at once. A segment is added at each end of the grid: there the open-circuit
    voltage goes straight on, the others are flat.
    """
    curves = np.stack([pack.cell.ocv_V, pack.cell.r0_ohmAh, pack.spread.ocv_drift_sd_V])
    goes_on = np.array([[1.0], [0.0], [0.0]])
    below, above = goes_on * (curves[:, 1:2] - curves[:, :1]), goes_on * (curves[:, -1:] - curves[:, -2:-1])
    nodes = np.concatenate([curves[:, :1] - below, curves, curves[:, -1:] + above], axis=1)
    return np.stack([nodes[:, :-1], np.diff(nodes)])


def looked_up(tables: Array, soc: Array) -> Array:
    """Return the values of the curves in `tables` (`curve_tables`) at a charge [batch], as [curve, batch]."""
    index, share = eq.segment(soc, LOWEST_SOC - GRID_STEP, GRID_STEP, tables.shape[2])
    found = np.asarray(tables.take(index, axis=2))
    return np.asarray(found[0] + found[1] * share)
