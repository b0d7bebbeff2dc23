"""Flight modes of ArduCopter and PX4 -> `Mode`. Other vehicles' numbers mean other modes: UNKNOWN.

ArduCopter: HEARTBEAT.custom_mode is the number of the mode, as in DataFlash MODE. PX4: custom_mode holds a main mode in
its third byte and a mode of AUTO in its fourth; its log has vehicle_status.nav_state.
"""

from __future__ import annotations

from typing import Any

from uavbatt.mavlink.fields import AUTOPILOT_PX4
from uavbatt.navigation import Mode

AUTOPILOT_ARDUPILOT = 3
_MULTIROTORS = frozenset((2, 3, 4, 13, 14, 15, 29, 35, 43))  # MAV_TYPE of all that have rotors only

_COPTER = {  # number: (its name, as old text logs print it; what it is here)
    0: ("STABILIZE", Mode.MANUAL),
    1: ("ACRO", Mode.MANUAL),
    2: ("ALT_HOLD", Mode.MANUAL),
    3: ("AUTO", Mode.MISSION),
    4: ("GUIDED", Mode.MANUAL),
    5: ("LOITER", Mode.HOLD),
    6: ("RTL", Mode.RETURN),
    7: ("CIRCLE", Mode.HOLD),
    9: ("LAND", Mode.LAND),
    11: ("DRIFT", Mode.MANUAL),
    13: ("SPORT", Mode.MANUAL),
    14: ("FLIP", Mode.MANUAL),
    15: ("AUTOTUNE", Mode.MANUAL),
    16: ("POSHOLD", Mode.HOLD),
    17: ("BRAKE", Mode.HOLD),
    18: ("THROW", Mode.MANUAL),
    19: ("AVOID_ADSB", Mode.MANUAL),
    20: ("GUIDED_NOGPS", Mode.MANUAL),
    21: ("SMART_RTL", Mode.RETURN_BY_TRACK),
    22: ("FLOWHOLD", Mode.HOLD),
    23: ("FOLLOW", Mode.MANUAL),
    24: ("ZIGZAG", Mode.MANUAL),
    25: ("SYSTEMID", Mode.MANUAL),
    26: ("AUTOROTATE", Mode.LAND),
    27: ("AUTO_RTL", Mode.MISSION),  # AUTO from the mission's landing sequence on
    28: ("TURTLE", Mode.MANUAL),
    29: ("RATE_ACRO", Mode.MANUAL),
}
_COPTER_NAMES = dict(_COPTER.values())
_PX4_AUTO = 4
_PX4_MAIN = {1: Mode.MANUAL, 2: Mode.MANUAL, 3: Mode.MANUAL, 5: Mode.MANUAL, 6: Mode.MANUAL, 7: Mode.MANUAL,
             8: Mode.MANUAL, 9: Mode.MANUAL}  # fmt: skip
_PX4_OF_AUTO = {1: Mode.HOLD, 2: Mode.TAKEOFF, 3: Mode.HOLD, 4: Mode.MISSION, 5: Mode.RETURN, 6: Mode.LAND,
                8: Mode.MANUAL, 9: Mode.LAND}  # fmt: skip
_PX4_STATE = {0: Mode.MANUAL, 1: Mode.MANUAL, 2: Mode.MANUAL, 3: Mode.MISSION, 4: Mode.HOLD, 5: Mode.RETURN,
              10: Mode.MANUAL, 12: Mode.LAND, 14: Mode.MANUAL, 15: Mode.MANUAL, 17: Mode.TAKEOFF, 18: Mode.LAND,
              19: Mode.MANUAL, 20: Mode.LAND, 21: Mode.HOLD}  # fmt: skip


def mode_of(heartbeat: Any) -> Mode:
    """Return the mode in a HEARTBEAT of an autopilot."""
    if heartbeat.type not in _MULTIROTORS:
        return Mode.UNKNOWN
    if heartbeat.autopilot == AUTOPILOT_PX4:
        return px4_mode(heartbeat.custom_mode)
    return copter_mode(heartbeat.custom_mode) if heartbeat.autopilot == AUTOPILOT_ARDUPILOT else Mode.UNKNOWN


def copter_mode(number: int) -> Mode:
    """Return the mode of an ArduCopter by its number."""
    return _COPTER[number][1] if number in _COPTER else Mode.UNKNOWN


def copter_mode_named(text: str) -> Mode:
    """Return the mode of an ArduCopter by its name or number, as a text log prints it."""
    name = text.strip().upper()
    return copter_mode(int(name)) if name.isdigit() else _COPTER_NAMES.get(name, Mode.UNKNOWN)


def px4_mode(custom_mode: int) -> Mode:
    """Return the mode of a PX4 multicopter by HEARTBEAT.custom_mode."""
    main, of_auto = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    return _PX4_OF_AUTO.get(of_auto, Mode.UNKNOWN) if main == _PX4_AUTO else _PX4_MAIN.get(main, Mode.UNKNOWN)


def px4_auto(of_auto: int) -> int:
    """Return HEARTBEAT.custom_mode of a PX4 in this mode of AUTO (3 hold, 4 mission, 5 return)."""
    return _PX4_AUTO << 16 | of_auto << 24


def px4_state(nav_state: int) -> Mode:
    """Return the mode of a PX4 multicopter by vehicle_status.nav_state."""
    return _PX4_STATE.get(nav_state, Mode.UNKNOWN)
