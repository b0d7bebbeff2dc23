"""Findings of a flight about its pack, other than resistance and capacity: weak cell, damage, another pack."""

from __future__ import annotations

import math

from uavbatt.battery.battery_file import is_generic
from uavbatt.battery.model import Array
from uavbatt.packs.records import FlightRecord, PackFinding

WEAK_CELL_V = 0.06  # below the mean of the cells under load; cells of a balanced pack stay within half of it
FASTEST_CHARGE_C, COUNTED_CHARGE = 6.0, 0.15  # chargers give 1 to 5 C; smaller rises may be a misread start
ANOTHER = "another_pack"
HELD_TEXT = "another pack under this name?"


def by_itself(flight: FlightRecord) -> tuple[PackFinding, ...]:
    """Return the findings that one flight shows alone."""
    if not flight.weak_cell_V > WEAK_CELL_V:
        return ()
    words = f"cell {flight.weak_cell} lies {1000.0 * flight.weak_cell_V:.0f} mV below the others under load"
    return (PackFinding("weak_cell", words),)


def between(earlier: FlightRecord, flight: FlightRecord) -> tuple[PackFinding, ...]:
    """Return the findings that two flights of one pack name, one after the other, show together."""
    found = []
    hours = (flight.start_utc_s - earlier.start_utc_s - earlier.duration_s) / 3600.0
    charged = flight.soc_start - earlier.soc_end
    if charged > COUNTED_CHARGE and hours * FASTEST_CHARGE_C < charged:
        words = f"{100.0 * charged:.0f} % more charge after {60.0 * max(hours, 0.0):.0f} minutes: {HELD_TEXT}"
        found.append(PackFinding("charged_too_fast", words))
    if earlier.cycles is not None and flight.cycles is not None and flight.cycles < earlier.cycles:
        words = f"its counter fell from {earlier.cycles} to {flight.cycles} cycles: {HELD_TEXT}"
        found.append(PackFinding("counter", words))
    return tuple(found)


def of_battery_file(battery: str) -> tuple[PackFinding, ...]:
    """Return the finding that a pack's flights are read with the generic file; nothing for a file of a make."""
    if not is_generic(battery):
        return ()
    words = f"read with {battery}: its capacity may be a third off; fit a file of its make before you retire it"
    return (PackFinding("generic_file", words),)


def of_higher_charge(flight: FlightRecord) -> PackFinding:
    """Return the finding of a pack whose cells are seen to charge higher than in its earlier flights (LiHV)."""
    words = f"a cell rests at {flight.fullest_cell_V:.2f} V: it charges to 4.35 V (LiHV), flights before are left out"
    return PackFinding("higher_charge", words)


def sudden(
    z: Array,
    change: Array,
    since: str = " at once",
    causes: tuple[str, ...] = ("damaged",),
    *,
    has_thermometer: bool = True,
) -> PackFinding:
    """Return the finding of damage, by the resistance or by the capacity, whichever is further off.

    z [2] : distance of ln ohm and ln Ah from their expected values [sd]; change [2] : the same in ln; causes : that
    are asked about. The cold is one more where no thermometer was read.
    """
    *first, last = causes if has_thermometer else (*causes, "cold")
    asked = f"{', '.join(first)}, or {last}?" if first else f"{last}?"
    asked += "" if has_thermometer else " No temperature was measured"
    if z[0] >= -z[1]:
        return PackFinding("sudden_ohms", f"{100.0 * math.expm1(change[0]):.0f} % more resistance{since}: {asked}")
    return PackFinding("sudden_loss", f"{-100.0 * math.expm1(change[1]):.0f} % less charge{since}: {asked}")


def another(z: Array, change: Array) -> PackFinding:
    """Return the finding of another pack, by a change that no pack can make; z and change as in `sudden`."""
    if -z[0] >= z[1]:
        what = f"{-100.0 * math.expm1(change[0]):.0f} % less resistance"
    else:
        what = f"{100.0 * math.expm1(change[1]):.0f} % more charge"
    return PackFinding(ANOTHER, f"{what} at once, which no pack can do: {HELD_TEXT}")
