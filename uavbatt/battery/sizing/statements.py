"""Statements about the pack are compared with the measurements; `Statements` is a value that is replaced at each row.

The count of cells is compared with the first voltages, the sensor's sign with the direction of the current, the
capacity and the power of a vehicle file with a minute of flight, the unit of time with the time between rows. A certain
doubt refuses the number for as long as the rows show it; a likely one is a warning. The state of charge is not known
here: a capacity that is stated a few times too large is found by the filter, when the voltage falls too soon.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from uavbatt.battery.initial_state import IDLE_C_RATE
from uavbatt.battery.sizing.pack_size import PackSize
from uavbatt.limits import (
    C_RATE,
    KELVIN,
    LONGEST_ROW_S,
    POWER_FACTOR,
    USUAL_C_RATE,
    Doubt,
    FirstVoltages,
    Resting,
    cells_doubt,
)
from uavbatt.notice import Kind, Notice
from uavbatt.records import NAN, Sample

MINUTE_S = 60.0
SEVERAL_ROWS = 3
STAYS_S = 10.0  # a voltage above that at rest, in flight, must stay: a voltmeter may read too much for seconds
LOADED_C_RATE = 0.4
REVERSED_C_RATE = 0.1  # a sensor's offset on the ground is less
REVERSED_S, REGENERATING_S = 15.0, 90.0  # longest charging by a current that never discharged, and by one that did
# The load is light for the stated capacity, but the voltage falls so much that no battery has this resistance. Of the
# fall at most OCV_SLOPE_V per cell and unit of charge is the discharge itself, while a cell is above PLATEAU_V.
STRAIN_CELL_V, SURE_STRAIN_CELL_V = 0.08, 0.15
OCV_SLOPE_V, PLATEAU_CELL_V = 1.5, 3.5
# Charge drawn over the stated capacity, with cells still far from empty: sensors read up to a third too much.
OVERDRAWN, SURELY_OVERDRAWN = 1.2, 1.5

PowerRange = tuple[float, float]
SLOW_ROWS = Doubt(
    Notice(f"the rows are more than {LONGEST_ROW_S:.0f} s apart: is their time in milliseconds?", Kind.SLOW_ROWS), True
)
CHARGING = Doubt(
    Notice("the current flows into the pack: the sensor's sign is reversed, or the pack is charged", Kind.CHARGING),
    True,
)
IN_KELVIN = Doubt(Notice("the temperature reads as if it were in kelvin: not used", Kind.NO_TEMPERATURE), False)


class Means(NamedTuple):
    """Means holds the time under load [s], and mean current [A] and power [W] over about the last minute of it."""

    loaded_s: float = 0.0
    current_A: float = NAN
    power_W: float = NAN

    def after(self, current_A: float, power_W: float, step_s: float) -> Means:
        """Return the means with one more row."""
        if self is NO_LOAD:
            return Means(step_s, current_A, power_W)
        keep = math.exp(-step_s / MINUTE_S)
        mean_A, mean_W = (self.current_A - current_A) * keep, (self.power_W - power_W) * keep
        return Means(self.loaded_s + step_s, current_A + mean_A, power_W + mean_W)


class Strain(NamedTuple):
    """Strain tells how long the voltage has been lower than the discharge explains [s], and how much [V a cell].

    It lasts from the first row that shows it on: a silence before that row says nothing.
    """

    lasting_s: float = 0.0
    mean_V: float = 0.0

    def after(self, strain_V: float, step_s: float) -> Strain:
        """Return the strain with one more row."""
        if self is NO_STRAIN:
            return Strain(0.0, strain_V)
        return Strain(self.lasting_s + step_s, strain_V + (self.mean_V - strain_V) * math.exp(-step_s / MINUTE_S))


NO_LOAD, NO_STRAIN = Means(), Strain()


class Current(NamedTuple):
    """Current sums up the current of the rows: charge drawn, load, sign, and the strain of the voltage under it."""

    time_s: float = NAN
    current_A: float = NAN
    load: Means = NO_LOAD  # NO_LOAD until the first row under load: it has not flown
    drawn_Ah: float = 0.0
    plateau_Ah: float = 0.0  # the part drawn while the cells were far from empty
    calm_V: float = NAN  # the rested voltage before the charge was counted; NaN when the count has a gap
    strain: Strain = NO_STRAIN
    negative_s: float = 0.0

    def after(self, time_s: float, volts: float, current_A: float, rested_V: float, pack: PackSize) -> Current:
        """Return the summary after a row of this voltage [V] and current [A]; rested_V [V] is that before the load."""
        gap_s, rate = time_s - self.time_s, current_A / pack.capacity_Ah
        if gap_s < 0.0:  # a row that comes late: the time after it was counted already
            return self
        step_s = gap_s if 0.0 < gap_s < LONGEST_ROW_S else 0.0
        drawn_Ah = self.drawn_Ah + (0.5 * (self.current_A + current_A) * step_s / 3600.0 if step_s else 0.0)
        calm_V = NAN if gap_s >= LONGEST_ROW_S else self.calm_V
        if gap_s != gap_s or (self.load is NO_LOAD and calm_V == calm_V):  # NaN: the first row; no count any more
            calm_V = rested_V
        is_plateau = volts > PLATEAU_CELL_V * pack.cells
        strain_V = (calm_V - volts) / pack.cells - OCV_SLOPE_V * max(drawn_Ah, 0.0) / pack.capacity_Ah
        is_strained = strain_V > STRAIN_CELL_V and 0.0 < rate < USUAL_C_RATE[0] and is_plateau
        return Current(
            time_s,
            current_A,
            self.load.after(current_A, current_A * volts, step_s) if rate > LOADED_C_RATE else self.load,
            drawn_Ah,
            max(self.plateau_Ah, drawn_Ah) if is_plateau else self.plateau_Ah,
            calm_V,
            self.strain.after(strain_V, step_s) if is_strained else NO_STRAIN,
            0.0 if rate > REVERSED_C_RATE else self.negative_s + step_s * (rate < -REVERSED_C_RATE),
        )


class Above(NamedTuple):
    """Above holds the lowest voltage [V] of the rows in turn that are higher than any before, and since when [s]."""

    voltage_V: float = math.inf
    since_s: float = NAN

    def after(self, time_s: float, volts: float) -> Above:
        """Return the same with one more of these rows."""
        return Above(min(volts, self.voltage_V), time_s if self is NOT_ABOVE else self.since_s)


NOT_ABOVE = Above()


class Statements(NamedTuple):
    """Statements sums up the rows so far, as far as statements are compared with them; `after` takes in one more."""

    voltages: FirstVoltages = FirstVoltages()
    above: Above = NOT_ABOVE
    rows: int = 0
    time_s: float = NAN
    long_rows: int = 0  # in turn, LONGEST_ROW_S apart or more
    kelvin_rows: int = 0  # in turn
    current: Current = Current()

    def after(self, raw: Sample, sample: Sample, pack: PackSize) -> Statements:
        """Return the summary after one row more, `raw` as it came and `sample` after cleaning, of a pack this size."""
        kelvin_rows = self.kelvin_rows  # a row without a temperature neither counts nor ends the count
        if math.isfinite(raw.temp_C):
            kelvin_rows = kelvin_rows + 1 if KELVIN[0] <= raw.temp_C <= KELVIN[1] else 0
        time_s, volts, current_A = sample.time_s, sample.voltage_V, raw.current_A
        if not math.isfinite(volts):
            return self._replace(kelvin_rows=kelvin_rows)
        is_flown = self.current.load is not NO_LOAD
        is_idle = not is_flown and is_at_rest(raw, pack.capacity_Ah)
        voltages, above = self._highest_voltages(time_s, volts, is_idle, STAYS_S if is_flown else 0.0)
        long_rows = self.long_rows + 1 if time_s - self.time_s >= LONGEST_ROW_S else 0
        is_metered = math.isfinite(current_A)
        current = self.current.after(time_s, volts, current_A, voltages.rested_V, pack) if is_metered else self.current
        return Statements(voltages, above, self.rows + 1, time_s, long_rows, kelvin_rows, current)

    def doubts(self, pack: PackSize, resting: Resting, power_W: PowerRange | None = None) -> tuple[Doubt, ...]:
        """Return the doubts about the statements, the certain ones first.

        resting : the rested voltages of a cell of the type; power_W : lowest and highest power [W] that are stated of
        this aircraft. The words hold no number that changes from row to row, so that each is said once.
        """
        current, capacity_Ah = self.current, pack.capacity_Ah
        load, is_minute = current.load, current.load.loaded_s >= MINUTE_S
        may_charge_s = REVERSED_S if load is NO_LOAD else REGENERATING_S  # braking motors charge in flight
        reasons = (
            Doubt(pack.refusal, True) if pack.refusal else None,
            cells_doubt(pack.cells, self.voltages, resting, current.drawn_Ah, capacity_Ah) if self.rows else None,
            SLOW_ROWS if self.long_rows >= SEVERAL_ROWS else None,
            CHARGING if current.negative_s >= may_charge_s else None,
            _strong(load, capacity_Ah) if is_minute and load.current_A > USUAL_C_RATE[1] * capacity_Ah else None,
            _weak(current, capacity_Ah) if current.strain.lasting_s >= MINUTE_S else None,
            _overdrawn(current, capacity_Ah) if current.plateau_Ah > OVERDRAWN * capacity_Ah else None,
            _unlike(load.power_W, *power_W) if is_minute and power_W is not None else None,
            IN_KELVIN if self.kelvin_rows >= SEVERAL_ROWS else None,
        )
        if not any(reasons):
            return ()
        return tuple(sorted((doubt for doubt in reasons if doubt is not None), key=lambda doubt: not doubt.is_certain))

    def denies(self, cells: int, resting: Resting) -> bool:
        """Return True if the voltages say for certain that there are not so many cells."""
        doubt = cells_doubt(cells, self.voltages, resting)
        return doubt is not None and doubt.is_certain

    def with_voltage(self, volts: float, is_idle: bool) -> Statements:
        """Return the summary after a row of which only the voltage [V] is compared."""
        voltages, above = self._highest_voltages(0.0, volts, is_idle, 0.0)
        return self._replace(voltages=voltages, above=above, rows=self.rows + 1)

    def _highest_voltages(
        self, time_s: float, volts: float, is_idle: bool, stays_s: float
    ) -> tuple[FirstVoltages, Above]:
        """Return the highest voltages that rows in turn have shown, of all rows and of those at rest.

        stays_s : how long they must show it [s]. One row alone may be damaged. Rest ends with the first load.
        """
        (first_V, rested_V), above = self.voltages, NOT_ABOVE
        if self.rows < 2:
            first_V = min(volts, first_V) if self.rows else volts
        elif volts > first_V:
            above = self.above.after(time_s, volts)
            if self.above is not NOT_ABOVE and time_s - above.since_s >= stays_s:
                first_V, above = above.voltage_V, Above(volts, time_s) if volts > above.voltage_V else NOT_ABOVE
        if is_idle:
            rested_V = min(volts if math.isnan(rested_V) else max(rested_V, volts), first_V)
        voltages = (first_V, rested_V)
        return self.voltages if voltages == self.voltages else FirstVoltages(*voltages), above


def _strong(load: Means, capacity_Ah: float) -> Doubt:
    """Return the doubt about a capacity for which the load of a minute is too high."""
    is_certain = load.current_A > C_RATE[1] * capacity_Ah
    bound = C_RATE[1] if is_certain else USUAL_C_RATE[1]
    words = f"the stated {capacity_Ah:g} Ah gives more than {bound:g} C for a minute: is the capacity right?"
    return Doubt(Notice(words, Kind.CAPACITY), is_certain)


def _weak(current: Current, capacity_Ah: float) -> Doubt:
    """Return the doubt about a capacity for which the load is light, though the voltage falls as under a heavy one."""
    is_certain = current.current_A < C_RATE[0] * capacity_Ah and current.strain.mean_V > SURE_STRAIN_CELL_V
    bound = C_RATE[0] if is_certain else USUAL_C_RATE[0]
    words = f"less than {bound:g} C, and yet the voltage gives way: is the capacity right (mAh?)"
    return Doubt(Notice(f"the stated {capacity_Ah:g} Ah gives {words}", Kind.CAPACITY), is_certain)


def _overdrawn(current: Current, capacity_Ah: float) -> Doubt:
    """Return the doubt about a capacity less than the charge drawn while the cells are still far from empty."""
    is_certain = current.plateau_Ah > SURELY_OVERDRAWN * capacity_Ah
    share = SURELY_OVERDRAWN if is_certain else OVERDRAWN
    words = f"{share:g} times the stated {capacity_Ah:g} Ah were drawn, and the cells are far from empty"
    words += ": is the capacity right, or does the current read high?"
    return Doubt(Notice(words, Kind.CAPACITY), is_certain)


def _unlike(power_W: float, low_W: float, high_W: float) -> Doubt | None:
    """Return the doubt about a mean power [W] far outside the range that is stated of this aircraft; None if inside."""
    if low_W / POWER_FACTOR <= power_W <= high_W * POWER_FACTOR:
        return None
    more = "more than twice" if power_W > high_W else "less than half"
    spoken = f"{low_W:.0f} W" if low_W == high_W else f"{low_W:.0f} to {high_W:.0f} W"
    words = f"this aircraft draws {more} the {spoken} that are stated of it: another aircraft's?"
    return Doubt(Notice(words, Kind.POWER), False)


def is_at_rest(sample: Sample, capacity_Ah: float) -> bool:
    """Return True if a row shows a pack at rest, or a pack that supplies only avionics."""
    if math.isfinite(sample.current_A):
        return abs(sample.current_A) <= IDLE_C_RATE * capacity_Ah
    return sample.armed is False
