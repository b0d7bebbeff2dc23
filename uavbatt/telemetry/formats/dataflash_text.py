"""DataFlash text logs (.log): one record a line, `NAME, value, value`, described by FMT lines.

Values come printed: format characters with a built-in factor (`c`, `e`, `L`) are already scaled.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from uavbatt.records import NAN
from uavbatt.telemetry.builder import LogBuilder
from uavbatt.telemetry.formats.dataflash_identity import TELLING, identity
from uavbatt.telemetry.formats.dataflash_route import OF_ROUTE, navigation
from uavbatt.telemetry.formats.dataflash_rows import WANTED, Moment, RowLayout, Table, fold

_TEXT_CHARS = "nNZM"  # a mode is printed by its name

Value = float | str


@dataclass(slots=True)
class _Lines:
    """_Lines collects the lines of one layout while one file is read; it is mutable."""

    order: list[int] = field(default_factory=list)
    values: list[list[Value]] = field(default_factory=list)

    def add(self, place: int, values: list[Value]) -> None:
        """Add one more line."""
        self.order.append(place)
        self.values.append(values)


Lines = dict[RowLayout, _Lines]


@dataclass(slots=True)
class _Scan:
    """_Scan sorts the lines of one file by what they are for; it is mutable.

    head : the words before the first description of a layout; first, last : the first and the last line with a time
    """

    layouts: dict[str, RowLayout] = field(default_factory=dict)
    rows: Lines = field(default_factory=dict)
    identity: Lines = field(default_factory=dict)
    route: Lines = field(default_factory=dict)
    head: list[str] = field(default_factory=list)
    first: Moment | None = None
    last: Moment | None = None
    skipped_bytes: int = 0

    def take(self, place: int, line: bytes) -> None:
        """Take in one line; `place` counts the lines."""
        cells = [cell.strip() for cell in line.decode("latin-1").split(",")]
        if cells[0] == "FMT":
            _learn(cells, self.layouts)
            return
        layout = self.layouts.get(cells[0])
        if layout is None:
            if not self.layouts:
                self.head.append(cells[0])
            return
        is_damaged = False
        is_whole = line.endswith((b"\n", b"\r"))
        if WANTED.match(layout.name):
            is_damaged = not _added(self.rows, layout, place, _values(layout, cells[1:], is_whole))
        elif TELLING.match(layout.name):
            # text may hold commas; such a damaged line costs no row and is not counted
            last = len(layout.labels)
            _added(self.identity, layout, place, _values(layout, [*cells[1:last], ", ".join(cells[last:])], True))
        if is_damaged:
            self.skipped_bytes += len(line)
            return
        if OF_ROUTE.match(layout.name):
            _added(self.route, layout, place, _values(layout, cells[1:], is_whole))
        if layout.ticks_per_s > 0 and len(cells) > 1:
            self.last = Moment(place, _number(cells[1]) / layout.ticks_per_s)
            self.first = self.first or self.last


def _added(lines: Lines, layout: RowLayout, place: int, values: list[Value] | None) -> bool:
    """Add the values of a line to those of its layout; return False for a damaged line, which has none."""
    if values is not None:
        lines.setdefault(layout, _Lines()).add(place, values)
    return values is not None


def read_dataflash_text(data: bytes) -> LogBuilder:
    """Read all batteries' rows and the parameters of a text DataFlash log."""
    scan = _Scan()
    for place, line in enumerate(data.splitlines(keepends=True)):
        scan.take(place, line)
    log = LogBuilder()
    log.skipped_bytes += scan.skipped_bytes
    log.identity = identity(_tables(scan.identity), scan.first, scan.head)
    clock = fold(_tables(scan.rows), scan.first, scan.last, log)
    log.navigation = navigation(_tables(scan.route), clock, log.identity.firmware, log.parameters)
    return log


def _tables(lines: Lines) -> list[Table]:
    return [_table(layout, own) for layout, own in lines.items()]


def _table(layout: RowLayout, lines: _Lines) -> Table:
    numbers, texts = {}, {}
    for label, char, column in zip(layout.labels, layout.chars, zip(*lines.values, strict=True), strict=True):
        if char in _TEXT_CHARS:
            texts[label] = [str(value) for value in column]
        else:
            numbers[label] = np.array(column, np.float64)
    return Table(layout, np.array(lines.order, np.int64), numbers, texts)


def _learn(cells: list[str], layouts: dict[str, RowLayout]) -> None:
    """Learn a layout from `FMT, type, length, name, format, label, label, ...`"""
    if len(cells) >= 6 and cells[3]:
        layouts[cells[3]] = RowLayout(cells[3], cells[4], tuple(cells[5:]))


def _values(layout: RowLayout, cells: list[str], is_whole: bool) -> list[Value] | None:
    """Return the values of one line; None if the line is damaged.

    A last line without its line end may be cut inside its last number, which is then unknown.
    """
    if len(cells) != len(layout.labels) or len(cells) != len(layout.chars):
        return None
    try:
        values: list[Value] = [
            cell if char in _TEXT_CHARS else float(cell) for char, cell in zip(layout.chars, cells, strict=True)
        ]
    except ValueError:
        return None
    if not is_whole:
        values[-1] = NAN
    return values


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return NAN
