"""Curves, corridors and the model: the study's Figures 1, 4, 5, 6 and 7, and corridors as deviations from the mean."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from uavbatt.dataset import Run
from uavbatt.report import plot
from uavbatt.report.page import Html, celsius, figure, missing_figure, percent, sentence
from uavbatt.report.validation.page_values import Array, ValidationPage
from uavbatt.validation.judging.corridor import Corridor, time_corridor
from uavbatt.validation.judging.crossing import crossing_time
from uavbatt.validation.judging.finding import NAMES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

JUMPS = "A jump between near neighbours is a break between series of tests, not the battery."
MINUTES = "time from the start of the discharge (min)"
SAMPLES = ((plot.BLUE, "-"), (plot.GREEN, "--"), (plot.AMBER, "-."), (plot.PINK, ":"))
AXIS = {"voltage_V": "pack voltage (V)", "surface_C": "surface temperature (°C)"}
DEPARTURE = {"voltage_V": "deviation from the mean (mV)", "surface_C": "deviation from the mean (K)"}


def repeated(page: ValidationPage, as_read: bool = False) -> tuple[list[Run], list[Run]]:
    """Return (runs of samples tested repeatedly, one-time runs) at the gated temperature.

    as_read : True for the runs as they are judged, with fast records read at whole minutes; False for raw records
    """
    runs = (page.found.readings.tests if as_read else page.found.dataset).at(page.found.ambient_C)
    counts = {s: sum(r.sample == s for r in runs) for s in dict.fromkeys(r.sample for r in runs)}
    return [r for r in runs if counts[r.sample] > 1], [r for r in runs if counts[r.sample] == 1]


def _study(page: ValidationPage, number: int) -> str:
    """Return the number of the study's figure in brackets, if the data are the study's own."""
    return f" (the study's Figure {number})" if page.is_study else ""


def _values(run: Run, quantity: str) -> Array:
    readings: Array = getattr(run, quantity)
    return readings


def _curve(axes: Axes, run: Run, quantity: str, style: tuple[str, str], name: str, weight: float = 0.9) -> None:
    y = _values(run, quantity)
    measured = ~np.isnan(y)
    t, y = run.time_s[measured], y[measured]
    step = max(1, t.size // 300)
    axes.plot(t[::step] / 60.0, y[::step], style[1], color=style[0], linewidth=weight, label=name, alpha=0.85)


def _run_curves(axes: Axes, page: ValidationPage, quantity: str) -> None:
    """Draw every run at the page's temperature, one style a sample; one-time curves are dotted in red."""
    many, single = repeated(page)
    styles: dict[str, tuple[str, str]] = {}
    for run in many:
        new = run.sample not in styles
        style = styles.setdefault(run.sample, SAMPLES[len(styles) % len(SAMPLES)])
        _curve(axes, run, quantity, style, f"{'' if new else '_'}sample {plot.literal(run.sample)}")
    for i, run in enumerate(single):
        if np.isfinite(_values(run, quantity)).any():
            name = f"{'_' if i else ''}{plot.literal(run.sample)}, tested once"
            _curve(axes, run, quantity, (plot.RED, ":"), name, 1.8)


def family(page: ValidationPage) -> Html:
    """Draw the study's Figure 1: the discharge curves of every run at the gated temperature."""
    many, single = repeated(page)
    alt = f"{len(many)} repeated and {len(single)} one-time discharge curves at {celsius(page.found.ambient_C)}."

    def draw(axes: Axes) -> None:
        _run_curves(axes, page, "voltage_V")

    return figure(
        plot.panel(draw, alt, x=MINUTES, y=AXIS["voltage_V"]),
        f"Discharge curves at {celsius(page.found.ambient_C)}{_study(page, 1)}",
        "Every test, with straight lines between the readings.",
    )


def _shade(axes: Axes, at: Array, low: Array, high: Array) -> None:
    axes.fill_between(at, low, high, color=plot.SKY, alpha=0.45, linewidth=0, label="mean ± C")


def _edges(axes: Axes, at: Array, mean: Array, corridor: Corridor, scale: float = 1.0) -> None:
    """Draw the outlines of the tolerance band and of the simultaneous band."""
    bands = (
        ("95/95 tolerance", corridor.tolerance, (0, (1, 1.2))),
        ("all instants", corridor.simultaneous, "--"),
    )
    for name, half, style in bands:
        if np.isfinite(half).any():
            for sign in (-1.0, 1.0):
                label = name if sign > 0 else f"_{name}"
                axes.plot(at, mean + sign * scale * half, color=plot.FAINT, linewidth=1.1, linestyle=style, label=label)


