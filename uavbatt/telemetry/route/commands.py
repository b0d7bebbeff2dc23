"""Mission items as MAVLink spells them (MAV_CMD, MAV_FRAME, seven parameters) -> `MissionItem`, and items -> `Mission`.

For ArduPilot latitude and longitude 0 of an item mean "where the aircraft is", and height 0 means "unchanged"; PX4 uses
NaN for both. An item is UNKNOWN if its command moves the aircraft in a way that is not modelled here, or if a field is
impossible. One such item makes the route unknown: a wrong route is worse than none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from uavbatt.navigation import (
    HIGHEST_STATED_M,
    LONGEST_STATED_S,
    NAN,
    Action,
    Frame,
    Mission,
    MissionItem,
    SpeedKind,
    is_stated_speed,
)

WAYPOINT, LOITER_UNLIMITED, LOITER_TURNS, LOITER_TIME, RETURN, LAND, TAKEOFF = 16, 17, 18, 19, 20, 21, 22
LOITER_TO_HEIGHT, SPLINE, DELAY, PLACE, JUMP, SPEED = 31, 82, 93, 94, 177, 178
_PARACHUTE, _PARACHUTE_RELEASE = 208, 2
_LAST_NAVIGATION_COMMAND = 95  # MAV_CMD_NAV_LAST: up to here an item is flown to, or waited at
FRAMES = {0: Frame.SEA, 5: Frame.SEA, 3: Frame.HOME, 6: Frame.HOME, 10: Frame.TERRAIN, 11: Frame.TERRAIN}
SPEED_KINDS = {0: SpeedKind.AIR, 1: SpeedKind.GROUND, 2: SpeedKind.CLIMB, 3: SpeedKind.DESCENT}
_AT_A_PLACE = {
    WAYPOINT: Action.WAYPOINT, SPLINE: Action.SPLINE, LOITER_UNLIMITED: Action.LOITER_UNLIMITED,
    LOITER_TURNS: Action.LOITER_TURNS, LOITER_TIME: Action.LOITER_TIME, LAND: Action.LAND, TAKEOFF: Action.TAKEOFF,
    LOITER_TO_HEIGHT: Action.LOITER_TO_HEIGHT, PLACE: Action.PLACE,
}  # fmt: skip
_MOST_TURNS = 10_000.0

# Camera, gimbal, servo, fence, tags and conditions of such items: they move nothing and take no time.
_HARMLESS = frozenset(
    (80, 112, 114, 115, 181, 182, 183, 184, 187, 188, 189, 195, 196, 197, 198, 200, 201, 202, 203, 204, 205, 206, 207,
     _PARACHUTE, 211, 212, 214, 215, 216, 217, 220, 530, 531, 532, 533, 534, 600, 1000, 1001, 2000, 2001, 2003, 2500,
     2501, 42600)
)  # fmt: skip
_NAMES = {
    24: "a local take-off", 23: "a local landing", 25: "following", 30: "a change of height",
    34: "an orbit", 36: "an arc", 83: "waiting for a height", 84: "a VTOL take-off", 85: "a VTOL landing",
    92: "guidance by another computer", 113: "a change of height", 176: "a change of mode",
    179: "a new home", 186: "a change of height", 190: "a landing at a rally point", 191: "going around",
    192: "a new place", 193: "a pause", 601: "a jump to a tag", 3000: "a VTOL transition", 42702: "a script",
}  # fmt: skip


class Fields(NamedTuple):
    """Fields holds one item as sent: degrees and metres, NaN for a field that is not set."""

    seq: int
    frame: int  # MAV_FRAME; -1: it is not said
    command: int  # MAV_CMD
    param1: float
    param2: float
    param3: float
    param4: float
    lat_deg: float
    lon_deg: float
    alt_m: float


def is_flown(command: int) -> bool:
    """Return True if an item of this command can be the current one: the vehicle flies to it or waits at it."""
    return command <= _LAST_NAVIGATION_COMMAND


def needs_height(command: int) -> bool:
    """Return True if an item of this command has a height of its own."""
    return command in _AT_A_PLACE and command != LAND


def mission_item(fields: Fields, is_px4: bool = False) -> MissionItem:
    """Return the mission item of these fields; UNKNOWN with a reason if it is not understood."""
    if fields.command in _AT_A_PLACE:
        return _at_a_place(fields, is_px4)
    read = _WITHOUT_PLACE.get(fields.command)
    if read is not None:
        return read(fields)
    is_release = fields.command == _PARACHUTE and fields.param1 == _PARACHUTE_RELEASE
    if fields.command in _HARMLESS and not is_release:
        return MissionItem(fields.seq, Action.OTHER, command=fields.command)
    name = _NAMES.get(fields.command, "what this does")
    return _unknown(fields, f"{name} is not understood (command {fields.command})")


def item_fields(item: MissionItem) -> Fields:
    """Return the fields of an item as ArduPilot sends it: the inverse of `mission_item` for items that are
    understood."""
    param1 = {Action.LOITER_TURNS: item.turns, Action.SPEED: _number_of(item.speed_kind), Action.JUMP: item.jump_to}
    param2 = {Action.SPEED: item.speed_ms if item.speed_ms > 0.0 else -2.0, Action.JUMP: item.repeats}
    lat_deg, lon_deg, alt_m = (0.0 if v != v else v for v in (item.lat_deg, item.lon_deg, item.alt_m))
    frame = next(number for number in (0, 3, 10) if FRAMES[number] is item.frame)
    return Fields(
        item.seq, frame, item.command, float(param1.get(item.action, item.hold_s)), float(param2.get(item.action, 0.0)),
        item.radius_m, 0.0, lat_deg, lon_deg, alt_m,
    )  # fmt: skip


def _number_of(kind: SpeedKind) -> int:
    return next(number for number, known in SPEED_KINDS.items() if known is kind)


def mission(items: Sequence[MissionItem], source: str, has_home_item: bool = True) -> Mission:
    """Return the mission of these items, in order; its `reason` says why it is not understood, if so."""
    return Mission(tuple(items), source, _reason(items, has_home_item), has_home_item)


def _reason(items: Sequence[MissionItem], has_home_item: bool) -> str:
    flown = items[1:] if has_home_item else items
    if not flown:
        return "the mission has no items"
    gap = next((at for at, item in enumerate(items) if item.seq != at), None)
    if gap is not None:
        return f"item {gap} of the mission is missing"
    for item in flown:
        if item.action is Action.UNKNOWN:
            return f"item {item.seq}: {item.reason}"
        if item.action is Action.JUMP and not 0 < item.jump_to + (not has_home_item) <= len(flown):
            return f"item {item.seq}: jumps to item {item.jump_to} of {len(items)}"
    return ""


def _unknown(fields: Fields, reason: str) -> MissionItem:
    return MissionItem(fields.seq, Action.UNKNOWN, command=fields.command, reason=reason)


def _at_a_place(fields: Fields, is_px4: bool) -> MissionItem:
    """Return the item of a waypoint, with its place."""
    lat_deg, lon_deg, alt_m = fields.lat_deg, fields.lon_deg, fields.alt_m
    if lat_deg == 0.0 and lon_deg == 0.0:
        lat_deg = lon_deg = NAN
    elif not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0) and not (
        lat_deg != lat_deg and lon_deg != lon_deg and fields.command != WAYPOINT
    ):
        return _unknown(fields, f"no place is at latitude {lat_deg:g}, longitude {lon_deg:g}")
    action, frame = _AT_A_PLACE[fields.command], FRAMES.get(fields.frame)
    if action is Action.LAND or (alt_m == 0.0 and not is_px4 and action is not Action.TAKEOFF):
        alt_m = NAN
    if abs(alt_m) > HIGHEST_STATED_M:
        return _unknown(fields, f"a height of {alt_m:g} m")
    if alt_m == alt_m and frame is None:
        said = f"height in frame {fields.frame}" if fields.frame >= 0 else "height without a frame"
        return _unknown(fields, f"{said} is not understood")
    return _stay(fields, MissionItem(
        fields.seq, action, lat_deg, lon_deg, alt_m, frame or Frame.HOME, command=fields.command
    ))  # fmt: skip


def _stay(fields: Fields, item: MissionItem) -> MissionItem:
    """Return the item with the time or the turns for which the vehicle stays."""
    if item.action is Action.LOITER_TURNS:
        if not 0.0 <= fields.param1 <= _MOST_TURNS:
            return _unknown(fields, f"{fields.param1:g} turns")
        return replace(item, turns=fields.param1, radius_m=_radius_m(fields.param3))
    if item.action is Action.LOITER_UNLIMITED:
        return replace(item, radius_m=_radius_m(fields.param3))
    may_be_open = item.action in (Action.WAYPOINT, Action.SPLINE) and fields.param1 != fields.param1
    if may_be_open or item.action in (Action.TAKEOFF, Action.LAND, Action.PLACE, Action.LOITER_TO_HEIGHT):
        return item
    if not 0.0 <= fields.param1 <= LONGEST_STATED_S:
        return _unknown(fields, f"a stay of {fields.param1:g} s")
    return replace(item, hold_s=fields.param1)


def _radius_m(said: float) -> float:
    """Return the radius of a circle [m]; the sign (direction) is dropped, 0 is the autopilot's default."""
    return abs(said) if math.isfinite(said) else 0.0


