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


def read_dataflash_text(data: bytes) -> LogBuilder:
    """Read all batteries' rows and the parameters of a text DataFlash log."""
    log = LogBuilder()
    layouts: dict[str, RowLayout] = {}
    wanted: dict[RowLayout, _Lines] = {}
    telling: dict[RowLayout, _Lines] = {}
    of_route: dict[RowLayout, _Lines] = {}
    head: list[str] = []
    first: Moment | None = None
    last: Moment | None = None
    for place, line in enumerate(data.splitlines(keepends=True)):
        cells = [cell.strip() for cell in line.decode("latin-1").split(",")]
        if cells[0] == "FMT":
            _learn(cells, layouts)
            continue
        layout = layouts.get(cells[0])
        if layout is None:
            if not layouts:
                head.append(cells[0])
            continue
        if WANTED.match(layout.name):
            values = _values(layout, cells[1:], whole=line.endswith((b"\n", b"\r")))
            if values is None:
                log.skipped_bytes += len(line)
                continue
            wanted.setdefault(layout, _Lines()).add(place, values)
        elif TELLING.match(layout.name):
            # text may hold commas; such a damaged line costs no row and is not counted
            values = _values(layout, [*cells[1 : len(layout.labels)], ", ".join(cells[len(layout.labels) :])], True)
            if values is not None:
                telling.setdefault(layout, _Lines()).add(place, values)
        if OF_ROUTE.match(layout.name):
            values = _values(layout, cells[1:], whole=line.endswith((b"\n", b"\r")))
            if values is not None:
                of_route.setdefault(layout, _Lines()).add(place, values)
        if layout.ticks_per_s > 0 and len(cells) > 1:
            last = Moment(place, _number(cells[1]) / layout.ticks_per_s)
            first = first or last
    log.identity = identity(_tables(telling), first, head)
    clock = fold(_tables(wanted), first, last, log)
    log.navigation = navigation(_tables(of_route), clock, log.identity.firmware, log.parameters)
    return log


def _tables(lines: dict[RowLayout, _Lines]) -> list[Table]:
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


def _values(layout: RowLayout, cells: list[str], whole: bool) -> list[Value] | None:
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
    if not whole:
        values[-1] = NAN
    return values


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return NAN
