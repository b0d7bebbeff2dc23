"""The size of a pack (cells, capacity, cut-off, warning): the caller, the vehicle, the voltage and the battery file
state it, in this order. Every command and the live process go by this one rule.

An impossible statement (`limits`) is not used. If it is the vehicle's, a notice says so, and the next source in the
order counts. If it is the caller's, there is no number, but the reason.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from uavbatt.battery.battery_file import Battery, BatteryFile
from uavbatt.battery.high_voltage import ORDINARY_FULL_V, fullest_cell_V
from uavbatt.battery.scaling import Pack, pack_of
from uavbatt.battery.sizing.remarks import CAPACITY, likely, other_kind, possible_facts, scaled_far, uncertified
from uavbatt.errors import CapacityNotStated, UsageError
from uavbatt.limits import (
    EMPTIEST_CELL_V,
    GUESSED_FROM,
    LOWEST_CELL_V,
    OPTIONS,
    RESTING_SLACK_V,
    Doubt,
    FirstVoltages,
    Names,
    Resting,
    capacity_doubt,
    cells_doubt,
    cells_from_voltage,
    check_stated,
    ending_doubt,
    refuse_certain,
)
from uavbatt.nan_equal import nan_equal
from uavbatt.notice import Kind, Notice
from uavbatt.records import NAN, PackFacts

LITTLE_SOC, LITTLE_CELL_V = 0.1, 3.65
FROM_VEHICLE, FROM_BATTERY_FILE = "vehicle", "battery file"  # sources of a number
CALLERS_CELLS = {names.cells.rstrip(" =") for names in (OPTIONS, Names())}


@nan_equal
@dataclass(frozen=True, slots=True)
class PackOptions:
    """PackOptions holds what the caller states of the pack; None or NaN is not stated. Raises UsageError if impossible.

    fullest_cell_V : at which a full cell of this pack has rested in earlier flights [V]; names : the names by which the
    caller knows these numbers; what is said of them later uses the names.
    """

    cells: int | None = None
    capacity_Ah: float = NAN
    cutoff_V: float = NAN
    low_V: float = NAN
    ambient_C: float = NAN
    fullest_cell_V: float = ORDINARY_FULL_V
    names: Names = field(default=OPTIONS, repr=False)

    def __post_init__(self) -> None:
        check_stated(self.cells, self.capacity_Ah, self.cutoff_V, self.low_V, self.ambient_C)


@dataclass(frozen=True, slots=True)
class PackSize:
    """PackSize holds the size of a pack, and where each number came from."""

    battery: str
    status: str
    cells: int
    cells_from: str
    capacity_Ah: float
    capacity_from: str
    cutoff_V: float
    cutoff_from: str
    low_V: float
    low_from: str
    uncertified: str = ""  # how this pack goes beyond the battery file's certificate
    notices: tuple[str, ...] = ()  # odd values, and statements that were not believed
    refusal: Notice | None = None  # why there can be no number for it
    fullest_cell_V: float = ORDINARY_FULL_V  # more for cells that charge higher (`high_voltage`)
    full_share: float = 1.0  # capacity_Ah as a share of the rated one: the battery says that it is worn

    @property
    def rated_Ah(self) -> float:
        """Return the capacity of a new pack of this size [Ah]."""
        return self.capacity_Ah / self.full_share

    @property
    def cell_kind(self) -> tuple[int, float, float]:
        """Return cells, capacity [Ah] and fullest voltage of a cell, if that counts [V]: others are another battery."""
        return self.cells, self.capacity_Ah, self.fullest_cell_V if self.status == "generic" else ORDINARY_FULL_V

    def numbers(self) -> dict[str, int | float | str]:
        """Return the numbers of the pack, each with where it came from, by the names that every summary uses."""
        fields = ("cells", "capacity_Ah", "cutoff_V", "low_V")
        return {name: getattr(self, name) for of in fields for name in (of, f"{of.partition('_')[0]}_from")}

    @property
    def words(self) -> str:
        """Return the size of the pack and its cut-off in words, each with where it came from."""
        return (
            f"{self.cells}S from {self.cells_from}, {self.capacity_Ah:g} Ah from {self.capacity_from}, "
            f"cut-off {self.cutoff_V:g} V from {self.cutoff_from}"
        )


def size_of_pack(
    battery: BatteryFile,
    options: PackOptions,
    facts: PackFacts,
    guessed_cells: int,
    guessed_from: str = GUESSED_FROM,
    voltages: FirstVoltages = FirstVoltages(),
    rested_V: float = NAN,
) -> PackSize:
    """Size a pack: by the caller's statement, else the vehicle's, else the guess (cells) or the battery file.

    guessed_cells, guessed_from : the count that fits the voltage, and its source in words; voltages : those [V] that
    the statements are compared with; rested_V : voltage of the pack before its first load [V], if it is to show the
    kind of the cells (`high_voltage`). Raises UsageError when nobody states the capacity.
    """
    guess = (guessed_cells, guessed_from)
    cells, cells_from, cells_notices = _cells(options, facts, guess, voltages, resting(battery))
    if cells_notices:  # PX4 works out its critical voltage from its count of cells
        facts = replace(facts, critical_voltage_V=NAN)
    if why_not := why_no_capacity(battery, options, facts):
        raise CapacityNotStated(why_not)
    facts, notices = possible_facts(facts, cells, voltages)
    capacity_Ah, capacity_from = _capacity(battery, options, facts)
    full_share = facts.full_share if capacity_from == FROM_VEHICLE else 1.0
    capacity_Ah *= full_share
    (cutoff_V, cutoff_from), (low_V, low_from) = _endings(battery.battery, options, facts, cells)
    doubts = _ending_doubts(options, cells, voltages)
    fullest_V = max(fullest_cell_V(rested_V, cells), options.fullest_cell_V)
    doubtful = (*cells_notices, *notices, *likely(doubts))
    return PackSize(
        battery=battery.battery.name,
        status=battery.status,
        cells=cells,
        cells_from=cells_from,
        capacity_Ah=capacity_Ah,
        capacity_from=capacity_from,
        cutoff_V=cutoff_V,
        cutoff_from=cutoff_from,
        low_V=low_V,
        low_from=low_from,
        uncertified=uncertified(battery, cells, capacity_Ah),
        notices=(*doubtful, *scaled_far(battery, cells, capacity_Ah), *other_kind(battery, cells, cutoff_V, fullest_V)),
        refusal=next((doubt.words for doubt in doubts if doubt is not None and doubt.is_certain), None),
        fullest_cell_V=fullest_V,
        full_share=full_share,
    )


def why_no_capacity(battery: BatteryFile, options: PackOptions, facts: PackFacts) -> str:
    """Return why nobody states the capacity, with what was not believed of the vehicle; empty where it is stated."""
    doubt = capacity_doubt(facts.capacity_Ah)
    vehicle_Ah = facts.capacity_Ah if doubt is None else NAN
    if math.isfinite(_capacity(battery, options, replace(facts, capacity_Ah=vehicle_Ah))[0]):
        return ""
    why = f"{CAPACITY} {doubt.words}: not used; " if doubt is not None else ""
    by = _by(options.names.capacity)
    return f"{why}capacity: neither the vehicle nor battery `{battery.battery.name}` states one: give {by}"


def capacity_since_s(
    battery: BatteryFile, options: PackOptions, statements: Iterable[tuple[float, PackFacts]]
) -> float:
    """Return since when the capacity is stated [s], by what the vehicle says in order of time; infinite if it never is.

    A ground station records rows first, parameters after. Minus infinity where caller or battery file states it.
    """
    changes = ((-math.inf, PackFacts()), *statements)
    return next((time_s for time_s, stated in changes if not why_no_capacity(battery, options, stated)), math.inf)


def counts_of_cells(
    battery: BatteryFile, options: PackOptions, facts: PackFacts, volts: float, current_A: float
) -> tuple[int, ...]:
    """Return the counts of cells that fit a voltage [V] under a current [A, NaN if unknown], the likeliest first."""
    capacity_Ah = options.capacity_Ah if math.isfinite(options.capacity_Ah) else facts.capacity_Ah
    rate = current_A / capacity_Ah if math.isfinite(current_A) and capacity_Ah > 0.0 else 0.0
    return cells_from_voltage(volts, battery.battery.cells_series, facts.endings_V, rate)


def pack_from(battery: BatteryFile, options: PackOptions) -> Pack:
    """Return the battery file scaled to a pack whose size the caller states; what he leaves out is the file's.

    Raises UsageError when neither states the capacity.
    """
    return sized(battery, size_of_pack(battery, options, PackFacts(), battery.battery.cells_series, FROM_BATTERY_FILE))


def sized(battery: BatteryFile, size: PackSize) -> Pack:
    """Return the battery file scaled to a pack of this size."""
    return pack_of(battery, size.cells, size.capacity_Ah, size.cutoff_V, size.low_V, size.fullest_cell_V)


def checked(battery: BatteryFile, pack: PackSize, voltages: FirstVoltages) -> PackSize:
    """Return `pack` if what the caller states of it fits the voltages that were seen; raises UsageError if not."""
    if pack.refusal:
        raise UsageError(pack.refusal)
    if pack.cells_from in CALLERS_CELLS:
        refuse_certain(cells_doubt(pack.cells, voltages, resting(battery)), f"{pack.cells_from}: ")
    return pack


def resting(battery: BatteryFile) -> Resting:
    """Return the voltages [V] of a rested cell of this battery when it is empty, and when little charge is left.

    Both are kept inside the limits of any cell, so that a wrong file cannot move them far.
    """
    table = battery.parameters
    low_V = float(np.interp(LITTLE_SOC, table.ocv_soc, table.ocv_V))
    empty_V = min(table.ocv_V[0], EMPTIEST_CELL_V + RESTING_SLACK_V)
    return Resting(max(empty_V - RESTING_SLACK_V, LOWEST_CELL_V), min(low_V, LITTLE_CELL_V))


def _capacity(battery: BatteryFile, options: PackOptions, facts: PackFacts) -> tuple[float, str]:
    """Return the capacity [Ah] and its source; `facts` holds the vehicle's statements that are believed."""
    stated, typed_Ah = (options.capacity_Ah, _by(options.names.capacity)), battery.battery.capacity_Ah
    return _first(stated, (facts.capacity_Ah, FROM_VEHICLE), (typed_Ah, FROM_BATTERY_FILE))


