"""Telemetry logs of a few frames: several batteries, several vehicles."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

EPOCH_S = 1_700_000_000.0
HOME_POSITION = dialect.MAVLink_home_position_message(470000000, 80000000, 400000, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)


def frame(message: Any, time_s: float, system: int = 1) -> bytes:
    """One frame of an autopilot as a .tlog holds it, `time_s` [s] after the log's begin."""
    link = dialect.MAVLink(None, srcSystem=system, srcComponent=1)
    return struct.pack(">Q", round((EPOCH_S + time_s) * 1e6)) + bytes(message.pack(link))


def battery_row(time_s: float, voltage_V: float, current_A: float, instance: int = 0, system: int = 1) -> bytes:
    """A heartbeat of an armed copter and one BATTERY_STATUS."""
    volts = [round(voltage_V * 1000.0)] + [65535] * 9
    status = dialect.MAVLink_battery_status_message(
        instance, 0, 0, 2500, volts, round(current_A * 100.0), -1, -1, -1, voltages_ext=[0, 0, 0, 0]
    )
    beat = dialect.MAVLink_heartbeat_message(2, 3, 128, 0, 3, 3)
    return frame(beat, time_s, system) + frame(status, time_s, system)


def smart_info(capacity_mAh: int, cells: int, serial: bytes = b"A7", instance: int = 0, full_mAh: int = -1) -> Any:
    """A SMART_BATTERY_INFO: what a smart battery states of itself."""
    return dialect.MAVLink_smart_battery_info_message(
        instance, 0, 1, capacity_mAh, full_mAh, 12, serial, b"maker", 65535, 0, 0, 0, 0, cells, 0, 0, b""
    )


def smart(
    capacity_mAh: int, cells: int, time_s: float, serial: bytes = b"A7", instance: int = 0, full_mAh: int = -1
) -> tuple[float, bytes]:
    """The same as a frame of a log, with the time at which it is sent [s]."""
    return time_s, frame(smart_info(capacity_mAh, cells, serial, instance, full_mAh), time_s)


def hover(seconds: int, volts: float, amps: float, instance: int = 0, system: int = 1) -> list[tuple[float, bytes]]:
    """Five seconds at rest, then a hover; a row a second, each with its time [s]."""
    rest = [(float(k), battery_row(k, volts, 0.1, instance, system)) for k in range(5)]
    sag_V = 0.03 * amps
    air = [(float(k), battery_row(k, volts - sag_V - 0.001 * k, amps, instance, system)) for k in range(5, seconds)]
    return rest + air


def write_log(path: Path, rows: Iterable[tuple[float, bytes]]) -> Path:
    """The rows of all batteries in the order of their times."""
    path.write_bytes(b"".join(data for _, data in sorted(rows, key=lambda row: row[0])))
    return path
