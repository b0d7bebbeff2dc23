"""`discharge.csv`: the readings of a discharge data set, checked row by row.

Columns `sample,run,ambient_c,time_s,voltage_v,current_a,surface_c` in any order; an empty cell means not
measured, and a row without a voltage is left out. Where a few currents of a run are empty, they are read from their
neighbours; where many are, the current of that run counts as not measured. A run is one (sample, run, ambient) triple.
Bounds: a lithium cell reads 0.5 to 5 V, the air of a test is at -80 to 70 °C; other values are mistakes of the unit.
Every error names the line.
"""

from __future__ import annotations

import csv
import io
import math
from difflib import get_close_matches
from typing import NamedTuple

import numpy as np

from uavbatt.dataset.records import Array, Run
from uavbatt.errors import BadInput

COLUMNS = ("sample", "run", "ambient_c", "time_s", "voltage_v", "current_a", "surface_c")
MIN_POINTS = 3
CELL_RANGE_V = (0.5, 5.0)
LEAST_HIGHEST_CELL_V = 2.2  # every flying cell shows more at some time; half a full LiPo cell is less
MOST_EMPTY = 0.2  # share of a run's currents that may be read from their neighbours
TEMP_RANGE_C = {"ambient_c": (-80.0, 70.0), "surface_c": (-80.0, 150.0)}


class _Row(NamedTuple):
    line: int
    key: tuple[str, int, float]
    time_s: float
    voltage_V: float
    current_A: float
    surface_C: float


def read_runs(text: str, shown: str, cells_series: int) -> tuple[Run, ...]:
    """Read the runs in the text of `discharge.csv`; raises BadInput, in which `shown` names the file."""
    try:
        return _runs(_rows(text, shown), cells_series, shown)
    except csv.Error as error:  # a quoted cell is not closed
        raise BadInput(shown, "", f"a table, cannot be read: {error}") from None


def _rows(text: str, shown: str) -> list[_Row]:
    reader = csv.reader(io.StringIO(text))
    header = [h.strip() for h in next(reader, [])]
    if not any(header):
        raise BadInput(shown, "line 1", f"the columns {','.join(COLUMNS)}, the file is empty")
    _check_header(header, shown)
    rows = []
    for cells in reader:
        line = reader.line_num
        if not any(c.strip() for c in cells):
            continue
        if len(cells) != len(header):
            commas = " (decimal commas? decimals are written with points)" if len(cells) > len(header) else ""
            raise BadInput(shown, f"line {line}", f"{len(header)} cells, found {len(cells)}{commas}")
        rows.append(_row(dict(zip(header, cells, strict=True)), line, shown))
    if not rows:
        raise BadInput(shown, "line 2", "at least one row of readings")
    return rows


def _check_header(header: list[str], shown: str) -> None:
    """Raise BadInput if the columns are not COLUMNS, in any order."""
    absent = [name for name in COLUMNS if name not in header]
    if absent:
        near = get_close_matches(absent[0], [h for h in header if h not in COLUMNS], 1)
        said = f"the column{'s' * (len(absent) > 1)} {','.join(absent)}" + (f", found {near[0]}" if near else "")
        if ";" in header[0] or "\t" in header[0]:
            said += " (found semicolons or tabs between the columns: write commas, and decimals with points)"
        rest = f"; all of them: {','.join(COLUMNS)}" if len(absent) < len(COLUMNS) else ""
        raise BadInput(shown, "line 1", f"{said}{rest}")
    extra = [h for h in header if h not in COLUMNS or header.count(h) > 1]
    if extra:
        said = f"only the columns {','.join(COLUMNS)}, found {extra[0] or 'an empty name'}"
        raise BadInput(shown, "line 1", said)


def _row(cells: dict[str, str], line: int, shown: str) -> _Row:
    def number(name: str, *, needed: bool = False) -> float:
        text = cells[name].strip()
        if not text and not needed:
            return math.nan
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            empty = "" if needed else " or an empty cell"
            units = " (a row of units? the header is one line)" if line == 2 and text and name == "run" else ""
            raise BadInput(shown, f"line {line}, {name}", f"a finite number{empty}, found '{text}'{units}")
        return value

    sample, run = cells["sample"].strip(), number("run", needed=True)
    if not sample:
        raise BadInput(shown, f"line {line}, sample", "a label, found an empty cell")
    if run != int(run):
        raise BadInput(shown, f"line {line}, run", f"a whole number, found '{cells['run'].strip()}'")
    key = (sample, int(run), number("ambient_c", needed=True) + 0.0)
    readings = [number(n) for n in ("voltage_v", "current_a", "surface_c")]
    return _Row(line, key, number("time_s", needed=True), *readings)


