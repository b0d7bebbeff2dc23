"""Open-loop simulation of many columns, compiled: the twin of `openloop.states`, equal to it to rounding."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import overload

from uavbatt.battery import model
from uavbatt.battery.model import Array, Parameters, State
from uavbatt.compiled.jit import compiled, compiled_numbers

TABLES = ("ocv_V", "r0_ohmAh")


def states(p: Parameters, start: State, c_rate: Array, dt_s: Array, ambient_C: Any) -> State:
    """Simulate columns as `battery.openloop.states` does; returns the state at every row, [rows, batch] each."""
    rows, batch = c_rate.shape

    def each(value: Any) -> Array:
        return np.array(np.broadcast_to(value, (batch,)), dtype=float)

    columns = {name: each(value) for name, value in p._asdict().items() if name not in TABLES}
    tables = {name: np.array(np.atleast_2d(getattr(p, name)), dtype=float) for name in TABLES}
    steps_s = np.broadcast_to(dt_s if dt_s.ndim == 2 else dt_s[:, None], (rows, batch))
    found = walk(
        Parameters(**tables, **columns),
        State(*(each(value) for value in start)),
        np.array(c_rate.T, order="C"),
        np.array(steps_s.T, order="C"),
        each(ambient_C),
    )
    return State(*(np.ascontiguousarray(values.T) for values in found))


def column(p: Parameters, j: int) -> Parameters:
    """Return column `j` of parameters that are arrays; a table of one row serves all. For compiled code only."""
    raise NotImplementedError


def _column_of(p: Any, j: Any) -> Any:
    """Return the source of `column` for this record, whatever fields it has."""
    rows = {name: f"p.{name}[j if p.{name}.shape[0] > 1 else 0]" for name in TABLES}
    values = ", ".join(rows.get(name, f"p.{name}[j]") for name in p.instance_class._fields)
    scope: dict[str, Any] = {"made": p.instance_class}
    exec(f"def column(p, j):\n    return made({values})", scope)
    return scope["column"]


overload(column, strict=False)(_column_of)


@compiled
def walk(p: Parameters, start: State, c_rate: Array, dt_s: Array, ambient_C: Array) -> Array:
    """Return the states [5, batch, rows] under `c_rate` [batch, rows]."""
    batch, rows = c_rate.shape
    out = np.empty((5, batch, rows))
    for j in range(batch):
        s = State(start.soc[j], start.polarisation_V[j], start.diffusion_V[j], start.core_C[j], start.sensor_C[j])
        walk_one(column(p, j), s, c_rate[j], dt_s[j], ambient_C[j], out[:, j])
    return out


@compiled_numbers
def walk_one(cell: Parameters, s: State, c_rate: Array, dt_s: Array, ambient_C: float, out: Array) -> None:
    """Write the states of one column under `c_rate` [rows] into `out` [5, rows]."""
    lags, lags_s = model.lags(cell, dt_s[0]), dt_s[0]
    for k in range(dt_s.size):
        if dt_s[k] != lags_s:
            lags, lags_s = model.lags(cell, dt_s[k]), dt_s[k]
        if k > 0:
            s = model.step(cell, s, c_rate[k], ambient_C, dt_s[k], lags)
        out[0, k], out[1, k], out[2, k], out[3, k], out[4, k] = s
