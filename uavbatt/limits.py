"""The limits of what a pack can be: every statement about a pack is checked against them, in every command and live.

Each limit has two bounds. Outside the first a statement is impossible and is not used (certain); outside the second
it is unusual, and a warning says so (likely). Cells are judged at rest or at the first rows: under load an empty cell
may show any voltage.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple, SupportsFloat, SupportsIndex

from uavbatt.errors import UsageError
from uavbatt.notice import Kind, Notice

MOST_CELLS = 100
LOWEST_CELL_V, HIGHEST_CELL_V = 2.5, 4.45  # before the load, for every chemistry that flies
FULLEST_CELL_V = 4.40  # cells are sold that charge to 4.35 V
EMPTIEST_CELL_V = 3.0
RESTING_SLACK_V = 0.2  # a cell that rests so far below its type's empty voltage is damaged
ENDING_CELL_V, USUAL_ENDING_CELL_V = (2.0, 4.2), (2.5, 3.8)  # for a cut-off or a low-voltage warning
CAPACITY_AH = (0.05, 500.0)
LEAST_FULL_SHARE = 0.5  # a gauge that leaves less of its battery's capacity is of another one, or not calibrated
AMBIENT_C = (-40.0, 60.0)
# How crews charge packs and set cut-offs. A count of cells is guessed from the first voltage by these numbers.
CHARGED_CELL_V, CHARGED_SD_V, DROP_V = 4.17, 0.05, 0.035  # full cell, its sd, its fall for each C of load
LEAST_CHARGED_CELL_V = 3.65  # at rest: crews do not take off with less than a tenth of the charge
HIGH_CHARGED, HIGH_CHARGED_CELL_V, HIGH_CHARGED_SD_V = 0.05, 4.33, 0.03  # cells that charge to 4.35 V, so many of all
PART_CHARGED, UNUSUALLY_CHARGED = 0.02, 0.005  # likelihoods of a start in part, and outside that range
COMMON_CELLS, RARE = {1: 1.0, 2: 1.0, 3: 1.0, 4: 1.0, 5: 0.3, 6: 1.0, 8: 1.0, 10: 0.3, 12: 1.0, 14: 0.3}, 0.02
STATED_ENDING_CELL_V, STATED_ENDING_SD_V, UNUSUALLY_STATED = 3.5, 0.12, 0.02
LESS_LIKELY = 12.0
GUESSED_FROM, TOLD_FROM = "first voltage", "cell voltages"  # sources of a count of cells that nobody states
CUT_CELLS = 10  # fields for cells in BATTERY_STATUS: where all are used, a sender without more may leave cells out
HIGHEST_RESERVE = 0.99
C_RATE, USUAL_C_RATE = (0.3, 60.0), (0.5, 30.0)  # over a minute in flight: at 60 C a pack lasts a minute
FLYING_C_RATE = 0.4  # a multirotor hovers at 2-6 C, most aeroplanes cruise above 0.5 C
GROUNDED_C_RATE = 1.5  # disarmed or landed: a payload draws less; an aircraft of which that is wrong hovers with more
HIGHEST_C_RATE = 200.0  # in any row: at this rate a pack is empty in 18 s
LEAST_SAG = 0.0004  # share of the voltage that a load of 1 C takes at least; the best packs show three times it
# A pack that rested nearly empty cannot give this share of the stated capacity, even if it has twice that capacity.
EMPTY_OVERDRAWN = 0.3
LONGEST_ROW_S = 90.0  # rows farther apart are no telemetry: milliseconds
KELVIN = (230.0, 360.0)  # a cell's temperature in the wrong unit
POWER_FACTOR = 2.0  # beyond this factor it is another aircraft


class Doubt(NamedTuple):
    """A Doubt says in words what speaks against a statement, and if that is certain."""

    words: Notice
    is_certain: bool


def refuse_certain(doubt: Doubt | None, who: str = "") -> None:
    """Raise UsageError with the words of a doubt that is certain; any other doubt is let pass.

    who : the option or the file that states it, at the beginning of the message
    """
    if doubt is not None and doubt.is_certain:
        raise UsageError(f"{who}{doubt.words}")


class Resting(NamedTuple):
    """Resting holds the voltages [V] of a rested cell of the battery file's type, empty and with little charge left."""

    empty_V: float = EMPTIEST_CELL_V
    low_V: float = 3.5


