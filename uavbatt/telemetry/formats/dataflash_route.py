"""Records of route and place in ArduPilot's DataFlash logs, and their way to `Navigation`.

CMD   CTot,CNum,CId,Prm1..4,Lat,Lng,Alt,Frame   the whole mission at the log's start and after an upload, in order;
                                                one alone: this item is flown now (CNum 0 alone: a new home)
MISE  as CMD                                    this item is flown now (4.4 and later)
MODE  Mode,ModeNum                              numbers of ArduCopter's modes, in old text logs their names
ORGN  Type,Lat,Lng,Alt                          Type 1: home
POS   Lat,Lng,Alt,RelHomeAlt                    height above home (RelAlt in old logs)
GPS   Spd,GCrs,VZ                               speed over ground, course, speed downwards; old logs have no POS,
                                                but the height above home here (RelAlt)
XKF2, NKF2, EKF2  VWN,VWE                       wind of the EKF; C is its core, the first counts
EV    Id                                        18 landed, 28 no longer landed
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from uavbatt.navigation import Home, MissionItem, Mode, Navigation
from uavbatt.telemetry.columns import Column, Order, latest_before
from uavbatt.telemetry.formats.dataflash_rows import DataflashClock, Table
from uavbatt.telemetry.route.builder import POSITION_STEP_S, NavigationBuilder
from uavbatt.telemetry.route.commands import Fields, is_flown, mission, mission_item
from uavbatt.telemetry.route.events import Event, one_each, play
from uavbatt.telemetry.route.modes import copter_mode, copter_mode_named

OF_ROUTE = re.compile(r"(CMD|MISE|MODE|ORGN|POS|GPS|XKF2|NKF2|EKF2|EV)$")
SOURCE = "log"
_WIND = re.compile(r"(XKF2|NKF2|EKF2)$")
_HOME_TYPE, _LANDED, _NOT_LANDED, _FIX_3D = 1, 18, 28, 3
_WIND_STEP_S, _GPS_AGE_S = 1.0, 1.0
_NO_FRAME = -1
PlacedEvent = tuple[int, Event]  # place in the log, event


def navigation(
    tables: Sequence[Table], clock: DataflashClock, firmware: str, parameters: Sequence[tuple[float, str, float]]
) -> tuple[Navigation, ...]:
    """Return what a DataFlash log tells of route and place.

    tables : records of the names that OF_ROUTE matches; parameters : (time [s], name, value), ascending
    firmware : as the log names it; modes are told only of a copter
    """
    builder = NavigationBuilder(keeps_all=True)
    fixes = [t for t in tables if t.layout.name == "GPS"]
    places = [t for t in tables if t.layout.name == "POS"] or [t for t in fixes if "RelAlt" in t.numbers]
    mission_records = _Mission(builder)
    events: list[PlacedEvent] = []
    for table in tables:
        name, time_s = table.layout.name, clock.times_s(table)
        if name in ("CMD", "MISE"):
            events += _commands(table, time_s, mission_records)
        elif name != "MODE" or "copter" in firmware.lower():
            events += _others(table, time_s, builder)
    for table in places:
        events += _positions(table, clock.times_s(table), fixes, clock, builder)
    events.sort(key=lambda one: one[0])
    play((event for _, event in events), parameters, builder)
    return builder.timeline()


def _others(table: Table, time_s: Column, builder: NavigationBuilder) -> Iterator[PlacedEvent]:
    """Yield modes, homes, winds, and whether the aircraft has landed."""
    name = table.layout.name
    if name == "MODE":
        for (place, at_s), mode in zip(_rows(table, time_s), _modes(table), strict=True):
            yield place, (at_s, builder.mode, (mode,))
    elif name == "ORGN":
        for place, at_s, kind, lat_deg, lon_deg, alt_m in _rows(table, time_s, "Type", "Lat", "Lng", "Alt"):
            if kind == _HOME_TYPE:
                yield place, (at_s, builder.home, (Home(lat_deg, lon_deg, alt_m),))
    elif name == "EV":
        for place, at_s, event in _rows(table, time_s, "Id"):
            if event in (_LANDED, _NOT_LANDED):
                yield place, (at_s, builder.landed, (event == _LANDED,))
    elif _WIND.match(name):
        yield from _winds(table, time_s, builder)


def _rows(table: Table, time_s: Column, *labels: str) -> Iterator[tuple[Any, ...]]:
    """Yield the place, the time [s] and the named values of each record."""
    return zip(table.order.tolist(), time_s.tolist(), *(table.column(label).tolist() for label in labels), strict=True)


class _Mission:
    """_Mission puts the mission together from CMD records, one by one."""

    def __init__(self, builder: NavigationBuilder) -> None:
        self._builder = builder
        self._items: list[MissionItem] = []  # items of a list that is being written

    def command(self, time_s: float, total: int, fields: Fields) -> None:
        """Take a CMD: the next of a list, the first of one, or the item that is flown now."""
        item = mission_item(fields)
        if fields.seq == len(self._items) and fields.seq < total:
            self._items.append(item)
            if len(self._items) == total:
                read = mission(self._items, SOURCE)
                self._builder.mission(time_s, read)
                self._builder.home_of(time_s, read)
                self._items = []
            return
        self._items = [item] if fields.seq == 0 and total > 1 else []
        if fields.seq:
            self.flown(time_s, item)

    def flown(self, time_s: float, item: MissionItem) -> None:
        """Take the item that is flown now; another one than was told makes the mission that was told wrong."""
        known = self._builder.held
        if known is not None and not known.reason and repr(item) not in map(repr, known.items[item.seq : item.seq + 1]):
            reason = f"the autopilot flies another item {item.seq} than the log told before"
            self._builder.mission(time_s, replace(known, reason=reason))
        if is_flown(item.command):
            self._builder.current(time_s, item.seq)


def _commands(table: Table, time_s: Column, takes: _Mission) -> Iterator[PlacedEvent]:
    """Yield the items of CMD and MISE records; an item without a frame in the log has an unknown one."""
    labels = ("CTot", "CNum", "CId", "Prm1", "Prm2", "Prm3", "Prm4", "Lat", "Lng", "Alt", "Frame")
    for place, at_s, total, seq, command, *parameters_and_place, frame in _rows(table, time_s, *labels):
        if math.isnan(total + seq + command):
            continue
        fields = Fields(int(seq), _NO_FRAME if math.isnan(frame) else int(frame), int(command), *parameters_and_place)
        if table.layout.name == "MISE":
            yield place, (at_s, takes.flown, (mission_item(fields),))
        else:
            yield place, (at_s, takes.command, (int(total), fields))


def _modes(table: Table) -> list[Mode]:
    for label in ("ModeNum", "Mode"):
        if label in table.numbers:
            return [copter_mode(int(n)) if n == n else Mode.UNKNOWN for n in table.column(label).tolist()]
    return [copter_mode_named(text) for text in table.texts.get("Mode", [""] * len(table.order))]


def _positions(
    table: Table, time_s: Column, fixes: Sequence[Table], clock: DataflashClock, builder: NavigationBuilder
) -> Iterator[PlacedEvent]:
    """Yield the positions of POS with the velocity of the last fix; the same item is still flown at each."""
    height = next((label for label in ("RelHomeAlt", "RelAlt") if label in table.numbers), "RelHomeAlt")
    chosen = one_each(time_s, POSITION_STEP_S)
    order, at_s = table.order[chosen], time_s[chosen]
    columns = [table.column(label)[chosen] for label in ("Lat", "Lng", height)]
    columns += _velocities(order, at_s, fixes, clock)
    for place, when_s, *said in zip(order.tolist(), at_s.tolist(), *(c.tolist() for c in columns), strict=True):
        yield place, (when_s, builder.position, tuple(said))
        yield place, (when_s, builder.still_current, ())


def _velocities(order: Order, at_s: Column, fixes: Sequence[Table], clock: DataflashClock) -> list[Column]:
    """Return the velocity north, east and up [m/s] by the last fix before each place; NaN if that is old."""
    found = [np.full(len(order), np.nan) for _ in range(3)]
    for fix in fixes:
        if not len(fix.order):
            continue
        last = latest_before(order, fix.order)
        has_fix = (last >= 0) & (fix.column("Status")[last] >= _FIX_3D)
        has_fix &= np.abs(at_s - clock.times_s(fix)[last]) <= _GPS_AGE_S
        speed_ms, course_rad = fix.column("Spd")[last], np.radians(fix.column("GCrs")[last])
        said = (speed_ms * np.cos(course_rad), speed_ms * np.sin(course_rad), -fix.column("VZ")[last])
        found = [np.where(has_fix, new, old) for new, old in zip(said, found, strict=True)]
    return found


def _winds(table: Table, time_s: Column, builder: NavigationBuilder) -> Iterator[PlacedEvent]:
    is_first = table.column("C") == 0 if "C" in table.numbers else np.ones(len(time_s), np.bool_)
    own = np.flatnonzero(is_first)
    chosen = own[one_each(time_s[own], _WIND_STEP_S)] if len(own) else own
    columns = (table.column(label)[chosen].tolist() for label in ("VWN", "VWE"))
    for place, at_s, north_ms, east_ms in zip(table.order[chosen].tolist(), time_s[chosen].tolist(), *columns,
                                              strict=True):  # fmt: skip
        yield place, (at_s, builder.wind, (north_ms, east_ms))
