"""Values -> telemetry log (`.tlog`): MAVLink 2 frames, each after its time of reception.

File layout: `time (u64, big endian, microseconds since 1970) | frame`, repeated. pymavlink's reader takes the
two low bits of the time as a link number, so they are written as zero: times are true to 4 us.

Frames written, all little endian by pymavlink's own encoder:

- PARAM_VALUE at time 0, values as floats "by value" the way ArduPilot sends them;
- HEARTBEAT at most 1 s apart and at every change of arming (base_mode bit 128). A sample whose `armed` is
  None changes nothing; before the first that knows, there is no heartbeat, since its bit has no "unknown";
- SYS_STATUS and BATTERY_STATUS for every sample. NaN becomes the field's own sentinel:

| field | unit | unknown |
|---|---|---|
| voltages[0..9] | mV | 65535; the pack in [0] when no cells are known, above 65534 mV carried on in [1] |
| current_battery | cA | -1; a real -0.01 A is written as -2; beyond +-327.67 A it stays at the limit |
| current_consumed | mAh | -1 |
| energy_consumed, battery_remaining | hJ, % | -1 |
| temperature | cdegC | 32767 |
| time_remaining, charge_state | s | 0 |

Source: mavlink common.xml and the MAVLink file format of QGroundControl / MAVProxy logs.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from heapq import merge
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common

from uavbatt.files import atomic_write
from uavbatt.records import Sample

EPOCH_US = 1_700_000_000_000_000
"""Default time of the first record [us since 1970]: fixed, so that equal values give equal files."""

HEARTBEAT_PERIOD_S = 1.0
UINT16_MAX = 65535
INT16_MAX = 32767
CELLS, CELLS_EXT = 10, 4  # entries of voltages[] and of voltages_ext[]


def ascending_us(time_s: float, last_us: int) -> int:
    """Return `time_s` [s] in whole microseconds [us]; a log's clock starts at 0 and never goes back.

    Raises ValueError for a time below 0, not finite, or before `last_us`.
    """
    if not (math.isfinite(time_s) and time_s >= 0.0):
        raise ValueError(f"sample time {time_s} s: expected seconds from the log's first record, 0 or more")
    time_us = round(time_s * 1e6)
    if time_us < last_us:
        raise ValueError(f"sample time {time_s} s lies before the sample ahead of it")
    return time_us


def write_tlog(
    path: str | Path,
    samples: Iterable[Sample],
    parameters: Mapping[str, float] | None = None,
    *,
    battery_id: int = 0,
    epoch_us: int = EPOCH_US,
    route: Iterable[tuple[float, Any]] = (),
    mode_at: Callable[[float], int] = lambda time_s: 0,
    is_px4: bool = False,
) -> None:
    """Write `samples` and the vehicle's `parameters` to `path` as a tlog of system 1, component 1 (the autopilot).

    battery_id : BATTERY_STATUS.id, 0..8 for ground stations
    epoch_us : wall time of time_s = 0 [us since 1970]
    route : messages of route and place with their times [s], ascending (`route_writer`)
    mode_at : number of the autopilot's mode at a time [s]
    is_px4 : the autopilot is a PX4, else an ArduCopter
    """
    encoder: Any = common.MAVLink(None, srcSystem=1, srcComponent=1)
    with atomic_write(path, "wb") as file:

        def put(message: Any, time_us: int) -> None:
            file.write(struct.pack(">Q", (epoch_us + time_us) & ~0x3))
            file.write(message.pack(encoder))
            encoder.seq = (encoder.seq + 1) % 256

        for message in _parameter_frames(parameters or {}, is_px4):
            put(message, 0)
        told = _sample_messages(samples, battery_id, mode_at, is_px4)
        for time_s, message in merge(route, told, key=lambda one: one[0]):
            put(message, round(time_s * 1e6))


def _sample_messages(
    samples: Iterable[Sample], battery_id: int, mode_at: Callable[[float], int], is_px4: bool
) -> Iterator[tuple[float, Any]]:
    """Yield the messages of every sample in order with their times [s], and heartbeats between them."""
    last_us, beat_us, armed = 0, -math.inf, None
    for sample in samples:
        last_us = ascending_us(sample.time_s, last_us)
        changed = sample.armed is not None and sample.armed != armed
        armed = sample.armed if sample.armed is not None else armed
        if changed or (armed is not None and last_us - beat_us >= HEARTBEAT_PERIOD_S * 1e6):
            yield sample.time_s, heartbeat(bool(armed), mode_at(sample.time_s), is_px4)
            beat_us = last_us
        yield sample.time_s, sys_status(sample)
        yield sample.time_s, battery_status(sample, battery_id)


def _parameter_frames(parameters: Mapping[str, float], is_px4: bool) -> Iterator[Any]:
    for index, (name, value) in enumerate(parameters.items()):
        kind = common.MAV_PARAM_TYPE_REAL32
        if is_px4 and isinstance(value, int):  # a PX4 copies the bytes of an integer into the float
            kind, (value,) = common.MAV_PARAM_TYPE_INT32, struct.unpack("<f", struct.pack("<i", value))
        yield common.MAVLink_param_value_message(_ascii(name, 16), value, kind, len(parameters), index)


def heartbeat(armed: bool, mode: int = 0, is_px4: bool = False) -> Any:
    """Return a HEARTBEAT of a quadrotor with an ArduPilot or a PX4; base_mode has only the armed bit.

    mode : number of its flight mode (custom_mode)
    """
    return common.MAVLink_heartbeat_message(
        common.MAV_TYPE_QUADROTOR,
        common.MAV_AUTOPILOT_PX4 if is_px4 else common.MAV_AUTOPILOT_ARDUPILOTMEGA,
        common.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0,
        mode,
        common.MAV_STATE_ACTIVE if armed else common.MAV_STATE_STANDBY,
        3,
    )


def sys_status(sample: Sample) -> Any:
    """Return a SYS_STATUS with the battery fields of `sample`; it has neither temperature nor charge drawn."""
    voltage_mV = _scaled(sample.voltage_V, 1e3, UINT16_MAX)
    return common.MAVLink_sys_status_message(
        *(0, 0, 0, 0),
        min(voltage_mV, UINT16_MAX),
        current_cA(sample.current_A),
        _percent(sample.reported_soc),
        *(0, 0, 0, 0, 0, 0),
    )


def battery_status(sample: Sample, battery_id: int) -> Any:
    """Return a BATTERY_STATUS of `sample`, every unknown at its sentinel."""
    voltages_mV, voltages_ext_mV = cell_fields_mV(sample)
    return common.MAVLink_battery_status_message(
        battery_id,
        common.MAV_BATTERY_FUNCTION_UNKNOWN,
        common.MAV_BATTERY_TYPE_UNKNOWN,
        _clamped(_scaled(sample.temp_C, 100.0, INT16_MAX)),
        voltages_mV,
        current_cA(sample.current_A),
        _scaled(sample.consumed_Ah, 1e3, -1),
        -1,
        _percent(sample.reported_soc),
        voltages_ext=voltages_ext_mV,
    )


def cell_fields_mV(sample: Sample) -> tuple[list[int], list[int]]:
    """Return voltages[10] and voltages_ext[4] [mV]: the cells if they are known, else the pack's sum in front.

    Raises ValueError for more than 14 cells.
    """
    fields, extended = [UINT16_MAX] * CELLS, [0] * CELLS_EXT
    cells_V = sample.cell_voltages_V
    if cells_V:
        if len(cells_V) > CELLS + CELLS_EXT:
            raise ValueError(f"{len(cells_V)} cells: BATTERY_STATUS carries {CELLS + CELLS_EXT}")
        for cell, volts in enumerate(cells_V[:CELLS]):
            fields[cell] = min(_scaled(volts, 1e3, UINT16_MAX), UINT16_MAX)
        for cell, volts in enumerate(cells_V[CELLS:]):
            extended[cell] = max(_scaled(volts, 1e3, 0), 1) if math.isfinite(volts) else 0
        return fields, extended
    rest_mV = _scaled(sample.voltage_V, 1e3, -1)
    for entry in range(CELLS):
        if rest_mV < 0:
            break
        fields[entry] = min(rest_mV, UINT16_MAX - 1)
        # a full entry says "read on": even an exact 65534 mV needs a 0 behind it
        rest_mV = rest_mV - fields[entry] if fields[entry] == UINT16_MAX - 1 else -1
    return fields, extended


def current_cA(current_A: float) -> int:
    """Return current_battery [cA]; -1 is "no sensor", so a real -0.01 A moves to -2 and keeps its sign."""
    if not math.isfinite(current_A):
        return -1
    centi = _clamped(round(current_A * 100.0))
    return -2 if centi == -1 else centi


def _percent(soc: float) -> int:
    return min(max(round(soc * 100.0), 0), 100) if math.isfinite(soc) else -1


def _scaled(value: float, factor: float, unknown: int) -> int:
    return round(value * factor) if math.isfinite(value) else unknown


def _clamped(value: int) -> int:
    return min(max(value, -INT16_MAX), INT16_MAX)


def _ascii(text: str, limit: int) -> bytes:
    encoded = text.encode("ascii")
    if len(encoded) > limit:
        raise ValueError(f"{text!r}: at most {limit} characters fit")
    return encoded
