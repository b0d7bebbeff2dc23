"""The load to come, learned from how aircraft flew before.

With a vehicle file: each past flight is used from the point that corresponds to the present one (half by time since
take-off, half by state of charge). Its power is scaled half-way to this flight's own, or fully if this flight differs
more from all of them than flights of one aircraft usually do. By how much this flight differs is the median over its
half minutes, so that a payload set down or a tank emptied at another time does not count. A past flight counts more if
this flight has been similar in its last ten minutes. It counts without its landing, because the time left is that of a
flight that goes on. From then on it goes on as another past flight did from that charge. The errors on real flights are
in docs/scores.md.

A change of the power in flight, against all past flights, counts by what has been flown since (`power_change`).

Without a vehicle file: two flights of three end with a period of higher power (the way home, wind, the landing), which
begins anywhere in the rest; before it this flight is flown again, at its own power, with a wide spread. What it flew
before a load was set down does not come again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.battery.powers import UNKNOWN, Powers
from uavbatt.battery.vehicle_file import VehicleFile
from uavbatt.navigation import UNSTATED, ReturnSettings
from uavbatt.prediction.load.power_change import REMEMBERED_BLOCKS, last_change, since_set_down
from uavbatt.prediction.load.power_history import LOWEST_POWER_W, MEAN_TAU_S, PowerHistory
from uavbatt.prediction.load.rising import BLOCK_S, RISING_SD
from uavbatt.prediction.load.scenarios import ConstantLoad, FlightPoint, Load, Scenarios, equal_levels, flown_again

LENGTH_S, GRID_S = 3600.0, 5.0
STITCHES = 3
SHORTEST_REST_S = 60.0
OWN_SCALING = 0.5
LEAST_USUAL, USUAL_SDS = 0.1, 2.5  # nine of ten Matrice 100 flights are within 0.1 of the median of the others
LEAST_MEAN, LEAST_SHOWN = 0.1, 0.5  # of a past flight's mean: dropouts and glides do not scale
MOST_TYPICAL = 1.5  # times this flight's own power: the horizon, twice what is typical, must hold its end
OWN_SPREAD, FEW_SPREAD, FEW_FLIGHTS = 0.05, 0.12, 8
LEVELS = 3
# The end of a past flight: its last minutes, or its last third if that needed more, as the minutes may be a descent.
# The mean of the whole flight would hold what was set down on the way: a payload, the load of a sprayer.
TAIL_S, TAIL_SHARE = 120.0, 1.0 / 3.0
LANDING_SHARE = 0.95  # of the mean power: a flight whose end needs less is landing
# Two flights of one route differ by 10 % from half minute to half minute, and by more if one is late. With 0.13 and
# 0.25 the Matrice 100 flights are predicted equally well.
ALIKE_BLOCKS, BLOCK_SD = 20, 0.18
FAR_APART = 9.0  # squared standard deviations
ANY_SHARE = 0.2  # of the weight goes to all flights equally: similar flights may differ later

SURGE_FACTORS = np.array([1.0, 1.12, 1.3])
SURGE_BEGINS = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
FLIGHT_SPREAD = 0.06
CHANGE_SD = 0.1  # a real change of a flight's load, as ln of the ratio


@dataclass(frozen=True, slots=True)
class LearnedLoad:
    """LearnedLoad holds past flights on one time grid from take-off: power [W] and charge, [flights, grid]."""

    power_W: Array
    soc: Array
    landed_s: Array
    mean_W: Array  # running mean power since take-off
    drawn_J: Array  # energy since take-off at each point of the grid, and one step behind its end: [flights, grid + 1]
    powers: Powers = UNKNOWN  # used if a route is known
    usual: ReturnSettings = UNSTATED  # speeds and heights of the way home where the vehicle states none

    def typical_W(self, now: FlightPoint) -> float:
        """Return the median of the flights' mean powers [W]; less for a flight that needs much less power."""
        return min(float(np.median(self.mean_W[:, -1])), MOST_TYPICAL * now.flight_W)

    def scenarios(self, now: FlightPoint, dt_s: float, steps: int) -> Scenarios:
        """Return every flight of the library from the point that corresponds to the present, at three power levels.

        Each is weighted by its similarity to this flight.
        """
        grid_s = GRID_S * np.arange(self.power_W.shape[1])
        ahead_s = dt_s * np.arange(steps)
        flights = self.power_W.shape[0]
        traces_W, mean_W, minute_W = np.empty((steps, flights)), np.empty(flights), np.empty(flights)
        for i in range(flights):
            by_time_s = min(now.since_take_off_s, self.landed_s[i] + 300.0)
            by_soc_s = float(np.interp(-now.soc, -self.soc[i], grid_s))
            start_s = 0.5 * by_time_s + 0.5 * by_soc_s
            mean_W[i] = max(np.interp(start_s, grid_s, self.mean_W[i]), LEAST_MEAN * self.mean_W[i, -1])
            traces_W[:, i] = np.interp(start_s + ahead_s, grid_s, self.power_W[i])
            minute_W[i] = np.mean(np.interp(start_s - np.arange(0.0, MEAN_TAU_S, GRID_S), grid_s, self.power_W[i]))
        own_W, past_W = self._blocks(now)
        change = last_change(own_W, past_W)
        if change.since:
            past_mean_W = past_W[:, -change.since :].mean(axis=1)
            traces_W *= own_W[-change.since :].mean() / np.maximum(past_mean_W, LOWEST_POWER_W)
        else:
            ratio = np.exp(np.median(ln_ratio(own_W, past_W), axis=1)) if own_W.size else now.flight_W / mean_W
            traces_W *= own_scales(ratio, now.since_take_off_s) * late_scale(now, minute_W / mean_W)
        spread = OWN_SPREAD if flights >= FEW_FLIGHTS else FEW_SPREAD
        levels = equal_levels(math.hypot(spread, RISING_SD) if change.is_rising else spread, LEVELS)
        power_W = (traces_W[:, :, None] * levels).reshape(steps, -1)
        alike = likeness(own_W[-ALIKE_BLOCKS:], past_W[:, -ALIKE_BLOCKS:])
        weight = np.repeat(alike / LEVELS, LEVELS)
        return Scenarios(np.maximum(power_W, LOWEST_POWER_W), weight, np.full(steps, dt_s))

    def _blocks(self, now: FlightPoint) -> tuple[Array, Array]:
        """Return the power of each block of this flight [blocks] and of the past flights [flights, blocks].

        There are none if nothing can be compared: before the first block, and after a gap, which shifts the powers.
        """
        flown, flights = now.recent.history, self.power_W.shape[0]
        own_W = flown.blocks_W(BLOCK_S, REMEMBERED_BLOCKS)
        if own_W.size == 0 or now.since_take_off_s - flown.length_s - flown.open_s > BLOCK_S:
            return np.empty(0), np.empty((flights, 0))
        edges_s = flown.length_s - BLOCK_S * np.arange(own_W.size, -1, -1)
        at_s = GRID_S * np.arange(self.drawn_J.shape[1])
        past_J = [np.interp(edges_s, at_s, drawn_J) for drawn_J in self.drawn_J]
        past_J += np.maximum(edges_s - at_s[-1], 0.0) * self.power_W[:, -1:]  # beyond the grid as at its end
        return own_W, np.diff(past_J) / BLOCK_S


