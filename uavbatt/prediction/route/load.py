"""The load of a known route: the power over its pieces in scenarios of level, fast flight, timing and row noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.battery.powers import Powers, beyond_learned, power, terms, turning_power
from uavbatt.prediction.load.power_history import LOWEST_POWER_W
from uavbatt.prediction.load.scenarios import FlightPoint, Scenarios, stretches_s, swinging
from uavbatt.prediction.load.swings import Swings
from uavbatt.prediction.route.ahead import Ahead
from uavbatt.prediction.route.flight_lessons import WIND_SD_MS
from uavbatt.prediction.route.pieces import Pieces
from uavbatt.prediction.simulation import sampling
from uavbatt.records import Z90

SCENARIOS = 64
SLOW_MS, FAST_MS, STEEP_MS = 4.0, 10.0, 1.5  # between them flight changes from slow to fast, to which `fast_sd` applies
SIDES_RAD = (np.arange(8) + 0.5) * np.pi / 8.0  # half of a turn; the other half is its mirror image
GUSTS = 0.15  # sd of the airspeed over the wind speed, 40 m above open land: 1 / ln(40 m / 0.05 m) in EN 1991-1-4


@dataclass(frozen=True)
class RouteLoad:
    """RouteLoad flies the pieces to come with these powers, at a level known to `level_sd`, then hovers at home.

    excess : `FlightLessons.excess_beyond`
    """

    ahead: Ahead
    powers: Powers
    level: float
    level_sd: float
    excess: float = 0.0

    def typical_W(self, now: FlightPoint) -> float:
        """Return the mean power of the pieces to come [W], that of a hover where none is left; at least 1 W."""
        lengths_s = self.ahead.pieces.length_s
        if not lengths_s.sum() > 0.0:
            return max(self.level * self.powers.hover_W, LOWEST_POWER_W)
        return max(float(np.average(self.piece_W, weights=lengths_s)), LOWEST_POWER_W)

    @cached_property
    def piece_W(self) -> Array:
        """Return the middle power of each piece [W]."""
        gained_ms, flown_W = self.ahead.pieces.gained_ms, self.flown_W
        return np.where(gained_ms > 0.0, turning_power(self.powers, flown_W, gained_ms, self.level), flown_W)

    @cached_property
    def flown_W(self) -> Array:
        """Return the power of each piece [W] once its speed is gained."""
        pieces = self.ahead.pieces
        flown_W = power(self.powers, piece_terms(pieces, self.powers.induced_ms), self.level)
        on_curve = pieces.round_wind_ms > 0.0
        flown_W[on_curve] = self._curve_W(pieces.of(on_curve))
        return np.asarray(flown_W * np.exp(self.excess * beyond_learned(self.powers, pieces.airspeed_ms)))

    def _curve_W(self, pieces: Pieces) -> Array:
        """Return the power of each piece [W] on a curve: the mean over the sides from which the wind comes."""
        wind_ms = pieces.round_wind_ms[:, None]
        ground_ms = np.sqrt(np.maximum(pieces.airspeed_ms[:, None] ** 2 - wind_ms**2, 0.0))
        air_ms = np.hypot(ground_ms + wind_ms * np.cos(SIDES_RAD), wind_ms * np.sin(SIDES_RAD))
        columns = terms(air_ms, pieces.climb_ms[:, None], False, False, self.powers.induced_ms)
        return np.asarray(power(self.powers, columns, self.level).mean(axis=1))

    def scenarios(self, now: FlightPoint, dt_s: float, steps: int) -> Scenarios:
        """Return equally likely ways to fly the pieces, and a hover after them, with the noise of rows on them."""
        return self.scenarios_over(np.full(steps, dt_s))

    def scenarios_over(self, dt_s: Array) -> Scenarios:
        """Return the same as `scenarios` over steps of `dt_s` [steps]."""
        return swinging(self.steady(dt_s), self.noise)

    @property
    def noise(self) -> Swings:
        """Return the swings of the power from row to row within a leg."""
        return Swings(0.0, self.powers.row_sd)

    def steady(self, dt_s: Array) -> Scenarios:
        """Return the scenarios over steps of `dt_s` [steps] without the noise of rows."""
        levels, fast, stretch = factors(self)
        watts = np.append(self.piece_W, self.level * self.powers.hover_W)[:, None] * levels
        watts *= fast ** np.append(fast_shares(self), 0.0)[:, None]
        edges_s = stretches_s(dt_s)
        drawn_J = _energy_J(self.ahead.pieces.ends_s, watts, edges_s[:, None] / stretch) * stretch
        power_W = np.maximum(np.diff(drawn_J, axis=0) / np.diff(edges_s)[:, None], LOWEST_POWER_W)
        return Scenarios(power_W, np.full(SCENARIOS, 1.0 / SCENARIOS), dt_s)


def factors(load: RouteLoad) -> Array:
    """Return the factors on level, fast flight and time, [3, SCENARIOS], around 1."""
    sds = np.array([load.level_sd / load.level, load.powers.fast_sd, load.ahead.timing_sd])
    return np.asarray(np.exp(sds[:, None] * _normals()[:3]))


def wind_errors_ms(wind_sd_ms: float) -> Array:
    """Return by how much more the wind blows against the way than it is said to [m/s], [SCENARIOS]."""
    return np.asarray(wind_sd_ms * _normals()[3])


def _normals() -> Array:
    """Return the standard normals of level, fast flight, time and wind, [4, SCENARIOS]."""
    return sampling.whitened(SCENARIOS, 4, SCENARIOS)


def piece_terms(pieces: Pieces, induced_ms: float) -> Array:
    """Return the terms of the power (`powers.terms`) for each piece."""
    return terms(pieces.airspeed_ms, pieces.climb_ms, pieces.taking_off, pieces.landing, induced_ms)


def roughness(load: RouteLoad, slopes: Array, wind_ms: float) -> Array:
    """Return the relative sd of the power within each piece: of the rows, and of gusts where airspeed changes it."""
    return np.hypot(load.powers.row_sd, slopes * GUSTS * wind_ms)


def airspeed_slopes(load: RouteLoad) -> Array:
    """Return by how much more power, relatively, each piece asks when it is flown 1 m/s faster through the air."""
    return _faster(load, 1.0) - 1.0


def airspeed_bends(load: RouteLoad, slopes: Array, wind_sd_ms: float) -> Array:
    """Return how the logarithm of each piece's power bends upwards with the airspeed [per (m/s)²].

    The drag grows with the cube of the airspeed, so that a straight line is good for a wind that is nearly known. For
    another one the line is bent through the power in the highest head wind that is as likely as one in twenty.
    """
    if wind_sd_ms <= WIND_SD_MS:
        return np.zeros_like(slopes)
    head_ms = Z90 * wind_sd_ms
    return np.asarray((np.log(_faster(load, head_ms)) - slopes * head_ms) / head_ms**2)


def _faster(load: RouteLoad, more_ms: float) -> Array:
    """Return the power of each piece when it is flown `more_ms` [m/s] faster through the air, over its power."""
    pieces = load.ahead.pieces
    faster = replace(load, ahead=load.ahead._replace(pieces=pieces._replace(airspeed_ms=pieces.airspeed_ms + more_ms)))
    return np.asarray(faster.flown_W / load.flown_W)


def fast_shares(load: RouteLoad) -> Array:
    """Return how much each piece counts as fast flight or climb, 0..1; more beyond the airspeeds that were learned."""
    pieces = load.ahead.pieces
    fast = np.clip((pieces.airspeed_ms - SLOW_MS) / (FAST_MS - SLOW_MS), 0.0, 1.0)
    steep = np.clip(pieces.climb_ms / STEEP_MS, 0.0, 1.0)
    return np.hypot(np.maximum(fast, steep), beyond_learned(load.powers, pieces.airspeed_ms))


def _energy_J(ends_s: Array, watts: Array, at_s: Array) -> Array:
    """Return the energy drawn until `at_s` [times, scenarios] by `watts` [pieces + 1, scenarios]."""
    begins_s = np.concatenate([[0.0], ends_s])
    before_J = np.concatenate([np.zeros_like(watts[:1]), np.cumsum(watts[:-1] * np.diff(begins_s)[:, None], axis=0)])
    piece = np.searchsorted(ends_s, at_s.T, side="right").T  # times in ascending order are found in half the time
    column = np.arange(watts.shape[1])
    return np.asarray(before_J[piece, column] + watts[piece, column] * (at_s - begins_s[piece]))
