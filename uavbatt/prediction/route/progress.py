"""Progress on the route: the leg that is flown, where on it the aircraft is, and the lessons of those behind."""

from __future__ import annotations

import math
from typing import NamedTuple

from uavbatt.battery.powers import Powers, terms
from uavbatt.navigation import Home, Mission, Mode, Navigation, ReturnSettings
from uavbatt.prediction.route.flight_lessons import FlightLessons
from uavbatt.prediction.route.item import is_behind, is_there, item_end
from uavbatt.prediction.route.legs import Leg, Phase, Point
from uavbatt.prediction.route.passed import Passed
from uavbatt.prediction.route.path import Path, path, place
from uavbatt.prediction.route.steadiness import Steadiness
from uavbatt.prediction.route.track import Track
from uavbatt.prediction.route.way_home import finite_or, speeds_of
from uavbatt.records import NAN

OVER_HOME_M = 6.0
STALE_POSITION_S = 10.0
OVERDUE_LEGS, OVERDUE_S = 1.5, 45.0
SILENT_PROGRESS_S = 60.0
AIRBORNE_M = 1.0
ASTRAY, ASTRAY_S = 0.1, 4.0  # a new item may be reported some seconds late
TOLD_PERIOD_S, LONGEST_ROW_S = 1.0, 30.0
LEAST_SEEN_MS, SEEN_STEP_MS = 2.0, 0.5


class Movement(NamedTuple):
    """Movement says how the aircraft moves at one row."""

    airspeed_ms: float
    climb_ms: float
    taking_off: bool = False
    landing: bool = False


