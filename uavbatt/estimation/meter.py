"""A voltmeter of coarse steps: while its reading stands still, its error is not another one from row to row.

A meter of 0.2 V shows a pack of 3 V a minute fifteen times the same. As independent readings they say that the voltage
does not fall, so that the pack must be larger; and the next step says that it is smaller.
"""

from __future__ import annotations

import math
from typing import NamedTuple

# The step is known once the reading has changed so often. Finer steps are within the noise that every reading has.
CHANGES, COARSE_CELL_V = 8.0, 0.02


class Meter(NamedTuple):
    """Meter holds the last reading of a voltmeter and its smallest change so far [V], its changes, and its age [s]."""

    voltage_V: float = math.nan
    step_V: float = math.inf
    changes: float = 0.0
    held_s: float = 0.0


def meter_after(meter: Meter, voltage_V: float, dt_s: float) -> Meter:
    """Return the meter after one more row, `dt_s` [s] after the last one."""
    if voltage_V == meter.voltage_V:
        return Meter(voltage_V, meter.step_V, meter.changes, meter.held_s + dt_s)
    step_V = min(meter.step_V, abs(voltage_V - meter.voltage_V)) if math.isfinite(meter.voltage_V) else math.inf
    return Meter(voltage_V, step_V, meter.changes + 1.0, 0.0)


def meter_variance(meter: Meter, cells: float, block_s: float) -> float:
    """Return the variance [V²] of the mean reading of a block by the steps of its meter; 0 for a meter of fine steps.

    It grows with every block of `block_s` [s] for which the reading has stood still: their errors are one error.
    """
    if meter.changes < CHANGES or meter.step_V < COARSE_CELL_V * cells:
        return 0.0
    return meter.step_V**2 / 12.0 * (1.0 + meter.held_s / block_s)
