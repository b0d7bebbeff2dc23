"""Open-loop simulation of many records at once: current in, voltage and temperature out.

No measurement corrects the state on the way, so what differs from the measured voltage is the model's own
error. The time loop is in Python; each step is one set of array operations over the batch (records × parameter
variants), so that a whole Jacobian costs little more than one simulation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array, Parameters, State, cell_voltage, step


class Trajectory(NamedTuple):
    """Rows × batch: cell voltage [V], sensor and core temperature [°C], state of charge."""

    voltage_V: Array
    sensor_C: Array
    core_C: Array
    soc: Array


def simulate(p: Parameters, start: State, c_rate: Array, dt_s: Array, ambient_C: Array) -> Trajectory:
    """Run the model under `c_rate` [rows, batch]; `dt_s[k]` leads from row k-1 to row k, `dt_s[0]` is unused.

    The current of row k has flowed since row k-1 (a logger's row closes its interval), and the voltage of row k
    is under the current of row k. Steps should not exceed LONGEST_STEP_S: resample or repeat rows first.
    """
    rows, batch = c_rate.shape
    out = Trajectory(*(np.empty((rows, batch)) for _ in Trajectory._fields))
    state = State(*(np.broadcast_to(np.asarray(x, dtype=float), (batch,)) for x in start))
    for k in range(rows):
        if k:
            state = step(p, state, c_rate[k], ambient_C, dt_s[k])
        out.voltage_V[k] = cell_voltage(p, state, c_rate[k])
        out.sensor_C[k], out.core_C[k], out.soc[k] = state.sensor_C, state.core_C, state.soc
    return out
