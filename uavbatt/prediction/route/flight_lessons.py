"""The lessons of the legs flown so far for the rest of a flight: timing, power level, wind.

Two things lengthen a leg beyond its plan: a stretch of its time and the speeding up and slowing down,

    t = s t_plan + e v        s ~ 1.03 +- 0.1, e ~ 0.32 +- 0.12 s per m/s, before a leg was flown

and each flown leg improves both (Bayesian linear regression of two numbers), separately for short legs, of which the
corners are the main part, and for long ones. The power level (`power_level`) shows an undeclared payload. Beyond the
learned airspeeds the flight teaches how much more power it asks there.
Some autopilots climb along the whole leg, others at once and then fly on level; the latter asks more power for a
shorter time, which ends flights.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.battery.powers import MOST_BEYOND, Powers, beyond_learned, level_of, power
from uavbatt.navigation import Wind
from uavbatt.prediction.route.legs import Leg, Phase, Point
from uavbatt.prediction.route.power_level import LEVEL_TAU_S, PowerLevel, mean_of_rows
from uavbatt.records import NAN

STRETCH, STRETCH_SD, SPEEDING, SPEEDING_SD = 1.03, 0.1, 0.32, 0.12
SHORT_LEG_S = 20.0
UNUSUAL, UNUSUAL_S = 0.4, 8.0
LEG_NOISE_S, LEG_NOISE = 2.0, 0.08
WIND_TAU_S = 60.0
# Of a component of the wind for a whole flight: of the autopilot's estimate (against the true power of eight flights),
# and where there is none.
WIND_SD_MS, UNTOLD_WIND_SD_MS = 0.5, 3.5
# Error of the power at high airspeed by the wind estimate (that of 1 m/s), and of the law of the drag where the drag
# power is twice what was learned.
WIND_SD, EXCESS_SD = 0.05, 0.15
MOST_EXCESS = math.log(10.0)  # a row farther off is a fault of the sensor, and a saved sum farther off is damaged
ROUNDING = 1e-9


# Height and distance are compared where the two ways of climbing differ enough.
TELLING_M, TELLING_SHARE = 5.0, 0.25
EARLIEST_SHARE = 0.1  # of the distance; before, the aircraft has only begun to move


class Timing(NamedTuple):
    """Timing holds the belief about stretch s and speeding e.

    ss, se, ee : their precision matrix; s, e : its product with their means.
    """

    ss: float = 1.0 / STRETCH_SD**2
    se: float = 0.0
    ee: float = 1.0 / SPEEDING_SD**2
    s: float = STRETCH / STRETCH_SD**2
    e: float = SPEEDING / SPEEDING_SD**2

    def after(self, flown_s: float, planned_s: float, speed_ms: float) -> Timing:
        """Return the belief after a leg of `planned_s` [s] and a top speed of `speed_ms` [m/s] took `flown_s` [s]."""
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
        """Return the means of s [-] and e [s per m/s], bounded from below, so that no time becomes negative."""
        det = self.ss * self.ee - self.se**2
        stretch, speeding = (self.ee * self.s - self.se * self.e) / det, (self.ss * self.e - self.se * self.s) / det
        return min(max(stretch, 0.5), 2.0), min(max(speeding, -0.5), 2.0)

    def sd(self, planned_s: Array, speed_ms: Array) -> Array:
        """Return the sd of the time of legs of these planned times and speeds [s], by the uncertainty of s and e."""
        det = self.ss * self.ee - self.se**2
        variance = self.ee * planned_s**2 - 2.0 * self.se * planned_s * speed_ms + self.ss * speed_ms**2
        return np.asarray(np.sqrt(np.maximum(variance / det, 0.0)))


class FlightLessons(NamedTuple):
    """FlightLessons holds timing, power level and wind as learned in this flight; it is kept over a restart."""

    short: Timing = Timing()
    long: Timing = Timing()
    wind_north_ms: float = NAN
    wind_east_ms: float = NAN
    power: PowerLevel = PowerLevel()
    climbed_first_s: float = 0.0  # seconds in which the height was ahead of the distance, as if it climbed first
    climbed_along_s: float = 0.0  # seconds in which it was not
    beyond_s: float = 0.0  # seconds of flight beyond the learned airspeeds, older ones counted less
    beyond_sum_s: float = 0.0  # how far beyond (`powers.beyond_learned`), summed over them
    excess_sum_s: float = 0.0  # ln of flown over modelled power, summed over them

    @property
    def is_possible(self) -> bool:
        """Return True if a flight can have taught this: a saved file may hold anything."""
        timed = all(t.ss > 0.0 and t.ee > 0.0 and t.ss * t.ee > t.se**2 for t in (self.short, self.long))
        summed = (self.climbed_first_s, self.climbed_along_s, self.beyond_sum_s)
        most_s = self.beyond_s * (1.0 + ROUNDING)
        beyond = self.beyond_sum_s <= MOST_BEYOND * most_s and abs(self.excess_sum_s) <= MOST_EXCESS * most_s
        return timed and beyond and self.power.is_possible and all(value >= 0.0 for value in summed)

    @property
    def climbs_first(self) -> bool:
        """Return True if the aircraft was seen to climb and sink as a leg begins, not along the whole leg."""
        return self.climbed_first_s > self.climbed_along_s

    def with_timing(self, behind: Sequence[Leg], flown_s: float) -> FlightLessons:
        """Return the lessons after the legs `behind` took `flown_s` [s] together.

        The planned waits do not count. Take-offs, landings, unusual times and short legs mixed with long ones are not
        used.
        """
        flown_s -= sum(leg.hold_s for leg in behind)
        planned_s, speeds_ms = sum(leg.moving_s for leg in behind), sum(leg.fastest_ms for leg in behind)
        usual_s = STRETCH * planned_s + SPEEDING * speeds_ms
        is_odd = abs(flown_s - usual_s) > UNUSUAL * usual_s + UNUSUAL_S
        if is_odd or any(leg.phase in (Phase.TAKE_OFF, Phase.LANDING) for leg in behind):
            return self
        if all(leg.moving_s < SHORT_LEG_S for leg in behind):
            return self._replace(short=self.short.after(flown_s, planned_s, speeds_ms))
        if all(leg.moving_s >= SHORT_LEG_S for leg in behind):
            return self._replace(long=self.long.after(flown_s, planned_s, speeds_ms))
        return self

    def with_climb(self, leg: Leg, here: Point, row_s: float) -> FlightLessons:
        """Return the lessons after `row_s` [s] on a leg, now at `here`, about its way of climbing: first, or along it.

        A leg on which the two hardly differ tells nothing.
        """
        if abs(leg.rise_m) < TELLING_M or not leg.run_m > 0.0:
            return self
        run = 1.0 - math.dist(here[:2], leg.end[:2]) / leg.run_m
        first = min(run * leg.moving_s / leg.vertical_s, 1.0)  # share of the height if it climbs at its full rate
        if run < EARLIEST_SHARE or first - run < TELLING_SHARE:
            return self
        if (here.height_m - leg.begin.height_m) / leg.rise_m > 0.5 * (first + run):
            return self._replace(climbed_first_s=self.climbed_first_s + row_s)
        return self._replace(climbed_along_s=self.climbed_along_s + row_s)

    def with_wind(self, wind: Wind | None, row_s: float) -> FlightLessons:
        """Return the lessons with the wind, as the autopilot estimates it, averaged over a minute.

        row_s : time since the row before [s]; a wind of None changes nothing.
        """
        if wind is None:
            return self
        if not self.is_wind_told:
            return self._replace(wind_north_ms=wind.north_ms, wind_east_ms=wind.east_ms)
        share = 1.0 - math.exp(-row_s / WIND_TAU_S)
        return self._replace(
            wind_north_ms=self.wind_north_ms + share * (wind.north_ms - self.wind_north_ms),
            wind_east_ms=self.wind_east_ms + share * (wind.east_ms - self.wind_east_ms),
        )

    def with_power(
        self, powers: Powers, airspeed_ms: float, columns: Array, power_W: float, told_s: float
    ) -> FlightLessons:
        """Return the lessons after `told_s` [s] in which the aircraft flew at an airspeed [m/s] with a power [W].

        columns : the terms of the power (`powers.terms`). Beyond the learned airspeeds the law is extrapolated, so that
        its error there must not count as a payload: it is learned by itself. While the level is not known at all, also
        such a row counts for the level.
        """
        beyond, (level, _) = float(beyond_learned(powers, np.asarray(airspeed_ms))), self.power.level(powers)
        if not beyond > 0.0 or not 0.0 < level < math.inf:
            return self._replace(power=self.power.after(level_of(powers, columns, power_W), told_s, powers.row_sd))
        kept = math.exp(-told_s / LEVEL_TAU_S)
        excess = min(max(math.log(power_W / float(power(powers, columns, level))), -MOST_EXCESS), MOST_EXCESS)
        return self._replace(
            beyond_s=kept * self.beyond_s + told_s,
            beyond_sum_s=kept * self.beyond_sum_s + told_s * beyond,
            excess_sum_s=kept * self.excess_sum_s + told_s * excess,
        )

    def with_another_load(self) -> FlightLessons:
        """Return the lessons after a payload was taken up or set down."""
        return self._replace(power=self.power.with_another_load())

    def excess_beyond(self, powers: Powers) -> float:
        """Return how much more power than the law says is flown beyond the learned airspeeds.

        It is ln of the ratio, for each unit of `powers.beyond_learned`; the prior is 0 within EXCESS_SD.
        """
        if not self.beyond_s > 0.0:
            return 0.0
        beyond, excess = self.beyond_sum_s / self.beyond_s, self.excess_sum_s / self.beyond_s
        noise = powers.row_sd**2 * mean_of_rows(self.beyond_s) + WIND_SD**2
        return EXCESS_SD**2 * beyond * excess / (EXCESS_SD**2 * beyond**2 + noise)

    def timing(self, leg: Leg) -> Timing:
        """Return the belief about the timing of such a leg: short and long legs have one each."""
        return self.short if leg.moving_s < SHORT_LEG_S else self.long

    def expected_s(self, leg: Leg) -> float:
        """Return how long such a leg and the wait at its end are expected to take [s]."""
        stretch, speeding = self.timing(leg).factors
        return stretch * leg.moving_s + speeding * leg.fastest_ms + leg.hold_s

    @property
    def wind(self) -> tuple[float, float]:
        """Return the velocity of the air north and east [m/s]; still air where nobody measures it."""
        return (self.wind_north_ms, self.wind_east_ms) if self.is_wind_told else (0.0, 0.0)

    @property
    def is_wind_told(self) -> bool:
        """Return True if the autopilot has told its estimate of the wind."""
        return math.isfinite(self.wind_north_ms)

    @property
    def wind_sd_ms(self) -> float:
        """Return the sd of a component of the wind [m/s]; a wind that nobody measures may blow from any side."""
        return WIND_SD_MS if self.is_wind_told else UNTOLD_WIND_SD_MS
