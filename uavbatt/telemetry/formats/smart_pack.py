"""Rows of a smart pack as apps write them: ten rows a second, while the pack sends about one reading a second.

A repeated reading is not a second measurement: it would make the filter too sure. A row counts if a value has changed,
or if the last one was a second ago.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from uavbatt.records import NAN, Sample
from uavbatt.telemetry.builder import LogBuilder
from uavbatt.telemetry.formats.logger_table import TableRow
from uavbatt.telemetry.parameters import ardupilot_prefix

HELD_S = 1.0
CELLS = tuple(f"cell_{n}_V" for n in range(1, 15))


def add_rows(rows: Iterable[TableRow], log: LogBuilder) -> None:
    """Add the rows with new values to the log, and the cells and capacity that the pack states."""
    said: tuple[str, ...] = ()
    kept_s = -math.inf
    for row in rows:
        raw_s = row.values["time_s"]
        if math.isnan(raw_s):
            log.counts["rows without a time dropped"] += 1
            continue
        time_s = log.time_s(raw_s)
        sample = _sample(time_s, row)
        _state(log, time_s, row, sample)
        telling = row.cells[1:]  # behind the time
        if telling == said and time_s - kept_s < HELD_S:
            continue
        said, kept_s = telling, time_s
        log.add(0, sample)


def cells_of(names: str) -> dict[str, str]:
    """Return our names of the cells' voltages, each with the table's; `{}` in `names` is the number of the cell."""
    return {ours: names.format(n) for n, ours in enumerate(CELLS, start=1)}


def _sample(time_s: float, row: TableRow) -> Sample:
    values = row.values
    motors = values.get("motors", NAN)
    cells = (values.get(name, NAN) for name in CELLS)
    return Sample(
        time_s=time_s,
        voltage_V=values["voltage_V"],
        current_A=values.get("current_A", NAN),
        temp_C=values.get("temp_C", NAN),
        consumed_Ah=values.get("consumed_Ah", NAN),
        armed=None if math.isnan(motors) else bool(motors),
        cell_voltages_V=tuple(volts for volts in cells if volts > 0.0),  # 0: the pack does not have this cell
    )


def _state(log: LogBuilder, time_s: float, row: TableRow, sample: Sample) -> None:
    """Add cells and capacity that the pack states as vehicle parameters, the first time they are known."""
    stated = {
        "BAT1_N_CELLS": float(len(sample.cell_voltages_V)),
        ardupilot_prefix(0) + "CAPACITY": row.values.get("capacity_mAh", NAN),
    }
    known = {name for _, name, _ in log.parameters}
    for name, value in stated.items():
        if value > 0.0 and name not in known and sample.voltage_V > 0.0:
            log.add_parameter(time_s, name, value)
