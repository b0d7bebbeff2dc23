"""A flown route -> the MAVLink messages of its autopilot, or an ArduCopter's DataFlash records, for simulated logs.

tlog      HEARTBEAT, HOME_POSITION, MISSION_COUNT, MISSION_ITEM_INT at time 0; at every row GLOBAL_POSITION_INT,
          VFR_HUD, MISSION_CURRENT, EXTENDED_SYS_STATE, WIND (a PX4: WIND_COV); MISSION_ITEM_REACHED when the next item
          begins
DataFlash MSG, ORGN, CMD at time 0; at every row POS, GPS, XKF2; MISE, MODE and EV where something changes
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.navigation import Home, Mission, Position, Wind
from uavbatt.simulate.dataflash_layouts import CMD, EV, GPS, MISE, MODE, MSG, ORGN, POS, XKF2
from uavbatt.simulate.tlog_writer import heartbeat
from uavbatt.telemetry.route.commands import Fields, item_fields

STATION = (255, 190)  # who downloaded the mission: a ground station
FIRMWARE = b"ArduCopter V4.5.0 (simulated)"
EVENT_LANDED, EVENT_NOT_LANDED = 18, 28
FIX_3D, SATELLITES, HDOP = 3, 12, 80


class RouteRow(NamedTuple):
    """A RouteRow is a simulated aircraft at one instant; `mode` is its autopilot's number, `seq` the item flown."""

    position: Position
    seq: int
    mode: int
    is_landed: bool


class FlownRoute(NamedTuple):
    """A FlownRoute holds a mission and how it was flown."""

    home: Home
    mission: Mission
    wind: Wind
    rows: Sequence[RouteRow]
    is_px4: bool = False

    def mode_at(self, time_s: float) -> int:
        """Return the number of the mode at a time [s]."""
        after = bisect_right(self.rows, time_s, key=lambda row: row.position.time_s)
        return self.rows[max(after - 1, 0)].mode


def tlog_messages(route: FlownRoute) -> Iterator[tuple[float, Any]]:
    """Yield the messages of a route with their times [s], ascending."""
    yield 0.0, heartbeat(False, route.mode_at(0.0), route.is_px4)  # how items are counted depends on the autopilot
    for message in _home_and_mission(route):
        yield 0.0, message
    seq = None
    for row in route.rows:
        at_s = row.position.time_s
        if seq is not None and row.seq != seq:
            yield at_s, dialect.MAVLink_mission_item_reached_message(seq)
        seq = row.seq
        for message in _moving(row, route):
            yield at_s, message


def _home_and_mission(route: FlownRoute) -> Iterator[Any]:
    """Yield home, and the mission as a ground station downloads it."""
    home = route.home
    yield dialect.MAVLink_home_position_message(
        _e7(home.lat_deg), _e7(home.lon_deg), round(home.alt_m * 1000.0), 0, 0, 0, [1.0, 0, 0, 0], 0, 0, 0
    )
    yield dialect.MAVLink_mission_count_message(*STATION, len(route.mission.items))
    for item in route.mission.items:
        f = item_fields(item)
        yield dialect.MAVLink_mission_item_int_message(
            *STATION, f.seq, f.frame, f.command, int(f.seq == 0), 1, f.param1, f.param2, f.param3, f.param4,
            _e7(f.lat_deg), _e7(f.lon_deg), f.alt_m,
        )  # fmt: skip


def _moving(row: RouteRow, route: FlownRoute) -> Iterator[Any]:
    place, wind = row.position, route.wind
    sea_m = route.home.alt_m + place.height_m
    yield dialect.MAVLink_global_position_int_message(
        round(place.time_s * 1000.0), _e7(place.lat_deg), _e7(place.lon_deg), round(sea_m * 1000.0),
        round(place.height_m * 1000.0), round(place.north_ms * 100.0), round(place.east_ms * 100.0),
        round(-place.up_ms * 100.0), 65535,
    )  # fmt: skip
    ground_ms = math.hypot(place.north_ms, place.east_ms)
    yield dialect.MAVLink_vfr_hud_message(place.airspeed_ms, ground_ms, 0, 50, sea_m, place.up_ms)
    yield dialect.MAVLink_mission_current_message(row.seq)
    landed = dialect.MAV_LANDED_STATE_ON_GROUND if row.is_landed else dialect.MAV_LANDED_STATE_IN_AIR
    yield dialect.MAVLink_extended_sys_state_message(0, landed)
    yield _wind_cov(place.time_s, wind) if route.is_px4 else _wind(wind)


def _wind(wind: Wind) -> Any:
    from_deg = math.degrees(math.atan2(-wind.east_ms, -wind.north_ms)) % 360.0
    return dialect.MAVLink_wind_message(from_deg, math.hypot(wind.north_ms, wind.east_ms), 0.0)


def _wind_cov(time_s: float, wind: Wind) -> Any:
    unknown = math.nan
    return dialect.MAVLink_wind_cov_message(
        round(time_s * 1e6), wind.north_ms, wind.east_ms, 0.0, unknown, unknown, unknown, unknown, unknown
    )


def dataflash_records(route: FlownRoute) -> Iterator[tuple[float, bytes]]:
    """Yield the records of a route with their times [s], ascending."""
    home, total = route.home, len(route.mission.items)
    yield 0.0, MSG.record(0, FIRMWARE)
    yield 0.0, ORGN.record(0, 1, _e7(home.lat_deg), _e7(home.lon_deg), round(home.alt_m * 100.0))
    commands = [_command(item_fields(item), total) for item in route.mission.items]
    for command in commands:
        yield 0.0, CMD.record(0, *command)
    seq, mode, is_landed = None, None, None
    for row in route.rows:
        at_s, us = row.position.time_s, round(row.position.time_s * 1e6)
        if row.mode != mode:
            yield at_s, MODE.record(us, row.mode, row.mode, 0)
        if row.is_landed != is_landed:
            yield at_s, EV.record(us, EVENT_LANDED if row.is_landed else EVENT_NOT_LANDED)
        if row.seq != seq:
            yield at_s, MISE.record(us, *commands[row.seq])
        seq, mode, is_landed = row.seq, row.mode, row.is_landed
        for record in _places(row, route, us):
            yield at_s, record


def _command(f: Fields, total: int) -> tuple[float, ...]:
    place = (_e7(f.lat_deg), _e7(f.lon_deg), f.alt_m)
    return (total, f.seq, f.command, f.param1, f.param2, f.param3, f.param4, *place, f.frame)


def _places(row: RouteRow, route: FlownRoute, us: int) -> Iterator[bytes]:
    place, wind = row.position, route.wind
    lat, lon, sea_m = _e7(place.lat_deg), _e7(place.lon_deg), route.home.alt_m + place.height_m
    speed_ms = math.hypot(place.north_ms, place.east_ms)
    course_deg = math.degrees(math.atan2(place.east_ms, place.north_ms)) % 360.0
    yield GPS.record(us, 0, FIX_3D, 0, 0, SATELLITES, HDOP, lat, lon, round(sea_m * 100.0), speed_ms, course_deg,
                     -place.up_ms, 0.0, 1)  # fmt: skip
    yield POS.record(us, lat, lon, sea_m, place.height_m, place.height_m)
    yield XKF2.record(us, 0, round(wind.north_ms * 100.0), round(wind.east_ms * 100.0))


def _e7(degrees: float) -> int:
    return round(degrees * 1e7) if math.isfinite(degrees) else 0
