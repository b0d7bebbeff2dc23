"""The units of a table that is made by hand: what the numbers themselves show to be another unit is refused.

No plausible flight may be refused. So a unit is called wrong only where no pack can do what the table says, or where
the charge by the current is off from the autopilot's own counter by just the factor between two units.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from statistics import fmean, median

import numpy as np

from uavbatt.errors import BadInput
from uavbatt.limits import C_RATE, LONGEST_ROW_S, cells_from_voltage
from uavbatt.records import Sample
from uavbatt.telemetry.quality.drawn import drawn, loaded_A

SEVERAL_STEPS, SEVERAL_ROWS = 5, 20
LEAST_COUNTED_AH, SAME, SHORT_S = 0.3, 0.1, 90.0
LATER_UNITS = {60.0: "minutes", 3600.0: "hours"}  # in seconds
MILLI = 1000.0
# Under an equal load a cell falls by this voltage only after it has given this share of its charge.
FALLEN_CELL_V, FALLEN_SHARE, EQUAL_LOAD = 0.35, 0.4, 0.3


def check_units(source: str, rows: Sequence[Sample], impossible: int) -> None:
    """Raise BadInput where the times or the currents of a table cannot be in seconds and amperes.

    impossible : how many currents were beyond what any pack gives, and were left out of the rows.
    """
    _check_slow_rows(source, rows)
    known = sum(math.isfinite(row.current_A) for row in rows)
    if impossible > known and impossible >= SEVERAL_ROWS:
        raise BadInput(
            source, "column current_A", "amperes, found more than any pack gives in most rows (milliamperes?)"
        )
    if known < max(SEVERAL_ROWS, (1.0 - SAME) * len(rows)):
        return
    _check_counted(source, rows)
    _check_fallen(source, rows)


def _check_slow_rows(source: str, rows: Sequence[Sample]) -> None:
    """Raise BadInput if all rows are minutes apart: their time is in milliseconds."""
    steps_s = [b.time_s - a.time_s for a, b in pairwise(rows)]
    if len(steps_s) >= SEVERAL_STEPS and median(steps_s) >= LONGEST_ROW_S:
        raise BadInput(source, "column time_s", f"seconds, found rows {median(steps_s):g} apart (milliseconds?)")


def _check_counted(source: str, rows: Sequence[Sample]) -> None:
    """Compare the charge by current and time with the autopilot's counter, as far as that has risen."""
    total = drawn(rows, math.inf)
    if not (total.counter_Ah >= LEAST_COUNTED_AH and total.charge_Ah > 0.0):
        return
    times = total.counter_Ah / total.charge_Ah
    found = f"{total.charge_Ah:.2g} Ah by the current, {total.counter_Ah:.2g} Ah by the counter"
    if _is_about(times, 1.0 / MILLI):
        raise BadInput(source, "column current_A", f"amperes, found {found} (milliamperes?)")
    unit = next((unit for factor, unit in LATER_UNITS.items() if _is_about(times, factor)), "")
    if unit and rows[-1].time_s - rows[0].time_s <= SHORT_S:
        raise BadInput(source, "column time_s", f"seconds, found {found} ({unit}?)")


def _is_about(value: float, expected: float) -> bool:
    return abs(value / expected - 1.0) <= SAME


def _check_fallen(source: str, rows: Sequence[Sample]) -> None:
    """Compare the fall of the voltage under an equal load with the time in which a pack can give so much charge."""
    amps = np.array([row.current_A for row in rows])
    loaded = [row for row, is_loaded in zip(rows, amps > loaded_A(amps), strict=True) if is_loaded]
    if len(loaded) < SEVERAL_ROWS:
        return
    part = len(loaded) // 10
    first, last = loaded[:part], loaded[-part:]
    begin_A, end_A = (fmean(row.current_A for row in of) for of in (first, last))
    cells = cells_from_voltage(rows[0].voltage_V)[0]
    fall_V = (fmean(row.voltage_V for row in first) - fmean(row.voltage_V for row in last)) / cells
    length_s = loaded[-1].time_s - loaded[0].time_s
    if (
        fall_V >= FALLEN_CELL_V
        and end_A <= (1.0 + EQUAL_LOAD) * begin_A
        and length_s * C_RATE[1] < FALLEN_SHARE * 3600.0
    ):
        found = f"a pack flown from {rows[0].voltage_V:.1f} to {loaded[-1].voltage_V:.1f} V in {length_s:.2g}"
        raise BadInput(source, "column time_s", f"seconds, found {found} (minutes or hours?)")
