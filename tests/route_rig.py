"""Missions around a home for tests: waypoints in metres from home."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import msgspec

from uavbatt.battery import battery_file
from uavbatt.battery.powers import UNKNOWN, Powers
from uavbatt.battery.remembered import PackHealth
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.navigation import METRES_PER_DEGREE, Action, Frame, Home, Mission, MissionItem, ReturnSettings, Wind
from uavbatt.plan.endurance import TakeOff, resolve
from uavbatt.plan.mission import MissionPlan, PlannedMission, make_route_plan

POWERS = msgspec.structs.replace(UNKNOWN, hover_W=180.0, level_sd=0.05, flights=5)
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


def planned(
    *items: MissionItem,
    wind: Wind | None = None,
    remembered: PackHealth | None = None,
    reserve_soc: float = 0.0,
    ambient_C: float = 25.0,
    settings: ReturnSettings = SETTINGS,
    powers: Powers = POWERS,
) -> MissionPlan:
    """The plan of a mission for a quad of 180 W on a 4S pack of 5 Ah."""
    battery = battery_file.read_battery("lipo-generic")
    size = resolve(battery, PackOptions(cells=4, capacity_Ah=5.0, cutoff_V=13.2))
    asked = PlannedMission(mission(*items), HOME, settings, powers, wind or Wind(0.0, 0.0))
    return make_route_plan(battery, size, asked, TakeOff(ambient_C, reserve_soc=reserve_soc, remembered=remembered))
