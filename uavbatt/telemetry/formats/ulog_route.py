"""Topics of route and place in PX4 logs, and their way to `Navigation`.

A ULog names the present item of a mission, never the whole of it: the route comes from a mission file.

    vehicle_status          nav_state: the mode
    mission_result          seq_total, seq_current, seq_reached
    home_position           lat, lon, alt (above sea)
    vehicle_global_position lat, lon, alt (above sea): height counts from home's
    vehicle_local_position  vx, vy, vz: north, east, down
    wind, wind_estimate     windspeed_north, windspeed_east and their variances
    vehicle_land_detected   landed
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from uavbatt.navigation import NAN, Home, Mode, Navigation
from uavbatt.telemetry.columns import Column
from uavbatt.telemetry.route.builder import POSITION_STEP_S, NavigationBuilder
from uavbatt.telemetry.route.events import Event, one_each, play
from uavbatt.telemetry.route.modes import px4_state

OF_ROUTE = (
    "vehicle_status", "mission_result", "home_position", "vehicle_global_position", "vehicle_local_position", "wind",
    "wind_estimate", "vehicle_land_detected",
)  # fmt: skip
_US = 1e6
_VELOCITY_AGE_S = 1.0
_ROTARY_WING = 1  # of vehicle_type


def navigation(ulog: Any, parameters: Sequence[tuple[float, str, float]]) -> tuple[Navigation, ...]:
    """Return what a ULog tells of route and place.

    parameters : (time [s], name, value), ascending
    """
    builder = NavigationBuilder(keeps_all=True)
    builder.autopilot(0.0, is_px4=True)
    topics = {topic.name: topic.data for topic in ulog.data_list if topic.multi_id == 0 and topic.name in OF_ROUTE}
    told = [event for name, data in topics.items() for event in _events(name, data, topics, ulog, builder)]
    told.sort(key=lambda event: event[0])
    play(told, parameters, builder)
    return builder.timeline()


def _events(name: str, data: Any, topics: dict[str, Any], ulog: Any, builder: NavigationBuilder) -> Iterator[Event]:
    time_s = _time_s(data, ulog)
    if name == "vehicle_status":
        yield from _modes(time_s, data, builder)
    elif name == "mission_result":
        for t, total, current, reached in _rows(time_s, data, "seq_total", "seq_current", "seq_reached"):
            if total > 0:
                yield t, builder.items_told, (int(total),)
            if total > 0 and current >= 0:
                yield t, builder.current, (int(current),)
            if total > 0 and reached >= 0:
                yield t, builder.reached, (int(reached),)
    elif name == "home_position":
        for t, lat_deg, lon_deg, alt_m in _rows(time_s, data, "lat", "lon", "alt"):
            yield t, builder.home, (Home(lat_deg, lon_deg, alt_m),)
    elif name == "vehicle_land_detected":
        yield from ((t, builder.landed, (bool(is_so),)) for t, is_so in _rows(time_s, data, "landed"))
    elif name in ("wind", "wind_estimate"):
        yield from _winds(time_s, data, builder)
    elif name == "vehicle_global_position":
        yield from _positions(time_s, data, topics.get("vehicle_local_position"), ulog, builder)


def _time_s(data: Any, ulog: Any) -> Column:
    """Return times from the log's start [s]; what PX4 logged before the start counts as at the start."""
    since_us: Column = np.maximum(data["timestamp"].astype(np.float64) - ulog.start_timestamp, 0.0)
    return np.round(since_us / _US, 6)


def _rows(time_s: Column, data: Any, *names: str) -> Iterator[tuple[float, ...]]:
    """Yield time and the named values of each row; nothing if the log's topic lacks a field."""
    if all(name in data for name in names):
        yield from zip(time_s.tolist(), *(data[name].astype(np.float64).tolist() for name in names), strict=True)


def _modes(time_s: Column, data: Any, builder: NavigationBuilder) -> Iterator[Event]:
    """Yield the modes of a multicopter; the mode of an aircraft with wings is unknown."""
    is_vtol = data.get("is_vtol", np.zeros(len(time_s)))
    for (t, state, kind), has_wings in zip(_rows(time_s, data, "nav_state", "vehicle_type"), is_vtol, strict=False):
        is_multicopter = not has_wings and kind == _ROTARY_WING
        yield t, builder.mode, (px4_state(int(state)) if is_multicopter else Mode.UNKNOWN,)


def _winds(time_s: Column, data: Any, builder: NavigationBuilder) -> Iterator[Event]:
    names = ("windspeed_north", "windspeed_east", "variance_north", "variance_east")
    for t, north_ms, east_ms, north_var, east_var in _rows(time_s, data, *names):
        variance = 0.5 * (north_var + east_var)
        yield t, builder.wind, (north_ms, east_ms, math.sqrt(variance) if variance > 0.0 else NAN)


def _positions(time_s: Column, data: Any, local: Any, ulog: Any, builder: NavigationBuilder) -> Iterator[Event]:
    """Yield positions with the last velocity before each."""
    chosen = one_each(time_s, POSITION_STEP_S)
    velocity = _velocities(time_s[chosen], local, ulog)
    rows = list(_rows(time_s, data, "lat", "lon", "alt"))
    for k, moving in zip(chosen if rows else (), velocity.tolist() if rows else (), strict=True):
        t, lat_deg, lon_deg, sea_m = rows[k]
        yield t, _above_home, (builder, lat_deg, lon_deg, sea_m, *moving)


def _above_home(time_s: float, builder: NavigationBuilder, lat_deg: float, lon_deg: float, sea_m: float,
                north_ms: float, east_ms: float, up_ms: float) -> None:  # fmt: skip
    """Take a position by its height above sea; without a home its height above home is not known."""
    home = builder.now.home
    if home is not None:
        builder.position(time_s, lat_deg, lon_deg, sea_m - home.alt_m, north_ms, east_ms, up_ms)


def _velocities(time_s: Column, local: Any, ulog: Any) -> Any:
    """Return the velocity north, east and up [m/s] at each time, a row each; NaN if the last one is old."""
    found = np.full((len(time_s), 3), np.nan)
    if local is None or not all(name in local for name in ("vx", "vy", "vz")):
        return found
    told_s = _time_s(local, ulog)
    last = told_s.searchsorted(time_s, side="right") - 1
    fresh = (last >= 0) & (time_s - told_s[last] <= _VELOCITY_AGE_S)
    for column, (name, sign) in enumerate((("vx", 1.0), ("vy", 1.0), ("vz", -1.0))):
        found[fresh, column] = sign * local[name][last[fresh]]
    return found
