"""What is stated of the pack, held against what is measured: a value that goes from row to row.

The first voltages judge the count of cells, the current its own sign, a minute in flight the capacity and the power
that a vehicle file promises, the steps of time their unit. What is certain refuses the number until the rows say
otherwise; what is likely is said beside it. Nothing here knows the charge: a capacity that is a few times too large
looks like a good one in flight, and only the filter, which can doubt it, sees the voltage fall too soon.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from uavbatt.battery.file import BatteryFile
from uavbatt.battery.start import IDLE_C_RATE
from uavbatt.errors import UsageError
from uavbatt.limits import C_RATE, KELVIN, LONGEST_ROW_S, POWER_FACTOR, USUAL_C_RATE, Doubt, Resting, Seen, cells_doubt
from uavbatt.prediction.learned import GRID_S, LearnedLoad
from uavbatt.prediction.load import ConstantLoad, Load
from uavbatt.records import NAN, Flight, Sample
from uavbatt.resolved import PackOptions, Resolved, cells_from_voltage, checked, resolve

MINUTE_S = 60.0
SEVERAL_ROWS = 3
FIRST_ROWS_S = 120.0  # of a log: what a command reads before it begins
LOADED_C_RATE = 0.4
REVERSED_C_RATE = 0.1  # what an offset of the sensor shows on the ground is less
REVERSED_S, REGENERATING_S = 15.0, 90.0  # of a current that never discharged, and of one that did before
# A load that is light for the stated capacity, and yet the voltage gives way: the ohms would be those of no battery.
# OCV_SLOPE_V a cell and unit of charge at most are the discharge itself, while a cell shows more than PLATEAU_V.
STRAIN_CELL_V, SURE_STRAIN_CELL_V = 0.08, 0.15
OCV_SLOPE_V, PLATEAU_CELL_V = 1.5, 3.5
# Charge drawn against the charge stated, the cells still far from empty: sensors read up to a third too much.
OVERDRAWN, SURELY_OVERDRAWN = 1.2, 1.5

PowerRange = tuple[float, float]


class Statements(NamedTuple):
    """What the rows so far say about the statements; `after` takes in one more."""

    seen: Seen = Seen()
    rows: int = 0
    time_s: float = NAN
    voltage_V: float = NAN
    long_rows: int = 0  # in turn, LONGEST_ROW_S apart or more
    kelvin_rows: int = 0
    current_s: float = NAN
    current_A: float = NAN
    has_flown: bool = False
    loaded_s: float = 0.0
    loaded_A: float = NAN  # means of about a minute, under load only
    loaded_W: float = NAN
    drawn_Ah: float = 0.0
    plateau_Ah: float = 0.0  # of it, what was drawn while the cells were far from empty
    calm_V: float = NAN  # the rested voltage before the charge was counted; NaN when the count has a gap
    strain_V: float = 0.0  # of a cell, beyond what the discharge explains: the mean of about a minute
    strained_s: float = 0.0
    negative_s: float = 0.0

    def after(self, raw: Sample, sample: Sample, pack: Resolved) -> Statements:
        """The next state after a row, `raw` as it came and `sample` as the filter has it, of a pack of this size."""
        now = self._with_temperature(raw.temp_C)
        if not math.isfinite(sample.voltage_V):
            return now
        gap_s = sample.time_s - now.time_s
        now = now._with_voltage(sample.voltage_V, _is_idle(raw, pack.capacity_Ah))
        now = now._replace(
            rows=now.rows + 1,
            time_s=sample.time_s,
            voltage_V=sample.voltage_V,
            long_rows=now.long_rows + 1 if gap_s >= LONGEST_ROW_S else 0,
        )
        return now._with_current(raw.current_A, pack) if math.isfinite(raw.current_A) else now

    def denies(self, cells: int, resting: Resting) -> bool:
        """Whether the voltages say for certain that there are not so many cells."""
        doubt = cells_doubt(cells, self.seen, resting)
        return doubt is not None and doubt.is_certain

    def doubts(self, pack: Resolved, resting: Resting, power_W: PowerRange | None = None) -> tuple[Doubt, ...]:
        """What speaks against the statements, the certain first; power_W: lowest and highest stated of this aircraft.

        The words name no number that changes from row to row: each is said once.
        """
        found = (
            Doubt(pack.refusal, True) if pack.refusal else None,
            cells_doubt(pack.cells, self.seen, resting) if self.rows else None,
            self._time_doubt(),
            self._sign_doubt(),
            self._rate_doubt(pack.capacity_Ah),
            self._charge_doubt(pack.capacity_Ah),
            self._power_doubt(power_W),
            self._temperature_doubt(),
        )
        return tuple(sorted((doubt for doubt in found if doubt is not None), key=lambda doubt: not doubt.is_certain))

    def _with_temperature(self, temp_C: float) -> Statements:
        if KELVIN[0] <= temp_C <= KELVIN[1]:
            return self._replace(kelvin_rows=self.kelvin_rows + 1)
        return self._replace(kelvin_rows=0) if self.kelvin_rows and math.isfinite(temp_C) else self

    def _with_voltage(self, volts: float, is_idle: bool) -> Statements:
        """The highest voltage that two rows in turn have shown: one may be damaged. Rest ends with the first load."""
        shown_V = min(volts, self.voltage_V) if self.rows else volts
        first_V = max(shown_V, self.seen.first_V) if self.rows > 1 else shown_V
        rested_V = self.seen.rested_V
        if is_idle and not self.has_flown:
            rested_V = min(volts if math.isnan(rested_V) else max(rested_V, volts), first_V)
        seen = Seen(first_V, rested_V)
        return self if seen == self.seen else self._replace(seen=seen)

    def _with_current(self, current_A: float, pack: Resolved) -> Statements:
        """The row's current: charge, means under load, sign and strain; `time_s` and `voltage_V` are the row's."""
        gap_s, rate = self.time_s - self.current_s, current_A / pack.capacity_Ah
        step_s = gap_s if 0.0 < gap_s < LONGEST_ROW_S else 0.0
        drawn_Ah = self.drawn_Ah + (0.5 * (self.current_A + current_A) * step_s / 3600.0 if step_s else 0.0)
        is_first = math.isnan(self.current_s)
        calm_V = NAN if gap_s >= LONGEST_ROW_S else self.calm_V
        if is_first or (math.isfinite(calm_V) and not self.has_flown):
            calm_V = self.seen.rested_V
        now = self._replace(
            current_s=self.time_s,
            current_A=current_A,
            drawn_Ah=drawn_Ah,
            calm_V=calm_V,
            negative_s=0.0 if rate > REVERSED_C_RATE else self.negative_s + step_s * (rate < -REVERSED_C_RATE),
        )
        if rate > LOADED_C_RATE:
            now = now._under_load(current_A, step_s)
        cell_V = self.voltage_V / pack.cells
        if cell_V > PLATEAU_CELL_V and drawn_Ah > now.plateau_Ah:
            now = now._replace(plateau_Ah=drawn_Ah)
        return now._strained(rate, step_s, pack)

    def _under_load(self, current_A: float, step_s: float) -> Statements:
        keep = math.exp(-step_s / MINUTE_S) if self.has_flown else 0.0
        watts = current_A * self.voltage_V

        def mean(before: float, now: float) -> float:
            return now + (before - now) * keep if keep else now

        return self._replace(
            has_flown=True,
            loaded_s=self.loaded_s + step_s,
            loaded_A=mean(self.loaded_A, current_A),
            loaded_W=mean(self.loaded_W, watts),
        )

    def _strained(self, rate: float, step_s: float, pack: Resolved) -> Statements:
        """How far the voltage gives way under a load that is light for the capacity."""
        drop_V = (self.calm_V - self.voltage_V) / pack.cells
        strain_V = drop_V - OCV_SLOPE_V * max(self.drawn_Ah, 0.0) / pack.capacity_Ah
        is_plateau = self.voltage_V > PLATEAU_CELL_V * pack.cells
        if not (strain_V > STRAIN_CELL_V and 0.0 < rate < USUAL_C_RATE[0] and is_plateau):
            return self._replace(strained_s=0.0, strain_V=0.0) if self.strained_s else self
        keep = math.exp(-step_s / MINUTE_S) if self.strained_s else 0.0
        return self._replace(strained_s=self.strained_s + step_s, strain_V=strain_V + (self.strain_V - strain_V) * keep)

    def _time_doubt(self) -> Doubt | None:
        if self.long_rows < SEVERAL_ROWS:
            return None
        return Doubt(f"the rows are more than {LONGEST_ROW_S:.0f} s apart: is their time in milliseconds?", True)

    def _sign_doubt(self) -> Doubt | None:
        if self.negative_s < (REGENERATING_S if self.has_flown else REVERSED_S):
            return None
        return Doubt("the current flows into the pack: the sensor's sign is reversed, or the pack is charged", True)

    def _rate_doubt(self, capacity_Ah: float) -> Doubt | None:
        said = f"the stated {capacity_Ah:g} Ah gives"
        if self.loaded_s >= MINUTE_S and self.loaded_A > USUAL_C_RATE[1] * capacity_Ah:
            is_certain = self.loaded_A > C_RATE[1] * capacity_Ah
            bound = C_RATE[1] if is_certain else USUAL_C_RATE[1]
            return Doubt(f"{said} more than {bound:g} C for a minute: is the capacity right?", is_certain)
        if self.strained_s >= MINUTE_S:
            is_certain = self.current_A < C_RATE[0] * capacity_Ah and self.strain_V > SURE_STRAIN_CELL_V
            bound = C_RATE[0] if is_certain else USUAL_C_RATE[0]
            words = f"{said} less than {bound:g} C, and yet the voltage gives way: is the capacity right (mAh?)"
            return Doubt(words, is_certain)
        return None

    def _charge_doubt(self, capacity_Ah: float) -> Doubt | None:
        if self.plateau_Ah <= OVERDRAWN * capacity_Ah:
            return None
        is_certain = self.plateau_Ah > SURELY_OVERDRAWN * capacity_Ah
        share = SURELY_OVERDRAWN if is_certain else OVERDRAWN
        words = f"{share:g} times the stated {capacity_Ah:g} Ah were drawn, and the cells are far from empty"
        return Doubt(f"{words}: is the capacity right, or does the current read high?", is_certain)

    def _power_doubt(self, power_W: PowerRange | None) -> Doubt | None:
        if power_W is None or self.loaded_s < MINUTE_S:
            return None
        low_W, high_W = power_W
        if low_W / POWER_FACTOR <= self.loaded_W <= high_W * POWER_FACTOR:
            return None
        more = "more than twice" if self.loaded_W > high_W else "less than half"
        spoken = f"{low_W:.0f} W" if low_W == high_W else f"{low_W:.0f} to {high_W:.0f} W"
        return Doubt(f"this aircraft draws {more} the {spoken} that are stated of it: another aircraft's?", False)

    def _temperature_doubt(self) -> Doubt | None:
        if self.kelvin_rows < SEVERAL_ROWS:
            return None
        return Doubt("the temperature reads as if it were in kelvin: not used", False)


def stated_power(load: Load) -> PowerRange | None:
    """Lowest and highest power [W] over a minute that the caller states of the aircraft; None when he states none."""
    if isinstance(load, ConstantLoad):
        return load.power_W, load.power_W
    if not isinstance(load, LearnedLoad):
        return None
    window = int(MINUTE_S / GRID_S)
    lowest_W, highest_W = math.inf, 0.0
    for watts, landed_s in zip(load.power_W, load.landed_s, strict=True):
        flown = watts[: max(int(landed_s / GRID_S), window)]
        means_W = np.convolve(flown, np.full(window, 1.0 / window), mode="valid")
        lowest_W, highest_W = min(lowest_W, float(means_W.min())), max(highest_W, float(means_W.max()))
    return lowest_W, highest_W


def first_seen(samples: Iterable[Sample], capacity_Ah: float = NAN) -> Seen:
    """The voltages before the load of a record, or of its first minutes; without a capacity none counts as rested."""
    found, start_s = Statements(), NAN
    for sample in samples:
        if not math.isfinite(sample.voltage_V):
            continue
        start_s = start_s if found.rows else sample.time_s
        is_idle = _is_idle(sample, capacity_Ah)
        if sample.time_s - start_s > FIRST_ROWS_S or (found.rows >= SEVERAL_ROWS and not is_idle):
            break
        found = found._with_voltage(sample.voltage_V, is_idle)
        found = found._replace(rows=found.rows + 1, voltage_V=sample.voltage_V)
    return found.seen


def check(battery: BatteryFile, options: PackOptions, flight: Flight) -> None:
    """UsageError when what the caller states of the pack cannot be, by the first rows of the flight."""
    first = next((s for s in flight.samples if math.isfinite(s.voltage_V)), None)
    if first is None:
        return
    facts = flight.facts_at(first.time_s + FIRST_ROWS_S)
    guess = cells_from_voltage(first.voltage_V, battery.battery.cells_series)
    try:
        seen = first_seen(flight.samples, resolve(battery, options, facts, guess).capacity_Ah)
        checked(battery, resolve(battery, options, facts, guess, seen=seen), seen)
    except UsageError as error:
        raise UsageError(f"{flight.source}: {error}") from None


def check_whole(flight: Flight, pack: Resolved, resting: Resting) -> None:
    """UsageError when any row of the flight contradicts for certain what is believed of its pack."""
    found = Statements()
    for sample in flight.samples:
        found = found.after(sample, sample, pack)
        doubts = found.doubts(pack, resting)
        if doubts and doubts[0].is_certain and found.rows >= SEVERAL_ROWS:
            raise UsageError(f"{flight.source}: {doubts[0].words}")


def _is_idle(sample: Sample, capacity_Ah: float) -> bool:
    """Whether a row shows a pack at rest, or one that only its avionics draw from."""
    if math.isfinite(sample.current_A):
        return abs(sample.current_A) <= IDLE_C_RATE * capacity_Ah
    return sample.armed is False
