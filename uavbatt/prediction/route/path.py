"""The way of a mission as legs in metres around home.

A leg ends at a point and may wait there. Its time at the planned speeds is the longer of two: its run at the ground
speed, and its rise at the climb or descent rate. A mission that is not understood gives a reason instead of legs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

from uavbatt.navigation import Action, Frame, Home, Mission, MissionItem, Position, ReturnSettings, SpeedKind, offset_m
from uavbatt.prediction.route.legs import Leg, LegsTable, Phase, Point, edge, left_at, legs_table
from uavbatt.prediction.route.way_home import LegSpeeds, finite_or, landing, return_reason, speeds_of, way_home

MOST_LEGS = 2000
ENDLESS_S = 1e6  # a loiter without end
SPLINE_LENGTHENS = 1.06
HIGHEST_M, FARTHEST_M = 10_000.0, 200_000.0
CIRCLE_RADIUS_M, CIRCLE_RATE_DEG_S, ACCELERATION_MS2 = 10.0, 20.0, 2.5  # ArduCopter's, where it does not state them
NEAR_M = 1.0  # a take-off so near its place does not fly there
PLACED_S = 3.0  # on the ground, while a payload is set down
MOVING_LOADS = (211, 42600)  # MAV_CMD_DO_GRIPPER, MAV_CMD_DO_WINCH
NO_LANDING = "the mission has no landing: flight home assumed"
STANDING = (Action.SPEED, Action.OTHER, Action.DELAY)  # on the ground these move nothing


@dataclass(frozen=True)
class Path:
    """Path holds the legs of a mission from its first item to touchdown, or the reason why there are none."""

    legs: tuple[Leg, ...] = ()
    reason: str = ""
    lands: bool = True  # False: it waits somewhere without end
    assumed: str = ""  # what the mission does not say, in words

    @cached_property
    def table(self) -> LegsTable:
        """Return the legs as columns."""
        return legs_table(self.legs)


def local(home: Home, lat_deg: float, lon_deg: float, height_m: float) -> Point:
    """Return a place as a point in metres around home."""
    return Point(*offset_m(home, lat_deg, lon_deg), height_m)


def place(home: Home, position: Position) -> Point:
    """Return where the aircraft is, in metres around home."""
    return local(home, position.lat_deg, position.lon_deg, position.height_m)


def path(mission: Mission, home: Home, settings: ReturnSettings) -> Path:
    """Return the whole way of a mission in the order in which it is flown, jumps and speed changes included.

    If it is not known, the path has a reason instead of legs. A mission that ends in the air is taken to fly home.
    """
    if mission.reason:
        return Path(reason=mission.reason)
    at, speeds, legs = Point(0.0, 0.0, 0.0), speeds_of(settings), list[Leg]()
    elsewhere = return_reason(mission, settings)
    flown = list(_flown(mission))
    for number, item in enumerate(flown, start=1):
        if item is None:
            return Path(reason=f"the mission flies more than {MOST_LEGS} items, jumps repeated")
        if item.action is Action.SPEED:
            speeds = _changed(speeds, item, settings)
            continue
        found = _legs(item, at, speeds, home, settings)
        if isinstance(found, str):
            return Path(reason=f"item {item.seq}: {found}")
        legs += found
        if legs and (item.action is Action.LAND or item.command in MOVING_LOADS):
            legs[-1] = legs[-1]._replace(moves_load=True)
        at = left_at(legs[-1]) if legs else at
        if item.action in (Action.LAND, Action.RETURN):
            later = [i for i in flown[number:] if i is None or i.action not in STANDING]
            if not _takes_off_again(item, later, settings):
                return _landed(item, later, legs, settings, elsewhere)
        if item.action is Action.LOITER_UNLIMITED:
            return Path(tuple(legs), lands=False)
    if not legs:
        return Path(reason="the mission goes nowhere")
    if elsewhere:
        return Path(reason=f"{elsewhere}, and the mission does not end with a landing")
    return replace(returned([*legs, *way_home(at, settings)], settings), assumed=NO_LANDING)


def returned(legs: list[Leg], settings: ReturnSettings) -> Path:
    """Return the whole way with the return at its end: one that ends in the air waits there for somebody to land it."""
    if not settings.return_final_m > 0.0:
        return Path(tuple(legs))
    aloft = list(legs)
    while aloft and aloft[-1].phase is Phase.LANDING:
        aloft.pop()
    if not aloft:
        return Path(reason="the mission goes nowhere")
    return Path((*aloft[:-1], aloft[-1]._replace(hold_s=ENDLESS_S)), lands=False)


def _takes_off_again(item: MissionItem, later: list[MissionItem | None], settings: ReturnSettings) -> bool:
    """Return True if an ArduCopter goes on after a landing: with a take-off, and only then."""
    following = later[0] if later else None
    takes_off = following is not None and following.action is Action.TAKEOFF
    return takes_off and item.action is Action.LAND and not settings.is_px4


def _landed(
    item: MissionItem, later: list[MissionItem | None], legs: list[Leg], settings: ReturnSettings, elsewhere: str
) -> Path:
    """Return the whole way that ends with a landing or a return, or why it is not known.

    later : the items after it that would move the vehicle; elsewhere : why the way home is not straight
    """
    if any(i is None or i.action is not Action.LAND for i in later):
        return Path(reason=f"the mission flies on after landing at item {item.seq}")
    if item.action is Action.LAND:
        return Path(tuple(legs))
    return Path(reason=elsewhere) if elsewhere else returned(legs, settings)


def _flown(mission: Mission) -> Iterator[MissionItem | None]:
    """Yield the items in the order in which they are flown; None for a mission without an end."""
    by_seq = {item.seq: index for index, item in enumerate(mission.items)}
    left = {item.seq: item.repeats for item in mission.items if item.action is Action.JUMP}
    index = 1 if mission.has_home_item and mission.items and mission.items[0].seq == 0 else 0
    for _ in range(MOST_LEGS):
        if index >= len(mission.items):
            return
        item = mission.items[index]
        index += 1
        if item.action is not Action.JUMP:
            yield item
        elif left[item.seq] != 0 and item.jump_to in by_seq:
            left[item.seq] -= 1
            index = by_seq[item.jump_to]
    yield None


def _changed(speeds: LegSpeeds, item: MissionItem, settings: ReturnSettings) -> LegSpeeds:
    """Return the speeds after an item that changes one; an item without a speed restores the vehicle's own."""
    kind = {SpeedKind.CLIMB: "climb_ms", SpeedKind.DESCENT: "descent_ms"}.get(item.speed_kind, "cruise_ms")
    return speeds._replace(**{kind: finite_or(item.speed_ms, getattr(speeds_of(settings), kind))})


