"""Faults of what a link tells of place, velocity, wind, home and progress, put into a telemetry log.

A fault changes messages of the autopilot, for three seconds in each minute or from a moment on, and may drop them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.navigation import METRES_PER_DEGREE

Fault = Callable[[Any, float], bool]  # changes a message at a time since the log's start [s]; False drops it
PERIOD_S, LASTS_S, BEGINS_S = 60.0, 3.0, 30.0
FAR_E7 = 1e7 * 30_000.0 / METRES_PER_DEGREE  # in 1e-7 degrees
NEAR_E7 = 1e7 * 300.0 / METRES_PER_DEGREE
POLE_E7 = 9e8
WANDER_S, WANDER_M = 30.0, 3.0
VELOCITY_NOISE_MS, WIND_WANDER_S, WIND_WANDER_MS = 0.3, 60.0, 1.5
DRIFT_MS = 0.02


def changed(message_type: str, *, always: bool = False, **fields: Callable[[float], float]) -> Fault:
    """Return a fault that changes fields of one message type, for LASTS_S in each PERIOD_S or `always`."""

    def fault(message: Any, time_s: float) -> bool:
        if message.get_type() == message_type and (always or is_on(time_s)):
            for name, change in fields.items():
                was = getattr(message, name)
                setattr(message, name, round(change(was)) if isinstance(was, int) else change(was))
        return True

    return fault


def is_on(time_s: float) -> bool:
    """Return True in the first LASTS_S of each PERIOD_S, from BEGINS_S on."""
    return time_s > BEGINS_S and time_s % PERIOD_S < LASTS_S


def dropped(*message_types: str) -> Fault:
    """Return a fault that drops all messages of these types."""
    return lambda message, _: message.get_type() not in message_types


def rarer(message_type: str, every_s: float) -> Fault:
    """Return a fault that keeps one message of a type in `every_s`."""
    last_s = -math.inf

    def fault(message: Any, time_s: float) -> bool:
        nonlocal last_s
        if message.get_type() != message_type or time_s < last_s:
            last_s = min(last_s, time_s)
            return True
        if time_s - last_s < every_s:
            return False
        last_s = time_s
        return True

    return fault


def each(message_type: str, change: Callable[[Any], None]) -> Fault:
    """Return a fault that changes every message of one type."""

    def fault(message: Any, _: float) -> bool:
        if message.get_type() == message_type:
            change(message)
        return True

    return fault


def wander(seed: int, axes: int, sd: float, keep: float) -> Iterator[NDArray[np.float64]]:
    """Yield values [axes] that wander around zero with this sd; each keeps a share of the one before."""
    rng, off = np.random.default_rng(seed), np.zeros(axes)
    while True:
        off = off * keep + rng.normal(0.0, sd * math.sqrt(1.0 - keep**2), axes)
        yield off


def wandering() -> Fault:
    """Return a fault in which the place wanders by WANDER_M around the true one, over WANDER_S."""
    off_m = wander(1, 3, WANDER_M, math.exp(-0.5 / WANDER_S))

    def change(message: Any) -> None:
        north, east, up = next(off_m)
        message.lat += round(1e7 * north / METRES_PER_DEGREE)
        message.lon += round(1e7 * east / METRES_PER_DEGREE / math.cos(math.radians(message.lat / 1e7)))
        message.relative_alt += round(1e3 * up)

    return each("GLOBAL_POSITION_INT", change)


def drifting(message: Any, time_s: float) -> bool:
    """Let the height drift by DRIFT_MS, as a barometer does that warms up."""
    if message.get_type() == "GLOBAL_POSITION_INT":
        message.relative_alt += round(1e3 * DRIFT_MS * time_s)
    return True


def noisy_velocity() -> Fault:
    """Return a fault in which each velocity has noise of VELOCITY_NOISE_MS in each axis."""
    off_ms = wander(2, 3, VELOCITY_NOISE_MS, keep=0.0)

    def change(message: Any) -> None:
        for name, off in zip(("vx", "vy", "vz"), next(off_ms), strict=True):
            setattr(message, name, getattr(message, name) + round(100.0 * off))

    return each("GLOBAL_POSITION_INT", change)


def wandering_wind() -> Fault:
    """Return a fault in which the wind wanders by WIND_WANDER_MS in each axis, over WIND_WANDER_S."""
    off_ms = wander(3, 2, WIND_WANDER_MS, math.exp(-1.0 / WIND_WANDER_S))

    def change(message: Any) -> None:
        from_rad = math.radians(message.direction)
        north_ms, east_ms = message.speed * np.array([math.cos(from_rad), math.sin(from_rad)]) + next(off_ms)
        message.speed = math.hypot(north_ms, east_ms)
        message.direction = math.degrees(math.atan2(east_ms, north_ms))

    return each("WIND", change)


def _without_velocity(message: Any, _: float) -> bool:
    """Send no velocity, as some autopilots do."""
    if message.get_type() == "GLOBAL_POSITION_INT":
        message.vx = message.vy = message.vz = 0
    return bool(message.get_type() != "VFR_HUD")


FAULTS: dict[str, Callable[[], Fault]] = {
    "nothing": lambda: dropped(),
    "place 300 m away": lambda: changed("GLOBAL_POSITION_INT", lat=lambda v: v + NEAR_E7),
    "place 30 km away": lambda: changed("GLOBAL_POSITION_INT", lat=lambda v: v + FAR_E7),
    "place of a receiver without a fix (0, 0)": lambda: changed(
        "GLOBAL_POSITION_INT", lat=lambda _: 0.0, lon=lambda _: 0.0
    ),
    "place wanders by 3 m, always": wandering,
    "height drifts by 12 m in 10 minutes": lambda: drifting,
    "a place every 10 s, always": lambda: rarer("GLOBAL_POSITION_INT", 10.0),
    "no velocity told, always": lambda: _without_velocity,
    "velocity of 90 m/s": lambda: changed("GLOBAL_POSITION_INT", vx=lambda _: 9000.0),
    "velocity 15 m/s too much": lambda: changed("GLOBAL_POSITION_INT", vx=lambda v: v + 1500.0),
    "velocity with noise of 0.3 m/s, always": noisy_velocity,
    "vertical velocity with the wrong sign, always": lambda: changed(
        "GLOBAL_POSITION_INT", always=True, vz=lambda v: -v
    ),
    "wind of 80 m/s": lambda: changed("WIND", speed=lambda _: 80.0),
    "wind 1.7 times the true one, always": lambda: changed("WIND", always=True, speed=lambda v: 1.7 * v),
    "wind wanders by 1.5 m/s, always": wandering_wind,
    "wind turned by 40°, always": lambda: changed("WIND", always=True, direction=lambda v: (v + 40.0) % 360.0),
    "home at the pole": lambda: changed("HOME_POSITION", latitude=lambda _: POLE_E7),
    "home never told, always": lambda: dropped("HOME_POSITION"),
    "item 0 told as the present one": lambda: changed("MISSION_CURRENT", seq=lambda _: 0.0),
    "mode GUIDED": lambda: changed("HEARTBEAT", custom_mode=lambda v: 4.0 if v == 3 else v),
}


def write_with_fault(source: Path, target: Path, fault: Fault) -> None:
    """Write a telemetry log with a fault."""
    wire = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    with closing(mavutil.mavlink_connection(str(source))) as link, target.open("wb") as out:
        begins_s = None
        while (message := link.recv_match()) is not None:
            begins_s = message._timestamp if begins_s is None else begins_s
            if fault(message, message._timestamp - begins_s):
                out.write(round(message._timestamp * 1e6).to_bytes(8, "big") + message.pack(wire))
