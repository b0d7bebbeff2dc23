"""State space of a pack: a mean and a covariance over nine named components, for each member of a sum of Gaussians.

The components are the cell's state, two slow scales of this pack against its type, and the model's own slowly changing
error, so that the filter does not take an error of the model for information:

    soc, polarisation_V, diffusion_V, core_C, sensor_C    state of an average cell
    log_resistance, log_capacity                          ln of this pack's scale against the battery file
    bias_V                                                discrepancy per cell, an Ornstein-Uhlenbeck process
    reaction_V                                            drop at a large load that this pack's electrodes take beyond
                                                          those of its type (`model.transfer_drop`); it stays

`transition` and `voltage` act on columns: x [9] or [9, batch]. Filter and forecast share them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from uavbatt.battery import equations as eq
from uavbatt.battery import model
from uavbatt.battery.equations import Number
from uavbatt.battery.model import Array, Parameters, State
from uavbatt.battery.pack import Installation, c_rate, compensated_voltage, grown, metered_voltage, terminal_voltage
from uavbatt.battery.scaling import Pack
from uavbatt.battery.spreads import DOUBT_LENGTH


class StateIndex(NamedTuple):
    """StateIndex names the index of each component of the state vector, as `X`.

    No IntEnum: before its version 0.68 numba takes none for the index of an array.
    """

    SOC: int = 0
    POLARISATION: int = 1
    DIFFUSION: int = 2
    CORE: int = 3
    SENSOR: int = 4
    LOG_RESISTANCE: int = 5
    LOG_CAPACITY: int = 6
    BIAS: int = 7
    REACTION: int = 8


X = StateIndex()
SIZE = len(X)


@dataclass(frozen=True, slots=True)
class Belief:
    """Belief is a sum of Gaussians; each member stands for another capacity of the pack.

    means [members, 9], covariances [members, 9, 9], log_weights [members]: ln of the members' weights, whose sum is 1;
    the ambient temperature [°C] is the one that the heat flows to.
    """

    means: Array
    covariances: Array
    log_weights: Array
    ambient_C: float
    weights: Array = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "weights", np.exp(self.log_weights))  # frozen: worked out once

    @classmethod
    def gaussian(cls, mean: Array, covariance: Array, ambient_C: float) -> Belief:
        """Return a belief of one member: mean [9], covariance [9, 9]."""
        return cls(mean[None], covariance[None], np.zeros(1), ambient_C)

    @property
    def mean(self) -> Array:
        """Return the mean [9] of the whole sum."""
        return np.asarray(self.weights @ self.means)

    @property
    def covariance(self) -> Array:
        """Return the covariance [9, 9] of the whole sum: within the members and between their means."""
        return mixed_covariance(self.means, self.covariances, self.weights)


def mixed_covariance(means: Array, covariances: Array, weights: Array) -> Array:
    """Return the covariance of a sum of Gaussians from its members' means, covariances and weights, whose sum is 1."""
    apart = means - weights @ means
    return np.asarray(np.tensordot(weights, covariances, 1) + (apart.T * weights) @ apart)


class Unpacked(NamedTuple):
    """Unpacked holds one belief vector as the model's own records."""

    cell: Parameters
    installation: Installation
    state: State


def unpack(pack: Pack, x: Array) -> Unpacked:
    """Return the model's records for the columns of x, with the pack's scales applied."""
    capacity_Ah = pack.installation.capacity_Ah * np.exp(x[X.LOG_CAPACITY])
    cell = grown(pack.cell, pack.installation)
    cell = cell._replace(
        resistance_gain=cell.resistance_gain * np.exp(x[X.LOG_RESISTANCE]),
        transfer_V=cell.transfer_V + x[X.REACTION],
    )
    state = State(x[X.SOC], x[X.POLARISATION], x[X.DIFFUSION], x[X.CORE], x[X.SENSOR])
    return Unpacked(cell, pack.installation._replace(capacity_Ah=capacity_Ah), state)


def transition(pack: Pack, x: Array, current_A: Number, ambient_C: float, dt_s: float) -> Array:
    """Return the columns `dt_s` later, `current_A` (true, of the pack) held; any step from 0.05 s to minutes."""
    now = unpack(pack, x)
    later = model.advance(now.cell, now.state, c_rate(now.installation, current_A), ambient_C, dt_s)
    out = x.copy()
    out[X.SOC], out[X.POLARISATION], out[X.DIFFUSION] = later.soc, later.polarisation_V, later.diffusion_V
    out[X.CORE], out[X.SENSOR] = later.core_C, later.sensor_C
    out[X.BIAS] = eq.relax(x[X.BIAS], 0.0, dt_s, pack.spread.bias_tau_s)
    return out


def bias_variance(pack: Pack, dt_s: Number) -> Number:
    """Return the variance [V²] that the discrepancy gains in `dt_s` [s] (Ornstein-Uhlenbeck)."""
    return pack.spread.bias_sd_V**2 * -np.expm1(-2.0 * dt_s / pack.spread.bias_tau_s)


def ocv_doubt(pack: Pack, soc: Number, drained: Number) -> Number:
    """Return the variance [V²] that the discrepancy gains while a share `drained` of the charge is drawn at `soc`.

    The error of the file's open-circuit voltage depends on the charge: over a change of the charge by DOUBT_LENGTH the
    part of it that changes at all becomes independent.
    """
    return drift_variance(at_charge(pack.spread.ocv_drift_sd_V, soc), drained)


def at_charge(table: Array, soc: Number) -> Number:
    """Return the value at a charge of a table over the model's grid of charges."""
    index, share = eq.segment(soc, model.LOWEST_SOC, model.GRID_STEP, model.SEGMENTS)
    return eq.interpolated(table, index, eq.held(share))


def drift_variance(drift_sd_V: Number, drained: Number) -> Number:
    """Return `ocv_doubt` [V²] with the known value of the table `ocv_drift_sd_V` at this charge."""
    return drift_sd_V**2 * (2.0 / DOUBT_LENGTH) * np.abs(drained)


def voltage(pack: Pack, x: Array, current_A: Number) -> Number:
    """Return the voltage [V] that the telemetry should report under a true current [A], the discrepancy included."""
    return reported_voltage(pack, unpack(pack, x), x[X.BIAS], current_A)


def reported_voltage(pack: Pack, now: Unpacked, bias_V: Number, current_A: Number) -> Number:
    """Return the `voltage` of an unpacked vector."""
    if pack.sag_compensated:  # by a guess of the resistance, without the drop of the reaction
        bias_V = bias_V - model.transfer_drop(now.cell, c_rate(now.installation, current_A))
        current_A = 0.0 * current_A
    true_V = terminal_voltage(now.installation, now.cell, now.state, current_A)
    metered_V = metered_voltage(now.installation, true_V + now.installation.cells * bias_V)
    return compensated_voltage(now.installation, metered_V, current_A)
