"""Vehicle parameters of speeds and of the way home -> `ReturnSettings`.

ArduCopter until 4.6 counts in centimetres (WPNAV_SPEED, RTL_ALT), from 4.7 on in metres under new names (WP_SPD,
RTL_ALT_M); PX4 counts in metres. 0 of an ArduCopter speed is "the speed of the mission". PX4 uses its cone only within
RTL_MIN_DIST of home, and climbs to the whole return height elsewhere; older versions used it at any distance. A value
that no multirotor has counts as not stated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from uavbatt.navigation import HIGHEST_STATED_M, LONGEST_STATED_S, NAN, ReturnSettings, is_stated_speed

_CENTI = 0.01
_CRUISE = (("WP_SPD", 1.0), ("WPNAV_SPEED", _CENTI), ("MPC_XY_CRUISE", 1.0))
_CLIMB = (("WP_SPD_UP", 1.0), ("WPNAV_SPEED_UP", _CENTI), ("MPC_Z_V_AUTO_UP", 1.0), ("MPC_Z_VEL_MAX_UP", 1.0))
_DESCENT = (("WP_SPD_DN", 1.0), ("WPNAV_SPEED_DN", _CENTI), ("MPC_Z_V_AUTO_DN", 1.0), ("MPC_Z_VEL_MAX_DN", 1.0))
_RETURN_HEIGHT = (("RTL_ALT_M", 1.0), ("RTL_ALT", _CENTI), ("RTL_RETURN_ALT", 1.0))
_RETURN_SPEED = (("RTL_SPEED_MS", 1.0), ("RTL_SPEED", _CENTI))
_RETURN_FINAL = (("RTL_ALT_FINAL_M", 1.0), ("RTL_ALT_FINAL", _CENTI))
_RETURN_CLIMB_MIN = (("RTL_CLIMB_MIN_M", 1.0), ("RTL_CLIMB_MIN", _CENTI))
_RETURN_HOLD = (("RTL_LOIT_TIME", 0.001), ("RTL_LAND_DELAY", 1.0))
_LAND = (("LAND_SPD_MS", 1.0), ("LAND_SPEED", _CENTI), ("MPC_LAND_SPEED", 1.0))
_LAND_FAST = (("LAND_SPD_HIGH_MS", 1.0), ("LAND_SPEED_HIGH", _CENTI))
_LAND_SLOW_BELOW = (("LAND_ALT_LOW_M", 1.0), ("LAND_ALT_LOW", _CENTI), ("MPC_LAND_ALT2", 1.0))
_CIRCLE_RADIUS = (("CIRCLE_RADIUS_M", 1.0), ("CIRCLE_RADIUS", _CENTI))
_CIRCLE_RATE = (("CIRCLE_RATE", 1.0),)
_ACCELERATION = (("WP_ACC", 1.0), ("WPNAV_ACCEL", _CENTI))
_CONE_SLOPE, _CONE_ANGLE_DEG = "RTL_CONE_SLOPE", "RTL_CONE_ANG"
_PX4_MIN_DIST, _PX4_MIN_DIST_M = "RTL_MIN_DIST", 10.0
_PX4_DESCEND_ALT, _PX4_LAND_DELAY, _PX4_RETURN_ALT = "RTL_DESCEND_ALT", "RTL_LAND_DELAY", "RTL_RETURN_ALT"
_PX4_TO_LANDING = (1.0, 3.0)  # to the landing of the mission if it has one, else straight home; 1 is a VTOL's default
_RALLY, _TERRAIN, _PX4_TYPE = "RALLY_TOTAL", "RTL_ALT_TYPE", "RTL_TYPE"
_ONLY_PX4 = (_CONE_ANGLE_DEG, _PX4_MIN_DIST, _PX4_DESCEND_ALT, _PX4_LAND_DELAY, _PX4_RETURN_ALT, _PX4_TYPE)
_ALL = (
    _CRUISE, _CLIMB, _DESCENT, _RETURN_HEIGHT, _RETURN_SPEED, _RETURN_FINAL, _RETURN_CLIMB_MIN, _RETURN_HOLD, _LAND,
    _LAND_FAST, _LAND_SLOW_BELOW, _CIRCLE_RADIUS, _CIRCLE_RATE, _ACCELERATION,
)  # fmt: skip

_ALONE = (_CONE_SLOPE, _CONE_ANGLE_DEG, _PX4_MIN_DIST, _PX4_DESCEND_ALT, _RALLY, _TERRAIN, _PX4_TYPE)
_QUANTITIES = (*(tuple(name for name, _ in names) for names in _ALL), *((name,) for name in _ALONE))

NAMES = frozenset(name for names in _QUANTITIES for name in names)
"""The parameters that this module reads."""


def names_to_ask(known: Mapping[str, float], is_px4: bool) -> list[str]:
    """Return the names under which this autopilot may state what is not known yet of its speeds and its way home.

    An ArduCopter has either the old name or the new one, and does not answer to the other.
    """
    unknown = (name for names in _QUANTITIES if known.keys().isdisjoint(names) for name in names)
    return [name for name in unknown if (name.startswith("MPC_") or name in _ONLY_PX4) is is_px4]


def return_settings(known: Mapping[str, float], is_px4: bool = False) -> ReturnSettings:
    """Return speeds and way home from the known parameters, by name."""
    return ReturnSettings(
        cruise_ms=_speed_ms(known, _CRUISE),
        climb_ms=_speed_ms(known, _CLIMB),
        descent_ms=_speed_ms(known, _DESCENT),
        return_height_m=_first(known, _RETURN_HEIGHT),
        return_ms=_speed_ms(known, _RETURN_SPEED),
        return_hold_s=_hold_s(known),
        return_final_m=_final_m(known),
        land_ms=_speed_ms(known, _LAND),
        land_slow_below_m=_positive(known, _LAND_SLOW_BELOW),
        land_fast_ms=_speed_ms(known, _LAND_FAST),
        return_climb_min_m=_first(known, _RETURN_CLIMB_MIN),
        return_cone_slope=_cone_slope(known),
        return_cone_within_m=known.get(_PX4_MIN_DIST, _PX4_MIN_DIST_M) if _CONE_ANGLE_DEG in known else NAN,
        circle_radius_m=_positive(known, _CIRCLE_RADIUS),
        circle_rate_deg_s=_first(known, _CIRCLE_RATE),
        acceleration_ms2=_positive(known, _ACCELERATION),
        return_reason=_reason(known),
        landing_reason=_landing_reason(known),
        is_px4=is_px4,
    )


def _first(known: Mapping[str, float], names: tuple[tuple[str, float], ...], most: float = HIGHEST_STATED_M) -> float:
    """Return the first of the named parameters that is known, in SI; NaN if none is, or if it is beyond `most`."""
    value = next((known[name] * factor for name, factor in names if math.isfinite(known.get(name, NAN))), NAN)
    return value if abs(value) <= most else NAN


def _positive(known: Mapping[str, float], names: tuple[tuple[str, float], ...]) -> float:
    value = _first(known, names)
    return value if value > 0.0 else NAN


def _speed_ms(known: Mapping[str, float], names: tuple[tuple[str, float], ...]) -> float:
    value = _first(known, names)
    return value if is_stated_speed(value) else NAN


def _hold_s(known: Mapping[str, float]) -> float:
    """Return the wait above home [s]; PX4's -1 (for ever) is told by `return_final_m`."""
    hold_s = _first(known, _RETURN_HOLD, LONGEST_STATED_S)
    return max(hold_s, 0.0) if math.isfinite(hold_s) else NAN


