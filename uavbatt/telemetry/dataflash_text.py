"""DataFlash text logs (.log): one record a line, `NAME, value, value`, described by FMT lines.

Values come printed: format characters with a built-in factor (`c`, `e`, `L`) are already scaled.
"""

from __future__ import annotations

from collections.abc import Iterator

from uavbatt.records import NAN
from uavbatt.telemetry.builder import LogBuilder
from uavbatt.telemetry.dataflash_rows import WANTED, Layout, Record, Value, fold

_TEXT_CHARS = "nNZ"


def read(data: bytes) -> LogBuilder:
    """All batteries' rows and the parameters of a text DataFlash log."""
    log = LogBuilder()
    fold(_records(data, log), log)
    return log


def _records(data: bytes, log: LogBuilder) -> Iterator[Record]:
    """The wanted records, and the first and last of any kind that carry a time."""
    layouts: dict[str, Layout] = {}
    started = False
    last_timed: Record | None = None
    for line in data.splitlines(keepends=True):
        cells = [cell.strip() for cell in line.decode("latin-1").split(",")]
        if cells[0] == "FMT":
            _learn(cells, layouts)
            continue
        layout = layouts.get(cells[0])
        if layout is None:
            continue
        timed = layout.ticks_per_s > 0
        wanted = WANTED.match(layout.name) is not None
        if timed and not wanted and len(cells) > 1:
            last_timed = (Layout("END", "Q", layout.labels[:1]), [_number(cells[1])])
        if wanted:
            values = _values(layout, cells[1:], whole=line.endswith((b"\n", b"\r")))
            if values is None:
                log.skipped_bytes += len(line)
                continue
            started = started or timed
            last_timed = None  # the wanted record moves the clock itself
            yield layout, values
        elif timed and not started and last_timed is not None:
            started = True
            yield last_timed
    if last_timed is not None:
        yield last_timed


def _learn(cells: list[str], layouts: dict[str, Layout]) -> None:
    """`FMT, type, length, name, format, label, label, ...`"""
    if len(cells) >= 6 and cells[3]:
        layouts[cells[3]] = Layout(cells[3], cells[4], tuple(cells[5:]))


def _values(layout: Layout, cells: list[str], whole: bool) -> list[Value] | None:
    """The values of one line; None if the line is damaged.

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
