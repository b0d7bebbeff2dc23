"""A survey of many items, as a mission file and as an aircraft that flies it tells its progress."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from msgspec.structs import replace

from uavbatt.battery.powers import UNKNOWN
from uavbatt.battery.vehicle_file import Phases, Trace, VehicleFile, write_vehicle
from uavbatt.navigation import METRES_PER_DEGREE

ITEMS, SPACING_M, SPEED_MS, HEIGHT_M = 200, 20.0, 5.0, 30
HOME_LAT_DEG, HOME_LON_DEG = 47.0, 8.0
AUTO = 3  # of ArduCopter


def write_survey(path: Path) -> None:
    """Write ITEMS items: home, take-off, waypoints to the north, the return."""
    lines = ["QGC WPL 110", _line(0, 16, 0.0, frame=0), _line(1, 22, 0.0)]
    lines += [_line(seq, 16, SPACING_M * (seq - 1)) for seq in range(2, ITEMS - 1)]
    path.write_text("\n".join([*lines, _line(ITEMS - 1, 20, 0.0)]) + "\n", encoding="utf-8")


def write_quad(path: Path) -> None:
    """Write a vehicle file with the powers of an aircraft that nobody knows, 200 W in hover."""
    phases = Phases(take_off_W=200.0, flight_W=200.0, last_minute_W=200.0)
    powers = replace(UNKNOWN, hover_W=200.0)
    flown = Trace(time_s=[0.0, 600.0], power_W=[200.0, 200.0], soc=[1.0, 0.5])
    write_vehicle(VehicleFile(name="quad", battery="lipo-generic", phases=phases, traces=[flown], powers=powers), path)


def _line(seq: int, command: int, north_m: float, frame: int = 3) -> str:
    lat_deg = HOME_LAT_DEG + north_m / METRES_PER_DEGREE
    height_m = 400 if frame == 0 else HEIGHT_M
    fields = (seq, int(seq == 0), frame, command, 0, 0, 0, 0, f"{lat_deg:.7f}", HOME_LON_DEG, height_m, 1)
    return "\t".join(map(str, fields))


def messages(dialect: Any, time_s: float) -> list[Any]:
    """Return what the autopilot says of its route at `time_s` [s]: home, place, item, wind."""
    north_m = SPEED_MS * time_s
    lat, lon = round(1e7 * (HOME_LAT_DEG + north_m / METRES_PER_DEGREE)), round(1e7 * HOME_LON_DEG)
    at_ms, home_lat = round(1e3 * time_s), round(1e7 * HOME_LAT_DEG)
    place = (lat, lon, 1000 * (400 + HEIGHT_M), 1000 * HEIGHT_M)
    return [
        dialect.MAVLink_home_position_message(
            home_lat, lon, 400_000, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0
        ),
        dialect.MAVLink_global_position_int_message(at_ms, *place, round(100 * SPEED_MS), 0, 0, 0),
        dialect.MAVLink_mission_current_message(2 + int(north_m / SPACING_M)),
        dialect.MAVLink_wind_message(90.0, 4.0, 0.0),
    ]