class FirstVoltages(NamedTuple):
    """FirstVoltages holds the pack voltages [V] of the first rows and at rest, by which statements are judged."""

    first_V: float = math.nan
    rested_V: float = math.nan


class Names(NamedTuple):
    """Names holds the names by which the caller knows the checked arguments."""

    cells: str = "cells="
    capacity: str = "capacity_Ah="
    cutoff: str = "cutoff_V="
    low: str = "low_V="
    ambient: str = "ambient_C="
    reserve: str = "reserve_soc="


OPTIONS = Names("--cells ", "--capacity-ah ", "--cutoff-voltage ", "--low-voltage ", "--ambient-c ", "--reserve-soc ")


def is_answered(leap_C: float, voltage_V: float, before_V: float) -> bool:
    """Return True if the voltage [V] has moved as a leap of the current [C] moves it at least, against that before."""
    return (before_V - voltage_V) * math.copysign(1.0, leap_C) >= LEAST_SAG * abs(leap_C) * before_V


def cells_doubt(
    cells: int, voltages: FirstVoltages, resting: Resting, drawn_Ah: float = 0.0, capacity_Ah: float = math.inf
) -> Doubt | None:
    """Return the doubt about a count of cells in series by the first voltages of a record; None if they allow it.

    drawn_Ah : charge drawn since [Ah], of the stated `capacity_Ah` [Ah]: a pack that rested nearly empty gives little.
    """
    first_V, rested_V = voltages.first_V / cells, voltages.rested_V / cells
    if first_V > HIGHEST_CELL_V or first_V < LOWEST_CELL_V:
        words = f"{voltages.first_V:.1f} V is {first_V:.3g} V a cell, {_expected_cells(voltages, LOWEST_CELL_V)}"
        return Doubt(Notice(f"{_count(cells)}: {words}", Kind.CELLS), True)
    if rested_V < resting.empty_V:
        expected = _expected_cells(voltages, resting.empty_V)
        words = f"{voltages.rested_V:.1f} V at rest is {rested_V:.3g} V a cell, {expected}"
        return Doubt(Notice(f"{_count(cells)}: {words}", Kind.CELLS), True)
    if rested_V < resting.low_V:
        words = f"{_count(cells)} at {rested_V:.1f} V a cell at rest"
        if drawn_Ah > EMPTY_OVERDRAWN * capacity_Ah:
            drawn = f"{EMPTY_OVERDRAWN:g} times the stated {capacity_Ah:g} Ah were drawn since"
            return Doubt(Notice(f"{words}, and {drawn}: another count, or LiFePO4 cells", Kind.CELLS), True)
        return Doubt(Notice(f"{words}: nearly empty, or another count", Kind.NEARLY_EMPTY), False)
    if first_V > FULLEST_CELL_V:
        words = f"{_count(cells)} at {first_V:.1f} V a cell: fuller than cells are, or another count"
        return Doubt(Notice(words, Kind.TOO_FULL), False)
    return None


def cells_from_voltage(
    voltage_V: float, typical: int = 1, endings_V: tuple[float, ...] = (), c_rate: float = 0.0
) -> tuple[int, ...]:
    """Return the counts of cells in series that fit the first voltage [V], the likeliest first.

    typical : the battery file's own count, which is taken if it fits; endings_V : critical voltage and low-voltage
    warning of the vehicle [V of the pack], NaN where it states none; c_rate : of the load at the first voltage [1/h],
    where that is known. Counts that are LESS_LIKELY times less likely than the first are left out.
    """
    if EMPTIEST_CELL_V <= voltage_V / typical <= FULLEST_CELL_V:
        return (typical,)
    fewest, most = (max(1, math.ceil(voltage_V / V - 1e-9)) for V in (FULLEST_CELL_V, EMPTIEST_CELL_V))
    likely = {n: _likelihood_of(n, voltage_V / n, endings_V, c_rate) for n in range(fewest, max(most, fewest + 1))}
    counts = sorted(likely, key=lambda n: -likely[n])
    return tuple(n for n in counts if likely[n] * LESS_LIKELY >= likely[counts[0]])


