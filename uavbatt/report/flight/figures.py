"""Charts of a flight for engineers: one panel a quantity over the same time axis, with refused stretches hatched."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from uavbatt.battery.sizing.pack_size import PackSize
from uavbatt.log_replay.outcome import Outcome
from uavbatt.report import plot
from uavbatt.report.flight.axis import TimeAxis, band, line
from uavbatt.report.flight.series import Array, FlightSeries
from uavbatt.report.page import Html, figure, missing_figure, number, percent

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def figures(rows: FlightSeries, axis: TimeAxis, outcome: Outcome, resolved: PackSize) -> list[Html]:
    """Draw every panel for which the log has data; a sentence replaces the others."""
    return [
        _soc(rows, axis, outcome),
        _voltage(rows, axis, resolved),
        _innovation(rows, axis),
        _current(rows, axis),
        _temperature(rows, axis),
    ]


def _voltage(rows: FlightSeries, axis: TimeAxis, resolved: PackSize) -> Html:
    title = "Voltage, measured and modelled"
    if not np.isfinite(rows.voltage_V).any():
        return missing_figure(title, "The log has no voltage.")

    def draw(axes: Axes) -> None:
        line(axes, axis, rows.time_s, rows.voltage_V, plot.BLUE, "measured")
        line(axes, axis, rows.time_s, rows.predicted_V, plot.RED, "modelled", "--")
        if math.isfinite(resolved.cutoff_V):
            axes.axhline(resolved.cutoff_V, color=plot.PINK, linewidth=1.2, linestyle=(0, (4, 2)), label="cut-off")
        low, high = _span(rows.voltage_V, resolved.cutoff_V)
        axes.set_ylim(low, high)
        axis.dress(axes)

    least, greatest = np.nanmin(rows.voltage_V), np.nanmax(rows.voltage_V)
    alt = f"Pack voltage over time, from {least:.2f} to {greatest:.2f} V, with the model's prediction."
    note = "The model predicts each voltage before it sees it."
    return figure(plot.panel(draw, alt, x=axis.label, unit_s=axis.unit_s, y="pack voltage (V)"), title, note)


def _span(values: Array, *more: float) -> tuple[float, float]:
    """Return limits that hold the middle 99.8 % of `values` and every finite one of `more`, with a margin."""
    finite = values[np.isfinite(values)]
    ends = [*np.percentile(finite, [0.1, 99.9]), *(m for m in more if math.isfinite(m))]
    low, high = float(min(ends)), float(max(ends))
    air = 0.06 * (high - low) or 0.1
    return low - air, high + air


def _innovation(rows: FlightSeries, axis: TimeAxis) -> Html:
    title = "Innovation: measured less predicted voltage"
    if not np.isfinite(rows.innovation_V).any():
        return missing_figure(title, "The filter compared no voltage with its prediction.")
    # One innovation a block of rows; rows without voltage (gaps) stay, so that no line crosses them.
    mask = np.isfinite(rows.innovation_V) | np.isnan(rows.voltage_V)
    time_s, innovation, sd = (x[mask] for x in (rows.time_s, rows.innovation_V, rows.innovation_sd_V))
    both = np.isfinite(sd) & np.isfinite(innovation)
    share = float(np.mean(np.abs(innovation[both]) <= 2.0 * sd[both])) if both.any() else math.nan

    def draw(axes: Axes) -> None:
        millivolts = 1000.0
        band(axes, axis, time_s, -2.0 * sd * millivolts, 2.0 * sd * millivolts, plot.GREEN, "expected, ±2 sd")
        line(axes, axis, time_s, innovation * millivolts, plot.BLUE, "innovation")
        edge = float(np.nanpercentile(np.abs(innovation), 99.5)) * millivolts
        reach = max(1.3 * edge, 2.6 * float(np.nanmedian(sd)) * millivolts if both.any() else 0.0, 10.0)
        axes.set_ylim(-reach, reach)
        axis.dress(axes)

    inside = f" {percent(share)} of the innovations lie inside; about 95 % should." if math.isfinite(share) else ""
    with_temp = np.isfinite(rows.temp_C).any()
    from_nis = " The band is recovered from the filter's NIS; with a measured temperature it is a lower bound."
    alt = "Difference of measured and predicted voltage over time with its expected band." + inside
    chart = plot.panel(draw, alt, x=axis.label, unit_s=axis.unit_s, y="innovation (mV)")
    return figure(chart, title, "What the model did not foresee." + inside + (from_nis if with_temp else ""))


def _current(rows: FlightSeries, axis: TimeAxis) -> Html:
    if not np.isfinite(rows.current_A).any():
        return missing_figure("Current", "The log has no current.")

    def draw(axes: Axes) -> None:
        line(axes, axis, rows.time_s, rows.current_A, plot.BLUE, "_current")
        axis.dress(axes)

    mean, most = np.nanmean(rows.current_A), np.nanmax(rows.current_A)
    alt = f"Current over time; mean {mean:.1f} A, at most {most:.1f} A."
    return figure(
        plot.panel(draw, alt, x=axis.label, unit_s=axis.unit_s, y="current (A)"),
        "Current",
        "Positive current discharges.",
    )


def _temperature(rows: FlightSeries, axis: TimeAxis) -> Html:
    measured, core = np.isfinite(rows.temp_C).any(), np.isfinite(rows.core_C).any()
    if not measured and not core:
        return missing_figure("Temperature", "No temperature was measured and none was estimated.")

    def draw(axes: Axes) -> None:
        if measured:
            line(axes, axis, rows.time_s, rows.temp_C, plot.BLUE, "measured")
        if core:
            line(axes, axis, rows.time_s, rows.core_C, plot.RED, "core, estimated", "--")
        axis.dress(axes)

    note = "" if measured else "No pack temperature in the log: the core is the model's guess from an assumed start."
    alt = "Temperature of the pack over time." + (" Only the estimate: nothing was measured." if not measured else "")
    return figure(plot.panel(draw, alt, x=axis.label, unit_s=axis.unit_s, y="temperature (°C)"), "Temperature", note)


def _soc(rows: FlightSeries, axis: TimeAxis, outcome: Outcome) -> Html:
    title = "State of charge"
    if not np.isfinite(rows.soc).any():
        return missing_figure(title, "The state of charge was refused throughout.")

    def draw(axes: Axes) -> None:
        low, high = (np.clip(rows.soc + k * rows.soc_sd, 0.0, 1.0) for k in (-2.0, 2.0))
        band(axes, axis, rows.time_s, low, high, plot.BLUE, "±2 sd")
        line(axes, axis, rows.time_s, rows.soc, plot.BLUE, "estimate")
        axes.set_ylim(-0.02, 1.02)
        axis.dress(axes)

    alt = f"State of charge over time, {number(outcome.end_soc, 2)} at the end, with a band of two standard deviations."
    return figure(plot.panel(draw, alt, x=axis.label, unit_s=axis.unit_s, y="state of charge (1 = full)"), title)
