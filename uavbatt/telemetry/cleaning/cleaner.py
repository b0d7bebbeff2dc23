"""Cleaning of telemetry before the filter uses it; a `Cleaner` is a value that is replaced at each row.

A voltage that leaps between two rows is not used until a second row repeats it. A pack whose voltage was read, and that
then shows less than 1 V a cell, has lost its meter or was taken out: that voltage is not used. The same holds in the
air for a voltage that falls within a second below 3 V a cell, by more than 1 V a cell, under an unchanged current: no
discharge does that. A fall that one failing cell explains is used. The voltage is used again from 3 V a cell on. A
temperature that a cell cannot have, or that starts as hot as a circuit board, is not used. A current that no pack of
the size can give is not used: with it the model would overflow. A current that leaps while the voltage stays where it
was is not used for up to 2 s: it is a fault of the sensor, or the voltage is late. The voltage may have moved before
it: then the current is late. A current that is missing for up to 5 s is held. Without a current sensor the current is
worked out from the power that the operator stated, or from a typical power, and the filter gives it a wide error.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from uavbatt.limits import EMPTIEST_CELL_V, HIGHEST_C_RATE
from uavbatt.records import NAN, PackFacts, Sample
from uavbatt.telemetry.cleaning.plausibility import BOARD_START_C, plausible_temperature_C

LATEST_S = 1e12  # 30,000 years: a later time is damaged
HELD_CURRENT_S = 5.0
LEAP_C = 3.0  # a change of the current that also a rounded or noisy voltage shows
LEVEL_TAU_S = 2.0
ANSWER_SHARE, ANSWER_WITHIN_S = 0.0004, 2.0  # share of the voltage for each C; the best packs show three times it
ABSENT_S = 5.0  # without a current for so long from the start: there is no sensor
LEAP_SHARE, LEAP_WITHIN_S = 0.25, 5.0  # full throttle takes a fifth of the voltage, of an empty pack a quarter
LOWEST_READING_V, HIGHEST_READING_V = 0.5, 5.0  # of a cell; outside, the monitor is at fault
CONNECTED_CELL_V = 1.0  # an open input of an autopilot floats below it; no cell of a pack that flies does
BROKEN_FALL_V = 1.0  # a cell that falls so far below its last seconds, under the same current, has lost its meter
ONE_CELL = 1.25  # a fall of fewer cells' voltage may be a cell that fails
CELL_SPREAD_TAU_S = 30.0
NOTICED_CELL_SPREAD_V = 0.02


class Cleaner(NamedTuple):
    """A Cleaner holds the last plausible readings and what they showed of the sensors; `clean` takes a sample in."""

    stated_power_W: float = NAN
    voltage_V: float = NAN
    voltage_s: float = NAN
    is_broken: bool = False  # the wire of the voltmeter is broken
    odd_V: float = NAN  # last voltage, if it leapt: used if the next row repeats it
    temp_C: float = NAN
    temp_s: float = NAN
    hottest_start_C: float = BOARD_START_C  # highest temperature at the start for a sensor in the pack
    is_board_sensor: bool = False
    reads_escs: bool = False  # the temperature is that of the motor controllers
    current_A: float = NAN
    current_s: float = NAN
    current_V: float = NAN  # the voltage with that current
    level_V: float = NAN  # the voltage, smoothed over the last seconds
    level_A: float = NAN  # the current, smoothed in the same way
    level_s: float = NAN
    leapt_s: float = NAN  # time of a leap of the current that the voltage has not shown yet
    metered: bool = False
    first_s: float = NAN
    guessed: bool = False  # the current is worked out from a power
    cell_spread_V: float = 0.0
    spread_s: float = NAN

    def clean(
        self, sample: Sample, assumed_power_W: float = NAN, capacity_Ah: float = math.inf, cells: int = 0
    ) -> tuple[Cleaner, Sample]:
        """Return the cleaner after a sample, and the sample with NaN in place of what must not be used.

        assumed_power_W : power [W] that gives the current where there is no sensor and the operator stated no power;
        capacity_Ah : of the pack [Ah], by which currents are judged; infinite while unknown;
        cells : in series, by which voltages are judged; 0 while unknown.
        """
        if not abs(sample.time_s) < LATEST_S:
            return self, Sample(NAN, NAN)  # the time is not known
        now, sample = self._with_voltage(sample, cells, LEAP_C * capacity_Ah)
        now, temp_C = now._with_temperature(sample)
        now, current_A = now._with_current(sample, assumed_power_W, capacity_Ah)
        now = now._with_level(sample)
        if temp_C is not sample.temp_C or current_A is not sample.current_A:
            sample = replace(sample, temp_C=temp_C, current_A=current_A)
        return now._with_cells(sample) if sample.cell_voltages_V else now, sample

    def with_facts(self, facts: PackFacts) -> Cleaner:
        """Return the cleaner with what the vehicle states of its sensors."""
        return self._replace(reads_escs=facts.temperature_of_escs)

    def moved(self, shift_s: float) -> Cleaner:
        """Return the same memory on a clock that shows `shift_s` [s] more."""
        return self._replace(
            voltage_s=self.voltage_s + shift_s,
            temp_s=self.temp_s + shift_s,
            current_s=self.current_s + shift_s,
            level_s=self.level_s + shift_s,
            leapt_s=self.leapt_s + shift_s,
            first_s=self.first_s + shift_s,
            spread_s=self.spread_s + shift_s,
        )

    def _with_voltage(self, sample: Sample, cells: int, leap_A: float) -> tuple[Cleaner, Sample]:
        """Take the voltage in. A sudden change is used from its second row on, as one row may be a damaged frame.

        cells : in series, 0 while unknown; leap_A : a rise of the current [A] that may explain a fall of the voltage.
        """
        volts, unused = sample.voltage_V, replace(sample, voltage_V=NAN, cell_voltages_V=())
        if not math.isfinite(volts):
            return self, sample
        if volts <= 0.0 or volts < cells * CONNECTED_CELL_V <= self.voltage_V:
            return self, unused
        if self._is_broken_by(sample, cells, leap_A):
            return self._replace(is_broken=True), unused
        is_soon = sample.time_s - self.voltage_s <= LEAP_WITHIN_S
        is_repeated = abs(volts - self.odd_V) <= LEAP_SHARE * self.odd_V
        if is_soon and not is_repeated and not abs(volts - self.voltage_V) <= LEAP_SHARE * self.voltage_V:
            return self._replace(odd_V=volts), unused
        return self._replace(voltage_V=volts, voltage_s=sample.time_s, odd_V=NAN, is_broken=False), sample

    def _is_broken_by(self, sample: Sample, cells: int, leap_A: float) -> bool:
        """Return True if the wire of the voltmeter has broken in the air, or is broken still; parameters as above."""
        if sample.armed is False or sample.voltage_V >= cells * EMPTIEST_CELL_V:
            return False
        is_at_once = sample.time_s - self.level_s <= LEAP_WITHIN_S
        deep_V = max(cells * BROKEN_FALL_V, ONE_CELL * self.level_V / max(cells, 1))
        is_deep = self.level_V - sample.voltage_V > deep_V
        return self.is_broken or (is_at_once and is_deep and not sample.current_A - self.level_A > leap_A)

    def _with_temperature(self, sample: Sample) -> tuple[Cleaner, float]:
        """Take the temperature in; returns it [°C], NaN where it is not a cell's."""
        temp_C = plausible_temperature_C(sample.temp_C, self.temp_C, sample.time_s - self.temp_s)
        if not math.isfinite(temp_C):
            return self, NAN
        is_board = self.is_board_sensor or (not math.isfinite(self.temp_C) and temp_C > self.hottest_start_C)
        now = self._replace(temp_C=temp_C, temp_s=sample.time_s, is_board_sensor=is_board)
        return now, NAN if is_board or self.reads_escs else temp_C

    def _with_current(self, sample: Sample, assumed_power_W: float, capacity_Ah: float) -> tuple[Cleaner, float]:
        """Take the current in; returns it [A] as read, held or worked out, NaN where it is unknown."""
        is_read = math.isfinite(sample.current_A)
        if is_read and abs(sample.current_A) <= HIGHEST_C_RATE * capacity_Ah:
            return self._with_read(sample, capacity_Ah)
        if sample.time_s - self.current_s <= HELD_CURRENT_S:
            return self, self.current_A
        if is_read:
            return self._replace(metered=True), NAN
        now = self if math.isfinite(self.first_s) else self._replace(first_s=sample.time_s)
        is_absent = math.isfinite(self.stated_power_W) or sample.time_s - now.first_s >= ABSENT_S
        power_W = self.stated_power_W if math.isfinite(self.stated_power_W) else assumed_power_W
        if self.metered or not is_absent or not math.isfinite(power_W) or not sample.voltage_V > 0.0:
            return now, NAN
        return now._replace(guessed=True), 0.0 if sample.armed is False else power_W / sample.voltage_V

    def _with_read(self, sample: Sample, capacity_Ah: float) -> tuple[Cleaner, float]:
        """Take a current in that was read; return it [A], or the last one while the voltage does not show its leap."""
        read_A, time_s = sample.current_A, sample.time_s
        leap_C = (read_A - self.current_A) / capacity_Ah
        if time_s - self.current_s <= LEAP_WITHIN_S and abs(leap_C) > LEAP_C and math.isfinite(self.current_V):
            falls = [(1.0 - sample.voltage_V / V) * math.copysign(1.0, leap_C) for V in (self.current_V, self.level_V)]
            is_answered = any(fall >= ANSWER_SHARE * abs(leap_C) for fall in falls)
            since_s = self.leapt_s if math.isfinite(self.leapt_s) else time_s
            if not is_answered and time_s - since_s < ANSWER_WITHIN_S:
                return self._replace(leapt_s=since_s, metered=True, guessed=False), self.current_A
        now = self._replace(
            current_A=read_A, current_s=time_s, current_V=sample.voltage_V, leapt_s=NAN, metered=True, guessed=False
        )
        return now, read_A

    def _with_level(self, sample: Sample) -> Cleaner:
        """Take voltage and current into their levels of the last seconds."""
        if not math.isfinite(sample.voltage_V):
            return self
        dt_s = sample.time_s - self.level_s
        keep = math.exp(-max(dt_s, 0.0) / LEVEL_TAU_S) if dt_s <= LEAP_WITHIN_S else 0.0
        level_V, level_A = (
            _blended(self.level_V, sample.voltage_V, keep),
            _blended(self.level_A, sample.current_A, keep),
        )
        return self._replace(level_V=level_V, level_A=level_A, level_s=sample.time_s)

    def _with_cells(self, sample: Sample) -> Cleaner:
        """Take the cell voltages in: how far the weakest cell is below the mean, smoothed over half a minute."""
        cells = [v for v in sample.cell_voltages_V if math.isfinite(v) and v > 0.0]
        if len(cells) < 2 or not all(LOWEST_READING_V < v < HIGHEST_READING_V for v in cells):
            return self
        spread_V = sum(cells) / len(cells) - min(cells)
        if not math.isfinite(self.spread_s):
            return self._replace(cell_spread_V=spread_V, spread_s=sample.time_s)
        keep = math.exp(-max(sample.time_s - self.spread_s, 0.0) / CELL_SPREAD_TAU_S)
        blended_V = keep * self.cell_spread_V + (1.0 - keep) * spread_V
        return self._replace(cell_spread_V=blended_V, spread_s=sample.time_s)

    @property
    def notices(self) -> tuple[str, ...]:
        """Return notices about the sensors for whoever reads the estimate."""
        found = []
        if self.reads_escs:
            found.append("the temperature is that of the motor controllers (BATT_MONITOR 9), not the pack's: not used")
        elif self.is_board_sensor:
            found.append(f"the temperature started above {BOARD_START_C:.0f} °C: a board's, not the pack's, not used")
        if self.guessed and math.isfinite(self.stated_power_W):
            found.append("no current sensor: current worked out from the stated power")
        elif self.guessed:
            found.append("no current sensor: a middling load is assumed, known to a factor; --load WATTS tells better")
        if self.cell_spread_V > NOTICED_CELL_SPREAD_V:
            found.append(f"the weakest cell is {1000 * self.cell_spread_V:.0f} mV below the mean and ends the flight")
        return tuple(found)


def _blended(before: float, now: float, keep: float) -> float:
    """Return the mean of two values, the first with the weight `keep`; one that is NaN does not count."""
    if math.isnan(now):
        return before
    return now + keep * (before - now) if math.isfinite(before) else now
