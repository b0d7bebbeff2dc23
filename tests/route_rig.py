"""Missions around a home for tests: waypoints in metres from home."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from uavbatt.navigation import Action, Frame, Home, Mission, MissionItem, ReturnSettings
from uavbatt.prediction.route_path import METRES_PER_DEGREE

HOME = Home(47.0, 8.0, 400.0)
SETTINGS = ReturnSettings(
    cruise_ms=5.0,
    climb_ms=2.5,
    descent_ms=1.5,
    return_height_m=30.0,
    return_ms=8.0,
    land_ms=0.5,
    land_slow_below_m=10.0,
)


def to(seq: int, north_m: float, east_m: float, alt_m: float, **other: Any) -> MissionItem:
    """A waypoint at metres from home."""
    lon = HOME.lon_deg + east_m / METRES_PER_DEGREE / math.cos(math.radians(HOME.lat_deg))
    item = MissionItem(seq, Action.WAYPOINT, HOME.lat_deg + north_m / METRES_PER_DEGREE, lon, alt_m)
    return replace(item, **other)


def mission(*items: MissionItem) -> Mission:
    """A mission as ArduPilot holds it: home in front."""
    return Mission((MissionItem(0, Action.WAYPOINT, HOME.lat_deg, HOME.lon_deg, 0.0, Frame.SEA), *items), "test")