def ln_ratio(own_W: Array, past_W: Array) -> Array:
    """Return the power of each block of this flight over that of past flights, as ln, [flights, blocks].

    own_W : mean power of each block of this flight [W], [blocks]; past_W : of each past flight [W], [flights, blocks].
    """
    return np.asarray(np.log(np.maximum(own_W, LOWEST_POWER_W) / np.maximum(past_W, LOWEST_POWER_W)))


def likeness(own_W: Array, past_W: Array) -> Array:
    """Return the weights [flights] of past flights by the similarity of their power over time to that of this flight.

    own_W : mean power of each block of this flight [W], [blocks]; past_W : of each past flight [W], [flights, blocks].
    Only the shape counts: the median difference in level is removed, because a payload says nothing about the route.
    The remaining log ratios are assumed independent and normal with sd BLOCK_SD. One block counts FAR_APART at most, so
    that a motor that stops at another time does not decide alone. The sum of the weights is 1; without blocks all are
    equal.
    """
    if own_W.size == 0:
        return np.full(past_W.shape[0], 1.0 / past_W.shape[0])
    ratio = ln_ratio(own_W, past_W)
    apart = (ratio - np.median(ratio, axis=1, keepdims=True)) / BLOCK_SD
    misfit = np.sum(np.minimum(np.square(apart), FAR_APART), axis=1)
    weight = np.exp(-0.5 * (misfit - misfit.min()))
    return np.asarray((1.0 - ANY_SHARE) * weight / weight.sum() + ANY_SHARE / weight.size)


