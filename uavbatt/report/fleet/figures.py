"""Figures of the fleet page: a scale of one pack over its flights, errors of the forecasts of all flights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from uavbatt.report import plot
from uavbatt.report.fleet.groups import CHECKPOINTS, Group, precision
from uavbatt.report.page import Html, figure, number
from uavbatt.small_chart import small_chart, span

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_POINTS = 400  # points of one figure; more are thinned evenly
FEWEST_OF_A_LINE = 3  # flights
LEAST_SHOWN = 0.4  # least height of a scale, so that scatter of a few percent looks small
DAY_S = 86_400.0
_SPREAD = 0.28  # sideways spread of the dots of one checkpoint


def scale_figure(group: Group, quantity: Literal["resistance", "capacity"]) -> Html:
    """Draw the resistance or capacity scale of one group, flight by flight, with two standard deviations."""
    place, pairs = group.in_time(group.resistance if quantity == "resistance" else group.capacity)
    chosen = _thinned(len(place))
    place, pairs = place[chosen], pairs[chosen]
    colour = plot.RED if quantity == "resistance" else plot.BLUE

    def draw(axes: Axes) -> None:
        axes.axhline(1.0, color=plot.FAINT, linewidth=0.8)
        position = place / DAY_S if group.is_dated else place
        spread = 2.0 * pairs[:, 1]
        axes.fill_between(position, pairs[:, 0] - spread, pairs[:, 0] + spread, color=colour, alpha=0.15, linewidth=0)
        axes.plot(position, pairs[:, 0], "o", markersize=3.5, color=colour)
        if len(position) >= 5:
            axes.plot(position, _smoothed(pairs), color=colour)
        if group.is_dated:
            from matplotlib import dates

            untyped: Any = dates
            locator = untyped.AutoDateLocator(minticks=3, maxticks=6)
            axes.xaxis.set_major_locator(locator)
            axes.xaxis.set_major_formatter(untyped.ConciseDateFormatter(locator))
        else:
            axes.locator_params(axis="x", integer=True)
        low, high = np.min(pairs[:, 0] - 2.0 * pairs[:, 1]), np.max(pairs[:, 0] + 2.0 * pairs[:, 1])
        axes.set_ylim(min(0.8, float(low)), max(1.2, float(high)))

    alt = f"{quantity.capitalize()} scale of {group.name} over its flights"
    svg = plot.panel(draw, alt, x="date" if group.is_dated else "flight", y=f"{quantity} scale")
    return figure(svg, f"{plot.literal(group.name)}: {quantity}")


def resistance_spark(group: Group) -> Html:
    """Draw the resistance of one group over its flights as a small line for a table; nothing without a history."""
    if group.flights < FEWEST_OF_A_LINE or not group.is_identified:
        return Html("")
    place, pairs = group.in_time(group.resistance)
    scale, low, high = ((pairs[:, 0] + k * pairs[:, 1]).tolist() for k in (0.0, -2.0, 2.0))
    alt = f"Resistance of {group.name}: {number(scale[0], 2)} at the first flight, {number(scale[-1], 2)} at the last"
    limits = span(scale, least=LEAST_SHOWN)
    return Html(small_chart(place.tolist(), scale, alt=alt, band=(low, high), shown=limits, css="spark"))


def errors_figure(errors: Mapping[str, Sequence[float]]) -> Html:
    """Draw the error of every forecast at each instant before the end: a dot a flight, middle half, median."""
    by_checkpoint = [(label, np.array(errors[key])) for key, label in CHECKPOINTS.items() if errors[key]]

    def draw(axes: Axes) -> None:
        axes.axhline(0.0, color=plot.FAINT, linewidth=0.8)
        for index, (_, values) in enumerate(by_checkpoint):
            errors_s = np.sort(values)[_thinned(len(values))]
            aside = _SPREAD * np.sin(2.4 * np.arange(len(errors_s)))  # even, and the same in every run
            axes.plot(index + aside, errors_s, "o", color=plot.SKY, markersize=3.0, alpha=0.8)
            low, middle, high = np.percentile(values, (25.0, 50.0, 75.0))
            axes.plot([index, index], [low, high], color=plot.BLUE, linewidth=5.0, solid_capstyle="butt")
            axes.plot([index - 0.3, index + 0.3], [middle, middle], color=plot.INK)
        axes.set_xticks(range(len(by_checkpoint)), [label for label, _ in by_checkpoint])
        axes.set_xlim(-0.6, len(by_checkpoint) - 0.4)

    svg = plot.responsive(draw, "Errors of the forecasts before the end of flight", x="", y="forecast − truth (s)")
    return figure(
        svg,
        "Errors of the forecasts",
        "A dot a flight; bar: the middle half; line: the median. Positive is optimistic.",
    )


def _smoothed(pairs: NDArray[np.float64]) -> NDArray[Any]:
    """Return the weighted mean of each flight and its two neighbours on each side."""
    weight = precision(pairs)
    near = np.abs(np.subtract.outer(np.arange(len(pairs)), np.arange(len(pairs)))) <= 2
    smooth: NDArray[np.float64] = near @ (weight * pairs[:, 0]) / (near @ weight)
    return smooth


def _thinned(count: int) -> NDArray[Any]:
    return np.unique(np.linspace(0, count - 1, min(count, MOST_POINTS)).astype(int)) if count else np.zeros(0, int)
