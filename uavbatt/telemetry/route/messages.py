"""Decoded MAVLink messages -> `NavigationBuilder`, for telemetry logs and for the live link.

A message is anything with the attributes of the MAVLink XML: pymavlink's own, or a light tuple of a fast reader.
ArduPilot and PX4 read some items differently, and only ArduPilot's item 0 is its home. So a mission that comes before
the first heartbeat, which names the make, is not understood until then.
Scales: 1e-7 deg, mm, cm/s; `relative_alt` counts from home, `vz` downwards, WIND.direction is where it comes from.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from uavbatt.mavlink.fields import AUTOPILOT_PX4
from uavbatt.navigation import NAN, Home, Mission, Navigation
from uavbatt.telemetry.route.builder import NavigationBuilder
from uavbatt.telemetry.route.commands import Fields, mission_item
from uavbatt.telemetry.route.modes import mode_of
from uavbatt.telemetry.route.transfer import ACCEPTED, Transfer

HEARTBEAT, GLOBAL_POSITION_INT, VFR_HUD, WIND, WIND_COV, HOME_POSITION = 0, 33, 74, 168, 231, 242
MISSION_WRITE_PARTIAL_LIST, MISSION_ITEM, MISSION_REQUEST, MISSION_CURRENT, MISSION_REQUEST_LIST = 38, 39, 40, 42, 43
MISSION_COUNT, MISSION_CLEAR_ALL, MISSION_ITEM_REACHED, MISSION_ACK, MISSION_REQUEST_INT = 44, 45, 46, 47, 51
MISSION_ITEM_INT, EXTENDED_SYS_STATE = 73, 245
OF_AUTOPILOT = frozenset(
    (GLOBAL_POSITION_INT, VFR_HUD, WIND, WIND_COV, HOME_POSITION, MISSION_CURRENT, MISSION_ITEM_REACHED, MISSION_COUNT,
     MISSION_ITEM, MISSION_ITEM_INT, MISSION_ACK, MISSION_REQUEST, MISSION_REQUEST_INT, EXTENDED_SYS_STATE)
)  # fmt: skip
"""Messages of the autopilot that are taken, beside its HEARTBEAT."""
OF_OTHERS = frozenset((MISSION_COUNT, MISSION_ITEM, MISSION_ITEM_INT, MISSION_CLEAR_ALL, MISSION_WRITE_PARTIAL_LIST))
"""Messages of other stations to the autopilot that are taken."""
_TO_SOMEBODY = frozenset(
    (MISSION_COUNT, MISSION_ITEM, MISSION_ITEM_INT, MISSION_ACK, MISSION_REQUEST, MISSION_REQUEST_INT)
)
_OF_MISSIONS = OF_OTHERS | {MISSION_ACK}

SOURCE = "link"
MOST_EARLY = 6000  # messages of missions before the first heartbeat; a mission has 5000 items at most
NO_MAKE = "the make of the autopilot is not known before its first heartbeat"
_E7 = 1e7
_UNKNOWN_INT = 0x7FFFFFFF
_MISSION, _RALLY, _ALL = 0, 2, 255  # MAV_MISSION_TYPE; fences and rally points travel by the same messages
_ON_GROUND, _UNDEFINED = 1, 0
_NO_TOTAL = (0, 0xFFFF)


class NavigationListener:
    """NavigationListener takes messages of one autopilot and messages of others to it; it gives route and place.

    own : system and component by which this process asks for the mission itself, if it does
    """

    def __init__(self, keeps_all: bool = False, own: tuple[int, int] | None = None) -> None:
        self.builder = NavigationBuilder(keeps_all)
        self.transfer = Transfer()
        self._own = own
        self._is_outdated = False
        self._is_px4: bool | None = None  # until the first heartbeat
        self._early: deque[Callable[[], None]] = deque(maxlen=MOST_EARLY)  # read again at the first heartbeat
        self._mission_id = 0
        self._rally_to_come: int | None = None  # points that another station writes, until they are acknowledged
        self._take: dict[int, Callable[[float, Any], None]] = {
            HEARTBEAT: self._heartbeat, GLOBAL_POSITION_INT: self._position, VFR_HUD: self._speed, WIND: self._wind,
            WIND_COV: self._wind_cov, HOME_POSITION: self._home, MISSION_CURRENT: self._current,
            MISSION_ITEM_REACHED: self._reached, MISSION_ACK: self._ack, EXTENDED_SYS_STATE: self._state,
        }  # fmt: skip

    @property
    def now(self) -> Navigation:
        """Return route and place as known now."""
        return self.builder.now

    @property
    def wants_mission(self) -> bool:
        """Return True if the autopilot's mission is not known."""
        return self.builder.held is None or self._is_outdated or self.transfer.is_open

    def take(self, time_s: float, message_id: int, message: Any) -> None:
        """Take a message of the autopilot."""
        if self._is_px4 is None and message_id in _OF_MISSIONS:
            self._early.append(lambda: self.take(time_s, message_id, message))
        self.transfer.passes(time_s)
        if message_id in _TO_SOMEBODY and (message.target_system, message.target_component) != self._own:
            self.transfer.of_another(time_s)
        read = self._take.get(message_id)
        if read is not None:
            read(time_s, message)
        elif message_id in OF_OTHERS:
            self._transfers(time_s, message_id, message, is_upload=False)
        self.builder.transferring(time_s, self.transfer.may_change(self.builder.held))

    def take_other(self, time_s: float, message_id: int, message: Any) -> None:
        """Take a message of another station to the autopilot."""
        if self._is_px4 is None and message_id in OF_OTHERS:
            self._early.append(lambda: self.take_other(time_s, message_id, message))
        self.transfer.passes(time_s)
        if message_id in OF_OTHERS:
            self.transfer.of_another(time_s)
            self._transfers(time_s, message_id, message, is_upload=True)
        self.builder.transferring(time_s, self.transfer.may_change(self.builder.held))

    def _transfers(self, time_s: float, message_id: int, message: Any, is_upload: bool) -> None:
        is_all = message.mission_type == _ALL and message_id == MISSION_CLEAR_ALL
        if is_all or message.mission_type == _RALLY:
            self._rally(time_s, message_id, message, is_upload)
        if not is_all and message.mission_type != _MISSION:
            return
        if message_id == MISSION_COUNT:
            self.transfer.begins(time_s, message.count, is_upload)
            if not is_upload:
                self.builder.items_told(time_s, message.count)
        elif message_id == MISSION_CLEAR_ALL:
            self.transfer.clears(time_s)
        elif message_id == MISSION_WRITE_PARTIAL_LIST:
            self._part(time_s, message)
        else:
            self.transfer.takes(time_s, mission_item(_fields(message_id, message), self._is_px4 is True), is_upload)
        read = self.transfer.whole(SOURCE, self._is_px4 is not True)
        self._hold(time_s, read)
        if read is not None and self._is_px4 is False:  # an upload is not read: the autopilot keeps its own home
            self.builder.home_of(time_s, read)

    def _rally(self, time_s: float, message_id: int, message: Any, is_upload: bool) -> None:
        """Count rally points in a transfer; points written to the autopilot count once it has acknowledged them."""
        if message_id == MISSION_CLEAR_ALL:
            self._rally_to_come = 0
        elif message_id == MISSION_COUNT and is_upload:
            self._rally_to_come = message.count
        elif message_id == MISSION_COUNT:
            self.builder.rally(time_s, message.count)

    def _part(self, time_s: float, message: Any) -> None:
        """Begin a transfer in which another station replaces some items of the known mission."""
        known = self.builder.held
        if known is not None and 0 <= message.start_index <= message.end_index < len(known.items):
            kept = [i for i in known.items if not message.start_index <= i.seq <= message.end_index]
            self.transfer.begins(time_s, len(known.items), True, kept)

    def _ack(self, time_s: float, message: Any) -> None:
        if message.mission_type in (_RALLY, _ALL):
            if message.type == ACCEPTED and self._rally_to_come is not None:
                self.builder.rally(time_s, self._rally_to_come)
            self._rally_to_come = None
        if message.mission_type not in (_MISSION, _ALL):
            return
        is_unheard = message.type == ACCEPTED and not self.transfer.explains_acknowledgement(time_s)
        self._hold(time_s, self.transfer.acknowledged(message.type, SOURCE, self._is_px4 is not True))
        if is_unheard:
            self._outdate(time_s)

    def _hold(self, time_s: float, mission: Mission | None) -> None:
        """Set the mission that the autopilot has from now on; None changes nothing."""
        if mission is not None:
            self._mission_id, self._is_outdated = 0, False
            mission = replace(mission, reason=NO_MAKE) if self._is_px4 is None else mission
            self.builder.mission(time_s, mission)

    def _heartbeat(self, time_s: float, message: Any) -> None:
        self._is_px4 = message.autopilot == AUTOPILOT_PX4
        self.builder.autopilot(time_s, self._is_px4)
        self.builder.mode(time_s, mode_of(message))
        if self._early:
            self._take_early()

    def _take_early(self) -> None:
        """Read the messages of missions that came before the first heartbeat, as those of the make now known."""
        early, self._early = self._early, deque()
        self.transfer = Transfer()
        for take in early:
            take()

    def _current(self, time_s: float, message: Any) -> None:
        total = getattr(message, "total", 0)
        self._doubt(time_s, total, getattr(message, "mission_id", 0) or 0)
        if total not in _NO_TOTAL:
            self.builder.items_told(time_s, total)
        self.builder.current(time_s, message.seq)

    def _doubt(self, time_s: float, total: int, mission_id: int) -> None:
        """Compare length and id that the autopilot reports of its mission with the known mission."""
        known = self.builder.held
        if known is None or known.reason or self.transfer.is_open:
            return
        is_changed = mission_id and self._mission_id and mission_id != self._mission_id
        lengths = (len(known.items) - known.has_home_item, len(known.items))  # some programs count home, some do not
        self._mission_id = mission_id or self._mission_id
        if is_changed or total not in (*_NO_TOTAL, *lengths):
            self._outdate(time_s)

    def _outdate(self, time_s: float) -> None:
        """Mark the known mission as wrong: the autopilot has another one, whose items were not heard."""
        known, self._is_outdated = self.builder.held, True
        if known is not None and not known.reason:
            self.builder.mission(time_s, replace(known, reason="the autopilot holds another mission than was read"))

    def _reached(self, time_s: float, message: Any) -> None:
        self.builder.reached(time_s, message.seq)

    def _position(self, time_s: float, message: Any) -> None:
        self.builder.position(
            time_s, message.lat / _E7, message.lon / _E7, message.relative_alt / 1000.0,
            message.vx / 100.0, message.vy / 100.0, -message.vz / 100.0,
        )  # fmt: skip

    def _home(self, time_s: float, message: Any) -> None:
        self.builder.home(time_s, Home(message.latitude / _E7, message.longitude / _E7, message.altitude / 1000.0))

    def _speed(self, time_s: float, message: Any) -> None:
        self.builder.airspeed(time_s, message.airspeed)

    def _wind(self, time_s: float, message: Any) -> None:
        if not math.isfinite(message.direction):
            return
        from_rad = math.radians(message.direction)
        north_ms, east_ms = -message.speed * math.cos(from_rad), -message.speed * math.sin(from_rad)
        self.builder.wind(time_s, round(north_ms, 6), round(east_ms, 6))

    def _wind_cov(self, time_s: float, message: Any) -> None:
        sd_ms = math.sqrt(message.var_horiz) if 0.0 < message.var_horiz < math.inf else NAN
        self.builder.wind(time_s, message.wind_x, message.wind_y, sd_ms)

    def _state(self, time_s: float, message: Any) -> None:
        is_landed = message.landed_state == _ON_GROUND
        self.builder.landed(time_s, None if message.landed_state == _UNDEFINED else is_landed)


def _fields(message_id: int, message: Any) -> Fields:
    """Return the fields of MISSION_ITEM (degrees) or MISSION_ITEM_INT (1e-7 degrees)."""
    lat_deg, lon_deg = float(message.x), float(message.y)
    if message_id == MISSION_ITEM_INT:
        lat_deg, lon_deg = (NAN if v == _UNKNOWN_INT else v / _E7 for v in (message.x, message.y))
    return Fields(
        message.seq, message.frame, message.command, message.param1, message.param2, message.param3, message.param4,
        lat_deg, lon_deg, message.z,
    )  # fmt: skip
