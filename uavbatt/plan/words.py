"""Words of a planned mission: what is flown in each leg, with which speeds, in which wind."""

from __future__ import annotations

import math
from collections.abc import Sequence

from uavbatt.navigation import Wind
from uavbatt.prediction.route.legs import Leg, Phase


def leg_words(leg: Leg) -> str:
    """Return what is flown in a leg, and how long the aircraft waits at its end."""
    return f"{_moved(leg)}, waits {leg.hold_s:.0f} s" if leg.hold_s > 0.0 else _moved(leg)


def _moved(leg: Leg) -> str:
    """Return in words how the aircraft moves in a leg."""
    if leg.circle_m > 0.0:
        return f"{leg.run_m / (2.0 * math.pi * leg.circle_m):.3g} turns of {leg.circle_m:.0f} m radius"
    if leg.phase is Phase.TAKE_OFF:
        return "takes off"
    if leg.phase is Phase.LANDING:
        return "descends" if leg.end.height_m > 0.0 else "lands"
    if leg.moves_load and leg.rise_m < 0.0:
        return "sets its payload down"
    upright = "climbs" if leg.rise_m > 0.0 else "descends" if leg.rise_m < 0.0 else "stays"
    moved = "flies" if leg.run_m > 0.0 else upright
    return f"{moved} home" if moved == "flies" and leg.phase is Phase.HOME else moved


def wind_words(wind: Wind) -> str:
    """Return the wind: its speed and where it comes from."""
    speed_ms = math.hypot(wind.north_ms, wind.east_ms)
    from_deg = math.degrees(math.atan2(-wind.east_ms, -wind.north_ms)) % 360.0
    return f"{speed_ms:.1f} m/s from {from_deg:.0f}°" if speed_ms > 0.0 else "none stated: still air"


def speed_words(legs: Sequence[Leg]) -> str:
    """Return the speeds over ground that are planned on the route and on the way home [m/s]."""
    parts = []
    for phase, name in ((Phase.ROUTE, "route"), (Phase.HOME, "way home")):
        flown = [leg for leg in legs if leg.phase is phase and leg.run_m > 0.0]
        if flown:
            slowest, fastest = (pick(leg.speed_ms for leg in flown) for pick in (min, max))
            speeds = f"{slowest:.3g}" if slowest == fastest else f"{slowest:.3g} to {fastest:.3g}"
            parts.append(f"{name} {speeds} m/s")
    climbs = max(leg.climb_ms for leg in legs)
    return ", ".join([*parts, f"climb {climbs:.3g} m/s, descent {max(leg.descent_ms for leg in legs):.3g} m/s"])
