"""Tables that an app or a logger wrote: which kind a table is, and its cells in our units.

Such tables have dozens of columns, and a few of them are of the battery. Column names are those of the program, with
the unit in brackets. Blanks around a name and a first line `sep=,` are ignored. An empty cell is not measured.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

from uavbatt.errors import BadInput
from uavbatt.records import NAN
from uavbatt.telemetry.builder import LogBuilder, finite_or_nan

Cell = Callable[[str], float]  # raises ValueError for a cell that is none
Columns = Mapping[str, Mapping[str, Cell]]  # our name -> the program's names; the first that is present counts
_BEGINNING = 1 << 16  # bytes in which a table names the aircraft and the battery
_OF_RADIOS = {"TxBat(V)", "LSW", "RxBt(V)", "VFAS(V)", "Curr(A)"}  # a radio's log has one of them at least
_NO_NUMBERS = {"Date": "a day as 2026-05-01", "Time": "a time as 16:39:41.300"}
_TRUTHS = {"true": 1.0, "1": 1.0, "false": 0.0, "0": 0.0}


class TableRow(NamedTuple):
    """A TableRow holds the cells of a row as written, and their values in our units; NaN is not measured."""

    cells: tuple[str, ...]
    values: Mapping[str, float]


def scaled(factor: float, offset: float = 0.0) -> Cell:
    """Return a function that reads a cell as a number and converts it into our unit: factor * number + offset."""
    return lambda cell: finite_or_nan(factor * float(cell) + offset)


NUMBER, MILLI, FAHRENHEIT = scaled(1.0), scaled(1e-3), scaled(5.0 / 9.0, -160.0 / 9.0)


def truth(cell: str) -> float:
    """Return 1 for true, 0 for false, NaN for anything else."""
    return _TRUTHS.get(cell.lower(), NAN)


def kind_of_table(head: bytes) -> str:
    """Return the kind of log whose table begins with `head`.

    It is `airdata`, `dji-record`, `edgetx` or `blackbox`, else `csv`.
    """
    names = _header(csv.reader(head.decode("utf-8-sig", errors="replace").splitlines()))
    if "time(millisecond)" in names:
        return "airdata"
    if any(name.startswith("OSD.") for name in names):
        return "dji-record"
    if names[:2] == ["Date", "Time"] and _OF_RADIOS & set(names):
        return "edgetx"
    return "blackbox" if "loopIteration" in names else "csv"


def read_rows(
    source: str, data: bytes, wanted: Columns, needed: tuple[str, ...], log: LogBuilder
) -> Iterator[TableRow]:
    """Read the wanted columns of a table, row by row; rows left out are counted in the notes of `log`.

    wanted : our columns with the names that they may have in the table
    needed : those that must be there
    Raises BadInput for a table without one of them, a row that is short, and a cell that is no number.
    """
    text = data.decode("utf-8-sig", errors="replace")
    written = text.splitlines()
    lines = csv.reader(written)
    header = _header(lines)
    chosen = _chosen(source, header, wanted, needed)
    width = 1 + max(index for index, _ in chosen.values())
    for number, cells in enumerate(filter(None, _whole(source, lines)), start=1):
        if len(cells) < len(header) and lines.line_num == len(written) and not text.endswith(("\n", "\r")):
            log.skipped_bytes += sum(len(cell.encode()) + 1 for cell in cells)
            log.notes.append("the last row is cut")
            return
        place = f"row {number} (line {lines.line_num})"
        if len(cells) < width:
            raise BadInput(source, place, f"{len(header)} cells, found {len(cells)}")
        values = {}
        for ours, (index, read) in chosen.items():
            cell = cells[index].strip()
            try:
                values[ours] = read(cell) if cell else NAN
            except ValueError:
                expected = _NO_NUMBERS.get(header[index], "a number")
                raise BadInput(source, f"{place}, column {header[index]}", f"{expected}, found `{cell[:40]}`") from None
        yield TableRow(tuple(cells[index] for index, _ in chosen.values()), values)


def first_words(data: bytes, wanted: Mapping[str, tuple[str, ...]]) -> dict[str, str]:
    """Return the first filled cell of each wanted column of text, by our name, where there is one.

    Only the beginning of a table is looked at.
    """
    lines = csv.reader(data[:_BEGINNING].decode("utf-8-sig", errors="replace").splitlines())
    header = _header(lines)
    places = {ours: [header.index(name) for name in theirs if name in header] for ours, theirs in wanted.items()}
    found: dict[str, str] = {}
    for cells in lines:
        for ours in wanted.keys() - found.keys():
            words = [cells[index].strip() for index in places[ours] if index < len(cells)]
            if any(words):
                found[ours] = next(filter(None, words))
    return found


def _whole(source: str, lines: Iterator[list[str]]) -> Iterator[list[str]]:
    try:
        yield from lines
    except csv.Error as error:  # a quoted cell is not closed
        raise BadInput(source, "", f"a table, cannot be read: {error}") from None


def _header(lines: Iterator[list[str]]) -> list[str]:
    """Return the names of the columns; the next of `lines` is then the first row."""
    for cells in lines:
        names = [cell.strip() for cell in cells]
        if any(names) and not names[0].startswith("sep="):
            return names
    return []


def _chosen(source: str, header: list[str], wanted: Columns, needed: tuple[str, ...]) -> dict[str, tuple[int, Cell]]:
    found = {}
    for ours, theirs in wanted.items():
        name = next((name for name in theirs if name in header), None)
        if name is not None:
            found[ours] = (header.index(name), theirs[name])
        elif ours in needed:
            raise BadInput(source, "header", f"a column {' or '.join(f'`{name}`' for name in theirs)}, found none")
    return found
