"""The route on the page of a flight: a map, the turn-back, and which load was used."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

from uavbatt.log_replay.run import ReplayedRow, RouteForecasts, route_forecasts
from uavbatt.prediction.route.legs import Point, way_points
from uavbatt.prediction.route.path import path, place
from uavbatt.records import Flight, Route
from uavbatt.report.page import Html, duration, paragraph, percent, section
from uavbatt.report.route_map import route_map


def route_section(flight: Flight, steps: Sequence[ReplayedRow]) -> list[Html]:
    """Return the section on the route; an empty list if neither a route nor home is known."""
    forecasts = route_forecasts(steps)
    if not forecasts.rows:
        return []
    turn_s = forecasts.turn_back_now_s
    note = "The red point is where “turn back now” was said first." if math.isfinite(turn_s) else ""
    track = [point for fix in flight.navigation if (point := _place(fix.time_s, flight)) is not None]
    planned = _planned(flight)
    maps = [route_map(planned, track, _place(turn_s, flight), note)] if planned or track else []
    return [
        section(
            "The route", paragraph(_words(forecasts.rows, turn_s)), *maps, paragraph(_loads(forecasts), css="quiet")
        )
    ]


def _place(time_s: float, flight: Flight) -> Point | None:
    """Return the position of the aircraft; None if it is unknown."""
    fix = flight.navigation_at(time_s) if math.isfinite(time_s) else None
    if fix is None or fix.position is None or fix.home is None:
        return None
    return place(fix.home, fix.position)


def _planned(flight: Flight) -> list[Point]:
    """Return the route of the last known mission."""
    last = flight.navigation_at(math.inf)
    if last.mission is None or last.home is None:
        return []
    return way_points(path(last.mission, last.home, last.settings).legs)


def _words(forecasts: Sequence[tuple[float, Route]], turn_s: float) -> str:
    time_s, last = forecasts[-1]
    words = [f"“Turn back now” was said {duration(turn_s)} after the log's start."] if math.isfinite(turn_s) else []
    if math.isfinite(last.home_soc) and not last.must_turn_back_now:  # too late, home is no promise any more
        charge = f"{percent(last.home_soc)} of the charge (at worst {percent(last.home_soc_lo)})"
        how = "it was expected at home" if last.is_returning else "turning back would have brought it home"
        words.append(f"At {duration(time_s)} {how} with {charge}.")
    if not words:
        reasons = Counter(route.reason for _, route in forecasts if route.reason).most_common(1)
        words.append(f"Nothing was known of the way home: {reasons[0][0] if reasons else 'no position'}.")
    return " ".join(words)


def _loads(forecasts: RouteForecasts) -> str:
    """Return in words which load to come was used in how many rows, and why the route was not used."""
    loads = Counter(route.load for _, route in forecasts.rows)
    used = ", ".join(f"{load} in {count} of {len(forecasts.rows)} rows" for load, count in loads.most_common())
    why = f"; most often because {forecasts.why_no_route}" if forecasts.why_no_route else ""
    assumed = f" Assumed: {forecasts.assumed}." if forecasts.assumed else ""
    return f"Load to come: {used}{why}.{assumed}"