def corridor(page: ValidationPage, band: Corridor, model: Array | None, study: int) -> Html:
    """Draw the study's Figure 4 or 5 (`study`): mean, corridor, runs and model, in the unit of the readings."""
    minutes = band.at / 60.0

    def draw(axes: Axes) -> None:
        _shade(axes, minutes, band.mean - band.C, band.mean + band.C)
        many, _ = repeated(page)
        for run in many:
            _curve(axes, run, band.quantity, (plot.FAINT, "-"), "_run", 0.5)
        axes.plot(minutes, band.mean, color=plot.BLUE, label="mean")
        if model is not None:
            axes.plot(page.model.time_s / 60.0, model, "x", color=plot.RED, markersize=6, label="model, held out")

    name = NAMES[band.quantity]
    alt = f"Mean {name} with its corridor, every run and the model's prediction of runs it was not fitted to."
    return figure(
        plot.panel(draw, alt, x=MINUTES, y=AXIS[band.quantity]),
        f"Corridor of the {name} at {celsius(page.found.ambient_C)}{_study(page, study)}",
        "The corridor is narrow compared with the fall of the curve: the next drawing shows the deviations alone.",
    )


def departures(page: ValidationPage, band: Corridor, model: Array | None) -> Html:
    """Draw corridor, wider bands, runs and model as deviations from the mean of the tests."""
    minutes, scale = band.at / 60.0, 1000.0 if band.quantity == "voltage_V" else 1.0

    def draw(axes: Axes) -> None:
        zero = np.zeros(band.at.size)
        _shade(axes, minutes, -scale * band.C, scale * band.C)
        _edges(axes, minutes, zero, band, scale)
        many, single = repeated(page, as_read=True)
        for i, run in enumerate(many):
            _departure(axes, run, band, scale, (plot.BLUE, "-"), "_" * (i > 0) + "runs", 0.6)
        for i, run in enumerate(single):
            _departure(axes, run, band, scale, (plot.RED, ":"), "_" * (i > 0) + "tested once", 1.8)
        if model is not None:
            gap = scale * (model - np.interp(page.model.time_s, band.at, band.mean))
            axes.plot(page.model.time_s / 60.0, gap, "x", color=plot.RED, markersize=6, label="model, held out")
        _frame(axes, band, scale)

    share_words = f" Of genuine curves {percent(band.covers_all)} stay inside mean ± C at every instant."
    cut = " Curves that leave the drawing lie further out."
    alt = "Deviations of runs and model from the mean of the tests, with three bands."
    note = "Blue: the repeated tests." + (share_words if math.isfinite(band.covers_all) else "") + cut
    chart = plot.panel(draw, alt, x=MINUTES, y=DEPARTURE[band.quantity], legend_columns=3)
    return figure(
        chart, f"{sentence(NAMES[band.quantity])}: deviations from the mean at {celsius(page.found.ambient_C)}", note
    )


def _departure(
    axes: Axes, run: Run, band: Corridor, scale: float, style: tuple[str, str], name: str, weight: float
) -> None:
    y = _values(run, band.quantity)
    measured = ~np.isnan(y)
    if int(measured.sum()) < 2:
        return
    within = (band.at >= run.time_s[measured][0]) & (band.at <= run.time_s[measured][-1])
    gap = scale * (np.interp(band.at[within], run.time_s[measured], y[measured]) - band.mean[within])
    axes.plot(band.at[within] / 60.0, gap, style[1], color=style[0], linewidth=weight, label=name, alpha=0.8)


def _frame(axes: Axes, band: Corridor, scale: float) -> None:
    """Set symmetric limits of the axis that hold the widest band."""
    widest = [float(np.nanmax(b)) for b in (band.C, band.tolerance, band.simultaneous) if np.isfinite(b).any()]
    if widest and max(widest) > 0:
        reach = 1.08 * scale * max(widest)
        axes.set_ylim(-reach, reach)
    plot.zero_line(axes)


def in_time(page: ValidationPage) -> Html:
    """Draw the corridor of crossing times at fixed voltages, in seconds."""
    band = time_corridor(page.found.readings, page.found.ambient_C)
    title = "When a voltage is reached: the corridor in time"
    if band is None or not np.isfinite(band.C).any():
        return missing_figure(title, "Not enough data: no voltage that every repeated run falls through.")

    def draw(axes: Axes) -> None:
        _shade(axes, band.at, -band.C, band.C)
        _edges(axes, band.at, np.zeros(band.at.size), band)
        for i, run in enumerate(repeated(page, as_read=True)[1]):
            times = _first_falls(run.time_s, run.voltage_V, band.at)
            name = "_" * (i > 0) + "tested once"
            axes.plot(band.at, times - band.mean, ":", color=plot.RED, linewidth=1.8, label=name)
        model = _first_falls(page.model.time_s, page.model.voltage_V, band.at)
        axes.plot(band.at, model - band.mean, "x", color=plot.RED, markersize=6, label="model, held out")
        plot.zero_line(axes)
        axes.invert_xaxis()

    alt = "Seconds earlier or later than the mean test at which each voltage is reached, with bands."
    chart = plot.panel(
        draw, alt, x="pack voltage that is reached (V)", y="earlier (−) or later (+) (s)", legend_columns=3
    )
    return figure(chart, title, "The same tests in time: seconds before or after the mean time of each voltage.")


