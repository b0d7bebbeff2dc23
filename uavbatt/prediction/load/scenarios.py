"""The load to come: the power until the end of the flight.

A load gives scenarios: power over time, each with a weight. They depend on the `FlightPoint` of now.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from statistics import NormalDist
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from uavbatt.battery.model import Array
from uavbatt.navigation import NOWHERE, Navigation
from uavbatt.prediction.load.power_history import LOWEST_POWER_W, PowerHistory, RecentLoad
from uavbatt.prediction.load.swings import Swings, swung
from uavbatt.prediction.load.waits import Waits, in_air_s

UNSHOWN, SHOWN_S = Swings(manoeuvres=0.15, gusts=0.10), 600.0  # swings of a flight that has just begun
STATED_SPREAD = 0.04  # relative sd of a power that the operator states
SCENARIOS = 9
SLOW_ROW_S = 5.0  # rows slower than this are judged one by one


class Scenarios(NamedTuple):
    """Scenarios holds the possible loads: true pack power [W], [steps, scenarios], from now on, each with a weight.

    `dt_s` [steps] are the lengths of the steps [s]. A step's power is that of the instant at which it begins, where its
    voltage is judged: the mean over `stretches_s` around it.
    """

    power_W: Array
    weight: Array
    dt_s: Array


class FlightPoint(NamedTuple):
    """FlightPoint holds a point of a flight: log time, time since take-off [s], charge, mean power [W], position.

    left_s : about the time to the end under a steady power [s].
    """

    time_s: float
    since_take_off_s: float
    soc: float
    flight_W: float
    recent: RecentLoad
    navigation: Navigation = NOWHERE
    left_s: float = math.inf


class Load(Protocol):
    """Load is the interface of a load to come."""

    def typical_W(self, now: FlightPoint) -> float:
        """Return a typical power [W], from which the length of the simulation follows."""
        ...

    def scenarios(self, now: FlightPoint, dt_s: float, steps: int) -> Scenarios:
        """Return the loads that may come from now on, in `steps` steps of `dt_s` [s]."""
        ...


def equal_levels(spread: float, count: int) -> Array:
    """Return `count` equally likely factors, log-normal around 1: the middles of equal shares of probability."""
    return np.exp(spread * _middles(count))


@cache
def _middles(count: int) -> Array:
    """Return standard normals in the middle of `count` equal shares of probability."""
    return np.array([NormalDist().inv_cdf((k + 0.5) / count) for k in range(count)])


@dataclass(frozen=True, slots=True)
class ConstantLoad:
    """ConstantLoad is a constant power until the end, log-normal around `power_W` [W] with relative sd `spread`."""

    power_W: float
    spread: float

    def typical_W(self, now: FlightPoint) -> float:
        """Return the power itself [W]."""
        return self.power_W

    def scenarios(self, now: FlightPoint, dt_s: float, steps: int) -> Scenarios:
        """Return equally likely powers, each the same at every step."""
        return constant(self.power_W, self.spread, dt_s, steps)


@dataclass(frozen=True, slots=True)
class RecentMean:
    """RecentMean expects that the flight goes on as in its last minutes."""

    def typical_W(self, now: FlightPoint) -> float:
        """Return the mean power of about the last minute [W], at least 1 W."""
        return max(now.recent.mean_W, LOWEST_POWER_W)

    def scenarios(self, now: FlightPoint, dt_s: float, steps: int) -> Scenarios:
        """Return powers around the recent mean, which go up and down as they have so far."""
        flown = now.recent.history
        return flown_again(constant(self.typical_W(now), flown.minute_sd, dt_s, steps), flown)


def stretches_s(dt_s: Array) -> Array:
    """Return the times [steps + 1] between which the power is averaged [s]: one stretch around each instant judged.

    A step is judged at its beginning. A mean over the step itself would include a climb half a step before it begins.

    dt_s : lengths of the steps [steps], in seconds
    """
    middles_s = np.cumsum(dt_s) - 0.5 * dt_s
    return np.concatenate([[0.0], middles_s])


def constant(power_W: float, spread: float, dt_s: float, steps: int) -> Scenarios:
    """Return constant powers, log-normal around `power_W` [W] with relative sd `spread`, over `steps` of `dt_s` [s]."""
    levels_W = power_W * equal_levels(spread, SCENARIOS)
    weight = np.full(SCENARIOS, 1.0 / SCENARIOS)
    return Scenarios(np.broadcast_to(levels_W, (steps, SCENARIOS)), weight, np.full(steps, dt_s))


def swinging(scenarios: Scenarios, swings: Swings) -> Scenarios:
    """Return the scenarios with gusts and manoeuvres of their own on them; their mean power stays."""
    rough = swung(scenarios.dt_s, scenarios.power_W.shape[1], swings)
    return Scenarios(scenarios.power_W * rough, scenarios.weight, scenarios.dt_s)


def flown_again(scenarios: Scenarios, flown: PowerHistory) -> Scenarios:
    """Return the scenarios with the ups and downs of the flight so far, each from another place of it on.

    In the first SHOWN_S of a flight, swings stand for what it has not shown yet; they become less and less.
    """
    again = flown.again(stretches_s(scenarios.dt_s), scenarios.power_W.shape[1])
    power_W = np.maximum(scenarios.power_W * again, LOWEST_POWER_W)
    return swinging(scenarios._replace(power_W=power_W), UNSHOWN.times(max(1.0 - flown.length_s / SHOWN_S, 0.0)))


@dataclass(frozen=True, slots=True)
class LoggedLoad:
    """LoggedLoad gives the flight's own later power [W], read from its log: replay only, it tests the battery alone.

    waits : on the ground, which are left out of the load
    """

    time_s: Array
    power_W: Array
    begins_s: tuple[float, ...] = ()  # when a pack was changed [s]: the flight before did not go on with that load
    waits: Waits = ()

    def typical_W(self, now: FlightPoint) -> float:
        """Return the mean power of the rows [W], at least 1 W."""
        return max(float(np.mean(self.power_W)), LOWEST_POWER_W)

    def scenarios(self, now: FlightPoint, dt_s: float, steps: int) -> Scenarios:
        """Return the one scenario that came true; beyond the discharge, the mean of its last minute.

        Its powers are means around the instants that are judged, or, when the log's rows are slow, those of its own
        rows.
        """
        if self.begins_s:
            return self._discharge(now.time_s).scenarios(now, dt_s, steps)
        if self.waits:
            return self._in_air().scenarios(now._replace(time_s=float(self._flown_s(now.time_s))), dt_s, steps)
        last_W = float(np.mean(self.power_W[self.time_s >= self.time_s[-1] - 60.0]))
        if float(np.median(np.diff(self.time_s))) > SLOW_ROW_S:
            return self._rows(now.time_s, dt_s, steps, last_W)
        pieces_J = 0.5 * (self.power_W[1:] + self.power_W[:-1]) * np.diff(self.time_s)
        energy_J = np.concatenate([[0.0], np.cumsum(pieces_J)])
        length_s = np.full(steps, dt_s)
        edges_s = now.time_s + stretches_s(length_s)
        beyond_s = np.maximum(edges_s - self.time_s[-1], 0.0)
        drawn_J = np.interp(edges_s, self.time_s, energy_J) + beyond_s * last_W
        power_W = np.maximum(np.diff(drawn_J) / np.diff(edges_s), LOWEST_POWER_W)
        return Scenarios(power_W[:, None], np.ones(1), length_s)

    def _discharge(self, time_s: float) -> LoggedLoad:
        """Return the load of the discharge that goes on at a time [s]."""
        edges_s = (-np.inf, *self.begins_s, np.inf)
        k = int(np.searchsorted(edges_s, time_s, side="right"))
        own = (self.time_s >= edges_s[k - 1]) & (self.time_s < edges_s[k])
        one = replace(self, begins_s=())
        return replace(one, time_s=self.time_s[own], power_W=self.power_W[own]) if own.sum() > 1 else one

    def _in_air(self) -> LoggedLoad:
        """Return the load without the waits, on a clock that stands still in them."""
        own = ~np.any([(begin_s <= self.time_s) & (self.time_s < end_s) for begin_s, end_s in self.waits], axis=0)
        if own.sum() < 2:
            return replace(self, waits=())
        return LoggedLoad(self._flown_s(self.time_s[own]), self.power_W[own])

    def _flown_s(self, time_s: ArrayLike) -> Array:
        """Return times [s] on the clock that stands still in the waits."""
        first_s = self.time_s[0]
        return np.asarray(first_s + in_air_s(first_s, time_s, self.waits))

    def _rows(self, time_s: float, dt_s: float, steps: int, last_W: float) -> Scenarios:
        later = self.time_s >= time_s - 1e-6
        beyond = max(steps - int(later.sum()), 1)
        power_W = np.concatenate([self.power_W[later], np.full(beyond, last_W)])
        gaps_s = np.concatenate([np.diff(self.time_s[later]), np.full(beyond + 1, dt_s)])[: power_W.size]
        return Scenarios(np.maximum(power_W, LOWEST_POWER_W)[:, None], np.ones(1), gaps_s)