class Progress(NamedTuple):
    """Progress remembers how far the aircraft is on its route; it is a value, replaced by `after`."""

    known_by: tuple[Mission, Home, ReturnSettings] | None = None  # the path was made from these
    path: Path = Path()
    path_since_s: float = -math.inf  # time at which the mission replaced another one
    at: int = -1  # index of the first leg of the present item
    leg_since_s: float = NAN
    is_timed: bool = False  # that leg began as planned, so that its time counts
    behind: int = 0  # number of legs of that item that are over, by position
    behind_s: float = NAN  # time at which the present leg began
    arrived_s: float = NAN  # time at which the aircraft arrived at that leg's end
    passed: Passed = Passed()
    time_s: float = NAN
    told_s: float = NAN  # time at which the power was last compared with the model
    steadiness: Steadiness = Steadiness()
    lessons: FlightLessons = FlightLessons()
    track: Track = Track()
    seen_ms: float = NAN  # the highest speed over ground that it kept on legs whose speed nobody states

    def after(
        self, time_s: float, navigation: Navigation, power_W: float = NAN, powers: Powers | None = None
    ) -> Progress:
        """Return the memory with one more row at `time_s` [s] that drew `power_W` [W]."""
        row_s = min(max(time_s - self.time_s, 0.0), LONGEST_ROW_S) if math.isfinite(self.time_s) else 0.0
        moved = self._on_path(time_s, navigation)._with_position(navigation)
        moved = moved._replace(time_s=time_s, lessons=moved.lessons.with_wind(navigation.wind, row_s))
        if navigation.mode is Mode.MISSION:
            moved = moved._followed(time_s, navigation, row_s)._with_speed_seen(navigation)
        else:
            moved = moved._paused(row_s)
        if powers is None or not power_W > 0.0 or time_s - self.told_s < TOLD_PERIOD_S:
            return moved
        flown, told_s = moved.flown(time_s, navigation), min(time_s - self.told_s, LONGEST_ROW_S)
        moved = moved._replace(told_s=time_s)
        if flown is None or not moved.steadiness.is_steady or not told_s > 0.0:
            return moved
        columns = terms(*flown, powers.induced_ms)
        return moved._replace(lessons=moved.lessons.with_power(powers, flown.airspeed_ms, columns, power_W, told_s))

    def _with_position(self, navigation: Navigation) -> Progress:
        """Return the progress with a new position, which the track takes in as often as positions are compared."""
        steadiness, home = self.steadiness.after(navigation.position), navigation.home
        now = steadiness.compared
        if now is self.steadiness.compared or now is None or home is None:
            return self._replace(steadiness=steadiness)
        track = self.track.after(now.time_s, place(home, now), home, navigation.mode is Mode.RETURN_BY_TRACK)
        return self._replace(steadiness=steadiness, track=track)

    def _on_path(self, time_s: float, navigation: Navigation) -> Progress:
        """Return the progress with the leg that the autopilot flies to, and with the timing of the legs behind."""
        if navigation.mission is None or navigation.home is None:
            return self
        moved, known_by = self, (navigation.mission, navigation.home, navigation.settings)
        if self.known_by is None or any(a is not b for a, b in zip(known_by, self.known_by, strict=True)):
            is_same_mission = self.known_by is not None and self.known_by[0] == navigation.mission
            moved = self._replanned(path(*known_by), is_same_mission, time_s)._replace(known_by=known_by)
        found = moved.path
        at = _leg_of(found, navigation.current, moved.at)
        if at is None or at == moved.at:
            return moved
        # The item of a mission that replaced another one may have the number of the item that was flown before.
        since_s, began_s = max(navigation.current_since_s, moved.path_since_s), moved.leg_since_s
        if navigation.mode is Mode.MISSION and 0 <= moved.at < at and moved.is_timed and math.isfinite(began_s):
            moved = moved._replace(lessons=moved.lessons.with_timing(found.legs[moved.at : at], since_s - began_s))
        if 0 <= moved.at < at and any(leg.moves_load for leg in found.legs[moved.at + moved.behind : at]):
            moved = moved._replace(lessons=moved.lessons.with_another_load())
        here = here_at(time_s, navigation)
        is_timed = moved.path is self.path and _begins_as_planned(found.legs[at], here)
        passed = moved.passed.over(moved.path.legs[moved.item][-1], here) if moved.is_on_path else moved.passed
        moved = moved._replace(at=at, leg_since_s=since_s, is_timed=is_timed, passed=passed)
        return moved._replace(behind=0, behind_s=since_s, arrived_s=NAN)

    def _replanned(self, found: Path, is_same_mission: bool, time_s: float) -> Progress:
        """Return the progress on another path; the same mission with another home or speed keeps its progress."""
        if found == self.path:  # the same mission uploaded twice changes nothing
            return self
        changed = self._replace(path=found, is_timed=False)  # the running leg began on the other path
        if self.known_by is not None and not is_same_mission:
            changed = changed._replace(path_since_s=time_s)
        fresh = changed._replace(behind=0, behind_s=NAN, arrived_s=NAN, passed=Passed())
        if not (is_same_mission and self.is_on_path and self._is_alike(found)):
            return fresh._replace(at=-1, leg_since_s=NAN)
        return fresh if found.legs[self.at].phase is Phase.HOME else changed  # a return flies to the new home

    def _is_alike(self, found: Path) -> bool:
        """Return True if the other path has the same items, in as many legs, up to the one that is flown."""
        last = self.item.stop + 1
        return [leg.seq for leg in found.legs[:last]] == [leg.seq for leg in self.path.legs[:last]]

    @property
    def is_on_path(self) -> bool:
        """Return True if it is known which leg is flown."""
        return 0 <= self.at < len(self.path.legs)

    @property
    def item(self) -> slice:
        """Return the range of the legs of the item that is flown to."""
        return slice(self.at, item_end(self.path.legs, self.at))

    @property
    def leg(self) -> Leg:
        """Return the leg that is flown: the first of its item that is not over."""
        return self.path.legs[self.at + self.behind]

    def _followed(self, time_s: float, navigation: Navigation, row_s: float) -> Progress:
        """Return the progress on the present item by the place; it never goes back, and notes waits at a leg's end."""
        here = here_at(time_s, navigation)
        if here is None or not self.is_on_path:
            return self
        moved, legs = self._arrived(time_s, here, navigation), self.path.legs[self.item]
        passed = moved.passed.at(legs[-1], here)
        moved = moved if passed is moved.passed else moved._replace(passed=passed)
        while moved.behind + 1 < len(legs) and moved._is_over(legs[moved.behind + 1], here, time_s, navigation):
            lessons = moved.lessons.with_another_load() if moved.leg.moves_load else moved.lessons
            moved = moved._replace(behind=moved.behind + 1, behind_s=time_s, arrived_s=NAN, lessons=lessons)
            moved = moved._arrived(time_s, here, navigation)
        if moved.is_timed and moved.behind == 0 and moved.leg.phase is Phase.ROUTE and not moved.leg.circle_m > 0.0:
            return moved._replace(lessons=moved.lessons.with_climb(moved.leg, here, row_s))
        return moved

    def _with_speed_seen(self, navigation: Navigation) -> Progress:
        """Return the progress with the speed that is kept now, on a leg whose speed neither vehicle nor item states."""
        position, settings = navigation.position, navigation.settings
        if position is None or not (self.steadiness.is_steady and self.is_on_path) or math.isfinite(settings.cruise_ms):
            return self
        leg, speed_ms = self.leg, math.hypot(position.north_ms, position.east_ms)
        is_own = leg.phase is Phase.ROUTE and leg.speed_ms == speeds_of(settings).cruise_ms and not leg.circle_m > 0.0
        is_new = speed_ms > max(LEAST_SEEN_MS, finite_or(self.seen_ms, 0.0) + SEEN_STEP_MS)
        return self._replace(seen_ms=speed_ms) if is_own and is_new else self

    def _paused(self, row_s: float) -> Progress:
        """Return the progress after `row_s` [s] in another mode: the leg's clock stands still, its time is not used."""
        if not self.is_on_path:
            return self
        return self._replace(
            leg_since_s=self.leg_since_s + row_s, behind_s=self.behind_s + row_s, arrived_s=NAN, is_timed=False
        )

    def _arrived(self, time_s: float, here: Point, navigation: Navigation) -> Progress:
        """Note since when the aircraft waits at the end of its leg; a gust does not begin the wait anew."""
        is_new = not math.isfinite(self.arrived_s) and is_there(self.leg, here, navigation.position)
        return self._replace(arrived_s=time_s) if is_new else self

    def _is_over(self, following: Leg, here: Point, time_s: float, navigation: Navigation) -> bool:
        """Return True if the leg that is flown is over, and the next leg of its item has begun."""
        leg = self.leg
        if leg.circle_m > 0.0:
            return time_s - self.behind_s >= self.lessons.expected_s(leg)
        return is_behind(leg, following, here, navigation.position, time_s - self.arrived_s)

    def _by_clock(self, time_s: float) -> Leg:
        """Return the leg of the item that should be flown now by the clock, if the position is not known."""
        legs, left_s = self.path.legs[self.item], time_s - self.leg_since_s
        for leg in legs[:-1]:
            left_s -= self.lessons.expected_s(leg)
            if left_s < 0.0:
                return leg
        return legs[-1]

    def flown(self, time_s: float, navigation: Navigation) -> Movement | None:
        """Return how the aircraft moves now, by its position, else by the plan of its leg; None where neither tells."""
        position = navigation.position
        if position is not None and time_s - position.time_s <= STALE_POSITION_S and math.isfinite(position.up_ms):
            if not position.height_m > AIRBORNE_M:
                return None
            wind_north_ms, wind_east_ms = self.lessons.wind
            north_ms, east_ms = position.north_ms - wind_north_ms, position.east_ms - wind_east_ms
            over_home = navigation.mode is Mode.RETURN and is_over_home(navigation)
            landing = navigation.mode is Mode.LAND or over_home or self._phase(navigation) is Phase.LANDING
            return Movement(math.hypot(north_ms, east_ms), position.up_ms, self._takes_off(navigation), landing)
        if navigation.mode is not Mode.MISSION or not self.is_on_path:
            return None
        leg = self._by_clock(time_s)
        if not leg.moving_s > 0.0 or overdue(self, time_s, navigation):
            return None
        return Movement(
            leg.run_m / leg.moving_s,
            leg.rise_m / leg.moving_s,
            leg.phase is Phase.TAKE_OFF or self.at == 0,
            leg.phase is Phase.LANDING,
        )

    def _phase(self, navigation: Navigation) -> Phase:
        return self.leg.phase if navigation.mode is Mode.MISSION and self.is_on_path else Phase.ROUTE

    def _takes_off(self, navigation: Navigation) -> bool:
        return navigation.mode is Mode.TAKEOFF or self._phase(navigation) is Phase.TAKE_OFF


