"""Fields of MAVLink messages as values: units made SI, sentinels made NaN.

The functions take a decoded message (any object with the attributes of the MAVLink XML), so that log files and the live
link share them. Sentinels (common.xml): -1 for currents, charges and percents, 32767 for temperature, 65535 for cell
voltages. `time_remaining` is never read.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from uavbatt.nan_equal import nan_equal

HEARTBEAT, SYS_STATUS, PARAM_VALUE, BATTERY_STATUS, BATTERY2 = 0, 1, 22, 147, 181
AUTOPILOT_VERSION = 148
SMART_BATTERY_INFO, BATTERY_INFO = 370, 372

AUTOPILOT_PX4 = 12
_AUTOPILOT_INVALID = 8
_TYPE_GCS, _TYPE_BATTERY = 6, 36
_MODE_FLAG_ARMED = 128
_PACK_SPLIT_MV = 65534  # a higher voltage is 65534 in voltages[0] plus the rest in the next entry
# MAV_PARAM_TYPE -> struct code: PX4 copies the integer's bytes into the float field.
INTEGER_CODES = {1: "<B", 2: "<b", 3: "<H", 4: "<h", 5: "<I", 6: "<i"}


@nan_equal
@dataclass(frozen=True, slots=True)
class BatteryFields:
    """BatteryFields holds one battery message in SI; NaN where the sender did not know."""

    id: int
    voltage_V: float
    current_A: float = math.nan
    temp_C: float = math.nan
    consumed_Ah: float = math.nan
    reported_soc: float = math.nan
    cell_voltages_V: tuple[float, ...] = ()


@nan_equal
@dataclass(frozen=True, slots=True)
class PackIdentity:
    """PackIdentity holds what one pack states of itself: serial, its own count of cycles, cells and rated capacity.

    What it does not state is empty, None or NaN. full_Ah : what it holds today when full, by its own gauge [Ah].
    """

    id: int
    serial: str = ""
    cycles: int | None = None
    cells: int | None = None
    capacity_Ah: float = math.nan
    full_Ah: float = math.nan


class _Layout(NamedTuple):
    """_Layout holds where a payload has id, cycles, cells, serial and capacities, and how many of these are 1 Ah.

    capacities : the rated one and that of today, one behind the other from `capacities_at` on.
    """

    id: int
    cycles: int
    cells: int
    serial: slice
    capacities: struct.Struct
    capacities_at: int
    per_Ah: float


_LAYOUTS = {
    SMART_BATTERY_INFO: _Layout(18, 8, 89, slice(21, 37), struct.Struct("<2i"), 0, 1000.0),
    BATTERY_INFO: _Layout(44, 40, 48, slice(58, 90), struct.Struct("<2f"), 32, 1.0),
}
IDENTITY_LENGTH = {SMART_BATTERY_INFO: 109, BATTERY_INFO: 140}  # whole payloads
IDENTITY_EXTRA = {SMART_BATTERY_INFO: 75, BATTERY_INFO: 26}  # seeds of their checksums
_NO_SERIALS = ("", "0", "-1", "65535")


def pack_identity(message_id: int, payload: bytes) -> PackIdentity:
    """Return what a pack states of itself in a payload of SMART_BATTERY_INFO or BATTERY_INFO.

    Many releases of pymavlink do not hold BATTERY_INFO yet.
    """
    at = _LAYOUTS[message_id]
    whole = payload.ljust(IDENTITY_LENGTH[message_id], b"\0")
    cycles = int.from_bytes(whole[at.cycles : at.cycles + 2], "little")
    stated = at.capacities.unpack_from(whole, at.capacities_at)
    return PackIdentity(
        whole[at.id],
        known_serial(whole[at.serial].split(b"\0")[0].decode("latin-1")),
        None if cycles in (0, 65535) else cycles,
        whole[at.cells] or None,
        *(capacity / at.per_Ah if 0.0 < capacity < math.inf else math.nan for capacity in stated),
    )


def known_serial(text: str) -> str:
    """Return a pack's serial; empty if it is one of the values that mean "none"."""
    shown = "".join(letter for letter in text.strip() if letter.isprintable())
    return "" if shown in _NO_SERIALS else shown


def hardware(uid: int) -> str:
    """Return the flight controller's serial number from the `uid` of AUTOPILOT_VERSION; empty if it is 0."""
    return f"{uid:016x}" if uid else ""


