"""Legs become pieces: some seconds of one kind of flight each, with airspeed and climb, as columns.

A leg gives two pieces, its movement and the wait at its end. A route has hundreds of them and the wind changes with
every row, so that they are worked out as columns at every forecast.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.model import Array
from uavbatt.prediction.flight_lessons import SHORT_LEG_S, Timing
from uavbatt.prediction.route_legs import LegsTable, Phase, Point

Column = NDArray[Any]
CURVE = 1.5  # a leg so many times longer than the straight line is a curve: the wind meets it from all sides


class Pieces(NamedTuple):
    """Pieces holds the pieces of a way in order, each field [pieces]."""

    length_s: Array
    airspeed_ms: Array
    climb_ms: Array
    taking_off: Column  # bool
    landing: Column  # bool
    seq: Array  # of the mission item; -1 on the way home
    end: Array  # [pieces, 3]: where they end, as a `Point`
    length_sd_s: Array

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
    return Pieces(np.array([length_s]), none, none, no, no, np.array([-1.0]), np.array([at]), none)


class Way(NamedTuple):
    """Way turns legs into pieces, by the timing of short and long legs and the velocity of the air [m/s]."""

    short: Timing = Timing()
    long: Timing = Timing()
    wind: tuple[float, float] = (0.0, 0.0)

    def pieces(self, leg: LegsTable) -> Pieces:
        """Return the pieces of these legs in order."""
        found, _ = self.pieces_with_leg(leg)
        return found

    def pieces_with_leg(self, leg: LegsTable) -> tuple[Pieces, Column]:
        """Return the pieces of these legs in order, and the index of the leg of each."""
        moving_s, sd_s = self._moving_s(leg)
        with np.errstate(invalid="ignore", divide="ignore"):
            climb_ms = np.where(moving_s > 0.0, leg.rise_m / moving_s, 0.0)
            air_ms = np.where(moving_s > 0.0, self._airspeed_ms(leg, moving_s), np.hypot(*self.wind))
        none, landing = np.zeros_like(moving_s), leg.phase == Phase.LANDING
        moved = Pieces(moving_s, air_ms, climb_ms, leg.phase == Phase.TAKE_OFF, landing, leg.seq, leg.end, sd_s)
        held = moved._replace(
            length_s=leg.hold_s, airspeed_ms=none + np.hypot(*self.wind), climb_ms=none,
            taking_off=np.zeros_like(landing), length_sd_s=none,
        )  # fmt: skip
        both = Pieces(
            *(np.stack(pair, axis=1).reshape(-1, *pair[0].shape[1:]) for pair in zip(moved, held, strict=True))
        )
        last = np.flatnonzero(both.length_s > 0.0)
        return both.of(last), last // 2

    def _moving_s(self, leg: LegsTable) -> tuple[Array, Array]:
        """Return how long each movement takes, and its sd [s]."""
        planned_s, speed_ms, is_short = leg.moving_s, leg.fastest_ms, leg.moving_s < SHORT_LEG_S
        (short, short_speeding), (long, long_speeding) = self.short.factors, self.long.factors
        stretch, speeding = np.where(is_short, short, long), np.where(is_short, short_speeding, long_speeding)
        moving_s = np.maximum(stretch * planned_s + speeding * speed_ms, 0.5 * planned_s)
        sd_s = np.where(is_short, self.short.sd(planned_s, speed_ms), self.long.sd(planned_s, speed_ms))
        return moving_s, sd_s

    def _airspeed_ms(self, leg: LegsTable, moving_s: Array) -> Array:
        """Speed through the air; on a curve the wind comes from everywhere."""
        north_ms, east_ms = leg.north_m / moving_s - self.wind[0], leg.east_m / moving_s - self.wind[1]
        on_curve_ms = np.hypot(leg.run_m / moving_s, np.hypot(*self.wind))
        return np.where(leg.run_m > CURVE * np.hypot(leg.north_m, leg.east_m), on_curve_ms, np.hypot(north_ms, east_ms))