def _legs(item: MissionItem, at: Point, speeds: LegSpeeds, home: Home, settings: ReturnSettings) -> list[Leg] | str:
    """Return the legs of one item, or the reason why they are not known."""
    if item.action is Action.UNKNOWN:
        return item.reason or f"command {item.command} is not understood"
    if item.action in (Action.OTHER, Action.JUMP):
        return []
    if item.action is Action.RETURN:
        return [leg._replace(seq=item.seq) for leg in way_home(at, settings)]
    if item.action is Action.DELAY:
        return [Leg(item.seq, Phase.ROUTE, at, at, 0.0, *speeds, max(item.hold_s, 0.0))]
    if item.action is Action.LAND:
        item = _at_height(item, at)
    to = _target(item, at, home)
    if isinstance(to, str):
        return to
    if item.action is Action.TAKEOFF:
        return _take_off(item, at, to, speeds, settings.is_px4)
    if item.action is Action.LOITER_TURNS and item.turns > 0.0:
        return _turns(item, at, to, speeds, settings)
    if item.action is Action.LOITER_TO_HEIGHT and not settings.is_px4:
        return _to_height(item, at, to, speeds)
    run_m = math.dist(at[:2], to[:2])
    if item.action is Action.SPLINE:
        run_m *= SPLINE_LENGTHENS
    legs = [Leg(item.seq, Phase.ROUTE, at, to, run_m, *speeds, max(item.hold_s, 0.0))]
    if item.action is Action.LOITER_UNLIMITED:
        legs[-1] = legs[-1]._replace(hold_s=ENDLESS_S)
    if item.action is Action.PLACE:
        return [*legs, *_placing(to, speeds, settings, item.seq)]
    return [*legs, *landing(to, settings, item.seq)] if item.action is Action.LAND else legs


