"""Navigation values: where the aircraft is, what its autopilot will fly, and how it comes home (frozen, SI).

Heights are metres above home unless the name says otherwise; velocities are over ground, north, east and up.
Unknown is NaN (or None). The package `telemetry` converts the units, sentinels and altitude frames of the wire; each
altitude counts from one of the levels in `Frame`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from functools import lru_cache

from uavbatt.nan_equal import nan_equal

NAN = math.nan
FRESH_S = 5.0  # an older position is not used
METRES_PER_DEGREE = 111_194.9  # on a sphere with a radius of 6371 km
FARTHEST_HOME_M = 100_000.0  # a home that is farther away is a fault
# What is stated of a multirotor lies within these: other speeds, heights and waits are mistakes.
STATED_MS, HIGHEST_STATED_M, LONGEST_STATED_S = (0.01, 100.0), 20_000.0, 86_400.0
ALOFT_M, ALOFT_MS = 5.0, 5.0  # so high or so fast an armed aircraft is in the air


class Mode(StrEnum):
    """Mode names the ways in which the autopilot flies, as far as the load to come depends on them."""

    MISSION = "mission"  # AUTO
    RETURN = "return"  # RTL
    RETURN_BY_TRACK = "return_by_track"  # SMART_RTL
    LAND = "land"
    TAKEOFF = "takeoff"
    HOLD = "hold"  # loiter, brake, hold
    MANUAL = "manual"  # a pilot or another computer flies: the route says nothing
    UNKNOWN = "unknown"


class Action(StrEnum):
    """Action names the things that a mission item asks for."""

    TAKEOFF = "takeoff"
    WAYPOINT = "waypoint"
    SPLINE = "spline"
    LOITER_TIME = "loiter_time"  # hold_s
    LOITER_TURNS = "loiter_turns"  # turns, radius_m
    LOITER_UNLIMITED = "loiter_unlimited"
    LOITER_TO_HEIGHT = "loiter_to_height"
    LAND = "land"
    PLACE = "place"  # descends, sets a payload down, and climbs again
    RETURN = "return"
    SPEED = "speed"  # speed_ms, speed_kind
    JUMP = "jump"  # jump_to, repeats
    DELAY = "delay"  # hold_s
    OTHER = "other"  # moves nothing and takes no time (camera, servo, region of interest)
    UNKNOWN = "unknown"  # moves the aircraft in a way that is not modelled: the route is unknown, `reason` says why


class Frame(StrEnum):
    """Frame names the level from which an altitude counts."""

    HOME = "home"
    SEA = "sea"
    TERRAIN = "terrain"


class SpeedKind(StrEnum):
    """SpeedKind names the speed that a SPEED item changes."""

    GROUND = "ground"
    AIR = "air"
    CLIMB = "climb"
    DESCENT = "descent"


LANDINGS = (Action.LAND, Action.UNKNOWN)
LAND_STARTS = (189,)  # MAV_CMD_DO_LAND_START


@nan_equal
@dataclass(frozen=True, slots=True)
class MissionItem:
    """MissionItem is one item of a mission, in the autopilot's own numbering (ArduPilot: item 0 is home, kept)."""

    seq: int
    action: Action
    lat_deg: float = NAN  # NaN: where the aircraft is
    lon_deg: float = NAN
    alt_m: float = NAN  # in `frame`; NaN: as it is
    frame: Frame = Frame.HOME
    hold_s: float = 0.0
    turns: float = 0.0
    radius_m: float = 0.0
    speed_ms: float = NAN  # for SPEED; NaN: the vehicle's own speed again
    speed_kind: SpeedKind = SpeedKind.GROUND
    jump_to: int = -1
    repeats: int = 0  # for a jump; -1 is without end
    command: int = 0  # MAV_CMD, for words
    reason: str = ""  # why it is UNKNOWN


@nan_equal
@dataclass(frozen=True, slots=True)
class Mission:
    """Mission holds a whole mission; `reason` is empty or says why it is not understood."""

    items: tuple[MissionItem, ...]
    source: str = ""  # "link", "log" or the file's name
    reason: str = ""
    has_home_item: bool = True  # ArduPilot: item 0 is home and is never flown to; PX4: item 0 is the first that is
    return_reason: str = ""  # why the way home is not straight, if what came with the mission says so (rally points)

    @property
    def lands(self) -> bool:
        """Return True if the mission lands by itself, or may: an item is not understood."""
        return bool(self.reason) or any(item.action in LANDINGS or item.command in LAND_STARTS for item in self.items)


@nan_equal
@dataclass(frozen=True, slots=True)
class Home:
    """Home is the place that the autopilot returns to; alt_m is above sea."""

    lat_deg: float
    lon_deg: float
    alt_m: float = NAN
    is_of_mission: bool = False  # item 0 of an ArduPilot's mission said so, no HOME_POSITION