def _runs(rows: list[_Row], cells_series: int, shown: str) -> tuple[Run, ...]:
    seen: dict[tuple[str, int, float, float], int] = {}
    grouped: dict[tuple[str, int, float], list[_Row]] = {}
    for row in rows:
        _check_units(row, cells_series, shown)
        first = seen.setdefault((*row.key, row.time_s), row.line)
        if first != row.line:
            raise BadInput(shown, f"line {row.line}", f"each reading once, it repeats line {first}")
        run = grouped.setdefault(row.key, [])
        if run and row.time_s <= run[-1].time_s:
            said = f"time increasing within a run, {row.time_s:g} s follows {run[-1].time_s:g} s"
            raise BadInput(shown, f"line {row.line}, time_s", said)
        run.append(row)
    for name in ("surface_C", "current_A"):
        values = np.array([getattr(r, name) for r in rows])
        values = values[~np.isnan(values)]
        stuck = len(values) >= MIN_POINTS and bool(np.all(values == values[0]))
        if stuck and (name == "surface_C" or values[0] == 0):
            said = f"readings, every row says {values[0]:g}; leave the cells empty if it was not measured"
            raise BadInput(shown, f"column {name.lower()}", said)
    return tuple(_run(key, group, cells_series, shown) for key, group in grouped.items())


def _check_units(row: _Row, cells_series: int, shown: str) -> None:
    place, cell_V = f"line {row.line}", row.voltage_V / cells_series
    low, high = CELL_RANGE_V
    if not (math.isnan(cell_V) or low <= cell_V <= high):
        guess = " (millivolts?)" if 500 < cell_V <= 5000 else " (centivolts?)" if 50 < cell_V <= 500 else ""
        said = f"{low * cells_series:g} to {high * cells_series:g} V for {cells_series} cells in series"
        raise BadInput(shown, f"{place}, voltage_v", f"{said}, found {row.voltage_V:g}{guess}")
    for name, value in (("ambient_c", row.key[2]), ("surface_c", row.surface_C)):
        low, high = TEMP_RANGE_C[name]
        if not (math.isnan(value) or low <= value <= high):
            guess = " (kelvin?)" if 190 < value < 425 else " (degrees Fahrenheit?)" if high < value <= 190 else ""
            raise BadInput(shown, f"{place}, {name}", f"{low:g} to {high:g} °C, found {value:g}{guess}")


def _run(key: tuple[str, int, float], rows: list[_Row], cells_series: int, shown: str) -> Run:
    sample, run, ambient_C = key
    place = f"sample {sample}, run {run} at {ambient_C:g} °C (from line {rows[0].line})"
    readings = np.array([r[2:] for r in rows if not math.isnan(r.voltage_V)], dtype=float)
    if len(readings) < MIN_POINTS:
        raise BadInput(shown, place, f"at least {MIN_POINTS} voltage readings, found {len(readings)}")
    time_s, voltage_V, current_A, surface_C = readings.T
    if np.all(voltage_V == voltage_V[0]):
        raise BadInput(shown, place, f"a discharge, voltage_v is constant at {voltage_V[0]:g}")
    highest_V = float(np.max(voltage_V))
    if highest_V < LEAST_HIGHEST_CELL_V * cells_series:
        said = f"the voltage of the whole pack, found {highest_V:g} V at most for {cells_series} cells: per cell?"
        raise BadInput(shown, f"{place}, voltage_v", said)
    duration_s = time_s[-1] - time_s[0]
    if duration_s > 1e6:
        raise BadInput(shown, place, f"time_s in seconds, the run lasts {duration_s:g} (milliseconds?)")
    return Run(sample, run, ambient_C, time_s, voltage_V, _known_current_A(time_s, current_A), surface_C)


def _known_current_A(time_s: Array, current_A: Array) -> Array:
    """Return the current of a run at each of its rows [A], or NaN at all of them if it was not measured."""
    known = ~np.isnan(current_A)
    if np.mean(known) < 1.0 - MOST_EMPTY:
        return np.full(current_A.size, math.nan)
    return np.interp(time_s, time_s[known], current_A[known])
