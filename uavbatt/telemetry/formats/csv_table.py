"""Telemetry CSV: `time_s,voltage_V` and any of `current_A,temp_C,consumed_Ah,reported_soc,armed`.

A table is made by hand or by a script, so it is checked strictly: what no sensor writes by itself (text, a missing
voltage, time that runs back, millivolts, percent) is refused with row and column, another unit with its column.
An empty cell or `nan` means "not measured" outside time and voltage. `time_s` may be seconds or ISO 8601.

A table as `ulog2csv` writes it of PX4's battery_status (`timestamp` in microseconds, `voltage_v`, ...) is read as well.
"""

from __future__ import annotations

import csv
import difflib
import io
import math
import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime

from uavbatt.errors import BadInput
from uavbatt.records import NAN, Sample
from uavbatt.telemetry.builder import IMPOSSIBLE_CURRENTS, MAX_VOLTAGE_V, LogBuilder
from uavbatt.telemetry.cleaning.cleaner import LATEST_S
from uavbatt.telemetry.formats.csv_units import check_units
from uavbatt.telemetry.formats.px4_unknown import px4_value

REQUIRED = ("time_s", "voltage_V")
OPTIONAL = ("current_A", "temp_C", "consumed_Ah", "reported_soc", "armed")
# Columns of ulog2csv for each of ours, the first that is there, with the factor to our unit.
ULOG2CSV: dict[str, tuple[tuple[str, ...], float]] = {
    "time_s": (("timestamp",), 1e-6),
    "voltage_V": (("voltage_v", "voltage_filtered_v"), 1.0),
    "current_A": (("current_a", "current_filtered_a"), 1.0),
    "temp_C": (("temperature",), 1.0),
    "consumed_Ah": (("discharged_mah",), 1e-3),
    "reported_soc": (("remaining",), 1.0),
}
_MISSPELT_RATIO = 0.6
_ISO = re.compile(r"\d{4}-\d\d-\d\d[T ]")
_ARMED = {"1": True, "true": True, "0": False, "false": False, "": None, "nan": None}


def read_csv(source: str, data: bytes) -> LogBuilder:
    """Read the rows of a telemetry CSV; `source` names it in errors. Raises BadInput for a bad table."""
    text = data.decode("utf-8-sig", errors="replace")
    lines = [(n, line) for n, line in enumerate(text.splitlines(), start=1) if line.strip()]
    log = LogBuilder()
    header = _cells(lines[0][1]) if lines else []
    factors = _ulog2csv(header)
    columns = header if factors else _columns(source, header, log)
    start_s: float | None = None
    before_s = -math.inf
    for row, (line_number, line) in enumerate(lines[1:], start=1):
        cells = _cells(line)
        if len(cells) < len(columns) and row == len(lines) - 1 and not text.endswith(("\n", "\r")):
            log.skipped_bytes += len(line.encode())
            log.notes.append("the last row is cut")
            break
        place = f"row {row} (line {line_number})"
        if len(cells) != len(columns):
            raise BadInput(source, place, f"{len(columns)} cells, found {len(cells)}")
        named = dict(zip(columns, cells, strict=True))
        if factors:
            named = {ours: _scaled(theirs, named[theirs], factor) for ours, (theirs, factor) in factors.items()}
        before_s = _time_s(source, place, named, before_s)
        start_s = before_s if start_s is None else start_s
        log.now_s = before_s - start_s  # the times of a table are stated: a jump is no reboot
        log.add(0, _sample(source, place, named, log.now_s))
    check_units(source, log.rows.get(0, []), log.counts[IMPOSSIBLE_CURRENTS])
    return log


def _ulog2csv(header: Sequence[str]) -> dict[str, tuple[str, float]]:
    """Return our columns with PX4's name of each and the factor to our unit; empty for a table of another kind."""
    if "timestamp" not in header or "time_s" in header:
        return {}
    there = {ours: (next((n for n in names if n in header), ""), factor) for ours, (names, factor) in ULOG2CSV.items()}
    found = {ours: named for ours, named in there.items() if named[0]}
    return found if "voltage_V" in found else {}


def _scaled(column: str, cell: str, factor: float) -> str:
    """Return a cell of PX4's column in our unit, empty if unknown; what is no number stays, and is refused later."""
    try:
        value = float(cell)
    except ValueError:
        return cell
    if math.isnan(px4_value(column, value)):
        return ""
    return repr(value * factor) if factor != 1.0 else cell