@nan_equal
@dataclass(frozen=True, slots=True)
class ReturnSettings:
    """ReturnSettings holds speeds and way home by the vehicle's parameters; NaN if a parameter is not known."""

    cruise_ms: float = NAN
    climb_ms: float = NAN
    descent_ms: float = NAN
    return_height_m: float = NAN  # RTL_ALT: climbs to it first; 0 = stays at its height
    return_ms: float = NAN  # NaN: cruise
    return_hold_s: float = NAN  # waits above home
    return_final_m: float = NAN  # height above home at the end; 0 lands
    land_ms: float = NAN
    land_slow_below_m: float = NAN
    land_fast_ms: float = NAN  # from above home down to land_slow_below_m; NaN: descent_ms
    return_climb_min_m: float = NAN  # climbs at least so much before it returns (RTL_CLIMB_MIN)
    return_cone_slope: float = NAN  # climbs no higher than so many metres a metre of distance home; 0 or NaN: no cone
    return_cone_within_m: float = NAN  # the cone counts only so near home; NaN: everywhere
    circle_radius_m: float = NAN  # of turns whose item has no radius (CIRCLE_RADIUS)
    circle_rate_deg_s: float = NAN  # fastest turn on a circle, negative anticlockwise (CIRCLE_RATE)
    acceleration_ms2: float = NAN  # on the route (WPNAV_ACCEL)
    seen_ms: float = NAN  # the speed that it keeps on its route, for a vehicle that does not state its cruise
    return_reason: str = ""  # why the way home is not straight, if it is not (rally points)
    landing_reason: str = ""  # why it is not, if the mission lands by itself: the vehicle may fly to that landing
    is_px4: bool = False  # what is not known is PX4's default, else ArduCopter's


UNSTATED = ReturnSettings()


@lru_cache(maxsize=8)  # each row of a flight asks for the same one
def completed(stated: ReturnSettings, usual: ReturnSettings) -> ReturnSettings:
    """Return the settings that a vehicle states, with the `usual` speeds and heights where it states none."""
    values = ((field.name, getattr(stated, field.name)) for field in fields(stated))
    unknown = [name for name, value in values if isinstance(value, float) and math.isnan(value)]
    return replace(stated, **{name: getattr(usual, name) for name in unknown})


@nan_equal
@dataclass(frozen=True, slots=True)
class Position:
    """Position holds place and velocity of the aircraft at one instant."""

    time_s: float
    lat_deg: float
    lon_deg: float
    height_m: float  # above home
    north_ms: float = NAN
    east_ms: float = NAN
    up_ms: float = NAN
    airspeed_ms: float = NAN


def is_stated_speed(speed_ms: float) -> bool:
    """Return True if somebody may state this speed [m/s] of a multirotor."""
    return STATED_MS[0] <= speed_ms <= STATED_MS[1]


def offset_m(place: Home | Position, lat_deg: float, lon_deg: float) -> tuple[float, float]:
    """Return how far north and east of a place another one lies [m]."""
    east_deg = math.remainder(lon_deg - place.lon_deg, 360.0)  # the short way round, also across 180°
    east_m = east_deg * METRES_PER_DEGREE * math.cos(math.radians(place.lat_deg))
    return (lat_deg - place.lat_deg) * METRES_PER_DEGREE, east_m


@nan_equal
@dataclass(frozen=True, slots=True)
class Wind:
    """Wind is the wind as the autopilot estimates it: the velocity of the air, not where it comes from."""

    north_ms: float
    east_ms: float
    sd_ms: float = NAN


@nan_equal
@dataclass(frozen=True, slots=True)
class Navigation:
    """Navigation holds all that is known of route and place at one instant; fields change by replacement."""

    time_s: float = NAN  # of the last change of anything in it
    mode: Mode = Mode.UNKNOWN
    mode_since_s: float = NAN
    mission: Mission | None = None
    mission_since_s: float = NAN
    items_told: int = 0  # how many items the autopilot says that its mission has; 0 is unknown
    current: int | None = None  # seq of the item that is flown to (MISSION_CURRENT)
    current_since_s: float = NAN  # time since which it is this item
    current_heard_s: float = NAN  # last time that the autopilot said so: silence makes progress stale
    reached: int | None = None  # last MISSION_ITEM_REACHED
    home: Home | None = None
    settings: ReturnSettings = UNSTATED
    position: Position | None = None
    wind: Wind | None = None
    landed: bool | None = None  # EXTENDED_SYS_STATE
    transferring: bool = False  # a mission is being transferred and is not complete yet

    def with_plan(self, mission: Mission, home: Home | None, usual: ReturnSettings) -> Navigation:
        """Return the same with a mission from a file, which has priority.

        The file's home and its `usual` speeds count where the vehicle states none.
        """
        settings = completed(self.settings, usual)
        return replace(self, mission=mission, home=self.home or home, settings=settings, transferring=False)

    def with_usual(self, usual: ReturnSettings) -> Navigation:
        """Return the same with the `usual` speeds and heights of the vehicle where it states none."""
        return replace(self, settings=completed(self.settings, usual))

    @property
    def has_way(self) -> bool:
        """Return True if a mission or a home is known, without which there is no forecast of a route."""
        return self.mission is not None or self.home is not None

    def is_aloft(self, time_s: float) -> bool | None:
        """Return True if the autopilot says that it flies, or if its position of the last seconds is high or fast.

        False if the autopilot says that it is on the ground, None if it is not known.
        """
        at = self.position
        if self.landed is not None:
            return not self.landed
        if at is None or not abs(time_s - at.time_s) <= FRESH_S:
            return None
        return True if at.height_m > ALOFT_M or math.hypot(at.north_ms, at.east_ms) > ALOFT_MS else None


NOWHERE = Navigation()
