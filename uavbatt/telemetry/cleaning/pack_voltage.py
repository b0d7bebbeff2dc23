"""Voltage of a pack whose cells are sent one by one, if some cells are missing from the sum.

If a sense wire breaks in flight, its cell reads nothing or nonsense, while the pack is unchanged. A sender with fields
for ten cells leaves out the others. The sum is then too low by whole cells, which looks like a pack near its end.
SYS_STATUS holds the voltage of the same pack from another sensor: it is used if it is fresh. Otherwise each missing
cell is assumed to be like the others.
"""

from __future__ import annotations

import math
from collections.abc import Set
from dataclasses import replace
from typing import NamedTuple

from uavbatt.mavlink.fields import BatteryFields

FRESH_S = 2.0  # age up to which SYS_STATUS is used
WHOLE = 0.15  # of a cell: missing cells make a difference so near a whole number of cells
AGREE = 0.3  # of a cell
REPEATS = 3  # rows: between two messages the load may change by a cell's worth
MOST_TOLD = 10  # cells in the array that every sender has: the rest may be left out
LOWEST_IN_FLIGHT_V, HIGHEST_IN_FLIGHT_V = 1.0, 5.0  # outside nothing is a cell's voltage in flight
ANOTHER_PACK_S = 5.0  # silence on the ground, after which it may be another pack


class Cells(NamedTuple):
    """Cells holds what is known of the cells of one battery so far."""

    most: int = 0  # cells that were told at once
    time_s: float = math.nan
    agreed: bool = False  # the sum has agreed with SYS_STATUS
    missing: int = 0  # by the difference to SYS_STATUS in the last row; negative: too many
    repeats: int = 0  # rows with that difference


class PackVoltages:
    """PackVoltages corrects the pack voltages of one vehicle; `notes` says what it corrects now."""

    def __init__(self) -> None:
        self._cells: dict[int, Cells] = {}
        self._sys_status_V = self._sys_status_s = math.nan
        self._notes: dict[int, str] = {}

    @property
    def notes(self) -> list[str]:
        """Return a note for each battery with missing cells: what is wrong, and how it is corrected."""
        return [f"battery {number}: {words}" for number, words in sorted(self._notes.items())]

    def hear(self, voltage_V: float, time_s: float) -> None:
        """Take the voltage [V] of SYS_STATUS."""
        if voltage_V > 0.0:
            self._sys_status_V, self._sys_status_s = voltage_V, time_s

    def of(self, battery: BatteryFields, time_s: float, is_armed: bool | None, is_of_sys_status: bool) -> BatteryFields:
        """Return the BATTERY_STATUS with the voltage of the whole pack; cells are removed if some are missing.

        is_of_sys_status : SYS_STATUS speaks of the same battery.
        """
        before = self._cells.get(battery.id, Cells())
        if is_armed is False and time_s - before.time_s > ANOTHER_PACK_S:
            before = Cells()
        told_V = battery.cell_voltages_V
        if not told_V and before.most > 1 and battery.voltage_V < HIGHEST_IN_FLIGHT_V:
            told_V = (battery.voltage_V,)  # a single cell that is left is no pack
        sound_V = [volts for volts in told_V if LOWEST_IN_FLIGHT_V < volts < HIGHEST_IN_FLIGHT_V]
        if not sound_V:
            return battery
        mean_V = sum(sound_V) / len(sound_V)
        is_fresh = is_of_sys_status and time_s - self._sys_status_s <= FRESH_S
        pack_V = self._sys_status_V if is_fresh else math.nan
        now = _after(before, time_s, len(told_V), (pack_V - battery.voltage_V) / mean_V)
        self._cells[battery.id] = now
        missing = now.most - len(told_V) or _missing_by_sum(now, has_nonsense=len(sound_V) < len(told_V))
        if not missing:
            self._notes.pop(battery.id, None)
            return battery
        source = "SYS_STATUS" if is_fresh else "the others"
        what = f"{missing} of {now.most}" if now.most > len(told_V) else f"{abs(missing)}"
        words = f"the voltages of {what} cells are missing or wrong"
        self._notes[battery.id] = f"{words}: the pack's is taken from {source}"
        every = now.most + (now.missing if _is_cut(now) else 0)
        return replace(battery, voltage_V=pack_V if is_fresh else mean_V * every, cell_voltages_V=())


def is_in_sys_status(number: int, is_px4: bool, numbers: Set[int]) -> bool:
    """Return True if SYS_STATUS is of battery `number`, one of those in BATTERY_STATUS.

    ArduPilot sends its first battery in SYS_STATUS, PX4 the one in the worst state.
    """
    return number == 0 and not (is_px4 and numbers - {0})


def _after(before: Cells, time_s: float, told: int, difference: float) -> Cells:
    """Return the state after a row with `told` cells; their sum lacks `difference` cells of SYS_STATUS (NaN:
    unknown)."""
    most = max(before.most, told)
    if math.isnan(difference) or told < most:
        return before._replace(most=most, time_s=time_s)
    missing = round(difference) if abs(difference - round(difference)) <= WHOLE else 0
    repeats = before.repeats + 1 if missing == before.missing else 1
    return Cells(most, time_s, before.agreed or abs(difference) <= AGREE, missing, repeats)


def _is_cut(now: Cells) -> bool:
    """Return True if the sender has no fields for all cells: they have been missing from the start."""
    return now.most == MOST_TOLD and not now.agreed and now.missing > 0


def _missing_by_sum(now: Cells, has_nonsense: bool) -> int:
    """Return how many cells are missing by the difference to SYS_STATUS, if that is new or the sender lacks fields."""
    return now.missing if _is_cut(now) or (now.agreed and (has_nonsense or now.repeats >= REPEATS)) else 0