def _to_height(item: MissionItem, at: Point, to: Point, speeds: LegSpeeds) -> list[Leg]:
    """Return the legs of an ArduCopter to a place, at the height that it has, and then up or down."""
    there = to._replace(height_m=at.height_m)
    run_m = math.dist(at[:2], to[:2])
    return [Leg(item.seq, Phase.ROUTE, at, there, run_m, *speeds), Leg(item.seq, Phase.ROUTE, there, to, 0.0, *speeds)]


def _placing(above: Point, speeds: LegSpeeds, settings: ReturnSettings, seq: int) -> list[Leg]:
    """Return the legs down to the ground, where a payload is set down, and up again."""
    fast, slow = (leg._replace(phase=Phase.ROUTE) for leg in landing(above, settings, seq))
    ground = slow._replace(hold_s=PLACED_S, moves_load=True)
    return [fast, ground, Leg(seq, Phase.ROUTE, ground.end, above, 0.0, *speeds)]


def _take_off(item: MissionItem, at: Point, to: Point, speeds: LegSpeeds, is_px4: bool) -> list[Leg]:
    """Return the legs of a take-off: straight up. A PX4 then flies to the item's place, an ArduCopter ignores it."""
    above = at._replace(height_m=to.height_m)
    legs, run_m = [Leg(item.seq, Phase.TAKE_OFF, at, above, 0.0, *speeds)], math.dist(at[:2], to[:2])
    if is_px4 and run_m > NEAR_M:
        legs.append(Leg(item.seq, Phase.ROUTE, above, to, run_m, *speeds))
    return legs


def _turns(item: MissionItem, at: Point, centre: Point, speeds: LegSpeeds, settings: ReturnSettings) -> list[Leg]:
    """Return the legs of turns: to the nearest point of the circle, and the circle; the centre is never flown to."""
    radius_m = abs(item.radius_m) or finite_or(settings.circle_radius_m, CIRCLE_RADIUS_M)
    begin, round_speeds = edge(centre, radius_m, at), speeds
    if not settings.is_px4:
        round_speeds = speeds._replace(cruise_ms=min(speeds.cruise_ms, _fastest_on_circle_ms(radius_m, settings)))
    length_m = 2.0 * math.pi * radius_m * item.turns
    return [
        Leg(item.seq, Phase.ROUTE, at, begin, math.dist(at[:2], begin[:2]), *speeds),
        Leg(item.seq, Phase.ROUTE, begin, centre, length_m, *round_speeds, circle_m=radius_m),
    ]


def _fastest_on_circle_ms(radius_m: float, settings: ReturnSettings) -> float:
    """Return ArduCopter's highest speed on a circle: that of its turn rate, and of half of its acceleration inwards."""
    turn_rad_s = math.radians(finite_or(abs(settings.circle_rate_deg_s), CIRCLE_RATE_DEG_S))
    inwards_ms2 = 0.5 * finite_or(settings.acceleration_ms2, ACCELERATION_MS2)
    return min(turn_rad_s * radius_m, math.sqrt(inwards_ms2 * radius_m))


def _at_height(item: MissionItem, at: Point) -> MissionItem:
    """Return the landing with the height where it begins: the vehicle flies to the place at that height."""
    return MissionItem(item.seq, item.action, item.lat_deg, item.lon_deg, at.height_m)


def _target(item: MissionItem, at: Point, home: Home) -> Point | str:
    """Return where an item ends, or why that is not known."""
    height_m = item.alt_m if math.isfinite(item.alt_m) else at.height_m
    if item.frame is Frame.TERRAIN:
        return "its height is above terrain that is not known"
    if item.frame is Frame.SEA and math.isfinite(item.alt_m):
        if not math.isfinite(home.alt_m):
            return "its height is above the sea, and that of home is not known"
        height_m = item.alt_m - home.alt_m
    to = Point(at.north_m, at.east_m, height_m)
    if math.isfinite(item.lat_deg) and math.isfinite(item.lon_deg):
        to = local(home, item.lat_deg, item.lon_deg, height_m)
    if math.hypot(to.north_m, to.east_m) > FARTHEST_M or abs(height_m) > HIGHEST_M:
        return f"it lies {math.hypot(to.north_m, to.east_m) / 1000.0:.0f} km away at {height_m:.0f} m"
    return to
