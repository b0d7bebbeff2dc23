"""Progress on the route, and what the legs flown so far tell of the rest: timing, power level, wind.

Two things lengthen a leg beyond its plan: a stretch of its time and the speeding up and slowing down,

    t = s t_plan + e v        s ~ 1.03 +- 0.1, e ~ 0.32 +- 0.12 s per m/s, before a leg was flown

and each leg that was flown says more of both (Bayesian linear regression, two numbers), apart for short legs, where the
corners are most of it, and long ones. The power level is the power
flown over that of the vehicle's `[powers]`: a payload that nobody declared shows there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.battery.powers import Powers, power, terms
from uavbatt.navigation import Home, Mission, Mode, Navigation, ReturnSettings
from uavbatt.prediction.route_legs import Leg, Phase, Point
from uavbatt.prediction.route_path import Path, path, place

NAN = math.nan
STRETCH, STRETCH_SD, SPEEDING, SPEEDING_SD = 1.03, 0.1, 0.32, 0.12
SHORT_LEG_S = 20.0
UNUSUAL, UNUSUAL_S = 0.4, 8.0
LEG_NOISE_S, LEG_NOISE = 2.0, 0.08
WIND_TAU_S = 60.0
POWER_MEMORY_S, MODEL_SD = 8.0, 0.02
ARRIVED_M, OVER_HOME_M = 4.0, 6.0
STALE_POSITION_S = 10.0
OVERDUE_LEGS, OVERDUE_S = 1.5, 45.0
SILENT_PROGRESS_S = 60.0
AIRBORNE_M = 1.0
LEAST_FLOWN_S = 20.0
TOLD_PERIOD_S, LONGEST_ROW_S = 1.0, 30.0


class Timing(NamedTuple):
    """The belief about stretch s and speeding e: precision matrix (ss, se, ee) and its product with the means."""

    ss: float = 1.0 / STRETCH_SD**2
    se: float = 0.0
    ee: float = 1.0 / SPEEDING_SD**2
    s: float = STRETCH / STRETCH_SD**2
    e: float = SPEEDING / SPEEDING_SD**2

    def after(self, flown_s: float, planned_s: float, speed_ms: float) -> Timing:
        """The knowledge after a leg of `planned_s` [s] and `speed_ms` [m/s] took `flown_s` [s]."""
        weight = 1.0 / (LEG_NOISE_S**2 + (LEG_NOISE * planned_s) ** 2)
        return Timing(
            self.ss + weight * planned_s**2,
            self.se + weight * planned_s * speed_ms,
            self.ee + weight * speed_ms**2,
            self.s + weight * planned_s * flown_s,
            self.e + weight * speed_ms * flown_s,
        )

    @property
    def factors(self) -> tuple[float, float]:
        """The means of s and e, neither so small that time would run backwards."""
        det = self.ss * self.ee - self.se**2
        stretch, speeding = (self.ee * self.s - self.se * self.e) / det, (self.ss * self.e - self.se * self.s) / det
        return min(max(stretch, 0.5), 2.0), min(max(speeding, -0.5), 2.0)

    def sd(self, planned_s: Array, speed_ms: Array) -> Array:
        """Standard deviation of the time of such legs that s and e leave [s]."""
        det = self.ss * self.ee - self.se**2
        variance = self.ee * planned_s**2 - 2.0 * self.se * planned_s * speed_ms + self.ss * speed_ms**2
        return np.asarray(np.sqrt(np.maximum(variance / det, 0.0)))


class FlightLessons(NamedTuple):
    """The knowledge of this flight that no message repeats: timing, power level, wind. It outlives a restart."""

    short: Timing = Timing()
    long: Timing = Timing()
    wind_north_ms: float = NAN
    wind_east_ms: float = NAN
    level_s: float = 0.0  # seconds of flight that told the level
    level_sum_s: float = 0.0  # flown over modelled power, summed over them

    @property
    def is_possible(self) -> bool:
        """True if a flight can have taught this: a saved file may hold anything."""
        timed = all(t.ss > 0.0 and t.ee > 0.0 and t.ss * t.ee > t.se**2 for t in (self.short, self.long))
        return timed and self.level_s >= 0.0 and self.level_sum_s >= 0.0


class Movement(NamedTuple):
    """The aircraft's movement at one row."""

    airspeed_ms: float
    climb_ms: float
    taking_off: bool = False
    landing: bool = False


