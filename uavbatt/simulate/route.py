"""A simulated flight along a mission: position and power over time.

Legs are flown at their planned speeds over ground, each from standstill to standstill. The wind changes the airspeed
and so the power, by the same law as in the forecast of a route. After the last item the aircraft returns, as if the
pilot switched to RTL. A mission without home as item 0 is a PX4's: it is flown with PX4's modes, numbers and default
parameters.
"""

from __future__ import annotations

import dataclasses
import math
from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import accumulate
from typing import NamedTuple

from uavbatt.battery.powers import of_hover, power, terms
from uavbatt.errors import UsageError
from uavbatt.navigation import METRES_PER_DEGREE, NAN, Home, Mission, Position, ReturnSettings, Wind
from uavbatt.prediction.route.legs import Leg, Phase, Point, on_circle
from uavbatt.prediction.route.path import ACCELERATION_MS2, Path, path
from uavbatt.prediction.route.way_home import finite_or
from uavbatt.simulate.route_writer import FlownRoute, RouteRow
from uavbatt.telemetry.route.modes import px4_auto
from uavbatt.telemetry.route.settings import return_settings


class Autopilot(NamedTuple):
    """Autopilot holds the numbers of the modes of an autopilot, and its default parameters of speed and return.

    hold, mission, returning : as in HEARTBEAT.custom_mode
    """

    is_px4: bool
    hold: int
    mission: int
    returning: int
    cruise: tuple[str, float]  # the parameter of the speed on the route, and its units in 1 m/s
    parameters: Mapping[str, float]  # an int is an integer of the autopilot

    def at_cruise(self, cruise_ms: float) -> Autopilot:
        """Return the autopilot with another speed on the route [m/s]."""
        name, units = self.cruise
        return self._replace(parameters={**self.parameters, name: cruise_ms * units})


ARDUCOPTER = Autopilot(False, 5, 3, 6, ("WPNAV_SPEED", 100.0), {
    "WPNAV_SPEED": 500.0, "WPNAV_SPEED_UP": 250.0, "WPNAV_SPEED_DN": 150.0, "RTL_ALT": 1500.0, "RTL_SPEED": 0.0,
    "RTL_LOIT_TIME": 5000.0, "RTL_ALT_FINAL": 0.0, "LAND_SPEED": 50.0, "LAND_SPEED_HIGH": 0.0,
})  # fmt: skip
PX4 = Autopilot(True, px4_auto(3), px4_auto(4), px4_auto(5), ("MPC_XY_CRUISE", 1.0), {
    "MPC_XY_CRUISE": 5.0, "MPC_Z_V_AUTO_UP": 3.0, "MPC_Z_V_AUTO_DN": 1.5, "RTL_RETURN_ALT": 60.0, "RTL_LAND_DELAY": 0.0,
    "RTL_CONE_ANG": 45, "RTL_MIN_DIST": 10.0, "RTL_TYPE": 0, "MPC_LAND_SPEED": 0.7, "MPC_LAND_ALT2": 5.0,
})  # fmt: skip
ROW_PERIOD_S = 1.0
SHORTEST_AIRSPEED_MS = 0.01  # 0 would say that it is not known

Watts = Callable[[float, float, Phase], float]  # airspeed [m/s], climb [m/s], phase -> power [W]


class Motion(NamedTuple):
    """Motion is how a leg is flown: speed is gained for `gaining_s` [s], kept, and lost in the same time.

    fastest : the share of the leg that is flown in a second [1/s] at that speed
    """

    gaining_s: float
    fastest: float

    @property
    def lasts_s(self) -> float:
        """Return the time of the movement [s]."""
        return self.gaining_s + 1.0 / self.fastest

    def at(self, since_s: float) -> tuple[float, float]:
        """Return the share of the leg that is flown after a time [s], and the share that is flown in a second [1/s]."""
        if not 0.0 <= since_s < self.lasts_s:
            return float(since_s > 0.0), 0.0
        from_end_s = min(since_s, self.lasts_s - since_s)  # both halves of the movement are alike
        gained_s = min(from_end_s, self.gaining_s)
        rate = self.fastest * (gained_s / self.gaining_s)
        share = 0.5 * rate * gained_s + self.fastest * (from_end_s - gained_s)
        return (share if from_end_s == since_s else 1.0 - share), rate


def motion_of(leg: Leg, acceleration_ms2: float) -> Motion:
    """Return how a leg is flown from standstill to standstill."""
    if leg.moving_s == 0.0:
        return Motion(0.0, math.inf)
    gaining_s = leg.fastest_ms / acceleration_ms2
    if gaining_s <= leg.moving_s:
        return Motion(gaining_s, 1.0 / leg.moving_s)
    shortest_s = math.sqrt(gaining_s * leg.moving_s)
    return Motion(shortest_s, 1.0 / shortest_s)


