"""A discharge through a speed controller: constant current, reduced where the cell would fall below the limit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from uavbatt.battery import model
from uavbatt.battery.equations import Number
from uavbatt.battery.model import Array, Parameters, State


def limited_rate(emf_V: Number, r_ohmAh: Number, demand: Array, limit_V: Array) -> Array:
    """Return the C-rate [1/h] that leaves the cell at `limit_V` or above, at most the demand."""
    rate: Array = np.minimum(np.maximum((emf_V - limit_V) / r_ohmAh, 0.0), demand)
    return rate


def limited_discharge(
    cell_in: Callable[[State], Parameters],
    start: State,
    demand: Array,
    limit_V: Array,
    ambient_C: Number,
    time_s: Array,
    step_s: float,
) -> Array:
    """Simulate tests side by side from `start`, each with a constant C-rate [1/h] until its limit holds.

    cell_in: the cell's parameters in a state; its lags may not change. time_s: instants [s]; the one at 0 is before the
    load. step_s: longest step [s]. Returns [2, instants, tests]: cell voltage [V] and sensor temperature [°C]; tests
    are in the shape of `demand`.
    """
    out = np.empty((2, time_s.size, *demand.shape))
    state, now_s, lags_of = start, 0.0, dict[float, model.Lags]()
    cell = cell_in(state)
    emf_V, r_ohmAh = model.source(cell, state)
    for k, until_s in enumerate(time_s):
        while now_s < until_s - 1e-9:
            dt_s = min(step_s, until_s - now_s)
            if dt_s not in lags_of:
                lags_of[dt_s] = model.lags(cell, dt_s)
            rate = limited_rate(emf_V, r_ohmAh, demand, limit_V)
            state = model.step_with_resistance(cell, state, rate, r_ohmAh, ambient_C, dt_s, lags_of[dt_s])
            cell = cell_in(state)
            emf_V, r_ohmAh = model.source(cell, state)
            now_s += dt_s
        rate = limited_rate(emf_V, r_ohmAh, demand, limit_V) if until_s > 0.0 else np.zeros_like(demand)
        under = model.UnderLoad(rate, model.transfer_drop(cell, rate))
        out[0, k], out[1, k] = model.voltage_under(emf_V, r_ohmAh, under), state.sensor_C
    return out
