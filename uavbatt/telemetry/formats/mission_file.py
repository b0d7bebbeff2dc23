"""Mission files: QGC WPL text (`.waypoints`) and QGroundControl's `.plan` (JSON).

`.waypoints`: a line `QGC WPL 110`, then one item a line, twelve columns:

    index current frame command param1 param2 param3 param4 latitude longitude height autocontinue

Ground stations upload the items in the order of the lines, whatever their index says; some write home as command 0.

`.plan`: `mission.items`, each a `SimpleItem` with `command`, `frame` and seven `params`, or a `ComplexItem`; surveys
and corridor scans hold the items they were made into (`TransectStyleComplexItem.Items`), other patterns do not.
The ground station puts home in front as item 0 for an ArduPilot, and not for a PX4; `doJumpId` names items for jumps.
It uploads `rallyPoints` with the mission, and the vehicle may then return to one of them.

Of a `.waypoints` file with home in front, some programs upload all items to a PX4, others leave home out. The number of
items that the PX4 says it holds tells which; without it the route is not known.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from uavbatt.errors import BadInput, misread
from uavbatt.files import read_bounded
from uavbatt.navigation import NAN, STATED_MS, Home, Mission, Navigation, ReturnSettings, is_stated_speed
from uavbatt.telemetry.route import commands
from uavbatt.telemetry.route.commands import Fields

KIND = "a mission file (QGC WPL `.waypoints`, or QGroundControl `.plan`)"
LARGEST_BYTES = 20_000_000
_WPL = "QGC WPL"
_COLUMNS = 12
_FIRMWARE_PX4 = 12
_GLOBAL = 0  # MAV_FRAME: height above sea


class PlannedFlight(NamedTuple):
    """A PlannedFlight holds a file's mission, and what it says of home and of the speed it was planned with [m/s].

    for_other : the missions that the other make of autopilot may hold, which counts items differently: without several
    it is the first, else that of the length which the autopilot tells; empty if the file does not tell
    """

    mission: Mission
    home: Home | None
    cruise_ms: float = NAN
    for_other: tuple[Mission, ...] = ()

    def mission_on(self, is_px4: bool, items_told: int = 0) -> Mission:
        """Return the mission with its items numbered as this autopilot (PX4 or ArduPilot) counts them.

        items_told : how many items the autopilot says that it holds; 0 is unknown. The mission has a reason if it is
        needed and fits none.
        """
        if not self.for_other or self.mission.has_home_item is not is_px4:
            return self.mission
        if len(self.for_other) == 1:
            return self.for_other[0]
        held = next((mission for mission in self.for_other if len(mission.items) == items_told), None)
        if held is not None:
            return held
        said = f"the autopilot says {items_told}" if items_told else "the autopilot does not say how many it holds"
        expected = " or ".join(str(len(mission.items)) for mission in self.for_other)
        reason = f"home is the first of the file's items, a PX4 holds {expected} of them, {said}: use a .plan"
        return dataclasses.replace(self.mission, reason=reason)

    def flown(self, known: Navigation) -> Navigation:
        """Return what is known of route and place with this mission."""
        mission = self.mission_on(known.settings.is_px4, known.items_told)
        return known.with_plan(mission, self.home, ReturnSettings(cruise_ms=self.cruise_ms))


class _Transects(msgspec.Struct):
    items: list[_Item] | None = msgspec.field(default=None, name="Items")


class _Item(msgspec.Struct):
    type: str = "SimpleItem"
    command: int = -1
    frame: int = -1
    params: list[float | None] = msgspec.field(default_factory=list)
    jump_id: int = msgspec.field(default=-1, name="doJumpId")
    pattern: str = msgspec.field(default="", name="complexItemType")
    transects: _Transects | None = msgspec.field(default=None, name="TransectStyleComplexItem")


class _PlannedMission(msgspec.Struct):
    items: list[_Item]
    firmware: int = msgspec.field(default=3, name="firmwareType")
    home: list[float | None] | None = msgspec.field(default=None, name="plannedHomePosition")
    hover_ms: float | None = msgspec.field(default=None, name="hoverSpeed")


class _RallyPoints(msgspec.Struct):
    points: list[Any] | None = None


class _Plan(msgspec.Struct):
    mission: _PlannedMission
    rally: _RallyPoints | None = msgspec.field(default=None, name="rallyPoints")


def read_mission(path: str | Path) -> PlannedFlight:
    """Read a mission file. Raises BadInput for a file that is none, or a mission that is not understood."""
    data = read_bounded(Path(path), LARGEST_BYTES, KIND)
    planned = _plan(path, data) if data.lstrip().startswith(b"{") else _waypoints(path, data)
    if planned.mission.reason:
        raise BadInput(path, "", f"a mission that is understood: {planned.mission.reason}")
    return planned


def _waypoints(path: str | Path, data: bytes) -> PlannedFlight:
    """Return the flight of a `.waypoints` file; it has no home if its first item is no waypoint."""
    lines = data.decode("utf-8", errors="replace").splitlines()
    if not lines or not lines[0].startswith(_WPL):
        raise BadInput(path, "", f"{KIND}, found a file of another kind")
    said = [
        _line(path, number, line)
        for number, line in enumerate(lines[1:], start=2)
        if line.strip() and not line.startswith("#")
    ]
    said = [one._replace(seq=seq) for seq, one in enumerate(said)]
    if said and said[0].command == 0:
        said[0] = said[0]._replace(command=commands.WAYPOINT)
    has_home = bool(said) and said[0].command == commands.WAYPOINT
    home = Home(said[0].lat_deg, said[0].lon_deg, _sea_m(said[0])) if has_home else None
    mission = _mission(path, said, has_home, is_px4=not has_home)
    place = home if home and (home.lat_deg or home.lon_deg) else None
    on_px4 = (_without_first(path, said), _mission(path, said, False, is_px4=True)) if has_home else ()
    return PlannedFlight(mission, place, for_other=on_px4)


def _without_first(path: str | Path, said: Sequence[Fields]) -> Mission:
    """Return the mission as a PX4 holds it if home, the first item, is left out; jumps keep their targets."""
    fields = [
        one._replace(seq=one.seq - 1, param1=one.param1 - 1.0 if one.command == commands.JUMP else one.param1)
        for one in said[1:]
    ]
    return _mission(path, fields, has_home_item=False, is_px4=True)


def _sea_m(fields: Fields) -> float:
    return fields.alt_m if fields.frame == _GLOBAL else NAN


def _line(path: str | Path, number: int, line: str) -> Fields:
    """Return one item: index, current, frame, command, four parameters, latitude, longitude, height, autocontinue."""
    columns = line.split()
    try:
        values = [float(column) for column in columns]
        seq, frame, command = (int(columns[k]) for k in (0, 2, 3))
    except (ValueError, IndexError):
        values = []
    if len(values) != _COLUMNS:
        raise BadInput(path, f"line {number}", f"{_COLUMNS} numbers, found `{line.strip()[:60]}`")
    return Fields(seq, frame, command, *values[4:8], *values[8:11])


def _plan(path: str | Path, data: bytes) -> PlannedFlight:
    try:
        plan = msgspec.json.decode(data, type=_Plan)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise misread(path, error, "a QGroundControl plan") from None
    said = plan.mission
    is_px4 = said.firmware == _FIRMWARE_PX4
    place = [NAN if v is None else v for v in said.home or ()]
    home = Home(place[0], place[1], place[2] if len(place) > 2 else NAN) if len(place) > 1 else None
    if said.hover_ms and not is_stated_speed(said.hover_ms):
        low_ms, high_ms = STATED_MS
        raise BadInput(path, "key mission.hoverSpeed", f"{low_ms:g} to {high_ms:g} m/s, found {said.hover_ms:g}")
    mission, for_other = (_uploaded(path, plan, home, is_px4, has_home) for has_home in (not is_px4, is_px4))
    return PlannedFlight(mission, home, said.hover_ms or NAN, (for_other,))


def _uploaded(path: str | Path, plan: _Plan, home: Home | None, is_px4: bool, has_home_item: bool) -> Mission:
    """Return the mission as the ground station uploads it, with home as item 0 or without it.

    is_px4 : the plan was made for a PX4, which reads some fields differently
    """
    first, flat = int(has_home_item), list(_flattened(path, plan.mission.items))
    seq_of = {item.jump_id: seq for seq, item in enumerate(flat, start=first)}
    fields = [_fields(path, seq, item, seq_of) for seq, item in enumerate(flat, start=first)]
    if has_home_item:
        at = home or Home(0.0, 0.0, 0.0)
        fields.insert(0, Fields(0, _GLOBAL, commands.WAYPOINT, 0.0, 0.0, 0.0, 0.0, at.lat_deg, at.lon_deg, at.alt_m))
    found = _mission(path, fields, has_home_item, is_px4)
    return dataclasses.replace(found, return_reason=_return_reason(plan.rally))


def _return_reason(rally: _RallyPoints | None) -> str:
    count = len(rally.points or ()) if rally is not None else 0
    return f"the plan has rally points ({count}): the vehicle may return to one of them" if count else ""


def _flattened(path: str | Path, items: Iterable[_Item]) -> Iterator[_Item]:
    """Yield the simple items of a plan in order; a pattern is replaced by the items made of it."""
    for item in items:
        if item.type == "SimpleItem":
            yield item
        elif item.transects is not None and item.transects.items:
            yield from _flattened(path, item.transects.items)
        else:
            name = item.pattern or item.type
            raise BadInput(path, "", f"simple items, surveys and corridors with their items, found `{name}`")


def _fields(path: str | Path, seq: int, item: _Item, seq_of: dict[int, int]) -> Fields:
    """Return the fields of one item; a jump names its target by `doJumpId`."""
    params = [NAN if v is None else float(v) for v in item.params]
    if len(params) != 7 or item.command < 0:
        raise BadInput(path, f"item {seq}", "a command with seven params")
    if item.command == commands.JUMP:
        params[0] = seq_of.get(int(params[0]), -1) if math.isfinite(params[0]) else NAN
    if commands.needs_height(item.command) and params[6] != params[6]:
        raise BadInput(path, f"item {seq}", "a height, found none")
    return Fields(seq, item.frame, item.command, *params[:4], *params[4:])


def _mission(path: str | Path, said: Sequence[Fields], has_home_item: bool, is_px4: bool) -> Mission:
    items = [commands.mission_item(fields, is_px4) for fields in said]
    return commands.mission(items, Path(path).name, has_home_item)