def _speed(fields: Fields) -> MissionItem:
    """Return the item of DO_CHANGE_SPEED: a speed of -1 changes nothing, -2 is the vehicle's own speed again."""
    kind = SPEED_KINDS.get(int(fields.param1)) if math.isfinite(fields.param1) else None
    if kind is None or (fields.param2 > 0.0 and not is_stated_speed(fields.param2)):
        return _unknown(fields, f"a speed of {fields.param2:g} m/s of kind {fields.param1:g}")
    if fields.param2 > 0.0 or fields.param2 == -2.0:
        speed_ms = fields.param2 if fields.param2 > 0.0 else NAN
        return MissionItem(fields.seq, Action.SPEED, speed_ms=speed_ms, speed_kind=kind, command=fields.command)
    return MissionItem(fields.seq, Action.OTHER, command=fields.command)


def _jump(fields: Fields) -> MissionItem:
    """Return the item of DO_JUMP: its target, and how often (-1: without end)."""
    if not (math.isfinite(fields.param1) and math.isfinite(fields.param2)) or fields.param1 < 0.0:
        return _unknown(fields, f"a jump to item {fields.param1:g}, {fields.param2:g} times")
    repeats = max(int(fields.param2), -1)
    return MissionItem(fields.seq, Action.JUMP, jump_to=int(fields.param1), repeats=repeats, command=fields.command)


def _delay(fields: Fields) -> MissionItem:
    """Return the item of NAV_DELAY in seconds; -1 seconds mean a time of day, which is not understood."""
    if not 0.0 <= fields.param1 <= LONGEST_STATED_S:
        return _unknown(fields, "waiting for a time of day is not understood")
    return MissionItem(fields.seq, Action.DELAY, hold_s=fields.param1, command=fields.command)


def _return(fields: Fields) -> MissionItem:
    return MissionItem(fields.seq, Action.RETURN, command=fields.command)


_WITHOUT_PLACE: dict[int, Callable[[Fields], MissionItem]] = {
    SPEED: _speed, JUMP: _jump, DELAY: _delay, RETURN: _return,
}  # fmt: skip
