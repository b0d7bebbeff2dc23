"""The pilot's chart: the time left with its 90 % band over the flight, and the events of the flight."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from uavbatt.records import Status
from uavbatt.report import plot
from uavbatt.report.flight.axis import TimeAxis, band, line
from uavbatt.report.flight.events import Event, apart
from uavbatt.report.flight.series import FlightSeries
from uavbatt.report.page import Html, bullets, clock, duration, figure, missing_figure, strong, together

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TITLE, Y_LABEL = "Time left", "time left (min)"
LEAST_APART = 0.06  # of the axis; closer events share a mark, so that words do not overlap
# The scale reaches at most so many times the settled forecasts; a point without a bound is drawn far above it.
MOST_HELD, UNBOUNDED_S = 2.5, 1e8
SETTLED_PERCENT = 80.0  # percentile of the forecasts: the first ones may be far above the others
ROOM_RIGHT = 38.0  # room for the minutes on the right


def time_left_chart(rows: FlightSeries, axis: TimeAxis, events: Sequence[Event]) -> Html:
    """Draw the forecasts with their interval, the events, and the truth if the log shows it."""
    if not np.isfinite(rows.remaining_s).any():
        return missing_figure(TITLE, "The remaining time was refused throughout.")
    draw, top_min = _drawing(rows, axis, events)
    alt = f"Time left in minutes over the flight, with its 90 % interval. {_events_in_words(events)}"
    svg = plot.responsive(draw, alt, x=axis.label, y=Y_LABEL, right=ROOM_RIGHT, unit_s=axis.unit_s)
    return together((figure(svg, TITLE, _caption(rows, axis, top_min)), _list(events)))


def save_time_left(path: Path, rows: FlightSeries, axis: TimeAxis, events: Sequence[Event], title: str) -> None:
    """Write the chart of the time left to a file, PNG or SVG by its name; `rows` must hold a forecast somewhere."""
    plot.save_picture(path, _drawing(rows, axis, events)[0], title, x=axis.label, y=Y_LABEL, right=ROOM_RIGHT)


def _drawing(rows: FlightSeries, axis: TimeAxis, events: Sequence[Event]) -> tuple[Callable[[Axes], None], float]:
    """Return what draws the chart into axes, and the top of their scale [min]."""
    top_min = _top_min(rows, axis)
    marked = apart(events, LEAST_APART * (axis.last_s - axis.first_s))

    def draw(axes: Axes) -> None:
        high_s = np.where(np.isposinf(rows.hi_s), UNBOUNDED_S, rows.hi_s)
        band(axes, axis, rows.time_s, rows.lo_s / 60.0, high_s / 60.0, plot.BLUE, "9 in 10 lie here")
        line(axes, axis, rows.time_s, rows.remaining_s / 60.0, plot.BLUE, "forecast")
        if math.isfinite(axis.end_s):
            corners_s, left_s = axis.truth()
            axes.plot(axis.at(corners_s), left_s / 60.0, "--", color=plot.RED, label="truth")
        axes.set_ylim(-0.02 * top_min, top_min)
        axis.dress(axes)
        for event in marked:
            _mark(axes, float(axis.at(event.time_s)), event, top_min)
        untyped: Any = axes
        untyped.tick_params(axis="y", labelright=True, length=0.0)
        untyped.locator_params(axis="y", nbins=6, integer=top_min > 4.0)

    return draw, top_min


def _mark(axes: Axes, place: float, event: Event, top_min: float) -> None:
    """Draw an event as a line across the chart with its words along it."""
    colour = plot.RED if event.tells_danger else plot.FAINT
    low, high = axes.get_xlim()
    is_last = place > low + 0.95 * (high - low)  # no room for the words behind it
    axes.axvline(place, color=colour, linewidth=0.9, zorder=1.5)
    axes.text(
        place, 0.985 * top_min, f" {event.words} ", rotation=90, va="top", ha="right" if is_last else "left",
        color=colour, fontsize=plot.LETTERS,
    )  # fmt: skip


def _events_in_words(events: Sequence[Event]) -> str:
    return "; ".join(f"{event.words} at {duration(event.time_s)}" for event in events) + "." if events else ""


def _list(events: Sequence[Event]) -> Html:
    """Return the events with their times as text, because the marks in the chart are short."""
    entries = [
        together((f"{clock(event.time_s)} ", strong(event.words) if event.tells_danger else event.words), "")
        for event in events
    ]
    return bullets(entries, css="events")


def _caption(rows: FlightSeries, axis: TimeAxis, top_min: float) -> str:
    has_end = math.isfinite(axis.end_s)
    truth = (
        "Truth: the end of flight that the log itself shows"
        if has_end
        else "The flight ended before its battery did, so that there is no truth to compare"
    )
    over = np.max(rows.hi_s[~np.isnan(rows.hi_s)], initial=0.0) / 60.0 > top_min
    kinds = {s.status for s in axis.stretches if s.duration_s > 0.0}
    hatched = "; hatched: no forecast" if Status.REFUSED in kinds else ""
    shaded = "; shaded: not yet settled" if Status.CONVERGING in kinds else ""
    return f"{truth}{'; early values are off the chart' if over else ''}{hatched}{shaded}."


def _top_min(rows: FlightSeries, axis: TimeAxis) -> float:
    """Return the top of the axis [min]: it holds the truth, and forecasts and intervals up to 2.5 times as high."""
    medians, highs = (x[np.isfinite(x)] for x in (rows.remaining_s, rows.hi_s))
    has_end = math.isfinite(axis.end_s)
    core = float(axis.truth()[1][0]) if has_end else float(np.percentile(medians, SETTLED_PERCENT))
    widest = float(np.percentile(np.append(highs, medians), 98))
    return 1.08 * max(min(max(core, widest), MOST_HELD * core), 30.0) / 60.0
