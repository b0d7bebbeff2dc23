"""Two batteries that report as one: the readings go back and forth between two levels, nearly from row to row.

Another battery under the same id (a payload's, a second pack with its own monitor) has another voltage or another
current. No filter finds the pack that flies in their mixture, and it was up to 45 minutes too long. A reading that
comes back to a level, but not to the same digit, is counted: a coarse sensor also goes back and forth, from one digit
to the next. A load in pulses of some seconds stays at each level for some rows. Over 259 logs of flights the count
reached 2.9; two batteries reach 5 to 10 within 10 to 20 s. They also look like a pack that is changed again and again:
what is counted here outlives a change of the pack.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from uavbatt.estimation.sensor_row import SensorRow

RETURNS, RETURNS_TAU_S = 4.0, 15.0
LONGEST_COUNT_S = 30.0  # in which two batteries reach that count
APART_CELL_V, APART_C_RATE = 0.04, 1.0  # levels that are closer do no harm
SWITCHES, ROWS_KEPT = 0.6, 0.95  # share of the last 20 rows or so that came from the other level
DOUBTED_S = 120.0  # after the last such reading: the levels may cross, and the belief has followed both
NEAR_SHARE = 0.2  # of the distance of the levels: a reading so near to one belongs to it


class TwoLevels(NamedTuple):
    """TwoLevels follows one reading that may come from two batteries.

    here, there : the last reading of the level of the last row, and of the other level; returns : how often the reading
    came back to the other level, over about RETURNS_TAU_S; switches : the share of the last rows that did.
    """

    time_s: float = math.nan
    here: float = math.nan
    there: float = math.nan
    returns: float = 0.0
    switches: float = 0.0

    def after(self, time_s: float, value: float, least_apart: float) -> TwoLevels:
        """Return the same after one more row; levels closer than `least_apart` are one."""
        if not math.isfinite(self.here):
            return TwoLevels(time_s, value)
        apart, leap, off = abs(self.there - self.here), abs(value - self.here), abs(value - self.there)
        returns = self.returns * math.exp(-(time_s - self.time_s) / RETURNS_TAU_S)
        switches = self.switches * ROWS_KEPT
        if off < NEAR_SHARE * apart and apart > least_apart:
            return TwoLevels(time_s, value, self.here, returns + (off > 0.0), switches + 1.0 - ROWS_KEPT)
        if leap < least_apart or leap < NEAR_SHARE * apart:
            return TwoLevels(time_s, value, self.there, returns, switches)
        return TwoLevels(time_s, value, self.here)


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
        time_s = row.time_s
        voltage = self.voltage.after(time_s, row.voltage_V, APART_CELL_V * row.cells)
        current = self.current.after(time_s, row.current_A, APART_C_RATE * row.capacity_Ah)
        for levels in (voltage, current):
            if levels.returns > RETURNS and levels.switches > SWITCHES:
                since_s = self.since_s if self.are_likely(time_s) else time_s - LONGEST_COUNT_S
                return TwoBatteries(voltage, current, since_s, time_s)
        return TwoBatteries(voltage, current, self.since_s, self.seen_s)

    def are_likely(self, time_s: float) -> bool:
        """Return True if the readings of the last minutes came from two batteries."""
        return time_s - self.seen_s <= DOUBTED_S
