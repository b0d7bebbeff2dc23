"""Two batteries that report as one: the readings go back and forth between two levels, nearly from row to row.

Another battery under the same id (a payload's, a second pack with its own monitor) has another voltage or another
current. No filter finds the pack that flies in their mixture, and it was up to 45 minutes too long. A load in pulses of
some seconds stays at each level for some rows. A coarse sensor goes back and forth, too, but to the same digit. Two
batteries also look like a pack that is changed again and again: what is seen here outlives a change of the pack.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from uavbatt.estimation.sensor_row import SensorRow

# Shares of the last 20 rows or so. Over 259 logs of flights they were below a third of these limits.
SWITCHES, RETURNS, ROWS_KEPT = 0.6, 0.2, 0.95
LONGEST_COUNT_S = 30.0  # in which two batteries reach them, at a row a second
DOUBTED_S = 120.0  # after the last such reading: the levels may cross, and the belief has followed both
APART_CELL_V, APART_C_RATE = 0.04, 1.0  # levels that are closer do no harm
NEAR_SHARE = 0.2  # of the distance of the levels: a reading so near to one belongs to it


class TwoLevels(NamedTuple):
    """TwoLevels follows one reading that may come from two batteries.

    here, there : the last reading of the level of the last row, and of the other level; switches : the share of the
    last rows that came from the other level than the row before; returns : the same, without those to the same digit.
    """

    here: float = math.nan
    there: float = math.nan
    switches: float = 0.0
    returns: float = 0.0

    def after(self, value: float, least_apart: float) -> TwoLevels:
        """Return the same after one more row; levels closer than `least_apart` are one."""
        apart, leap, off = abs(self.there - self.here), abs(value - self.here), abs(value - self.there)
        switches, returns, share = self.switches * ROWS_KEPT, self.returns * ROWS_KEPT, 1.0 - ROWS_KEPT
        if off < NEAR_SHARE * apart and apart > least_apart:
            return TwoLevels(value, self.here, switches + share, returns + share * (off > 0.0))
        if leap < least_apart or leap < NEAR_SHARE * apart:
            return TwoLevels(value, self.there, switches, returns)
        return TwoLevels(value, self.here)


class TwoBatteries(NamedTuple):
    """TwoBatteries follows voltage and current of what reports as one battery.

    since_s, seen_s : times of the first (not later than) and of the last row that show two [s], NaN if there is none.
    """

    voltage: TwoLevels = TwoLevels()
    current: TwoLevels = TwoLevels()
    since_s: float = math.nan
    seen_s: float = math.nan

    def after(self, row: SensorRow) -> TwoBatteries:
        """Return the same after one more row."""
        voltage = self.voltage.after(row.voltage_V, APART_CELL_V * row.cells)
        current = self.current.after(row.current_A, APART_C_RATE * row.capacity_Ah)
        for levels in (voltage, current):
            if levels.switches > SWITCHES and levels.returns > RETURNS:
                since_s = self.since_s if self.are_likely(row.time_s) else row.time_s - LONGEST_COUNT_S
                return TwoBatteries(voltage, current, since_s, row.time_s)
        return TwoBatteries(voltage, current, self.since_s, self.seen_s)

    def are_likely(self, time_s: float) -> bool:
        """Return True if the readings of the last minutes came from two batteries."""
        return time_s - self.seen_s <= DOUBTED_S