def told_cells(cell_voltages_V: Sequence[float], voltage_V: float) -> int:
    """Return the count of cells in series that a row tells one by one [V]; 0 if it does not tell all cells of the pack.

    All are told if their sum is the voltage of the pack [V] and each is possible. Exactly CUT_CELLS may be a part.
    """
    told = len(cell_voltages_V)
    if told < 2 or told == CUT_CELLS or not all(LOWEST_CELL_V <= V <= HIGHEST_CELL_V for V in cell_voltages_V):
        return 0
    return told if abs(sum(cell_voltages_V) - voltage_V) < 0.5 * LOWEST_CELL_V else 0


def _likelihood_of(cells: int, cell_V: float, endings_V: tuple[float, ...], c_rate: float) -> float:
    """Return the likelihood of a first cell voltage for a count of cells: crews fly full packs, and few odd counts."""
    drop_V = DROP_V * min(max(c_rate, 0.0), 5.0)
    full_V = CHARGED_CELL_V - drop_V
    is_full = math.exp(-0.5 * ((cell_V - full_V) / CHARGED_SD_V) ** 2)
    is_full += HIGH_CHARGED * math.exp(-0.5 * ((cell_V - HIGH_CHARGED_CELL_V + drop_V) / HIGH_CHARGED_SD_V) ** 2)
    is_usual = LEAST_CHARGED_CELL_V - 2.0 * drop_V <= cell_V <= full_V
    likely = COMMON_CELLS.get(cells, RARE) * (PART_CHARGED * is_usual + is_full + UNUSUALLY_CHARGED)
    for volts in endings_V:
        if volts > 0.0:
            off_sds = (volts / cells - STATED_ENDING_CELL_V) / STATED_ENDING_SD_V
            likely *= math.exp(-0.5 * off_sds**2) + UNUSUALLY_STATED
    return likely


def ending_doubt(
    what: str, volts: float, cells: int, rested_V: float = math.nan, kind: Kind = Kind.OTHER
) -> Doubt | None:
    """Return the doubt about a cut-off or warning voltage [V of the pack] by its volts per cell; None if usual or NaN.

    what : the words before the number; rested_V : the voltage that the pack shows at rest [V], NaN while unknown;
    kind : of the doubt's notice.
    """
    cell_V, (lowest_V, highest_V) = volts / cells, ENDING_CELL_V
    said = f"{what}{volts:g} V is {cell_V:.3g} V a cell of {cells}"
    if not math.isnan(volts) and not lowest_V <= cell_V <= highest_V:
        words = f"{said}, expected {lowest_V:g} to {highest_V:g} V{_slip(volts, cells)}"
        return Doubt(Notice(words, kind), True)
    lowest_V, highest_V = USUAL_ENDING_CELL_V
    if cell_V > highest_V and volts > rested_V:
        return Doubt(Notice(f"{said}, above the {rested_V:.2f} V that the pack has at rest", kind), True)
    if cell_V < lowest_V or cell_V > highest_V:
        return Doubt(Notice(f"{said}, usual are {lowest_V:g} to {highest_V:g} V", kind), False)
    return None


def capacity_doubt(capacity_Ah: float) -> Doubt | None:
    """Return the doubt about a capacity [Ah]; None if it is possible or NaN."""
    lowest_Ah, highest_Ah = CAPACITY_AH
    if math.isnan(capacity_Ah) or lowest_Ah <= capacity_Ah <= highest_Ah:
        return None
    slip = " (mAh?)" if capacity_Ah > highest_Ah else ""
    words = f"{capacity_Ah:g} Ah, expected {lowest_Ah:g} to {highest_Ah:g} Ah{slip}"
    return Doubt(Notice(words, Kind.CAPACITY), True)


def rate_doubt(what: str, c_rate: float) -> Doubt | None:
    """Return the doubt about a C-rate [1/h] that is to last for a minute; None if packs give it.

    Too low a rate is judged elsewhere.
    """
    if c_rate <= USUAL_C_RATE[1]:
        return None
    is_certain = c_rate > C_RATE[1]
    shown = f"{c_rate:.0f}" if c_rate < 1e6 else f"{c_rate:.0e}"
    words = f"{what} {shown} C: a pack gives less than {C_RATE[1]:g} C for a minute"
    return Doubt(Notice(words, Kind.CAPACITY), is_certain)