def pack_voltage_V(voltages_mV: Sequence[int], ext_mV: Sequence[int] = ()) -> tuple[float, tuple[float, ...]]:
    """Return pack voltage [V] and cell voltages [V] from the two voltage arrays of BATTERY_STATUS [mV].

    One entry is the whole pack, several are cells, unless the first is 65534 (a pack too high for
    one field). Zeros are fillers of careless senders: a cell at 0 V does not fly.
    """
    entries = [v for v in voltages_mV if v not in (0, 65535)]
    if not entries:
        return math.nan, ()
    if voltages_mV[0] == _PACK_SPLIT_MV:
        return sum(entries) / 1000, ()
    entries += [v for v in ext_mV if 1 < v < 65535]
    total_V = sum(entries) / 1000
    return total_V, tuple(v / 1000 for v in entries) if len(entries) > 1 else ()


def current_A(centiamps: int) -> float:
    """Return a current [A]; -1 is unknown (a true -0.01 A cannot be told from it), 32767 is a saturated field: NaN."""
    return math.nan if centiamps in (-1, 32767) else centiamps / 100


def soc(percent: int) -> float:
    """Return the state of charge that the autopilot reports, 0..1; NaN for anything outside 0..100 %."""
    return percent / 100 if 0 <= percent <= 100 else math.nan


def battery_status(msg: Any) -> BatteryFields:
    """Return the fields of BATTERY_STATUS (147)."""
    voltage_V, cells_V = pack_voltage_V(msg.voltages, getattr(msg, "voltages_ext", ()))
    return BatteryFields(
        id=msg.id,
        voltage_V=voltage_V,
        current_A=current_A(msg.current_battery),
        temp_C=math.nan if msg.temperature == 32767 else msg.temperature / 100,
        consumed_Ah=math.nan if msg.current_consumed == -1 else msg.current_consumed / 1000,
        reported_soc=soc(msg.battery_remaining),
        cell_voltages_V=cells_V,
    )


def sys_status(msg: Any) -> BatteryFields:
    """Return the fields of SYS_STATUS (1): the fallback, ambiguous on a vehicle with several batteries."""
    known = msg.voltage_battery not in (0, 65535)
    return BatteryFields(
        id=0,
        voltage_V=msg.voltage_battery / 1000 if known else math.nan,
        current_A=current_A(msg.current_battery),
        reported_soc=soc(msg.battery_remaining),
    )


def battery2(msg: Any) -> BatteryFields:
    """Return the fields of BATTERY2 (181, retired): the second battery of old ArduPilot logs, instance 1."""
    known = msg.voltage not in (0, 65535)
    return BatteryFields(
        id=1,
        voltage_V=msg.voltage / 1000 if known else math.nan,
        current_A=current_A(msg.current_battery),
    )


def parameter(msg: Any, is_px4: bool) -> tuple[str, float]:
    """Return name and value of PARAM_VALUE (22); PX4 sends integers as bit patterns, ArduPilot by value."""
    name = msg.param_id if isinstance(msg.param_id, str) else bytes(msg.param_id).decode("latin-1")
    code = INTEGER_CODES.get(msg.param_type) if is_px4 else None
    if code is None:
        return name.split("\0")[0], float(msg.param_value)
    raw = struct.pack("<f", msg.param_value)[: struct.calcsize(code)]
    return name.split("\0")[0], float(struct.unpack(code, raw)[0])


def is_integer(msg: Any) -> bool:
    """Return True if a PARAM_VALUE holds an integer, which PX4 and ArduPilot send in different ways."""
    return msg.param_type in INTEGER_CODES


def is_armed(heartbeat: Any) -> bool:
    """Return True if the armed bit of HEARTBEAT.base_mode is set."""
    return bool(heartbeat.base_mode & _MODE_FLAG_ARMED)


def is_autopilot(heartbeat: Any) -> bool:
    """Return True for the heartbeat of a flight controller, not of a ground station or a payload."""
    return bool(heartbeat.autopilot != _AUTOPILOT_INVALID and heartbeat.type != _TYPE_GCS)


def is_battery(heartbeat: Any) -> bool:
    """Return True for the heartbeat of a battery that is a component of its own."""
    return bool(heartbeat.autopilot == _AUTOPILOT_INVALID and heartbeat.type == _TYPE_BATTERY)
