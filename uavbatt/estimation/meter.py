"""A voltmeter that is worse than an ordinary one: it reads in coarse steps, or its readings scatter.

While a coarse reading stands still, its error is one error. As independent readings it says that the voltage does not
fall, so that the pack must be larger; and the next step says that it is smaller. Scatter that the filter does not
expect makes it sure of a random capacity.
"""

from __future__ import annotations

import math
from typing import NamedTuple

# The step is known once the reading has changed so often. Finer steps are within the noise that every reading has.
CHANGES, COARSE_CELL_V = 8.0, 0.02
# Scatter from block to block: its mean over some blocks, and how much of it chance alone may bring.
SCATTER_BLOCKS, CHANCE_CELL_V = 8.0, 0.005
SD_OF_CHANGE = math.sqrt(math.pi) / 2.0  # sd of a normal distribution over the mean distance of two draws


class Meter(NamedTuple):
    """Meter holds the last reading of a voltmeter [V], how long it has stood still [s], and its steps.

    step_V : the smallest change so far [V]; changes : how many there were.
    """

    voltage_V: float = math.nan
    held_s: float = 0.0
    step_V: float = math.inf
    changes: float = 0.0


class Scatter(NamedTuple):
    """Scatter holds the innovation of the last block [V], and the mean change [V] from one to the next."""

    innovation_V: float = math.nan
    change_V: float = 0.0
    blocks: float = 0.0  # over which the mean is taken


def meter_after(meter: Meter, voltage_V: float, dt_s: float) -> Meter:
    """Return the meter after one more row, `dt_s` [s] after the last one."""
    if voltage_V == meter.voltage_V:
        return Meter(voltage_V, meter.held_s + dt_s, meter.step_V, meter.changes)
    step_V = min(meter.step_V, abs(voltage_V - meter.voltage_V)) if math.isfinite(meter.voltage_V) else math.inf
    return Meter(voltage_V, 0.0, step_V, meter.changes + 1.0)


def scatter_after(scatter: Scatter, innovation_V: float) -> Scatter:
    """Return the scatter after one more block, whose voltage is so far from the expected one [V]."""
    change_V, blocks = scatter.change_V, min(scatter.blocks + 1.0, SCATTER_BLOCKS)
    if math.isfinite(scatter.innovation_V):
        change_V += (abs(innovation_V - scatter.innovation_V) - change_V) / blocks
    return Scatter(innovation_V, change_V, blocks)


class MeterNoise(NamedTuple):
    """MeterNoise holds the least variance of the mean reading of a block by its scatter, and what steps add [V²]."""

    least_V2: float
    more_V2: float


def meter_noise(meter: Meter, scatter: Scatter, block_s: float, cells: float) -> MeterNoise:
    """Return the noise of the mean reading of a block of `block_s` [s], for a pack of so many cells in series.

    The variance by coarse steps grows with every block for which the reading has stood still: it is one error.
    """
    least_V2 = max((SD_OF_CHANGE * scatter.change_V) ** 2 - (CHANCE_CELL_V * cells) ** 2, 0.0)
    if meter.changes < CHANGES or meter.step_V < COARSE_CELL_V * cells:
        return MeterNoise(least_V2, 0.0)
    return MeterNoise(least_V2, meter.step_V**2 / 12.0 * (1.0 + meter.held_s / block_s))