def _first_falls(time_s: Array, voltage_V: Array, levels_V: Array) -> Array:
    """Return the time [s] of the first fall through each level; NaN if there is none."""
    return np.array([crossing_time(time_s, voltage_V, float(level)) for level in levels_V])


def over_ambient(page: ValidationPage, corridors: Sequence[Corridor], quantity: str, study: int) -> Html:
    """Draw the study's Figure 6 or 7 (`study`): the mean curve at every ambient temperature."""
    name = "Voltage" if quantity == "voltage_V" else "Surface temperature"
    title = f"{name} over ambient temperature{_study(page, study)}"
    measured = [c for c in corridors if np.isfinite(c.mean).any()]
    if len(measured) < 2:
        places = f"at {celsius(measured[0].ambient_C)} only" if measured else "nowhere"
        note = f"Not enough data: measured values were given {places}, so that this figure cannot be redrawn from them."
        return missing_figure(title, note)
    low, high = min(c.ambient_C for c in measured), max(c.ambient_C for c in measured)

    def draw(axes: Axes) -> None:
        labelled = set(_spread([c.ambient_C for c in measured], 6))
        for c in sorted(measured, key=lambda c: c.ambient_C):
            colour = plot.RAMP[round((c.ambient_C - low) / (high - low) * (len(plot.RAMP) - 1))]
            style = "-" if c.basis == "repeats" else "--" if c.basis == "quasi-replicates" else ":"
            axes.plot(c.at / 60.0, c.mean, style, color=colour, linewidth=1.8 if c.basis == "repeats" else 1.0)
            if c.ambient_C in labelled:
                axes.plot([], [], "-", color=colour, linewidth=3.0, label=celsius(c.ambient_C))

    bases = {b: sum(c.basis == b for c in measured) for b in ("repeats", "quasi-replicates", "one run")}
    note = (
        f"Solid: mean of repeats ({bases['repeats']}); dashed: near repeats a degree apart "
        f"({bases['quasi-replicates']}); dotted: one run ({bases['one run']}), no dispersion known."
    )
    alt = f"{name} over time at {len(measured)} ambient temperatures from {low:g} to {high:g} °C."
    return figure(plot.panel(draw, alt, x=MINUTES, y=AXIS[quantity]), title, note)


def _spread(values: Sequence[float], count: int) -> list[float]:
    """Return at most `count` of the values, evenly over their range."""
    ordered = sorted(values)
    targets = np.linspace(ordered[0], ordered[-1], count)
    return sorted({ordered[int(np.argmin(np.abs(np.array(ordered) - w)))] for w in targets})


def crossings(page: ValidationPage) -> Html:
    """Draw the time to a fixed voltage over ambient temperature, where one-time series break."""
    level_V = page.found.limits.crossing_V
    title = f"Time to {level_V:.4g} V over ambient temperature"
    runs = page.found.dataset.runs
    times = [(r.sample, r.ambient_C, crossing_time(r.time_s, r.voltage_V, level_V)) for r in runs]
    crossed = [c for c in times if math.isfinite(c[2])]
    if len({c[1] for c in crossed}) < 2:
        return missing_figure(title, "Tests at two ambient temperatures or more would be needed.")

    def draw(axes: Axes) -> None:
        for i, sample in enumerate(dict.fromkeys(c[0] for c in crossed)):
            mine = [c for c in crossed if c[0] == sample]
            colour, marker = (plot.BLUE, plot.GREEN, plot.RED, plot.AMBER)[i % 4], "osD^"[i % 4]
            axes.plot([c[1] for c in mine], [c[2] / 60.0 for c in mine], marker, color=colour, markersize=4,
                      markerfacecolor="none", label=f"sample {plot.literal(sample)}")  # fmt: skip

    alt = f"Time until the pack first falls to {level_V:.4g} V against ambient temperature, one mark a test."
    chart = plot.panel(draw, alt, x="ambient temperature (°C)", y=f"first fall to {level_V:.4g} V (min)")
    return figure(chart, title, f"One mark a test, {len(crossed)} tests. {JUMPS}")
