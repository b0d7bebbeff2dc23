"""A small map of a route in metres around home: the flown part, the part to come, and where to turn back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from uavbatt.prediction.route.legs import Point
from uavbatt.report import plot
from uavbatt.report.page import Html, figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_POINTS = 2000  # more than the map has px along its longer side


def route_map(
    to_come: Sequence[Point], track: Sequence[Point] = (), turning: Point | None = None, note: str = ""
) -> Html:
    """Return the map as a figure of the page; home is its origin.

    turning : where the aircraft must turn back, None if it is not known; note : the sentence under the title
    """

    def draw(axes: Axes) -> None:
        for points, colour, words in ((to_come, plot.SKY, "route"), (track, plot.BLUE, "flown")):
            if len(points) > 1:
                thinned = points[:: max(len(points) // MOST_POINTS, 1)]
                axes.plot([p.east_m for p in thinned], [p.north_m for p in thinned], color=colour, label=words)
        axes.plot([0.0], [0.0], "s", color=plot.INK, label="home")
        if turning is not None:
            axes.plot([turning.east_m], [turning.north_m], "o", color=plot.RED, label="turn back")
        axes.set_aspect("equal", adjustable="datalim")

    svg = plot.panel(
        draw, "Map of the route in metres around home", x="east (m)", y="north (m)", height=plot.TALL, legend_columns=4
    )
    return figure(svg, "The route from above", note)
