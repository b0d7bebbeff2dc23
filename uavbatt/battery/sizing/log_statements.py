"""Statements about the pack of a log, compared with its first rows or with all of them before a command begins.

Row by row in flight, `statements` does the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing.pack_size import (
    PackOptions,
    PackSize,
    capacity_since_s,
    checked,
    counts_of_cells,
    resting,
    size_of_pack,
)
from uavbatt.battery.sizing.statements import SEVERAL_ROWS, Statements, is_at_rest
from uavbatt.errors import UsageError
from uavbatt.limits import GUESSED_FROM, TOLD_FROM, FirstVoltages, Resting, told_cells
from uavbatt.records import NAN, Flight, PackFacts, Sample

FIRST_ROWS_S = 120.0  # part of a log that a command reads before it begins


def first_voltages(samples: Iterable[Sample], capacity_Ah: float = NAN) -> FirstVoltages:
    """Return the pack's highest voltages [V] before the load of a record, or of its first minutes.

    Where the current is metered and no capacity is given, none counts as rested.
    """
    statements, start_s = Statements(), NAN
    for sample in samples:
        if not math.isfinite(sample.voltage_V):
            continue
        start_s = start_s if statements.rows else sample.time_s
        is_idle = is_at_rest(sample, capacity_Ah)
        if sample.time_s - start_s > FIRST_ROWS_S or (statements.rows >= SEVERAL_ROWS and not is_idle):
            break
        statements = statements.with_voltage(sample.voltage_V, is_idle)
    return statements.voltages


def size_from_rows(battery: BatteryFile, options: PackOptions, flight: Flight, facts: PackFacts) -> PackSize:
    """Size the pack of a flight by its first rows and by what the vehicle says (`facts`).

    Raises UsageError when there is no voltage, or when the first rows contradict what the caller states.
    """
    first = next((s for s in flight.samples if math.isfinite(s.voltage_V)), None)
    if first is None:
        raise UsageError(f"{flight.source}: expected at least one row with the voltage of a pack")
    told = told_cells(first.cell_voltages_V, first.voltage_V)
    guess = told or counts_of_cells(battery, options, facts, first.voltage_V, first.current_A)[0]
    source = TOLD_FROM if told else GUESSED_FROM
    try:
        voltages = first_voltages(flight.samples, size_of_pack(battery, options, facts, guess).capacity_Ah)
        size = size_of_pack(battery, options, facts, guess, source, voltages=voltages, rested_V=voltages.rested_V)
        return checked(battery, size, voltages)
    except UsageError as error:
        raise UsageError(f"{flight.source}: {error}") from None


def check_statements(battery: BatteryFile, options: PackOptions, flight: Flight) -> None:
    """Raise UsageError when the first rows of a flight make a statement of the caller about its pack impossible."""
    first = next((s for s in flight.samples if math.isfinite(s.voltage_V)), None)
    if first is not None:
        until_s = max(first.time_s + FIRST_ROWS_S, capacity_since_s(battery, options, flight.facts))
        size_from_rows(battery, options, flight, flight.facts_at(until_s))


def check_whole(flight: Flight, pack: PackSize, rested: Resting) -> None:
    """Raise UsageError when a row of the flight contradicts the size of its pack for certain."""
    statements = Statements()
    for sample in flight.samples:
        statements = statements.after(sample, sample, pack)
        doubts = statements.doubts(pack, rested)
        if doubts and doubts[0].is_certain and statements.rows >= SEVERAL_ROWS:
            raise UsageError(f"{flight.source}: {doubts[0].words}")


def whole_size(battery: BatteryFile, options: PackOptions, flight: Flight) -> PackSize:
    """Return the size of a flight's pack by all that the log says.

    Raises UsageError when there is no voltage, or when a row contradicts the size for certain.
    """
    size = size_from_rows(battery, options, flight, flight.facts_at(math.inf))
    check_whole(flight, size, resting(battery))
    return size
