"""Remarks on the size of a pack: odd statements of it, and sizes that the battery file does not cover."""

from __future__ import annotations

from dataclasses import replace

from uavbatt.battery.battery_file import GENERIC, GENERIC_LITHIUM_ION, Battery, BatteryFile
from uavbatt.battery.high_voltage import ORDINARY_FULL_V
from uavbatt.limits import LEAST_FULL_SHARE, Doubt, FirstVoltages, capacity_doubt, ending_doubt
from uavbatt.notice import Kind, Notice
from uavbatt.records import NAN, PackFacts

CAPACITY = "capacity of the vehicle,"
SCALED_FAR = 1.5  # a capacity so many times that of the battery file is another pack's
LEAST_LIPO_ENDING_V = 3.1  # of a cell: crews end LiPo flights at 3.2 to 3.6 V, lithium-ion ones at 2.5 to 3.1 V


def likely(doubts: list[Doubt | None]) -> tuple[str, ...]:
    """Return the words of the doubts that are likely but not certain."""
    return tuple(doubt.words for doubt in doubts if doubt is not None and not doubt.is_certain)


def possible_facts(facts: PackFacts, cells: int, voltages: FirstVoltages) -> tuple[PackFacts, tuple[str, ...]]:
    """Return the vehicle's statements that are possible for a pack of `cells`, and notices about the others."""
    capacity = capacity_doubt(facts.capacity_Ah)
    volts, name = facts.critical_voltage_V, "critical voltage of the vehicle, "
    critical = ending_doubt(name, volts, cells, voltages.rested_V, Kind.CRITICAL_VOLTAGE)
    name = "low-voltage warning of the vehicle, "
    low = ending_doubt(name, facts.low_voltage_V, cells, kind=Kind.LOW_VOLTAGE)
    if capacity is not None:
        capacity = Doubt(Notice(f"{CAPACITY} {capacity.words}", Kind.CAPACITY_OF_VEHICLE), True)

    def unless_impossible(value: float, doubt: Doubt | None) -> float:
        return NAN if doubt is not None and doubt.is_certain else value

    sound = replace(
        facts,
        capacity_Ah=unless_impossible(facts.capacity_Ah, capacity),
        critical_voltage_V=unless_impossible(facts.critical_voltage_V, critical),
        low_voltage_V=unless_impossible(facts.low_voltage_V, low),
        full_share=facts.full_share if LEAST_FULL_SHARE <= facts.full_share <= 1.0 else 1.0,
    )
    doubts = [d for d in (capacity, critical, low) if d is not None]
    return sound, tuple(Notice(f"{d.words}: not used", d.words.kind) if d.is_certain else d.words for d in doubts)


def scaled_far(battery: BatteryFile, cells: int, capacity_Ah: float) -> tuple[str, ...]:
    """Return a remark where a file fitted to one pack is used for a very different one; other files have others."""
    typed = battery.battery
    if battery.status != "fitted":
        return ()
    ratio = capacity_Ah / typed.capacity_Ah if typed.capacity_Ah else 1.0
    if cells == typed.cells_series and 1.0 / SCALED_FAR <= ratio <= SCALED_FAR:
        return ()
    size = _size(typed)
    return (f"the battery file is of a {size} pack, this one is {cells}S {capacity_Ah:g} Ah: is it the right file?",)


def other_kind(battery: BatteryFile, cells: int, cutoff_V: float, fullest_V: float) -> tuple[str, ...]:
    """Return a remark where the cells look like another kind than a generic file's, by cut-off [V] or fullest cell [V].

    Cells that charge higher are taken for ones that do; lithium-ion cells need a file of their own.
    """
    if battery.status == "generic" and fullest_V > ORDINARY_FULL_V:
        return (f"a cell has rested at {fullest_V:g} V: taken for LiHV, which charges to 4.35 V",)
    if battery.battery.name != GENERIC or not ends_as_lithium_ion(cells, cutoff_V):
        return ()
    ends = f"cut-off {cutoff_V:g} V is {cutoff_V / cells:.2f} V a cell"
    return (f"{ends}, as for lithium-ion cells: for those take the battery file `{GENERIC_LITHIUM_ION}`",)


def ends_as_lithium_ion(cells: int, cutoff_V: float) -> bool:
    """Return True if the cut-off of a pack [V] is so low a cell as crews set it for lithium-ion cells."""
    return round(cutoff_V / cells, 3) < LEAST_LIPO_ENDING_V


def uncertified(battery: BatteryFile, cells: int, capacity_Ah: float) -> str:
    """Return in words how a pack of this size goes beyond the certificate; empty when it does not."""
    typed = battery.battery
    if battery.caveat:
        return Notice(battery.caveat, Kind.UNCERTIFIED)
    if (cells, capacity_Ah) == (typed.cells_series, typed.capacity_Ah):
        return ""
    known = "" if typed.capacity_Ah else " of a capacity that its tests do not tell"
    return f"the certificate is for a {_size(typed)} pack{known}; this one is scaled from it"


def _size(typed: Battery) -> str:
    return f"{typed.cells_series}S" + (f" {typed.capacity_Ah:g} Ah" if typed.capacity_Ah else "")
