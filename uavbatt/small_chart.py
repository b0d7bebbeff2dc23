"""A small chart and a small table as plain HTML, for notebooks and for cells of a table on a page.

They need no script and no style sheet: lines have the colour of the text around them, so that they are visible on light
and dark backgrounds. Charts with axes and legends are in `report.plot`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape
from itertools import groupby
from typing import NamedTuple

from uavbatt.errors import printable

Point = tuple[float, float]

MOST_POINTS = 240
MARGIN = 2.0


class Size(NamedTuple):
    """Size holds width and height of a drawing [px]."""

    width: float
    height: float


SPARK, CHART = Size(96.0, 22.0), Size(460.0, 130.0)


class Span(NamedTuple):
    """Span holds the least and the greatest value that an axis shows."""

    low: float
    high: float

    def share(self, value: float) -> float:
        """Return the place of a value on the axis, 0 at the low end and 1 at the high one; not beyond them."""
        return min(max((value - self.low) / (self.high - self.low), 0.0), 1.0)


def span(values: Iterable[float], *, least: float = 0.0) -> Span:
    """Return the span of the known values, at least `least` wide; 0 to 1 where none is known."""
    known = [value for value in values if math.isfinite(value)]
    low, high = (min(known), max(known)) if known else (0.0, 1.0)
    missing = max(least - (high - low), 0.0) or (1.0 if high == low else 0.0)
    return Span(low - 0.5 * missing, high + 0.5 * missing)


def small_chart(
    x: Sequence[float],
    y: Sequence[float],
    *,
    alt: str,
    band: tuple[Sequence[float], Sequence[float]] | None = None,
    shown: Span | None = None,
    size: Size = SPARK,
    css: str = "",
) -> str:
    """Draw a line, and a band around it, as inline SVG.

    x, y : of the points; NaN is a gap
    alt : what the drawing shows, in words
    band : low and high values at the points
    shown : the span of the vertical axis; by default that of the line
    css : class of the drawing
    """
    across, up = span(x), shown if shown is not None else span(y)
    chosen = _chosen(len(x))
    tops = [(x[i], band[1][i]) for i in chosen] if band is not None else []
    bottoms = [(x[i], band[0][i]) for i in chosen] if band is not None else []

    def place(point: Point) -> str:
        right = MARGIN + across.share(point[0]) * (size.width - 2.0 * MARGIN)
        down = MARGIN + (1.0 - up.share(point[1])) * (size.height - 2.0 * MARGIN)
        return f"{right:.1f},{down:.1f}"

    parts = []
    for pieces in _known_runs(zip(tops, bottoms, strict=True)):
        around = [top for top, _ in pieces] + [bottom for _, bottom in reversed(pieces)]
        parts.append(f'<polygon points="{" ".join(map(place, around))}" fill="currentColor" fill-opacity="0.2"/>')
    for points in _known_runs(((x[i], y[i]),) for i in chosen):
        line = " ".join(place(point) for (point,) in points)
        parts.append(f'<polyline points="{line}" fill="none" stroke="currentColor" stroke-width="1.5"/>')
    named = f'class="{escape(css)}" ' if css else ""
    box = f'width="{size.width:g}" height="{size.height:g}" viewBox="0 0 {size.width:g} {size.height:g}"'
    return f'<svg {named}role="img" aria-label="{_safe(alt)}" {box}>{"".join(parts)}</svg>'


def small_table(title: str, facts: Iterable[tuple[str, str]], below: str = "") -> str:
    """Return a result as a small table of names and values under its title; `below` is markup that follows it."""
    rows = "".join(
        f'<tr><th scope="row" style="text-align:left">{_safe(name)}</th>'
        f'<td style="text-align:left">{_safe(value)}</td></tr>'
        for name, value in facts
    )
    return f"<div><strong>{_safe(title)}</strong><table><tbody>{rows}</tbody></table>{below}</div>"


def captioned(drawing: str, words: str) -> str:
    """Return a drawing with a line of words under it."""
    return f"<div>{drawing}<div>{_safe(words)}</div></div>"


def voltage_table(title: str, facts: Iterable[tuple[str, str]], rows: Sequence[Point]) -> str:
    """Return a small table with a chart of the voltage below it, of rows (time [s], voltage of the pack [V])."""
    known = [voltage_V for _, voltage_V in rows if math.isfinite(voltage_V)]
    if not known:
        return small_table(title, facts)
    words = f"Voltage of the pack over the log: {min(known):.2f} to {max(known):.2f} V"
    time_s, voltage_V = zip(*rows, strict=True)
    return small_table(title, facts, captioned(small_chart(time_s, voltage_V, alt=words, size=CHART), words))


def _safe(text: str) -> str:
    return escape(printable(text), quote=True)


def _chosen(count: int) -> list[int]:
    """Return at most MOST_POINTS of the points, evenly chosen, with the first and the last."""
    if count <= MOST_POINTS:
        return list(range(count))
    return sorted({round(k * (count - 1) / (MOST_POINTS - 1)) for k in range(MOST_POINTS)})


def _known_runs(points: Iterable[tuple[Point, ...]]) -> list[list[tuple[Point, ...]]]:
    """Return the runs of neighbours in which every number is known."""
    runs = groupby(points, key=lambda of_one: all(math.isfinite(value) for point in of_one for value in point))
    return [list(run) for is_known, run in runs if is_known]