def _endings(
    typed: Battery, options: PackOptions, facts: PackFacts, cells: int
) -> tuple[tuple[float, str], tuple[float, str]]:
    """Return the cut-off and the low-voltage warning of the pack [V], each with its source."""
    share = cells / typed.cells_series
    cutoff = _first(
        (options.cutoff_V, _by(options.names.cutoff)),
        (facts.critical_voltage_V, FROM_VEHICLE),
        (typed.cutoff_V * share, FROM_BATTERY_FILE),
    )
    low = _first(
        (options.low_V, _by(options.names.low)),
        (facts.low_voltage_V, FROM_VEHICLE),
        (None if typed.low_V is None else typed.low_V * share, FROM_BATTERY_FILE),
        (NAN, "nobody"),
    )
    return cutoff, low


def _ending_doubts(options: PackOptions, cells: int, voltages: FirstVoltages) -> list[Doubt | None]:
    """Return the doubts about the cut-off and the low-voltage warning that the caller states."""
    return [
        ending_doubt("cut-off ", options.cutoff_V, cells, voltages.rested_V, Kind.CUTOFF),
        ending_doubt("low-voltage warning at ", options.low_V, cells, kind=Kind.LOW_VOLTAGE),
    ]


def _cells(
    options: PackOptions, facts: PackFacts, guess: tuple[int, str], voltages: FirstVoltages, cell: Resting
) -> tuple[int, str, tuple[str, ...]]:
    """Return the count of cells, its source, and a notice if the vehicle's own count is not believed."""
    if options.cells is not None:
        by = _by(options.names.cells)
        if facts.cells_series in (None, options.cells):
            return int(options.cells), by, ()
        option = f"{options.names.cells}{options.cells}"
        notice = f"{option}: the vehicle states {facts.cells_series}, whose critical voltage is not used"
        return int(options.cells), by, (Notice(notice, Kind.CELLS_OF_VEHICLE),)
    if facts.cells_series is None:
        return int(guess[0]), guess[1], ()
    doubt = cells_doubt(facts.cells_series, voltages, cell)
    if doubt is None or not doubt.is_certain:
        return facts.cells_series, FROM_VEHICLE, ()
    notice = f"the vehicle states {doubt.words}: not used, nor its critical voltage"
    return int(guess[0]), guess[1], (Notice(notice, Kind.CELLS_OF_VEHICLE),)


def _by(name: str) -> str:
    """Return the name alone of an option (`--cells `) or an argument (`cells=`)."""
    return name.rstrip(" =")


def _first(*candidates: tuple[float | int | None, str]) -> tuple[float, str]:
    """Return the first candidate that is known, with its source; NaN and the last source if none is known."""
    for value, source in candidates:
        if value is not None and math.isfinite(value):
            return float(value), source
    return NAN, candidates[-1][1]
