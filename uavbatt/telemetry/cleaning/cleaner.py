"""Cleaning of telemetry before the filter uses it; a `Cleaner` is a value that is replaced at each row.

A voltage that leaps between two rows is not used until a second row repeats it. A pack whose voltage was read, and that
then shows less than 1 V a cell (disarmed less than 1.8 V), has lost its meter or was taken out: that voltage is not
used. The same holds in the air for a voltage that falls within a second below 3 V a cell, by more than 1 V a cell,
under an unchanged current: no discharge does that. A fall that one failing cell explains is used. The voltage is used
again from 3 V a cell on. A temperature that a cell cannot have, or that starts as hot as a circuit board, is not used.
A current that no pack of the size can give is not used: with it the model would overflow. A current that leaps while
the voltage stays where it was is not used for up to 2 s, and a rise not for up to 10 s, the longer the larger it is: it
is a fault of the sensor, or the voltage is late. The voltage may have moved before it: then the current is late. A
current that is missing for up to 5 s is held. Without a current sensor the current is worked out from the power that
the operator stated, or from a typical power, and the filter gives it a wide error.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

from uavbatt.records import NAN, PackFacts, Sample
from uavbatt.telemetry.cleaning.readings import (
    BOARD_START_C,
    LEAP_C,
    CellsSeen,
    CurrentSeen,
    TemperatureSeen,
    VoltageSeen,
)

LATEST_S = 1e12  # 30,000 years: a later time is damaged
NOTICED_CELL_SPREAD_V = 0.02


class Cleaner(NamedTuple):
    """A Cleaner holds the last plausible readings and what they showed of the sensors; `clean` takes a sample in."""

    stated_power_W: float = NAN
    hottest_start_C: float = BOARD_START_C  # highest temperature at the start for a sensor in the pack
    reads_escs: bool = False  # the temperature is that of the motor controllers
    is_compensated: bool = False  # the autopilot adds the sag to the voltage
    voltage: VoltageSeen = VoltageSeen()
    current: CurrentSeen = CurrentSeen()
    temperature: TemperatureSeen = TemperatureSeen()
    cells: CellsSeen = CellsSeen()

    def clean(
        self, sample: Sample, assumed_power_W: float = NAN, capacity_Ah: float = math.inf, cells: int = 0
    ) -> tuple[Cleaner, Sample]:
        """Return the cleaner after a sample, and the sample with NaN in place of what must not be used.

        assumed_power_W : power [W] that gives the current where there is no sensor and the operator stated no power;
        capacity_Ah : of the pack [Ah], by which currents are judged; infinite while unknown;
        cells : in series, by which voltages are judged; 0 while unknown.
        """
        time_s = sample.time_s
        if not abs(time_s) < LATEST_S:
            return self, Sample(NAN, NAN)  # the time is not known
        voltage, voltage_V = self.voltage.after(sample, cells, LEAP_C * capacity_Ah)
        if voltage_V is not sample.voltage_V:
            sample = replace(sample, voltage_V=NAN, cell_voltages_V=())
        temperature, temp_C = self.temperature.after(time_s, sample.temp_C, self.hottest_start_C)
        current, current_A = self.current.after(
            sample, self.voltage.level_V, capacity_Ah, is_compensated=self.is_compensated
        )
        if not current.is_metered:
            current, current_A = current.worked_out(sample, self.stated_power_W, assumed_power_W)
        if self.reads_escs:
            temp_C = NAN
        if temp_C is not sample.temp_C or current_A is not sample.current_A:
            sample = replace(sample, temp_C=temp_C, current_A=current_A)
        seen = self.cells.after(time_s, sample.cell_voltages_V) if sample.cell_voltages_V else self.cells
        return Cleaner(*self[:4], voltage, current, temperature, seen), sample

    def with_facts(self, facts: PackFacts) -> Cleaner:
        """Return the cleaner with what the vehicle states of its sensors."""
        return self._replace(reads_escs=facts.temperature_of_escs, is_compensated=bool(facts.sag_compensated))

    def moved(self, shift_s: float) -> Cleaner:
        """Return the same memory on a clock that shows `shift_s` [s] more."""
        seen = (self.voltage, self.current, self.temperature, self.cells)
        return Cleaner(*self[:4], *(_moved(value, shift_s) for value in seen))

    @property
    def notices(self) -> tuple[str, ...]:
        """Return notices about the sensors for whoever reads the estimate."""
        found = []
        if self.reads_escs:
            found.append("the temperature is that of the motor controllers (BATT_MONITOR 9), not the pack's: not used")
        elif self.temperature.is_board:
            found.append(f"the temperature started above {BOARD_START_C:.0f} °C: a board's, not the pack's, not used")
        if self.current.is_guessed and math.isfinite(self.stated_power_W):
            found.append("no current sensor: current worked out from the stated power")
        elif self.current.is_guessed:
            found.append("no current sensor: a middling load is assumed, known to a factor; --load WATTS tells better")
        if self.cells.spread_V > NOTICED_CELL_SPREAD_V:
            found.append(f"the weakest cell is {1000 * self.cells.spread_V:.0f} mV below the mean and ends the flight")
        return tuple(found)


def _moved(seen: Any, shift_s: float) -> Any:
    """Return a record with all its times (fields in `_s`) `shift_s` [s] later."""
    times_s = {name: time_s + shift_s for name, time_s in seen._asdict().items() if name.endswith("_s")}
    return seen._replace(**times_s)
