"""Memory of each sensor between two rows, and the rule by which its next reading is used; one value for each sensor.

`after` takes the next reading in: it returns the value after it, and the reading to use, NaN if none may be used.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from uavbatt.limits import EMPTIEST_CELL_V, HIGHEST_C_RATE, is_answered
from uavbatt.records import NAN, Sample

HELD_CURRENT_S = 5.0
LEAP_C = 3.0  # a change of the current that also a rounded or noisy voltage shows
LEVEL_TAU_S = 2.0
ANSWER_WITHIN_S = 2.0
SLOWEST_ROW_S = 30.0  # rows farther apart tell no leap
RISE_S_PER_C, RISE_WITHIN_S = 1.0, 10.0  # the larger a rise, the surer would the voltage show it
ABSENT_S = 5.0  # without a current for so long from the start: there is no sensor
LEAP_SHARE, LEAP_WITHIN_S = 0.25, 5.0  # full throttle takes a fifth of the voltage, of an empty pack a quarter
CONNECTED_CELL_V = 1.0  # an open input of an autopilot floats below it; no cell of a pack that flies does
NO_CELL_V = 0.8  # before any pack was seen: an open input
RESTING_CELL_V = 1.8  # at rest no cell of a pack that flew is below it; USB power shows 1.3 V a cell of 4, 1.8 of 3
BROKEN_FALL_V = 1.0  # a cell that falls so far below its last seconds, under the same current, has lost its meter
ONE_CELL = 1.25  # a fall of fewer cells' voltage may be a cell that fails
LOWEST_READING_V, HIGHEST_READING_V = 0.5, 5.0  # of a cell; outside, the monitor is at fault
CELL_SPREAD_TAU_S = 30.0
MIN_CELL_C, MAX_CELL_C = -40.0, 85.0
# A cell in a flying pack has a thermal time constant of minutes: a reading that moves faster is a chip's, or noise.
# What has leapt further than LEAP_K is a sensor that failed: to wait a minute makes it no better.
MAX_SLOPE_K_PER_S, LEAP_K, SLOW_SLOPE_K_PER_S = 1.0, 10.0, 0.05
SLACK_K = 1.0  # sensors with 1 K resolution step by 1 K
BOARD_START_C = 40.0  # 42 to 54 °C were seen in a flight controller whose sensor is on its circuit board


class VoltageSeen(NamedTuple):
    """VoltageSeen holds the last voltage that was used, its time, and voltage and current of the last seconds."""

    used_V: float = NAN
    used_s: float = NAN
    level_V: float = NAN  # smoothed
    level_A: float = NAN  # smoothed in the same way
    odd_V: float = NAN  # last voltage, if it leapt: used if the next row repeats it
    is_broken: bool = False  # the wire of the voltmeter is broken

    def after(self, sample: Sample, cells: int, leap_A: float) -> tuple[VoltageSeen, float]:
        """Take the voltage of a row in. A sudden change is used from its second row on: one row may be a damaged frame.

        cells : in series, 0 while unknown; leap_A : a rise of the current [A] that may explain a fall of the voltage.
        """
        time_s, voltage_V = sample.time_s, sample.voltage_V
        if not math.isfinite(voltage_V):
            return self, voltage_V
        least_V = cells * (RESTING_CELL_V if sample.armed is False else CONNECTED_CELL_V)
        if voltage_V < (least_V if least_V <= self.used_V else NO_CELL_V):
            return self, NAN
        if self._is_broken_by(sample, cells, leap_A):
            return self._replace(is_broken=True), NAN
        dt_s = time_s - self.used_s
        is_soon, is_repeated = dt_s <= LEAP_WITHIN_S, abs(voltage_V - self.odd_V) <= LEAP_SHARE * self.odd_V
        if is_soon and not is_repeated and not abs(voltage_V - self.used_V) <= LEAP_SHARE * self.used_V:
            return self._replace(odd_V=voltage_V), NAN
        keep = math.exp(-max(dt_s, 0.0) / LEVEL_TAU_S) if is_soon else 0.0
        level_V, level_A = _blended(self.level_V, voltage_V, keep), _blended(self.level_A, sample.current_A, keep)
        return VoltageSeen(voltage_V, time_s, level_V, level_A), voltage_V

    def _is_broken_by(self, sample: Sample, cells: int, leap_A: float) -> bool:
        """Return True if the wire of the voltmeter has broken in the air, or is broken still; parameters as above."""
        if sample.armed is False or sample.voltage_V >= cells * EMPTIEST_CELL_V:
            return False
        is_at_once = sample.time_s - self.used_s <= LEAP_WITHIN_S
        deep_V = max(cells * BROKEN_FALL_V, ONE_CELL * self.level_V / max(cells, 1))
        is_deep = self.level_V - sample.voltage_V > deep_V
        return self.is_broken or (is_at_once and is_deep and not sample.current_A - self.level_A > leap_A)


def _blended(before: float, now: float, keep: float) -> float:
    """Return the mean of two values, the first with the weight `keep`; one that is NaN does not count."""
    if math.isnan(now):
        return before
    return now + keep * (before - now) if keep and math.isfinite(before) else now


class TemperatureSeen(NamedTuple):
    """TemperatureSeen holds the last plausible temperature [°C], its time [s], and if it is that of a board."""

    temp_C: float = NAN
    temp_s: float = NAN
    is_board: bool = False

    def after(self, time_s: float, temp_C: float, hottest_start_C: float) -> tuple[TemperatureSeen, float]:
        """Take a temperature in; `hottest_start_C` is the highest first one of a sensor in the pack [°C]."""
        temp_C = plausible_temperature_C(temp_C, self.temp_C, time_s - self.temp_s)
        if not math.isfinite(temp_C):
            return self, NAN
        is_board = self.is_board or (not math.isfinite(self.temp_C) and temp_C > hottest_start_C)
        return TemperatureSeen(temp_C, time_s, is_board), NAN if is_board else temp_C


def plausible_temperature_C(temp_C: float, previous_C: float = NAN, elapsed_s: float = NAN) -> float:
    """Return `temp_C` [°C] if a cell may have it, else NaN.

    previous_C : the last plausible reading [°C]; elapsed_s : its age [s]; NaN where there was none. Fields that are
    not set read exactly 0.0, which is not used; a real 0.00 °C costs one row.
    """
    if not MIN_CELL_C <= temp_C <= MAX_CELL_C or temp_C == 0.0:
        return NAN
    passed_s = max(elapsed_s, 0.0)
    if abs(temp_C - previous_C) > SLACK_K + min(MAX_SLOPE_K_PER_S * passed_s, LEAP_K + SLOW_SLOPE_K_PER_S * passed_s):
        return NAN
    return temp_C


class CurrentSeen(NamedTuple):
    """CurrentSeen holds the last current that was used, its time, and the voltage with it."""

    used_A: float = NAN
    used_s: float = NAN
    used_V: float = NAN
    leapt_s: float = NAN  # time of a leap that the voltage has not shown yet
    first_s: float = NAN  # time of the first row without a current
    is_metered: bool = False  # a current was read
    is_guessed: bool = False  # the current is worked out from a power

    def after(
        self, sample: Sample, level_V: float, capacity_Ah: float, *, is_compensated: bool = False
    ) -> tuple[CurrentSeen, float]:
        """Take the current of a row in; returns it as read, or the last one for a while if it is missing or leaps.

        sample : with the voltage that is used; level_V : the voltage over the last seconds [V]; capacity_Ah : of the
        pack [Ah]; is_compensated : the voltage does not show the load.
        """
        time_s, read_A = sample.time_s, sample.current_A
        if not abs(read_A) <= HIGHEST_C_RATE * capacity_Ah:  # not read, or of no pack of this size
            if time_s - self.used_s <= HELD_CURRENT_S:
                return self, self.used_A
            return self._replace(is_metered=self.is_metered or math.isfinite(read_A)), NAN
        leap_C = (read_A - self.used_A) / capacity_Ah
        since_s = self.leapt_s if math.isfinite(self.leapt_s) else time_s
        is_leap = abs(leap_C) > LEAP_C and since_s - self.used_s <= SLOWEST_ROW_S and math.isfinite(self.used_V)
        if is_leap and not any(is_answered(leap_C, sample.voltage_V, before_V) for before_V in (self.used_V, level_V)):
            rise_s = 0.0 if is_compensated else min(RISE_S_PER_C * leap_C, RISE_WITHIN_S)
            if time_s - since_s < max(ANSWER_WITHIN_S, rise_s):
                return self._replace(leapt_s=since_s), self.used_A
        return CurrentSeen(read_A, time_s, sample.voltage_V, is_metered=True), read_A

    def worked_out(self, sample: Sample, stated_W: float, assumed_W: float) -> tuple[CurrentSeen, float]:
        """Return the current of a row without a sensor from a power [W]: at once from a stated one, later an assumed
        one.
        """
        first_s, is_stated = self.first_s if math.isfinite(self.first_s) else sample.time_s, math.isfinite(stated_W)
        power_W = stated_W if is_stated else assumed_W
        is_absent = is_stated or sample.time_s - first_s >= ABSENT_S
        if not (is_absent and math.isfinite(power_W) and sample.voltage_V > 0.0):
            return self._replace(first_s=first_s), NAN
        current_A = 0.0 if sample.armed is False else power_W / sample.voltage_V
        return self._replace(first_s=first_s, is_guessed=True), current_A


class CellsSeen(NamedTuple):
    """CellsSeen holds how far the weakest cell is below the mean [V], smoothed, and the time of the last row [s]."""

    spread_V: float = 0.0
    spread_s: float = NAN

    def after(self, time_s: float, cell_voltages_V: tuple[float, ...]) -> CellsSeen:
        """Return the value after a row with the voltages of the cells [V]."""
        cells = [v for v in cell_voltages_V if math.isfinite(v) and v > 0.0]
        if len(cells) < 2 or not all(LOWEST_READING_V < v < HIGHEST_READING_V for v in cells):
            return self
        spread_V = sum(cells) / len(cells) - min(cells)
        if not math.isfinite(self.spread_s):
            return CellsSeen(spread_V, time_s)
        keep = math.exp(-max(time_s - self.spread_s, 0.0) / CELL_SPREAD_TAU_S)
        return CellsSeen(keep * self.spread_V + (1.0 - keep) * spread_V, time_s)
