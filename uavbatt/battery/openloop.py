"""Open-loop simulation of many records at once: current in, voltage and temperature out.

No measurement corrects the state, so that the difference to the measured voltage is the model's own error. Each step is
one set of array operations over the batch (records × parameter variants), so that a whole Jacobian costs little more
than one simulation.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from uavbatt.battery.equations import Number
from uavbatt.battery.model import Array, Parameters, State, cell_voltage, lags, step

States = Callable[[Parameters, State, Array, Array, Number], State]


class Trajectory(NamedTuple):
    """A trajectory holds cell voltage [V], sensor and core temperature [°C] and state of charge, [rows, batch] each."""

    voltage_V: Array
    sensor_C: Array
    core_C: Array
    soc: Array


def simulate(p: Parameters, start: State, c_rate: Array, dt_s: Array, ambient_C: Array) -> Trajectory:
    """Run the model under `c_rate` [rows, batch]; `dt_s[k]` leads from row k-1 to row k, `dt_s[0]` is unused.

    The current of row k has flowed since row k-1 (a logger's row closes its interval), and the voltage of row k
    is under the current of row k. Steps should not exceed LONGEST_STEP_S: resample or repeat rows first.
    """
    passed = states(p, start, c_rate, dt_s, ambient_C)
    return Trajectory(cell_voltage(p, passed, c_rate), passed.sensor_C, passed.core_C, passed.soc)


def states(p: Parameters, start: State, c_rate: Array, dt_s: Array, ambient_C: Number) -> State:
    """Step the model along all rows; returns the state at every row, [rows, batch] each (arguments: `simulate`)."""
    out = State(*np.empty((len(State._fields), *c_rate.shape)))
    state, known, known_s = start, lags(p, dt_s[0]), dt_s[0]
    for k in range(c_rate.shape[0]):
        if not np.array_equal(dt_s[k], known_s):  # most steps are as long as the one before
            known, known_s = lags(p, dt_s[k]), dt_s[k]
        if k:
            state = step(p, state, c_rate[k], ambient_C, dt_s[k], known)
        for column, value in zip(out, state, strict=True):
            column[k] = value
    return out
