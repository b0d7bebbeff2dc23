"""Legs become pieces: some seconds of one kind of flight each, with airspeed and climb, as columns.

A leg gives up to four pieces: the aircraft turns and speeds up, climbs, flies on, and waits at its end. A route has
hundreds of them and the wind changes with every row, so that they are worked out as columns at every forecast.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.model import Array
from uavbatt.battery.powers import TURN_S
from uavbatt.prediction.route.flight_lessons import SHORT_LEG_S, WIND_SD_MS, Timing
from uavbatt.prediction.route.legs import LegsTable, Phase, Point

Column = NDArray[Any]
THROUGH = 0.5  # cosine of 60 degrees: before a sharper corner the aircraft stops
CURVE = 1.5  # a leg so many times longer than the straight line is a curve


class Pieces(NamedTuple):
    """Pieces holds the pieces of a way in order, each field [pieces]."""

    length_s: Array
    airspeed_ms: Array
    climb_ms: Array
    taking_off: Column  # bool
    landing: Column  # bool
    seq: Array  # number of the mission item; -1 on the way home
    end: Array  # [pieces, 3]: where they end, as a `Point`
    length_sd_s: Array
    gained_ms: Array  # ground speed gained from rest in this piece; 0 if it flies on
    round_wind_ms: Array  # wind that comes from every side in turn, on a curve; 0 on a straight leg

    @property
    def ends_s(self) -> Array:
        """Return when each piece ends [s] after the first begins."""
        return np.cumsum(self.length_s)

    def of(self, which: Column | slice) -> Pieces:
        """Return only the pieces `which`."""
        return Pieces(*(column[which] for column in self))


def joined(*several: Pieces) -> Pieces:
    """Return the pieces one after the other."""
    return Pieces(*map(np.concatenate, zip(*several, strict=True)))


def waiting(at: Point, length_s: float) -> Pieces:
    """Return one piece of `length_s` [s] in which the aircraft stays where it is."""
    none, no = np.zeros(1), np.zeros(1, bool)
    return Pieces(np.array([length_s]), none, none, no, no, np.array([-1.0]), np.array([at]), none, none, none)


class LegTiming(NamedTuple):
    """LegTiming turns legs into pieces, by the timing of short and long legs and the velocity of the air [m/s].

    climbs_first : the aircraft climbs and sinks at its full rate as a leg begins, and then flies on level; else the
    climb lasts as long as the leg; wind_sd_ms : of a component of the wind.
    """

    short: Timing = Timing()
    long: Timing = Timing()
    wind: tuple[float, float] = (0.0, 0.0)
    climbs_first: bool = False
    wind_sd_ms: float = WIND_SD_MS

    def pieces(self, leg: LegsTable, is_flying: bool = False) -> Pieces:
        """Return the pieces of these legs in order; `is_flying` if the aircraft is on the first one already."""
        found, _ = self.pieces_with_leg(leg, is_flying)
        return found

    def pieces_with_leg(self, leg: LegsTable, is_flying: bool = False) -> tuple[Pieces, Column]:
        """Return the pieces of these legs in order, and the index of the leg of each."""
        moving_s, sd_s = self._moving_s(leg)
        with np.errstate(invalid="ignore", divide="ignore"):
            air_ms = np.where(moving_s > 0.0, self._airspeed_ms(leg, moving_s), np.hypot(*self.wind))
            speed_ms = np.where(moving_s > 0.0, leg.run_m / moving_s, 0.0)
        none, landing = np.zeros_like(moving_s), leg.phase == Phase.LANDING
        gained_ms = np.where(_stops_before(leg), speed_ms, 0.0)
        if is_flying:
            gained_ms[:1] = 0.0
        speeding_s = np.where(gained_ms > 0.0, np.minimum(moving_s, TURN_S), 0.0)
        round_ms = np.where(_is_curve(leg), np.hypot(*self.wind), 0.0)
        whole = Pieces(
            moving_s, air_ms, none, leg.phase == Phase.TAKE_OFF, landing, leg.seq, leg.end, sd_s, none, round_ms
        )
        held = whole._replace(
            length_s=leg.hold_s, airspeed_ms=none + np.hypot(*self.wind), taking_off=np.zeros_like(landing),
            length_sd_s=none, round_wind_ms=none,
        )  # fmt: skip
        edges_s = [none, speeding_s, moving_s]
        climbing_s = moving_s
        if self.climbs_first:
            climbing_s = np.where(leg.run_m > 0.0, np.minimum(leg.vertical_s, moving_s), moving_s)
            edges_s.insert(2, np.maximum(speeding_s, climbing_s))
        moved = [_cut(leg, whole, climbing_s, begin_s, end_s) for begin_s, end_s in pairwise(edges_s)]
        moved[0] = moved[0]._replace(gained_ms=gained_ms)
        kinds = (*moved, held)
        every = Pieces(*(np.stack(c, axis=1).reshape(-1, *c[0].shape[1:]) for c in zip(*kinds, strict=True)))
        flown = np.flatnonzero(every.length_s > 0.0)
        return every.of(flown), flown // len(kinds)

    def _moving_s(self, leg: LegsTable) -> tuple[Array, Array]:
        """Return how long each movement takes, and its sd [s]."""
        planned_s, speed_ms, is_short = leg.moving_s, leg.fastest_ms, leg.moving_s < SHORT_LEG_S
        (short, short_speeding), (long, long_speeding) = self.short.factors, self.long.factors
        stretch, speeding = np.where(is_short, short, long), np.where(is_short, short_speeding, long_speeding)
        moving_s = np.maximum(stretch * planned_s + speeding * speed_ms, 0.5 * planned_s)
        sd_s = np.where(is_short, self.short.sd(planned_s, speed_ms), self.long.sd(planned_s, speed_ms))
        return moving_s, sd_s

    def _airspeed_ms(self, leg: LegsTable, moving_s: Array) -> Array:
        """Return the speed through the air; on a curve, where the wind comes from every side, its root mean square."""
        north_ms, east_ms = leg.north_m / moving_s - self.wind[0], leg.east_m / moving_s - self.wind[1]
        on_curve_ms = np.hypot(leg.run_m / moving_s, np.hypot(*self.wind))
        return np.where(_is_curve(leg), on_curve_ms, np.hypot(north_ms, east_ms))


def _is_curve(leg: LegsTable) -> Column:
    """Return True for each leg that is much longer than the straight line."""
    return np.asarray(leg.run_m > CURVE * np.hypot(leg.north_m, leg.east_m))


def _cut(leg: LegsTable, whole: Pieces, climbing_s: Array, begin_s: Array, end_s: Array) -> Pieces:
    """Return the part of each leg's movement between two times [s] after it begins.

    whole : each leg's movement as one piece, without its climb; climbing_s : how long it climbs, from its begin on [s]
    """
    length_s = end_s - begin_s
    run, climbed = _share(end_s, whole.length_s), _share(np.minimum(end_s, climbing_s), climbing_s)
    rise_m = leg.rise_m * (climbed - _share(np.minimum(begin_s, climbing_s), climbing_s))
    left_m = np.stack([(1.0 - run) * leg.north_m, (1.0 - run) * leg.east_m, (1.0 - climbed) * leg.rise_m], axis=1)
    return whole._replace(
        length_s=length_s, climb_ms=_share(rise_m, length_s), end=leg.end - left_m,
        length_sd_s=_share(length_s, whole.length_s) * whole.length_sd_s,
    )  # fmt: skip


def _share(part: Array, of: Array) -> Array:
    """Return part / of; 0 where `of` is not positive."""
    return np.divide(part, of, out=np.zeros_like(of), where=of > 0.0)


def keeps_speed(north_m: Array, east_m: Array) -> Column:
    """Return True for each corner [parts - 1] of a way, by its parts north and east [parts], that is not sharp."""
    length_m = np.hypot(north_m, east_m)
    along_m2 = north_m[1:] * north_m[:-1] + east_m[1:] * east_m[:-1]
    return np.asarray(along_m2 > THROUGH * length_m[1:] * length_m[:-1])


def _stops_before(leg: LegsTable) -> Column:
    """Return True for each leg that begins from rest: after a wait, or after a sharp corner.

    A circle begins across the way to it, and may be left in any direction.
    """
    is_through = keeps_speed(leg.north_m, leg.east_m) & ~(leg.hold_s[:-1] > 0.0)
    is_curve = _is_curve(leg)
    is_through &= ~(is_curve[1:] | is_curve[:-1])
    return np.concatenate([np.ones(min(leg.run_m.size, 1), bool), ~is_through])
