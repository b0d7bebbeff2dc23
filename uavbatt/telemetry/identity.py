"""Identity of a flight (who, with what, when) from logs of each kind.

    DataFlash   MSG with the firmware's name and version; GPS with week and time of week; SYSID_THISMAV
    tlog        the frames' own system and clock; AUTOPILOT_VERSION; SMART_BATTERY_INFO, BATTERY_INFO of each pack
    ULog        sys_uuid, ver_sw_release; the UTC time of its GPS; MAV_SYS_ID; the smart battery's serial
A clock that says a time before 2000 was never set.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace

from uavbatt.mavlink.fields import PackIdentity, known_serial
from uavbatt.records import NAN, Identity
from uavbatt.telemetry.parameters import ardupilot_prefix

_EARLIEST_UTC_S, _LATEST_UTC_S = 946_684_800.0, 4_102_444_800.0  # 2000-01-01, 2100-01-01
_GPS_EPOCH_S, _WEEK_S = 315_964_800.0, 604_800.0  # 1980-01-06
_LEAP_S = 18.0  # GPS time less UTC since 2017; before, it is one or two seconds off
_VERSION = re.compile(r"\bV?\d+\.\d+")
_KINDS = {0: "dev", 64: "alpha", 128: "beta", 192: "rc"}
_SYSTEM = ("SYSID_THISMAV", "MAV_SYSID", "MAV_SYS_ID")


def utc_s(clock_s: float) -> float:
    """Return a clock's time [s since 1970] if it was ever set and shows no date of another century, else NaN."""
    return clock_s if _EARLIEST_UTC_S <= clock_s < _LATEST_UTC_S else NAN


def gps_utc_s(week: float, time_of_week_ms: float) -> float:
    """Return the UTC [s since 1970] of a GPS time (week, time of week [ms]); NaN before there is a fix."""
    return utc_s(_GPS_EPOCH_S + week * _WEEK_S + time_of_week_ms / 1000 - _LEAP_S) if week > 0 else NAN


def version(number: int) -> str:
    """Return MAVLink's or PX4's version number in words, `4.5.1` or `4.6.0-beta`.

    Its bytes hold major, minor, patch and kind.
    """
    text = ".".join(str(number >> shift & 0xFF) for shift in (24, 16, 8))
    kind = _KINDS.get(number & 0xC0 if number & 0xFF != 0xFF else 0xFF, "")
    return f"{text}-{kind}" if kind else text


def firmware_of(messages: Iterable[str]) -> str:
    """Return the first message that names a version: the autopilot says at its start what it is. Empty if none does."""
    return next((m.strip() for m in messages if _VERSION.search(m)), "")


def stated_serial(known: Mapping[str, float], instance: int) -> str:
    """Return a pack's serial by the vehicle's parameters; empty if they hold none."""
    return _as_serial(known.get(_serial_parameter(instance), NAN))


def stated_serials(parameters: Iterable[tuple[float, str, float]], instance: int) -> list[tuple[float, str]]:
    """Return the serials of a battery's packs by the vehicle's parameters, each with its time [s]."""
    name = _serial_parameter(instance)
    return [(time_s, _as_serial(value)) for time_s, said, value in parameters if said == name]


def _serial_parameter(instance: int) -> str:
    return ardupilot_prefix(instance) + "SERIAL_NUM"


def _as_serial(value: float) -> str:
    return known_serial(f"{value:.0f}") if value > 0 else ""


def completed(
    identity: Identity, parameters: Iterable[tuple[float, str, float]], instance: int, pack: PackIdentity | None = None
) -> Identity:
    """Return the identity with what one pack says of itself, and the parameters of vehicle number and serial."""
    pack = pack or PackIdentity(instance)
    said: Mapping[str, float] = {name: value for _, name, value in parameters}
    system = next((int(said[name]) for name in _SYSTEM if said.get(name, NAN) > 0), None)
    return replace(
        identity,
        system=system if identity.system is None else identity.system,
        battery_serial=pack.serial or identity.battery_serial or stated_serial(said, instance),
        battery_cycles=pack.cycles,
    )