def _seconds(cell: str) -> str:
    """Return a time in ISO 8601 as seconds; any other cell unchanged."""
    if not _ISO.match(cell):
        return cell
    try:
        when = datetime.fromisoformat(cell)
    except ValueError:
        return cell
    return repr((when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp())


def _cells(line: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader(io.StringIO(line)))]
    except csv.Error:
        return [line]  # a cell without an end: the count of columns refuses it


def _columns(source: str, header: Sequence[str], log: LogBuilder) -> list[str]:
    """Return the names of the columns. Raises BadInput for one that is missing, misspelt or there twice."""
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if any(mark in column for column in header):
            raise BadInput(source, "header", f"columns separated by commas, found {name}")
    absent = [name for name in (*REQUIRED, *OPTIONAL) if name not in header]
    for name in header:
        if name in REQUIRED or name in OPTIONAL:
            if header.count(name) > 1:
                raise BadInput(source, f"column `{name}`", "each column once")
            continue
        meant = _close(name, absent)
        if meant:
            known = ", ".join((*REQUIRED, *OPTIONAL))
            raise BadInput(source, f"column `{name}`", f"a known column (did you mean `{meant}`?): {known}")
        log.notes.append(f"column `{name}` is not known, ignored")
    for name in REQUIRED:
        if name not in header:
            found = ",".join(header)
            raise BadInput(source, "header", f"a column `{name}`, found `{found[:80]}`")
    return list(header)


def _close(name: str, candidates: Sequence[str]) -> str | None:
    lowered = {candidate.lower(): candidate for candidate in candidates}
    hits = difflib.get_close_matches(name.lower(), lowered, n=1, cutoff=_MISSPELT_RATIO)
    return lowered[hits[0]] if hits else None


def _time_s(source: str, place: str, cells: dict[str, str], before_s: float) -> float:
    """Return the checked time of a row [s] as written; `before_s` is that of the row before."""

    def error(expected: str) -> BadInput:
        return BadInput(source, f"{place}, column time_s", expected)

    time_s = _number(_seconds(cells.get("time_s", "")), True, error)
    if time_s < before_s:
        raise error(f"time not before {before_s:g} s, found {time_s:g}")
    if not abs(time_s) < LATEST_S:
        raise error(f"seconds, found {time_s:g}")
    return time_s


def _sample(source: str, place: str, cells: dict[str, str], time_s: float) -> Sample:
    """Return one checked row at `time_s` [s]."""

    def number(column: str, needed: bool = False) -> float:
        return _number(cells.get(column, ""), needed, lambda e: BadInput(source, f"{place}, column {column}", e))

    voltage_V = number("voltage_V", needed=True)
    if voltage_V > MAX_VOLTAGE_V:
        raise BadInput(source, f"{place}, column voltage_V", f"volts, found {voltage_V:g} (millivolts?)")
    soc, consumed_Ah = number("reported_soc"), number("consumed_Ah")
    if soc > 1:
        raise BadInput(source, f"{place}, column reported_soc", f"0..1, found {soc:g} (percent?)")
    armed = cells.get("armed", "").lower()
    if armed not in _ARMED and armed not in ("1.0", "0.0"):
        raise BadInput(source, f"{place}, column armed", f"0 or 1, found `{armed[:40]}`")
    return Sample(
        time_s=time_s,
        voltage_V=voltage_V,
        current_A=number("current_A"),
        temp_C=number("temp_C"),
        consumed_Ah=NAN if consumed_Ah == -1 else consumed_Ah,
        reported_soc=soc if soc >= 0 else NAN,
        armed=_ARMED.get(armed, armed == "1.0"),
    )


def _number(cell: str, needed: bool, error: Callable[[str], BadInput]) -> float:
    """Return a cell as a number; NaN for an empty cell, which is an error in a needed column."""
    try:
        value = float(cell) if cell and "_" not in cell else NAN
    except ValueError:
        value = math.inf
    if cell and (math.isinf(value) or "_" in cell):
        raise error(f"a number, found `{cell[:40]}`")
    if needed and math.isnan(value):
        raise error(f"a number, found {'`' + cell + '`' if cell else 'an empty cell'}")
    return value
