"""The time at which a discharge falls to a voltage.

Readings are joined by straight lines. Below about -15 °C a pack recovers by its own heat: the voltage crosses a level,
rises again and falls for good, so that the first and the last crossing differ by minutes (-17 °C: 10 V at 0.94 and
3.10 min). The caller says which one it wants (`which`).
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from uavbatt.validation.iso5725.cells import Array

Which = Literal["first", "last", "held"]
HOLD_S = 60.0  # a voltage that stays below a level for so long has fallen for good


def _crossings(time_s: Array, voltage_V: Array, level_V: float, downward: bool) -> Array:
    v = voltage_V - level_V if downward else level_V - voltage_V
    i = np.flatnonzero((v[:-1] >= 0) & (v[1:] < 0))
    times: Array = time_s[i] + (time_s[i + 1] - time_s[i]) * v[i] / (v[i] - v[i + 1])
    return times


def downward_crossings(time_s: Array, voltage_V: Array, level_V: float) -> Array:
    """List every time [s] at which the voltage falls through `level_V` [V]; readings that are NaN are passed over."""
    measured = ~np.isnan(voltage_V)
    return _crossings(time_s[measured], voltage_V[measured], level_V, True)


def crossing_time(time_s: Array, voltage_V: Array, level_V: float, which: Which = "first") -> float:
    """Return the time [s] of the first or last fall through `level_V` [V], NaN if there is none.

    "held" is the first fall after which the voltage stays below for `HOLD_S` (or to the end of the record).
    """
    down = downward_crossings(time_s, voltage_V, level_V)
    if not len(down):
        return math.nan
    if which == "held":
        measured = ~np.isnan(voltage_V)
        up = _crossings(time_s[measured], voltage_V[measured], level_V, False)
        next_up = [float(up[up > t].min(initial=math.inf)) for t in down]
        return float(next(t for t, u in zip(down, next_up, strict=True) if u - t >= HOLD_S or t == down[-1]))
    return float(down[0 if which == "first" else -1])