def own_scales(ratio: Array, since_take_off_s: float) -> Array:
    """Return the factors on the powers of past flights [flights], by this flight's power over theirs so far [flights].

    Half of the usual difference between flights of one aircraft is chance, and more of it in the first minutes. A
    flight that differs more from all of them has another payload, or wind, and keeps its own power.
    """
    early = 1.0 + MEAN_TAU_S / max(since_take_off_s, GRID_S)
    real_share = _real_share(float(np.median(np.log(ratio))), early * _usual_difference(ratio))
    return np.asarray(ratio ** (OWN_SCALING + (1.0 - OWN_SCALING) * real_share))


def late_scale(now: FlightPoint, shown: Array) -> float:
    """Return the factor on the power to come if the last minute needed more than past flights did at this point.

    The cause is a payload taken up or a head wind, which the mean of the whole flight would show late. A minute of less
    power is a descent or a landing, and changes nothing.

    shown : what a minute at this place took over the mean of its flight so far, [flights].
    """
    if now.since_take_off_s < 2.0 * MEAN_TAU_S:
        return 1.0
    shown = np.maximum(shown, LEAST_SHOWN)
    away = math.log(max(now.recent.mean_W, LOWEST_POWER_W) / now.flight_W) - float(np.median(np.log(shown)))
    return math.exp(_real_share(away, _usual_difference(shown)) * away) if away > 0.0 else 1.0


def _usual_difference(ratio: Array) -> float:
    """Return the difference of power, as ln of the ratio, that flights of one aircraft usually show at one place."""
    return math.hypot(LEAST_USUAL, USUAL_SDS * float(np.std(np.log(ratio))))


def _real_share(away: float, usual: float) -> float:
    """Return the share of a difference of power that is real: 0 up to the usual difference, 1 from twice that on."""
    return min(max(abs(away) / usual - 1.0, 0.0), 1.0)


def learned_load(file: VehicleFile) -> LearnedLoad:
    """Return the flights of a vehicle file on one time grid, each flown on after its landing as other flights were."""
    grid_s = np.arange(0.0, LENGTH_S, GRID_S)
    raw = [_before_landing(*np.array([t.time_s, t.power_W, t.soc])) for t in file.traces]
    power_W, soc = np.empty((len(raw), grid_s.size)), np.empty((len(raw), grid_s.size))
    order = np.random.default_rng(len(raw)).permutation(len(raw))
    for i, (time_s, watts, charge) in enumerate(raw):
        for joined in range(1, STITCHES + 1):
            other = raw[int(order[(i + joined) % len(raw)])]
            time_s, watts, charge = _stitched(time_s, watts, charge, *other)
        tail_s = (time_s[-1] - TAIL_S, (1.0 - TAIL_SHARE) * time_s[-1])
        tail_W = max(float(np.mean(watts[time_s >= begin_s])) for begin_s in tail_s)
        power_W[i] = np.interp(grid_s, time_s, watts, right=tail_W)
        soc[i] = np.interp(grid_s, time_s, charge)
        soc[i] -= 1e-9 * np.arange(grid_s.size)  # strictly falling, so that a charge has one time
    mean_W = np.cumsum(power_W, axis=1) / (np.arange(grid_s.size) + 1.0)
    drawn_J = GRID_S * np.cumsum(np.insert(power_W, 0, 0.0, axis=1), axis=1)
    landed_s = np.array([t.time_s[-1] for t in file.traces])
    return LearnedLoad(power_W, soc, landed_s, mean_W, drawn_J, file.powers or UNKNOWN, file.usual)


