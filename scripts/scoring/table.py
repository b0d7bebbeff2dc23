"""Tables as they are printed: aligned text for a terminal, Markdown for the docs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from uavbatt.files import atomic_write

DASH = "–"


@dataclass(frozen=True, slots=True)
class Table:
    """A Table has rows whose first column names the row; the others hold figures."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""

    def text(self) -> str:
        """Return the table for a terminal."""
        lines = [self.head, *self.rows]
        widths = [max(len(line[i]) for line in lines) for i in range(len(self.head))]
        made = [
            "  ".join([line[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(line[1:], widths[1:], strict=True))])
            for line in lines
        ]
        ruled = [made[0], "-" * len(made[0]), *made[1:]]
        return "\n".join([f"\n{self.title}", *ruled, *([self.note] if self.note else [])])

    def markdown(self) -> str:
        """Return the table for a page."""
        cells = [[c.replace("|", "\\|") for c in line] for line in (self.head, *self.rows)]
        ruler = "|---" + "|---:" * (len(self.head) - 1) + "|"
        made = ["| " + " | ".join(line) + " |" for line in cells]
        note = [f"\n{self.note}"] if self.note else []
        return "\n".join([f"\n**{self.title}**\n", made[0], ruler, *made[1:], *note])


def show(tables: Sequence[Table], markdown: Path | None) -> None:
    """Print tables as text, and write them as Markdown to a file if one is given."""
    print("\n".join(table.text() for table in tables), flush=True)
    if markdown is not None:
        with atomic_write(markdown, "w") as stream:
            stream.write("\n".join(table.markdown() for table in tables) + "\n")


def figure(value: float, decimals: int = 0, *, sign: bool = False) -> str:
    """Return a number in words, or a dash when there is none."""
    if not math.isfinite(value):
        return DASH if math.isnan(value) else "∞"
    return f"{round(value, decimals) + 0.0:{'+' if sign else ''}.{decimals}f}"


def with_error(value: float, error: float, *, sign: bool = False, decimals: int = 0) -> str:
    """Return `value ± standard error`."""
    return f"{figure(value, decimals, sign=sign)} ± {figure(error, decimals)}"


def share(value: float) -> str:
    """Return a share in per cent; a dash when it is unknown."""
    return DASH if math.isnan(value) else f"{value:.0%}"


def grid(title: str, columns: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]], note: str = "") -> Table:
    """Return a table with an unnamed first column."""
    return Table(title, ("", *columns), tuple((name, *cells) for name, cells in rows), note)
