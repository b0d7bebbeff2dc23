"""The drawings of a flight page: one panel a quantity over one time axis, refused stretches hatched in each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from uavbatt.battery.sizing import PackSize
from uavbatt.log_replay import Outcome
from uavbatt.records import Status
from uavbatt.report import plot
from uavbatt.report.page import Html, figure, number, paragraph
from uavbatt.report.series import Array, FlightSeries, Stretch, outer, thinned

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHORT_S = 240.0


class TimeAxis:
    """The time axis that all panels share: minutes, or seconds for a short log; hatching where nothing was said."""

    def __init__(self, rows: FlightSeries, stretches: Sequence[Stretch], outcome: Outcome) -> None:
        known = rows.time_s[np.isfinite(rows.time_s)]
        self.first_s, self.last_s = (float(known[0]), float(known[-1])) if known.size else (0.0, 1.0)
        self.in_seconds = self.last_s - self.first_s < SHORT_S
        self.label = "time since the log's start (s)" if self.in_seconds else "time since the log's start (min)"
        self.stretches = stretches
        self.end_s = outcome.end_of_flight_s

    def at(self, time_s: Array | float) -> Array:
        """Seconds in the unit of the axis."""
        return np.asarray(time_s, dtype=float) / (1.0 if self.in_seconds else 60.0)

    def dress(self, axes: Axes) -> None:
        """Limits, hatching and the end of flight."""
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


def figures(rows: FlightSeries, stretches: Sequence[Stretch], outcome: Outcome, resolved: PackSize) -> list[Html]:
    """Draw every panel for which the log has data; a sentence stands in place of the others."""
    axis = TimeAxis(rows, stretches, outcome)
    return [
        _remaining(rows, axis, outcome),
        _soc(rows, axis, outcome),
        _voltage(rows, axis, resolved),
        _innovation(rows, axis),
        _current(rows, axis),
        _temperature(rows, axis),
    ]


def _missing(title: str, why: str) -> Html:
    return figure(paragraph(why, css="quiet"), title)


def _line(axes: Axes, axis: TimeAxis, time_s: Array, values: Array, colour: str, name: str, style: str = "-") -> None:
    """A line thinned to its extremes; single known rows between gaps stay visible as dots."""
    t, y = thinned(time_s, values)
    axes.plot(axis.at(t), y, style, color=colour, label=name, linewidth=1.3)
    known = np.isfinite(y)
    alone = known & ~np.roll(np.append(known, False), 1)[:-1] & ~np.append(known, False)[1:]
    if alone.any():
        axes.plot(axis.at(t[alone]), y[alone], "o", color=colour, markersize=2.2)


def _band(axes: Axes, axis: TimeAxis, time_s: Array, low: Array, high: Array, colour: str, name: str) -> None:
    t, lo, hi = outer(time_s, low, high)
    axes.fill_between(axis.at(t), lo, hi, color=colour, alpha=0.25, linewidth=0, label=name)


def _voltage(rows: FlightSeries, axis: TimeAxis, resolved: PackSize) -> Html:
    title = "Voltage, measured and modelled"
    if not np.isfinite(rows.voltage_V).any():
        return _missing(title, "The log has no voltage.")

    def draw(axes: Axes) -> None:
        _line(axes, axis, rows.time_s, rows.voltage_V, plot.BLUE, "measured")
        _line(axes, axis, rows.time_s, rows.predicted_V, plot.RED, "modelled, one step ahead", "--")
        if math.isfinite(resolved.cutoff_V):
            axes.axhline(resolved.cutoff_V, color=plot.PINK, linewidth=1.2, linestyle=(0, (4, 2)), label="cut-off")
        low, high = _span(rows.voltage_V, resolved.cutoff_V)
        axes.set_ylim(low, high)
        axis.dress(axes)

    least, greatest = np.nanmin(rows.voltage_V), np.nanmax(rows.voltage_V)
    alt = f"Pack voltage over time, from {least:.2f} to {greatest:.2f} V, with the model's prediction."
    said = "The model predicts the voltage before it sees it."
    return figure(plot.panel(draw, alt, x=axis.label, y="pack voltage (V)", height=270), title, said)


def _span(values: Array, *more: float) -> tuple[float, float]:
    """Limits that hold the middle 99.8 % of `values` and every finite one of `more`, with some air."""
    known = values[np.isfinite(values)]
    ends = [*np.percentile(known, [0.1, 99.9]), *(m for m in more if math.isfinite(m))]
    low, high = float(min(ends)), float(max(ends))
    air = 0.06 * (high - low) or 0.1
    return low - air, high + air


def _innovation(rows: FlightSeries, axis: TimeAxis) -> Html:
    title = "Innovation: measured less predicted voltage"
    if not np.isfinite(rows.innovation_V).any():
        return _missing(title, "The filter compared no voltage with its prediction.")
    # One innovation a block of rows; rows without voltage (gaps) stay, so that no line crosses them.
    kept = np.isfinite(rows.innovation_V) | np.isnan(rows.voltage_V)
    time_s, innovation, sd = (x[kept] for x in (rows.time_s, rows.innovation_V, rows.innovation_sd_V))
    both = np.isfinite(sd) & np.isfinite(innovation)
    share = float(np.mean(np.abs(innovation[both]) <= 2.0 * sd[both])) if both.any() else math.nan

    def draw(axes: Axes) -> None:
        millivolts = 1000.0
        _band(axes, axis, time_s, -2.0 * sd * millivolts, 2.0 * sd * millivolts, plot.GREEN, "expected, ±2 sd")
        _line(axes, axis, time_s, innovation * millivolts, plot.BLUE, "innovation")
        edge = float(np.nanpercentile(np.abs(innovation), 99.5)) * millivolts
        reach = max(1.3 * edge, 2.6 * float(np.nanmedian(sd)) * millivolts if both.any() else 0.0, 10.0)
        axes.set_ylim(-reach, reach)
        axis.dress(axes)

    inside = f" {share:.0%} of the innovations lie inside; about 95 % should." if math.isfinite(share) else ""
    with_temp = np.isfinite(rows.temp_C).any()
    from_nis = " The band is recovered from the filter's NIS; with a measured temperature it is a lower bound."
    alt = "Difference of measured and predicted voltage over time with its expected band." + inside
    drawn = plot.panel(draw, alt, x=axis.label, y="innovation (mV)")
    return figure(drawn, title, "What the model did not foresee." + inside + (from_nis if with_temp else ""))


def _current(rows: FlightSeries, axis: TimeAxis) -> Html:
    if not np.isfinite(rows.current_A).any():
        return _missing("Current", "The log has no current.")

    def draw(axes: Axes) -> None:
        _line(axes, axis, rows.time_s, rows.current_A, plot.BLUE, "_current")
        axis.dress(axes)

    mean, most = np.nanmean(rows.current_A), np.nanmax(rows.current_A)
    alt = f"Current over time; mean {mean:.1f} A, at most {most:.1f} A."
    return figure(plot.panel(draw, alt, x=axis.label, y="current (A)"), "Current", "Positive current discharges.")


def _temperature(rows: FlightSeries, axis: TimeAxis) -> Html:
    measured, core = np.isfinite(rows.temp_C).any(), np.isfinite(rows.core_C).any()
    if not measured and not core:
        return _missing("Temperature", "No temperature was measured and none was estimated.")

    def draw(axes: Axes) -> None:
        if measured:
            _line(axes, axis, rows.time_s, rows.temp_C, plot.BLUE, "measured")
        if core:
            _line(axes, axis, rows.time_s, rows.core_C, plot.RED, "core, estimated", "--")
        axis.dress(axes)

    said = "" if measured else "No pack temperature in the log: the core is the model's guess from an assumed start."
    alt = "Temperature of the pack over time." + (" Only the estimate: nothing was measured." if not measured else "")
    return figure(plot.panel(draw, alt, x=axis.label, y="temperature (°C)"), "Temperature", said)


def _soc(rows: FlightSeries, axis: TimeAxis, outcome: Outcome) -> Html:
    title = "State of charge"
    if not np.isfinite(rows.soc).any():
        return _missing(title, "The state of charge was refused throughout.")

    def draw(axes: Axes) -> None:
        low, high = (np.clip(rows.soc + k * rows.soc_sd, 0.0, 1.0) for k in (-2.0, 2.0))
        _band(axes, axis, rows.time_s, low, high, plot.BLUE, "±2 sd")
        _line(axes, axis, rows.time_s, rows.soc, plot.BLUE, "estimate")
        axes.set_ylim(-0.02, 1.02)
        axis.dress(axes)

    alt = f"State of charge over time, {number(outcome.end_soc, 2)} at the end, with a band of two standard deviations."
    return figure(plot.panel(draw, alt, x=axis.label, y="state of charge (1 = full)"), title)


def _remaining(rows: FlightSeries, axis: TimeAxis, outcome: Outcome) -> Html:
    title = "Remaining time"
    if not np.isfinite(rows.remaining_s).any():
        return _missing(title, "The remaining time was refused throughout.")
    end_s = outcome.end_of_flight_s
    top_min = _top_min(rows, end_s, axis.first_s)

    def draw(axes: Axes) -> None:
        high = np.where(np.isposinf(rows.hi_s), 1e6, rows.hi_s)
        _band(axes, axis, rows.time_s, rows.lo_s / 60.0, high / 60.0, plot.BLUE, "5 % to 95 %")
        _line(axes, axis, rows.time_s, rows.remaining_s / 60.0, plot.BLUE, "forecast")
        if math.isfinite(end_s):
            ends = np.array([axis.first_s, end_s])
            axes.plot(axis.at(ends), (end_s - ends) / 60.0, "--", color=plot.RED, label="truth")
        axes.set_ylim(-0.02 * top_min, top_min)
        axis.dress(axes)

    cut = rows.hi_s[~np.isnan(rows.hi_s)].max(initial=0.0) / 60.0 > top_min
    truth = "The truth is the end of flight that the log itself shows" if math.isfinite(end_s) else ""
    unknown = "" if math.isfinite(end_s) else "The flight ended before its battery did: there is no truth to compare"
    above = "; some values are off the chart" if cut else ""
    alt = f"Forecast of the remaining time with its 90 % interval. {truth}{unknown}."
    said = f"{truth}{unknown}{above}. Seconds until the voltage or the reserve ends the flight under the load to come."
    return figure(plot.panel(draw, alt, x=axis.label, y="remaining time (min)", height=290), title, said)


def _top_min(rows: FlightSeries, end_s: float, first_s: float) -> float:
    """The top of the axis [min]: holds the truth, and forecast and interval up to 2.5 times as high."""
    known, finite = (x[np.isfinite(x)] for x in (rows.remaining_s, rows.hi_s))
    core = end_s - first_s if math.isfinite(end_s) else float(np.percentile(known, 98))
    widest = float(np.percentile(np.append(finite, known), 98))
    return 1.08 * max(min(max(core, widest), 2.5 * core), 30.0) / 60.0
