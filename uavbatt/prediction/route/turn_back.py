"""The turn-back: how long the aircraft may fly on and still come home, from the draws of the forecast itself.

Each draw (battery, power level, wind) flies on, turns at some instants t, and flies home as its autopilot does. On the
way home the smallest distance of the voltage above the cut-off is noted, in each step under the highest power of gusts.
The distance of the charge from the least one counts in the same way, because that ends a flight too. A draw's turn-back
is the last t before its end at which that distance is not negative.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.prediction.route.ahead import Ahead, HomeFrom
from uavbatt.prediction.route.legs import legs_table
from uavbatt.prediction.route.load import (
    RouteLoad,
    airspeed_bends,
    airspeed_slopes,
    factors,
    fast_shares,
    roughness,
    wind_errors_ms,
)
from uavbatt.prediction.route.pieces import Column, LegTiming, Pieces, waiting
from uavbatt.prediction.simulation import sampling
from uavbatt.prediction.simulation.draws import Draws, Source, source_of
from uavbatt.prediction.simulation.long_steps import STEP_S, above_cutoff_V, step_draws
from uavbatt.prediction.simulation.time_to_end import SOC_IN_CELL_V

TURNS, CROWDED = 16, 1.5  # number of instants; early ones are closer together
CLIMB_STEPS = 3  # least steps of a climb, because the sag is deepest at its end
FASTEST_CLIMB_MS = 0.3
TURN_STEPS = 2  # least steps of a turn in which the aircraft speeds up
ROUGH = 1.0  # sds that the highest mean over 5 s, which is judged, lies above the mean


class Turning(NamedTuple):
    """Turning holds draws that turn at instants `turn_at_s` [s], `at_turn` [turns, draws] after flying `flown`.

    load, scenario : the powers, the level and the scenario [draws] of each draw on the way home
    homes_from : the legs home from any place, of each possible way home; the draws fly them in turn
    least_soc : the charge [draws] at which a flight ends, as it does at the cut-off
    """

    at_turn: Draws
    turn_at_s: Array
    flown: Ahead
    load: RouteLoad
    scenario: Array
    way: LegTiming
    homes_from: Sequence[HomeFrom]
    least_soc: Array

    @property
    def now(self) -> Turning:
        """Return only the first instant, in which the aircraft turns now."""
        return self._replace(at_turn=self.at_turn.of(slice(1)), turn_at_s=self.turn_at_s[:1])


class TurnBack(NamedTuple):
    """TurnBack says how far above cut-off and least charge each draw stayed on its way home after a turn."""

    turn_at_s: Array  # [turns] from now
    above_V: Array  # [turns, draws]
    home_soc: Array  # [draws] at touchdown after turning now


class Homewards(NamedTuple):
    """Homewards holds ways home in equally many steps: lengths [s], middle powers [W], shares of fast flight.

    A way that is over repeats its last step with a length of 0 and no roughness, so that nothing changes any more.

    slopes, bends : change of the logarithm of the power with the airspeed [per m/s] and with its square
    """

    length_s: Array  # [steps, turns, ways]
    power_W: Array
    fast_shares: Array
    slopes: Array
    bends: Array
    rough: Array  # relative sd of the power within the step

    def at(self, k: int, turns: Column) -> Homewards:
        """Return step `k` of the ways home after these turns, for each draw: [turns, draws]."""
        ways = np.arange(sampling.DRAWS) % self.length_s.shape[2]
        return Homewards(*(column[k][turns[:, None], ways] for column in self))

    def drawn_W(self, scenarios: Array) -> Array:
        """Return the power that each draw flies with; `scenarios` as in `_fly_home`."""
        levels, fast, _, wind_ms = scenarios
        _, power_W, fast_share, slope, bend, _ = self
        return np.asarray(power_W * levels * fast**fast_share * np.exp((slope + bend * wind_ms) * wind_ms))


def turn_instants(longest_s: float) -> Array:
    """Return the instants within `longest_s` [s] at which a turn home is simulated."""
    return np.asarray(longest_s * np.linspace(0.0, 1.0, TURNS) ** CROWDED)


def fly_home(asked: Turning) -> TurnBack:
    """Simulate the ways home after turning at each instant, and return how far above its end each draw stays."""
    home = _homewards(asked.flown, asked.turn_at_s, asked.load, asked.way, asked.homes_from)
    scenarios = np.vstack([factors(asked.load), wind_errors_ms(asked.way.wind_sd_ms)])[:, asked.scenario]
    return _fly_home(asked, home, scenarios)


def _fly_home(asked: Turning, home: Homewards, scenarios: Array) -> TurnBack:
    """Return what comes of the ways `home`.

    scenarios : factors of level, fast flight and time, and the error of the wind [m/s], of each draw [4, draws]
    """
    at_turn, turn_at_s, stretch = asked.at_turn, asked.turn_at_s, scenarios[2]
    steps = np.count_nonzero(home.length_s > 0.0, axis=0).max(axis=1)
    normals = sampling.wander_home(int(steps.max()))
    least_V, soc = np.full(at_turn.bias_V.shape, np.inf), np.zeros(at_turn.bias_V.shape)
    flying = np.arange(turn_at_s.size)  # the turns whose ways are not over; their lengths differ
    for k in range(int(steps.max()) + 1):
        is_asked = _is_asked(least_V, has_charge=bool((at_turn.state.soc[0] >= 0.0).any()))[flying]
        if not is_asked.all():
            flying, at_turn = flying[is_asked], at_turn.of(is_asked)
        is_down = steps[flying] <= k
        if is_down.any():
            down, landed = flying[is_down], at_turn.of(is_down)
            power_W = home.at(max(k - 1, 0), down).drawn_W(scenarios)
            least_V[down] = np.minimum(least_V[down], _above_V(landed, source_of(landed), power_W, asked.least_soc))
            soc[down] = landed.state.soc
            flying, at_turn = flying[~is_down], at_turn.of(~is_down)
        if not flying.size:
            break
        at, now = source_of(at_turn), home.at(k, flying)
        power_W = now.drawn_W(scenarios)
        above_V = _above_V(at_turn, at, power_W * (1.0 + ROUGH * now.rough), asked.least_soc)
        least_V[flying] = np.minimum(least_V[flying], above_V)
        at_turn = step_draws(at_turn, at, power_W, now.length_s * stretch, normals[k % len(normals)])
    return TurnBack(turn_at_s, least_V, np.maximum(soc[0], 0.0))


def _is_asked(least_V: Array, *, has_charge: bool) -> Column:
    """Return True for each turn [turns] that is simulated on, while a draw comes home.

    From the other turns, and from the turn before each of them, no draw comes home, so that no crossing lies there
    (`last_crossing`). The first turn is simulated for its charge, too: `has_charge` if a draw has any left.
    """
    comes_home = np.asarray((least_V >= 0.0).any(axis=1))
    return np.asarray(comes_home | np.concatenate([[has_charge], comes_home[:-1]]))


def _above_V(draws: Draws, at: Source, power_W: Array, least_soc: Array) -> Array:
    """Return the height above the end of flight: above the cut-off, or above the least charge where that is nearer."""
    above_least_V = (draws.state.soc - least_soc) * SOC_IN_CELL_V * draws.installation.cells
    return np.asarray(np.minimum(above_cutoff_V(draws, at, power_W), above_least_V))


def _homewards(
    flown: Ahead, turn_at_s: Array, load: RouteLoad, way: LegTiming, homes_from: Sequence[HomeFrom]
) -> Homewards:
    """Return all ways home from where the aircraft is at each instant."""
    legs = [home_from(point) for point in flown.points(turn_at_s) for home_from in homes_from]
    pieces, leg_of = way.pieces_with_leg(legs_table([leg for those in legs for leg in those]))
    way_of = np.repeat(np.arange(len(legs)), [len(those) for those in legs])[leg_of]
    if not pieces.length_s.size:  # already down at home
        pieces, way_of = waiting(flown.begin, 0.0), np.zeros(1, int)
    pieces, way_of = _in_steps(pieces, way_of)
    there = replace(load, ahead=Ahead(flown.begin, pieces))
    slopes = airspeed_slopes(there)
    bends = airspeed_bends(there, slopes, way.wind_sd_ms)
    rough = roughness(there, slopes, math.hypot(*way.wind))
    told = np.stack([pieces.length_s, there.piece_W, fast_shares(there), slopes, bends, rough])
    counts = np.bincount(way_of, minlength=len(legs))
    ends = np.cumsum(counts)
    step = np.arange(np.max(counts))[:, None]
    is_flown, index = step < counts, np.minimum(ends - counts + step, ends - 1)
    length_s, *others, rough = told[:, index]
    columns = (np.where(is_flown, length_s, 0.0), *others, np.where(is_flown, rough, 0.0))
    return Homewards(*(column.reshape(step.size, turn_at_s.size, len(homes_from)) for column in columns))


def _in_steps(pieces: Pieces, way_of: Column) -> tuple[Pieces, Column]:
    """Return the pieces and the way home of each, cut into steps short enough to show the sag of the voltage."""
    least = np.where(pieces.climb_ms > FASTEST_CLIMB_MS, CLIMB_STEPS, np.where(pieces.gained_ms > 0.0, TURN_STEPS, 1))
    count = np.maximum(np.ceil(pieces.length_s / STEP_S).astype(int), least)
    pieces = pieces._replace(length_s=pieces.length_s / count)
    return Pieces(*(np.repeat(column, count, axis=0) for column in pieces)), np.repeat(way_of, count)


def turn_back_times(asked: TurnBack, end_s: Array) -> Array:
    """Return the last time at which each draw can turn back [s], which ends at `end_s`; 0 if it is too late already."""
    alive = asked.turn_at_s[:, None] <= end_s
    return last_crossing(asked.turn_at_s, np.where(alive, asked.above_V, -np.abs(asked.above_V)))


def last_crossing(at_s: Array, height: Array) -> Array:
    """Return the last time at which each column of `height` [times, draws] is not negative; 0 where none is."""
    fits = height >= 0.0
    last = at_s.size - 1 - np.argmax(fits[::-1], axis=0)
    after = np.minimum(last + 1, at_s.size - 1)
    column = np.arange(height.shape[1])
    above, below = height[last, column], height[after, column]
    share = np.where(after > last, above / np.maximum(above - below, 1e-9), 0.0)
    return np.where(fits.any(axis=0), at_s[last] + np.clip(share, 0.0, 1.0) * (at_s[after] - at_s[last]), 0.0)