def check_stated(
    cells: int | None = None,
    capacity_Ah: float = math.nan,
    cutoff_V: float = math.nan,
    low_V: float = math.nan,
    ambient_C: float = math.nan,
    reserve_soc: float = 0.0,
    names: Names = Names(),
) -> None:
    """Raise UsageError, with the argument's name and its bounds, for a statement of the caller that is impossible.

    cells in series; capacity_Ah [Ah]; cutoff_V and low_V [V of the pack]; ambient_C [°C]; reserve_soc 0 to 0.99. None
    or NaN is not stated.
    """
    if cells is not None and not 1 <= _whole(names.cells, cells) <= MOST_CELLS:
        raise UsageError(f"{names.cells}{cells}: expected 1 to {MOST_CELLS}")
    doubt = capacity_doubt(checked_number(names.capacity, capacity_Ah))
    if doubt is not None:
        raise UsageError(f"{names.capacity}{doubt.words}")
    lowest_V, highest_V = ENDING_CELL_V
    for name, volts in ((names.cutoff, cutoff_V), (names.low, low_V)):
        if cells is not None:
            refuse_certain(ending_doubt(name, checked_number(name, volts), cells))
        elif not math.isnan(checked_number(name, volts)) and not lowest_V <= volts <= highest_V * MOST_CELLS:
            slip = " (millivolts?)" if volts > highest_V * MOST_CELLS else ""
            raise UsageError(f"{name}{volts:g} V: expected {lowest_V:g} to {highest_V:g} V for each cell{slip}")
    _check_between(names.ambient, ambient_C, *AMBIENT_C, unit=" °C")
    if math.isnan(checked_number(names.reserve, reserve_soc)):
        raise UsageError(f"{names.reserve}{reserve_soc}: expected 0 to {HIGHEST_RESERVE:g}")
    _check_between(names.reserve, reserve_soc, 0.0, HIGHEST_RESERVE)


def _check_between(name: str, value: float, low: float, high: float, unit: str = "") -> None:
    if not math.isnan(checked_number(name, value)) and not low <= value <= high:
        raise UsageError(f"{name}{value:g}: expected {low:g} to {high:g}{unit}")


def _whole(name: str, value: object) -> int:
    if isinstance(value, SupportsIndex) and not isinstance(value, bool):
        with suppress(TypeError):  # an array of several
            return operator.index(value)
    raise UsageError(f"{name}{value!r}: expected a whole number from 1 to {MOST_CELLS}, or None")


def checked_number(name: str, value: object) -> float:
    """Return a value as a float. Raises UsageError, which begins with `name`, if it is no number."""
    # A text is no number, even if it looks like one; neither is True.
    if isinstance(value, SupportsFloat) and not isinstance(value, bool):
        with suppress(TypeError, ValueError):  # an array of several
            return float(value)
    raise UsageError(f"{name}{value!r}: expected a number, or NaN where it is not known")


def _count(cells: int) -> str:
    return f"{cells} cell{'s' if cells > 1 else ''} in series"


def _expected_cells(voltages: FirstVoltages, lowest_V: float) -> str:
    """Say the bounds of a cell, and the fewest cells that the voltage fits."""
    volts = voltages.first_V if math.isnan(voltages.rested_V) else voltages.rested_V
    fewest = max(1, math.ceil(volts / FULLEST_CELL_V))
    return f"expected {lowest_V:.3g} to {HIGHEST_CELL_V:g} V before the load, as with {fewest}"


def _slip(volts: float, cells: int) -> str:
    """Say the mistake that explains an impossible voltage: one cell's value, or another unit; empty if none does."""
    lowest_V, highest_V = ENDING_CELL_V
    if cells > 1 and lowest_V <= volts <= highest_V:
        return f" (one cell's value? {cells} of them make {volts * cells:g} V)"
    return " (millivolts?)" if lowest_V <= volts / 1000.0 / cells <= highest_V else ""
