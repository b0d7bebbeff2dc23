"""The way home of an autopilot from any point, as legs in metres around home.

Speeds and heights are those of the vehicle's parameters. Where it states none, its make's defaults count, and for the
height and the speed of the return the values that crews usually set, because a way home that is told too short ends in
a flight that does not come home.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from uavbatt.navigation import Mission, ReturnSettings
from uavbatt.prediction.route.legs import Leg, Phase, Point


class LegSpeeds(NamedTuple):
    """LegSpeeds holds the speeds at which a leg is flown [m/s]."""

    cruise_ms: float
    climb_ms: float
    descent_ms: float


class _Defaults(NamedTuple):
    """_Defaults holds an autopilot's own speeds and heights, used where the vehicle does not state them.

    return_heights_m : its default and those that crews set, in ascending order; a mission returns at the middle one
    """

    speeds: LegSpeeds
    return_heights_m: tuple[float, ...]
    land_ms: float
    slow_below_m: float


ARDUCOPTER = _Defaults(LegSpeeds(5.0, 2.5, 1.5), (15.0, 30.0, 60.0), 0.5, 10.0)
PX4 = _Defaults(LegSpeeds(5.0, 3.0, 1.5), (30.0, 60.0), 0.7, 5.0)
# Of PX4 and of older ArduCopters by default, and of ArduCopter 4.6. In calm air the slow way home asks more charge,
# against the wind the fast one.
RETURN_SPEEDS_MS = (5.0, 10.0)


def _defaults(settings: ReturnSettings) -> _Defaults:
    return PX4 if settings.is_px4 else ARDUCOPTER


def finite_or(value: float, otherwise: float) -> float:
    """Return `value` if it is finite and positive, else `otherwise`."""
    return value if math.isfinite(value) and value > 0.0 else otherwise


def return_reason(mission: Mission | None, settings: ReturnSettings) -> str:
    """Return why the way home is not known, as vehicle or mission tell it; empty when it is known."""
    if mission is None:  # it may have a landing that nobody sent
        return settings.return_reason or settings.landing_reason
    return settings.return_reason or mission.return_reason or (settings.landing_reason if mission.lands else "")


def possible_returns(settings: ReturnSettings) -> tuple[ReturnSettings, ...]:
    """Return the settings that a vehicle may have: all pairs of the heights and speeds that it may return with."""
    heights_m, speeds_ms = _unstated(settings)
    return tuple(
        replace(settings, return_height_m=height_m, return_ms=speed_ms)
        for height_m in heights_m or (settings.return_height_m,)
        for speed_ms in speeds_ms or (settings.return_ms,)
    )


def return_assumed(settings: ReturnSettings) -> str:
    """Return in words which heights and speeds of the return are assumed; empty if the vehicle states its own."""
    told = [(values, unit) for values, unit in zip(_unstated(settings), ("m", "m/s"), strict=True) if values]
    spans = " and ".join(f"{values[0]:.2g} to {values[-1]:.2g} {unit}" for values, unit in told)
    return f"return at {spans} assumed: the vehicle has not stated its own" if told else ""


def _unstated(settings: ReturnSettings) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the heights [m] and the speeds [m/s] that the return may have; none where the vehicle states its own."""
    is_height_known = math.isfinite(settings.return_height_m)
    is_speed_known = math.isfinite(settings.return_ms) or math.isfinite(settings.cruise_ms)
    heights_m = () if is_height_known else _defaults(settings).return_heights_m
    slow_ms, fast_ms = RETURN_SPEEDS_MS
    speeds_ms = tuple(sorted((finite_or(settings.seen_ms, slow_ms), fast_ms)))
    return heights_m, () if is_speed_known else speeds_ms


def way_home(begin: Point, settings: ReturnSettings) -> tuple[Leg, ...]:
    """Return the autopilot's way from a point to touchdown at home: climb, run, wait, descend, land."""
    speeds, run_m = speeds_of(settings), math.hypot(begin.north_m, begin.east_m)
    return_ms, hold_s = finite_or(settings.return_ms, speeds.cruise_ms), finite_or(settings.return_hold_s, 0.0)
    above = begin._replace(height_m=_return_height_m(begin, run_m, settings))
    over_home = Point(0.0, 0.0, above.height_m)
    limits = (return_ms, speeds.climb_ms, speeds.descent_ms)
    legs = (
        Leg(-1, Phase.HOME, begin, above, 0.0, *limits),
        Leg(-1, Phase.HOME, above, over_home, run_m, *limits, hold_s),
        *landing(over_home, settings, -1),
    )
    return tuple(leg for leg in legs if leg.moving_s + leg.hold_s > 0.0)


def _return_height_m(begin: Point, run_m: float, settings: ReturnSettings) -> float:
    """Return the height at which the autopilot flies home; it is never below the present height."""
    asked_m = settings.return_height_m
    if not math.isfinite(asked_m):
        heights_m = _defaults(settings).return_heights_m
        asked_m = heights_m[len(heights_m) // 2]
    if run_m <= finite_or(settings.return_cone_within_m, math.inf):
        asked_m = min(asked_m, finite_or(settings.return_cone_slope, math.inf) * run_m)
    return max(begin.height_m + finite_or(settings.return_climb_min_m, 0.0), asked_m, begin.height_m)


def landing(above: Point, settings: ReturnSettings, seq: int) -> tuple[Leg, ...]:
    """Return the legs straight down from a point to the ground, the last metres slowly."""
    speeds, defaults = speeds_of(settings), _defaults(settings)
    slow_m = min(finite_or(settings.land_slow_below_m, defaults.slow_below_m), max(above.height_m, 0.0))
    low, ground = above._replace(height_m=slow_m), above._replace(height_m=0.0)
    fast_ms = finite_or(settings.land_fast_ms, speeds.descent_ms)
    land_ms = finite_or(settings.land_ms, defaults.land_ms)
    return (
        Leg(seq, Phase.LANDING, above, low, 0.0, 1.0, speeds.climb_ms, fast_ms),
        Leg(seq, Phase.LANDING, low, ground, 0.0, 1.0, speeds.climb_ms, land_ms),
    )


def speeds_of(settings: ReturnSettings) -> LegSpeeds:
    """Return the vehicle's own speeds on a route."""
    defaults = _defaults(settings).speeds
    return LegSpeeds(
        finite_or(settings.cruise_ms, finite_or(settings.seen_ms, defaults.cruise_ms)),
        finite_or(settings.climb_ms, defaults.climb_ms),
        finite_or(settings.descent_ms, defaults.descent_ms),
    )