def _leg_of(way: Path, current: int | None, at: int) -> int | None:
    """Return the leg on which the autopilot flies to item `current`: the next such leg, else the first."""
    if current is None:
        return None
    if 0 <= at < len(way.legs) and way.legs[at].seq == current:
        return at
    same = [index for index, leg in enumerate(way.legs) if leg.seq == current]
    return next((index for index in same if index > at), same[0] if same else None)


def _begins_as_planned(leg: Leg, here: Point | None) -> bool:
    """Return False if the leg begins elsewhere than planned, so that its time says nothing about planned legs."""
    if here is None:
        return True
    from_here_s = leg._replace(begin=here, run_m=math.dist(here[:2], leg.end[:2])).moving_s
    straight_s = leg._replace(run_m=math.dist(leg.begin[:2], leg.end[:2])).moving_s
    return abs(from_here_s - straight_s) <= ASTRAY * straight_s + ASTRAY_S


def here_at(time_s: float, navigation: Navigation) -> Point | None:
    """Return where the aircraft is, in metres around home; None where nobody says it or has not for a while."""
    position, home = navigation.position, navigation.home
    if position is None or home is None or time_s - position.time_s > STALE_POSITION_S:
        return None
    return place(home, position)


def is_over_home(navigation: Navigation) -> bool:
    """Return True if the aircraft is over its home."""
    if navigation.position is None or navigation.home is None:
        return False
    here = place(navigation.home, navigation.position)
    return math.hypot(here.north_m, here.east_m) < OVER_HOME_M


def overdue(progress: Progress, time_s: float, navigation: Navigation) -> str:
    """Return why the progress that the autopilot reports cannot be believed; empty when it can."""
    if progress.passed.is_another_mission:
        return "the aircraft flies another mission: it does not pass the places of this one"
    heard_s = time_s - navigation.current_heard_s
    if heard_s > SILENT_PROGRESS_S:
        return f"the autopilot has not said for {heard_s:.0f} s where on its mission it is"
    legs = progress.path.legs[progress.item]
    planned_s = sum(map(progress.lessons.expected_s, legs))
    late_s = time_s - progress.leg_since_s
    if late_s > OVERDUE_LEGS * planned_s + OVERDUE_S:
        return f"item {legs[0].seq} is overdue: {late_s:.0f} s on a leg of {planned_s:.0f} s"
    return ""
