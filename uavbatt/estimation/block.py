"""Rows that the filter takes in together: fast telemetry is averaged over two seconds.

The row-to-row noise of a current sensor, multiplied by the resistance, would look like a voltage that does not answer
the current: a resistance too small. Means over two seconds leave little of it, and cost less.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from uavbatt.records import Sample

BLOCK_S = 2.0


class Block(NamedTuple):
    """Block holds the sums over the rows of a block, as a value: `after` gives the block with one row more."""

    rows: int = 0
    duration_s: float = 0.0
    charge_As: float = 0.0
    sum_V: float = 0.0
    sum_A: float = 0.0
    sum_C: float = 0.0
    temps: int = 0

    def after(self, sample: Sample, current_A: float, dt_s: float, previous_A: float) -> Block:
        """Return the block with one more row, `dt_s` [s] after a row of `previous_A` (trapezium rule)."""
        has_temp = math.isfinite(sample.temp_C)
        return Block(
            self.rows + 1,
            self.duration_s + dt_s,
            self.charge_As + 0.5 * (previous_A + current_A) * dt_s,
            self.sum_V + sample.voltage_V,
            self.sum_A + current_A,
            self.sum_C + (sample.temp_C if has_temp else 0.0),
            self.temps + has_temp,
        )

    @property
    def voltage_V(self) -> float:
        """Return the mean voltage [V]."""
        return self.sum_V / self.rows

    @property
    def current_A(self) -> float:
        """Return the mean of the rows' currents [A]."""
        return self.sum_A / self.rows

    @property
    def temp_C(self) -> float:
        """Return the mean temperature [°C]; NaN when no row had one."""
        return self.sum_C / self.temps if self.temps else math.nan


def is_complete(sample: Sample) -> bool:
    """Return True if the row has voltage and current, so that it can move the estimate."""
    return math.isfinite(sample.voltage_V) and math.isfinite(sample.current_A)