@dataclass(frozen=True, slots=True)
class RouteFlight:
    """A RouteFlight holds legs in their order, how and when [s] each is flown, the landing, wind and autopilot."""

    mission: Mission
    home: Home
    wind: Wind
    autopilot: Autopilot
    legs: tuple[Leg, ...]
    motions: tuple[Motion, ...]
    begins_s: tuple[float, ...]
    lands_s: float

    def power_W(self, time_s: float, watts: Watts) -> float:
        """Return the power that is asked [W] at a time [s] in the air; `watts` is the aircraft's power law."""
        leg = self._leg(time_s)
        position = self.position(time_s)
        return watts(position.airspeed_ms, position.up_ms, leg.phase)

    def position(self, time_s: float) -> Position:
        """Return where the aircraft is at a time [s], and how it moves."""
        index = self._index(time_s)
        share, rate = self.motions[index].at(time_s - self.begins_s[index])
        place, moved = _on_leg(self.legs[index], share)
        north_ms, east_ms, up_ms = (metres * rate for metres in moved)
        in_air = self.begins_s[0] <= time_s < self.lands_s
        wind = self.wind if in_air else Wind(0.0, 0.0)
        return Position(
            time_s, *_degrees(self.home, place), place.height_m, north_ms, east_ms, up_ms,
            max(math.hypot(north_ms - wind.north_ms, east_ms - wind.east_ms), SHORTEST_AIRSPEED_MS),
        )  # fmt: skip

    def flown(self, end_s: float) -> FlownRoute:
        """Return the rows of a log until `end_s` [s], one a second, with the mission and the wind."""
        rows = [self._row(k * ROW_PERIOD_S) for k in range(int(end_s / ROW_PERIOD_S) + 1)]
        return FlownRoute(self.home, self.mission, self.wind, rows, self.autopilot.is_px4)

    def _row(self, time_s: float) -> RouteRow:
        leg, is_landed = self._leg(time_s), not self.begins_s[0] <= time_s < self.lands_s
        last, own = self.mission.items[-1].seq, self.autopilot
        mode = own.hold if time_s < self.begins_s[0] else own.mission if leg.seq >= 0 else own.returning
        return RouteRow(self.position(time_s), leg.seq if leg.seq >= 0 else last, mode, is_landed)

    def _index(self, time_s: float) -> int:
        return max(bisect_right(self.begins_s, time_s) - 1, 0)

    def _leg(self, time_s: float) -> Leg:
        return self.legs[self._index(time_s)]


def route_flight(
    mission: Mission,
    home: Home,
    wind: Wind,
    take_off_s: float,
    settings: ReturnSettings | None = None,
    cruise_ms: float = NAN,
) -> RouteFlight:
    """Return the flight of a mission that takes off at `take_off_s` [s]. Raises UsageError for one without an end.

    settings : speeds and way home; by default those of the autopilot's parameters
    cruise_ms : speed on the route [m/s]; by default the autopilot's
    """
    mission = dataclasses.replace(mission, return_reason="")  # this one has no rally points
    own = ARDUCOPTER if mission.has_home_item else PX4
    own = own.at_cruise(cruise_ms) if math.isfinite(cruise_ms) else own
    settings = settings or return_settings(own.parameters, own.is_px4)
    way: Path = path(mission, home, settings)
    if way.reason or not way.lands:
        raise UsageError(f"--mission: {way.reason or 'it waits somewhere without end, and never lands'}")
    acceleration_ms2 = finite_or(settings.acceleration_ms2, ACCELERATION_MS2)
    motions = tuple(motion_of(leg, acceleration_ms2) for leg in way.legs)
    times_s = [motion.lasts_s + leg.hold_s for motion, leg in zip(motions, way.legs, strict=True)]
    begins_s = tuple(accumulate(times_s, initial=take_off_s))
    return RouteFlight(mission, home, wind, own, way.legs, motions, begins_s[:-1], begins_s[-1])


def _on_leg(leg: Leg, share: float) -> tuple[Point, tuple[float, float, float]]:
    """Return the place after a share of a leg, and the way along its direction there over the whole leg [m]."""
    if leg.circle_m > 0.0:
        here = on_circle(leg, share)
        along = leg.run_m / leg.circle_m
        return here, (-along * (here.east_m - leg.end.east_m), along * (here.north_m - leg.end.north_m), 0.0)
    place = Point(*(a + share * (b - a) for a, b in zip(leg.begin, leg.end, strict=True)))
    return place, (leg.end.north_m - leg.begin.north_m, leg.end.east_m - leg.begin.east_m, leg.rise_m)


def watts_of(hover_W: float) -> Watts:
    """Return the power of an unknown aircraft that asks `hover_W` [W] in hover."""
    powers = of_hover(hover_W)

    def watts(airspeed_ms: float, climb_ms: float, phase: Phase) -> float:
        columns = terms(airspeed_ms, climb_ms, phase is Phase.TAKE_OFF, phase is Phase.LANDING, powers.induced_ms)
        return float(power(powers, columns))

    return watts


def _degrees(home: Home, place: Point) -> tuple[float, float]:
    """Return latitude and longitude [deg] of a place in metres around home."""
    east_scale = METRES_PER_DEGREE * math.cos(math.radians(home.lat_deg))
    lon_deg = math.remainder(home.lon_deg + place.east_m / east_scale, 360.0)
    return home.lat_deg + place.north_m / METRES_PER_DEGREE, lon_deg
