"""What is known of a pack at one instant: a mean and a covariance over eight named components.

The components are the cell's state, two slow scales that tell this pack from its type, and the model's own
slowly wandering error, so that a filter does not take a misfit of the model for knowledge:

    soc, polarisation_V, diffusion_V, core_C, sensor_C    state of an average cell
    log_resistance, log_capacity                          ln of this pack's scale against the battery file
    bias_V                                                discrepancy per cell, an Ornstein-Uhlenbeck process

`transition` and `voltage` act on columns: x [8] or [8, batch]. Filter and forecast share them.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from uavbatt.battery import equations as eq
from uavbatt.battery import model
from uavbatt.battery.build import Pack
from uavbatt.battery.equations import Number
from uavbatt.battery.model import Array, Parameters, State
from uavbatt.battery.pack import Installation, c_rate, grown, metered_voltage, terminal_voltage


class C(IntEnum):
    """Index of a component in the vector."""

    SOC = 0
    POLARISATION = 1
    DIFFUSION = 2
    CORE = 3
    SENSOR = 4
    LOG_RESISTANCE = 5
    LOG_CAPACITY = 6
    BIAS = 7


SIZE = len(C)


@dataclass(frozen=True, slots=True)
class Belief:
    """Mean [8] and covariance [8, 8] at `time_s`, with the ambient temperature that the heat flows to."""

    time_s: float
    mean: Array
    covariance: Array
    ambient_C: float


class Unpacked(NamedTuple):
    """One belief vector as the model's own records."""

    cell: Parameters
    installation: Installation
    state: State


def unpack(pack: Pack, x: Array) -> Unpacked:
    """The model's records for the columns of x, the pack's scales applied."""
    installation = pack.installation._replace(
        capacity_Ah=pack.installation.capacity_Ah * np.exp(x[C.LOG_CAPACITY]),
    )
    cell = grown(pack.cell, installation)
    cell = cell._replace(resistance_gain=cell.resistance_gain * np.exp(x[C.LOG_RESISTANCE]))
    state = State(x[C.SOC], x[C.POLARISATION], x[C.DIFFUSION], x[C.CORE], x[C.SENSOR])
    return Unpacked(cell, installation, state)


def transition(pack: Pack, x: Array, current_A: Number, ambient_C: float, dt_s: float) -> Array:
    """The columns `dt_s` later, `current_A` (true, of the pack) held; any step from 0.05 s to minutes."""
    now = unpack(pack, x)
    later = model.advance(now.cell, now.state, c_rate(now.installation, current_A), ambient_C, dt_s)
    out = x.copy()
    out[C.SOC], out[C.POLARISATION], out[C.DIFFUSION] = later.soc, later.polarisation_V, later.diffusion_V
    out[C.CORE], out[C.SENSOR] = later.core_C, later.sensor_C
    out[C.BIAS] = eq.relax(x[C.BIAS], 0.0, dt_s, pack.bias_tau_s)
    return out


def voltage(pack: Pack, x: Array, current_A: Number) -> Number:
    """Voltage that the telemetry should report [V] under a true pack current [A], the discrepancy included."""
    return reported_voltage(pack, unpack(pack, x), x[C.BIAS], current_A)


def reported_voltage(pack: Pack, now: Unpacked, bias_V: Number, current_A: Number) -> Number:
    """`voltage` of a vector that is unpacked already."""
    if pack.sag_compensated:
        current_A = 0.0 * current_A
    true_V = terminal_voltage(now.installation, now.cell, now.state, current_A)
    return metered_voltage(now.installation, true_V + now.installation.cells * bias_V)