class Progress(NamedTuple):
    """The memory of the route; a value, replaced by `after`."""

    known_by: tuple[Mission, Home, ReturnSettings] | None = None  # what the path was made of
    path: Path = Path()
    at: int = -1  # the leg that is flown
    leg_since_s: float = NAN
    arrived_s: float = NAN  # since when the aircraft waits at the leg's end
    time_s: float = NAN
    short: Timing = Timing()
    long: Timing = Timing()
    wind_north_ms: float = NAN
    wind_east_ms: float = NAN
    told_s: float = NAN  # when the power was last held against the level
    level_s: float = 0.0  # seconds of flight that told the level
    level_sum_s: float = 0.0  # flown over modelled power, summed over them

    def after(
        self, time_s: float, navigation: Navigation, power_W: float = NAN, powers: Powers | None = None
    ) -> Progress:
        """The memory with one more row at `time_s` [s] that drew `power_W` [W]."""
        row_s = min(max(time_s - self.time_s, 0.0), LONGEST_ROW_S) if math.isfinite(self.time_s) else 0.0
        moved = self._on_path(navigation)._blown(navigation, row_s)._replace(time_s=time_s)
        if navigation.mode is Mode.MISSION:
            moved = moved._arrived(time_s, navigation)
        if powers is None or not power_W > 0.0 or time_s - self.told_s < TOLD_PERIOD_S:
            return moved
        flown, told_s = moved.flown(time_s, navigation), min(time_s - self.told_s, LONGEST_ROW_S)
        moved = moved._replace(told_s=time_s)
        if flown is None or not told_s > 0.0:
            return moved
        ratio = power_W / float(power(powers, terms(*flown, powers.induced_ms)))
        return moved._replace(level_s=self.level_s + told_s, level_sum_s=self.level_sum_s + told_s * ratio)

    @property
    def lessons(self) -> FlightLessons:
        """The part worth keeping over a restart; the rest is heard again."""
        return FlightLessons(*(getattr(self, name) for name in FlightLessons._fields))

    def recall(self, lessons: FlightLessons) -> Progress:
        """Return the memory with what was kept over a restart."""
        return self._replace(**lessons._asdict())

    def _on_path(self, navigation: Navigation) -> Progress:
        """The leg by what the autopilot says that it flies to, and the timing of those behind."""
        if navigation.mission is None or navigation.home is None:
            return self
        moved, known_by = self, (navigation.mission, navigation.home, navigation.settings)
        if self.known_by is None or any(a is not b for a, b in zip(known_by, self.known_by, strict=True)):
            found = path(*known_by)
            moved = self._replace(known_by=known_by)
            if found != self.path:  # the same mission uploaded twice changes nothing
                moved = moved._replace(path=found, at=-1, leg_since_s=NAN)
        found = moved.path
        at = _leg_of(found, navigation.current, moved.at)
        if at is None or at == moved.at:
            return moved
        since_s, began_s = navigation.current_since_s, moved.leg_since_s
        if navigation.mode is Mode.MISSION and 0 <= moved.at < at and math.isfinite(began_s):
            moved = moved._timed(found.legs[moved.at : at], since_s - began_s)
        return moved._replace(at=at, leg_since_s=since_s, arrived_s=NAN)

    def _timed(self, behind: Sequence[Leg], flown_s: float) -> Progress:
        """The timing after legs of one kind that took `flown_s` [s] together; a pause does not count."""
        flown_s -= sum(leg.hold_s for leg in behind)
        planned_s, speeds_ms = sum(leg.moving_s for leg in behind), sum(leg.fastest_ms for leg in behind)
        usual_s = STRETCH * planned_s + SPEEDING * speeds_ms
        is_odd = abs(flown_s - usual_s) > UNUSUAL * usual_s + UNUSUAL_S
        if is_odd or any(leg.phase is Phase.TAKE_OFF for leg in behind):
            return self
        if all(leg.moving_s < SHORT_LEG_S for leg in behind):
            return self._replace(short=self.short.after(flown_s, planned_s, speeds_ms))
        if all(leg.moving_s >= SHORT_LEG_S for leg in behind):
            return self._replace(long=self.long.after(flown_s, planned_s, speeds_ms))
        return self

    def timing(self, leg: Leg) -> Timing:
        """Return what is known of the timing of such a leg."""
        return self.short if leg.moving_s < SHORT_LEG_S else self.long

    def _blown(self, navigation: Navigation, row_s: float) -> Progress:
        """The wind, as the autopilot estimates it, averaged over a minute."""
        wind = navigation.wind
        if wind is None:
            return self
        if not math.isfinite(self.wind_north_ms):
            return self._replace(wind_north_ms=wind.north_ms, wind_east_ms=wind.east_ms)
        share = 1.0 - math.exp(-row_s / WIND_TAU_S)
        return self._replace(
            wind_north_ms=self.wind_north_ms + share * (wind.north_ms - self.wind_north_ms),
            wind_east_ms=self.wind_east_ms + share * (wind.east_ms - self.wind_east_ms),
        )

    def _arrived(self, time_s: float, navigation: Navigation) -> Progress:
        """Since when the aircraft waits at the end of its leg."""
        here = here_at(time_s, navigation)
        if here is None or not 0 <= self.at < len(self.path.legs):
            return self
        is_there = math.dist(here, self.path.legs[self.at].end) < ARRIVED_M
        if is_there and not math.isfinite(self.arrived_s):
            return self._replace(arrived_s=time_s)
        return self if is_there else self._replace(arrived_s=NAN)

    def flown(self, time_s: float, navigation: Navigation) -> Movement | None:
        """Return how the aircraft flies now: by its position, else by the plan of its leg; None where neither tells."""
        position = navigation.position
        if position is not None and time_s - position.time_s <= STALE_POSITION_S and math.isfinite(position.up_ms):
            if not position.height_m > AIRBORNE_M:
                return None
            north_ms, east_ms = position.north_ms - self.wind[0], position.east_ms - self.wind[1]
            over_home = navigation.mode is Mode.RETURN and _is_over_home(navigation)
            landing = navigation.mode is Mode.LAND or over_home or self._phase(navigation) is Phase.LANDING
            return Movement(math.hypot(north_ms, east_ms), position.up_ms, self._takes_off(navigation), landing)
        if navigation.mode is not Mode.MISSION or not 0 <= self.at < len(self.path.legs):
            return None
        leg = self.path.legs[self.at]
        if not leg.moving_s > 0.0 or overdue(self, time_s, navigation):
            return None
        return Movement(
            leg.run_m / leg.moving_s,
            leg.rise_m / leg.moving_s,
            leg.phase is Phase.TAKE_OFF or self.at == 0,
            leg.phase is Phase.LANDING,
        )

    def _phase(self, navigation: Navigation) -> Phase:
        on_route = navigation.mode is Mode.MISSION and 0 <= self.at < len(self.path.legs)
        return self.path.legs[self.at].phase if on_route else Phase.ROUTE

    def _takes_off(self, navigation: Navigation) -> bool:
        return navigation.mode is Mode.TAKEOFF or self._phase(navigation) is Phase.TAKE_OFF

    @property
    def wind(self) -> tuple[float, float]:
        """The velocity of the air north and east [m/s]; still where nobody measures it."""
        known = math.isfinite(self.wind_north_ms)
        return (self.wind_north_ms, self.wind_east_ms) if known else (0.0, 0.0)

    def level(self, powers: Powers) -> tuple[float, float]:
        """The flight's power over that of `powers`, and its sd: the prior and what was flown so far.

        Of an aircraft that nobody knows it is NaN until enough was flown.
        """
        if not self.level_s > (0.0 if powers.flights else LEAST_FLOWN_S):
            return (1.0, powers.level_sd) if powers.flights else (NAN, NAN)
        prior = powers.level_sd**2 if powers.flights else math.inf
        noise = powers.row_sd**2 * min(2.0 * POWER_MEMORY_S / self.level_s, 1.0) + MODEL_SD**2
        share = 1.0 / (1.0 + noise / prior)
        return 1.0 + share * (self.level_sum_s / self.level_s - 1.0), math.sqrt(share * noise)


