"""`NavigationBuilder`: route and place, put together from messages in the order of reception.

The readers of all logs and of the live link give it values in SI; it makes the same `Navigation` for all of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from uavbatt.navigation import (
    FARTHEST_HOME_M,
    NAN,
    NOWHERE,
    Frame,
    Home,
    Mission,
    Mode,
    Navigation,
    Position,
    Wind,
    offset_m,
)
from uavbatt.telemetry.route import settings
from uavbatt.telemetry.route.position_check import PositionCheck

POSITION_STEP_S = 0.2  # positions that come faster say nothing more of minutes to come
AIRSPEED_AGE_S = 3.0  # an older airspeed is not used
FASTEST_WIND_MS = 40.0  # in which no aircraft flies that we know: a fault of the estimate


class NavigationBuilder:
    """NavigationBuilder puts together route and place; with `keeps_all` it keeps the state of every instant."""

    def __init__(self, keeps_all: bool = False) -> None:
        self._known: dict[str, Any] = {name: getattr(NOWHERE, name) for name in Navigation.__slots__}
        self._built: Navigation | None = NOWHERE
        self._kept: list[Navigation] | None = [] if keeps_all else None
        self._parameters: Mapping[str, float] = {}
        self._is_px4 = False
        self._stated, self._rally_points = NOWHERE.settings, 0  # by the parameters alone, and by the mission protocol
        self._airspeed_ms, self._airspeed_at_s = NAN, -math.inf
        self._check = PositionCheck()

    @property
    def now(self) -> Navigation:
        """Return route and place as known now."""
        if self._built is None:
            self._built = Navigation(**self._known)
        return self._built

    @property
    def held(self) -> Mission | None:
        """Return the mission as known now; None without one."""
        found: Mission | None = self._known["mission"]
        return found

    def timeline(self) -> tuple[Navigation, ...]:
        """Return the states of all instants, ascending in time."""
        kept = self._kept or []
        return (*kept, self.now) if self.now is not NOWHERE else tuple(kept)

    def mode(self, time_s: float, mode: Mode) -> None:
        """Take the flight mode."""
        if mode is not self._known["mode"]:
            self._change(time_s, mode=mode, mode_since_s=time_s)

    def mission(self, time_s: float, mission: Mission) -> None:
        """Take a complete mission; if it is the same as before, only its transfer ends."""
        self.items_told(time_s, len(mission.items))
        if not _is_same(mission, self._known["mission"]):
            self._change(time_s, mission=mission, mission_since_s=time_s, transferring=False)
        else:
            self.transferring(time_s, False)

    def items_told(self, time_s: float, count: int) -> None:
        """Take the number of items that the autopilot says its mission has."""
        if count != self._known["items_told"]:
            self._change(time_s, items_told=count)

    def transferring(self, time_s: float, is_so: bool) -> None:
        """Note if a mission is being transferred and is not complete yet."""
        if is_so is not self._known["transferring"]:
            self._change(time_s, transferring=is_so)

    def current(self, time_s: float, seq: int) -> None:
        """Take the item to which the vehicle flies."""
        if seq == self._known["current"]:
            self._change(time_s, current_heard_s=time_s)
        else:
            self._change(time_s, current=seq, current_since_s=time_s, current_heard_s=time_s)

    def still_current(self, time_s: float) -> None:
        """Note with a position that the same item is still flown: the log would show a change."""
        if self._known["current"] is not None and time_s == self._known["time_s"]:
            self._known["current_heard_s"], self._built = time_s, None

    def reached(self, time_s: float, seq: int) -> None:
        """Take the item that was reached."""
        if seq != self._known["reached"]:
            self._change(time_s, reached=seq)

    def home(self, time_s: float, home: Home) -> None:
        """Take the home position; an impossible one, or one that is out of all reach, changes nothing."""
        if not _is_place(home.lat_deg, home.lon_deg) or _is_same(home, self._known["home"]):
            return
        here: Position | None = self._known["position"]
        if here is None or math.hypot(*offset_m(home, here.lat_deg, here.lon_deg)) <= FARTHEST_HOME_M:
            self._change(time_s, home=home)

    def home_of(self, time_s: float, mission: Mission) -> None:
        """Take home from a mission that an autopilot told: item 0 of an ArduPilot's. A home told by itself stays."""
        known, first = self._known["home"], mission.items[0] if mission.has_home_item and mission.items else None
        if first is not None and first.frame is Frame.SEA and (known is None or known.is_of_mission):
            self.home(time_s, Home(first.lat_deg, first.lon_deg, first.alt_m, is_of_mission=True))

    def parameter(self, time_s: float, name: str, value: float) -> None:
        """Take a vehicle parameter, if it is of speeds or of the way home."""
        if name not in settings.NAMES:
            return
        self.settings(time_s, {**self._parameters, name: value})

    def settings(self, time_s: float, parameters: Mapping[str, float]) -> None:
        """Take all parameters that are known now."""
        self._parameters = parameters
        self._stated = settings.return_settings(parameters, self._is_px4)
        self._settle(time_s)

    def autopilot(self, time_s: float, is_px4: bool) -> None:
        """Take the make of the autopilot, whose defaults stand for parameters that are not known."""
        if is_px4 is not self._is_px4:
            self._is_px4 = is_px4
            self.settings(time_s, self._parameters)

    def rally(self, time_s: float, points: int) -> None:
        """Take the number of rally points in the autopilot: with rally points the place of return is unknown."""
        self._rally_points = points
        self._settle(time_s)

    def _settle(self, time_s: float) -> None:
        """Combine the parameters of the way home with the rally points heard."""
        found = self._stated
        if self._rally_points > 0 and not found.return_reason:
            words = f"the vehicle has rally points ({self._rally_points}): it may return to one of them"
            found = replace(found, return_reason=words)
        if not _is_same(found, self._known["settings"]):
            self._change(time_s, settings=found)

    def position(
        self, time_s: float, lat_deg: float, lon_deg: float, height_m: float,
        north_ms: float = NAN, east_ms: float = NAN, up_ms: float = NAN,
    ) -> None:  # fmt: skip
        """Take the position of the aircraft; impossible positions, leaps, and those that come too fast are skipped."""
        last = self._known["position"]
        if last is not None and 0.0 <= time_s - last.time_s < POSITION_STEP_S:
            return
        if not (_is_place(lat_deg, lon_deg) and math.isfinite(height_m)):
            return
        airspeed_ms = self._airspeed_ms if time_s - self._airspeed_at_s <= AIRSPEED_AGE_S else NAN
        place = Position(time_s, lat_deg, lon_deg, height_m, north_ms, east_ms, up_ms, airspeed_ms)
        believed = self._check.believed(place)
        if believed is not None:
            self._change(time_s, position=believed)

    def airspeed(self, time_s: float, airspeed_ms: float) -> None:
        """Take the airspeed for the next position; 0 is unknown, as a copter without an estimate sends it."""
        if airspeed_ms > 0.0:
            self._airspeed_ms, self._airspeed_at_s = airspeed_ms, time_s

    def wind(self, time_s: float, north_ms: float, east_ms: float, sd_ms: float = NAN) -> None:
        """Take the wind, unless it is impossible; exactly 0 is unknown: an autopilot without an estimate sends it."""
        if 0.0 < math.hypot(north_ms, east_ms) <= FASTEST_WIND_MS:
            self._change(time_s, wind=Wind(north_ms, east_ms, sd_ms))

    def landed(self, time_s: float, is_landed: bool | None) -> None:
        """Note if the aircraft is on the ground; None is unknown."""
        if is_landed is not self._known["landed"]:
            self._change(time_s, landed=is_landed)

    def _change(self, time_s: float, **changed: Any) -> None:
        """Change the present state; of each instant only the last state is kept."""
        was_s = self._known["time_s"]
        if self._kept is not None and time_s > was_s:
            self._kept.append(self.now)
        self._known.update(changed)
        self._known["time_s"] = time_s if not time_s <= was_s else was_s
        self._built = None


def _is_place(lat_deg: float, lon_deg: float) -> bool:
    """Return True if this is a position on Earth; latitude and longitude 0 mean a receiver without a fix."""
    return abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0 and not (lat_deg == 0.0 and lon_deg == 0.0)


def _is_same(one: object, other: object) -> bool:
    """Return True if two values are equal; NaN counts as equal to NaN."""
    return repr(one) == repr(other)