def _final_m(known: Mapping[str, float]) -> float:
    """Return the height at which a return ends [m]; 0: it lands."""
    if known.get(_PX4_LAND_DELAY, 0.0) < 0.0:
        return known.get(_PX4_DESCEND_ALT, NAN)
    return 0.0 if _PX4_RETURN_ALT in known else _first(known, _RETURN_FINAL)


def _cone_slope(known: Mapping[str, float]) -> float:
    """Return the return height per distance [m/m]; PX4 sets the half angle of a cone [deg], 0 is no cone."""
    angle_deg = known.get(_CONE_ANGLE_DEG, NAN)
    if math.isfinite(angle_deg):
        return 1.0 / math.tan(math.radians(angle_deg)) if 0.0 < angle_deg <= 90.0 else 0.0
    return known.get(_CONE_SLOPE, NAN)


def _reason(known: Mapping[str, float]) -> str:
    """Return in words why the way home is not straight; empty if it is straight."""
    if known.get(_RALLY, 0.0) > 0.0:
        return f"the vehicle has rally points (RALLY_TOTAL {known[_RALLY]:g}): it may return to one of them"
    if known.get(_TERRAIN, 0.0) > 0.0:
        return "the vehicle returns at a height above the terrain (RTL_ALT_TYPE 1)"
    if known.get(_PX4_TYPE, 0.0) > 0.0 and known[_PX4_TYPE] not in _PX4_TO_LANDING:
        return f"the vehicle may return along a mission (RTL_TYPE {known[_PX4_TYPE]:g})"
    return ""


def _landing_reason(known: Mapping[str, float]) -> str:
    """Return in words why the way home is not straight if the mission lands; empty if it is straight even then."""
    if known.get(_PX4_TYPE, 0.0) in _PX4_TO_LANDING:
        return f"the vehicle may return to the landing of its mission (RTL_TYPE {known[_PX4_TYPE]:g})"
    return ""