def _leg_of(way: Path, current: int | None, at: int) -> int | None:
    """The leg on which the autopilot flies to item `current`: the next such one, else any."""
    if current is None:
        return None
    if 0 <= at < len(way.legs) and way.legs[at].seq == current:
        return at
    same = [index for index, leg in enumerate(way.legs) if leg.seq == current]
    return next((index for index in same if index > at), same[0] if same else None)


def here_at(time_s: float, navigation: Navigation) -> Point | None:
    """Return where the aircraft is; None where nobody says it or has not for a while."""
    position, home = navigation.position, navigation.home
    if position is None or home is None or time_s - position.time_s > STALE_POSITION_S:
        return None
    return place(home, position)


def _is_over_home(navigation: Navigation) -> bool:
    if navigation.position is None or navigation.home is None:
        return False
    here = place(navigation.home, navigation.position)
    return math.hypot(here.north_m, here.east_m) < OVER_HOME_M


def overdue(progress: Progress, time_s: float, navigation: Navigation) -> str:
    """Return why the progress that the autopilot reports cannot be believed; empty when it can."""
    heard_s = time_s - navigation.current_heard_s
    if heard_s > SILENT_PROGRESS_S:
        return f"the autopilot has not said for {heard_s:.0f} s where on its mission it is"
    leg = progress.path.legs[progress.at]
    stretch, speeding = progress.timing(leg).factors
    planned_s = stretch * leg.moving_s + speeding * leg.fastest_ms + leg.hold_s
    late_s = time_s - progress.leg_since_s
    if late_s > OVERDUE_LEGS * planned_s + OVERDUE_S:
        return f"item {leg.seq} is overdue: {late_s:.0f} s on a leg of {planned_s:.0f} s"
    return ""
