"""Time axis with its hatching, thinned lines and bands, shared by all drawings of a flight."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from uavbatt.log_replay.outcome import Outcome
from uavbatt.records import Status
from uavbatt.report import plot
from uavbatt.report.flight.series import Array, FlightSeries, Stretch, outer, thinned

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHORT_S = 240.0  # a shorter log has its axis in seconds


class TimeAxis:
    """TimeAxis is shared by all panels: minutes, or seconds for a short log; hatched where a number was refused."""

    def __init__(self, rows: FlightSeries, stretches: Sequence[Stretch], outcome: Outcome) -> None:
        times_s = rows.time_s[np.isfinite(rows.time_s)]
        self.first_s, self.last_s = (float(times_s[0]), float(times_s[-1])) if times_s.size else (0.0, 1.0)
        self.in_seconds = self.last_s - self.first_s < SHORT_S
        self.unit_s = 1.0 if self.in_seconds else 60.0
        self.label = f"time since the log's start ({'s' if self.in_seconds else 'min'})"
        self.stretches = stretches
        self.end_s, self.outcome = outcome.end_of_flight_s, outcome

    def at(self, time_s: Array | float) -> Array:
        """Return seconds in the unit of the axis."""
        return np.asarray(time_s, dtype=float) / self.unit_s

    def truth(self) -> tuple[Array, Array]:
        """Return the corners of the line of the true time left: their times [s], and the time left at each [s]."""
        corners_s = np.ravel([self.first_s, self.end_s, *np.ravel(self.outcome.waits)])
        times_s = np.unique(np.clip(corners_s, self.first_s, self.end_s))
        return times_s, self.outcome.left_s(times_s)

    def dress(self, axes: Axes) -> None:
        """Give the axes their limits, the hatching and the mark of the end of flight."""
        margin = 0.01 * max(self.last_s - self.first_s, 1.0)
        axes.set_xlim(float(self.at(self.first_s - margin)), float(self.at(self.last_s + margin)))
        least = 0.003 * (self.last_s - self.first_s)
        for s in self.stretches:
            begin, end = float(self.at(s.begin_s)), float(self.at(max(s.end_s, s.begin_s + least)))
            if s.status is Status.STALE:
                continue
            if s.status is Status.REFUSED:
                axes.axvspan(begin, end, facecolor=plot.SHADE, edgecolor=plot.FAINT, hatch="///", linewidth=0, zorder=0)
            else:
                axes.axvspan(begin, end, facecolor=plot.SHADE, linewidth=0, zorder=0)
        if math.isfinite(self.end_s):
            axes.axvline(float(self.at(self.end_s)), color=plot.PINK, linewidth=1.2, linestyle=(0, (1, 1.5)))


def line(axes: Axes, axis: TimeAxis, time_s: Array, values: Array, colour: str, name: str, style: str = "-") -> None:
    """Draw a line thinned to its extremes; single known rows between gaps stay visible as dots."""
    t, y = thinned(time_s, values)
    axes.plot(axis.at(t), y, style, color=colour, label=name, linewidth=1.3)
    finite = np.isfinite(y)
    alone = finite & ~np.roll(np.append(finite, False), 1)[:-1] & ~np.append(finite, False)[1:]
    if alone.any():
        axes.plot(axis.at(t[alone]), y[alone], "o", color=colour, markersize=2.2)


def band(axes: Axes, axis: TimeAxis, time_s: Array, low: Array, high: Array, colour: str, name: str) -> None:
    """Draw a band thinned to its outer edges, never narrower than it was."""
    t, lo, hi = outer(time_s, low, high)
    axes.fill_between(axis.at(t), lo, hi, color=colour, alpha=0.25, linewidth=0, label=name)