def _before_landing(time_s: Array, watts: Array, charge: Array) -> tuple[Array, Array, Array]:
    """Return a past flight, with falling charge, up to its landing: at most TAIL_S of less power than usual.

    Crews land with charge left. A flight that goes on does not sink there.
    """
    flown = (watts >= LANDING_SHARE * np.mean(watts)) | (time_s < time_s[-1] - TAIL_S)
    end = int(np.flatnonzero(flown)[-1]) + 1
    return time_s[:end], watts[:end], np.minimum.accumulate(charge[:end])


def _stitched(
    time_s: Array, watts: Array, charge: Array, next_s: Array, next_W: Array, next_charge: Array
) -> tuple[Array, Array, Array]:
    """Return the first flight, continued by the next one from the charge at which the first landed."""
    later = next_charge < charge[-1]
    if later.sum() < 2 or next_s[-1] - next_s[later][0] < SHORTEST_REST_S:
        return time_s, watts, charge
    moved_s = next_s[later] - next_s[later][0] + time_s[-1] + GRID_S
    return (
        np.concatenate([time_s, moved_s]),
        np.concatenate([watts, next_W[later]]),
        np.concatenate([charge, next_charge[later]]),
    )


def stated_power(load: Load) -> tuple[float, float] | None:
    """Return the lowest and highest power [W] over a minute that a load states; None for one that states none."""
    if isinstance(load, ConstantLoad):
        return load.power_W, load.power_W
    if not isinstance(load, LearnedLoad):
        return None
    window = int(MEAN_TAU_S / GRID_S)
    lowest_W, highest_W = math.inf, 0.0
    for watts, landed_s in zip(load.power_W, load.landed_s, strict=True):
        flown = watts[: max(int(landed_s / GRID_S), window)]
        means_W = np.convolve(flown, np.full(window, 1.0 / window), mode="valid")
        lowest_W, highest_W = min(lowest_W, float(means_W.min())), max(highest_W, float(means_W.max()))
    return lowest_W, highest_W


@dataclass(frozen=True, slots=True)
class UnknownAircraft:
    """UnknownAircraft expects of an unknown aircraft: power as recently, a surge that may come, a wide spread."""

    powers: Powers = UNKNOWN

    def typical_W(self, now: FlightPoint) -> float:
        """Return the mean power [W] since a load was set down, unless the last minute shows another; at least 1 W.

        The minutes of a flight differ by chance, and by much if its motor runs at intervals. A minute far above that is
        another load; a minute below it may be a descent.
        """
        return self._level_W(now, since_set_down(now.recent.history))

    def _level_W(self, now: FlightPoint, lighter: PowerHistory | None) -> float:
        """Return the same; lighter : the powers since a load was set down, None if none was."""
        flight_W = lighter.mean_W if lighter else now.flight_W
        by_chance = (lighter or now.recent.history).minute_sd
        away = math.log(max(now.recent.mean_W, LOWEST_POWER_W) / flight_W)
        share = CHANGE_SD**2 / (CHANGE_SD**2 + by_chance**2)
        if away > 0.0:
            share += (1.0 - share) * _real_share(away, math.hypot(LEAST_USUAL, USUAL_SDS * by_chance))
        return max(flight_W * math.exp(share * away), LOWEST_POWER_W)

    def scenarios(self, now: FlightPoint, dt_s: float, steps: int) -> Scenarios:
        """Return every level with every surge factor and every place in the rest of the flight where a surge begins."""
        lighter = since_set_down(now.recent.history)
        flown = lighter or now.recent.history
        by_chance = flown.minute_sd
        known_sd = CHANGE_SD * by_chance / math.hypot(CHANGE_SD, by_chance)
        levels = self._level_W(now, lighter) * equal_levels(math.hypot(FLIGHT_SPREAD, known_sd), LEVELS)
        share = (np.arange(steps) + 0.5) * dt_s / now.left_s
        surging = share[:, None] >= SURGE_BEGINS
        shape = np.where(surging[:, None, :], SURGE_FACTORS[None, :, None], 1.0).reshape(steps, -1)
        power_W = (shape[:, :, None] * levels).reshape(steps, -1)
        weight = np.full(power_W.shape[1], 1.0 / power_W.shape[1])
        return flown_again(Scenarios(power_W, weight, np.full(steps, dt_s)), flown)
