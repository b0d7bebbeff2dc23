"""The load to come: what power the flight will ask until its end.

A load gives scenarios: power over time, each with a weight. `RecentLoad` is the memory that feeds it: the mean of
the power over the last minutes and how far the mean of half a minute strays from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from uavbatt.battery.model import Array

MEAN_TAU_S = 60.0
WINDOW_TAU_S = 20.0
SPREAD_TAU_S = 240.0
PRIOR_SPREAD = 0.15  # a multirotor's minute-to-minute power before this flight has shown its own
STATED_SPREAD = 0.04  # an operator who states watts means about these watts
SCENARIOS = 9


class Scenarios(NamedTuple):
    """What may be asked: true pack power [W], [steps, scenarios], from now on, and the weight of each scenario."""

    power_W: Array
    weight: Array


@dataclass(frozen=True, slots=True)
class ConstantLoad:
    """One power until the end, log-normal around `typical_W` with relative sd `spread`."""

    typical_W: float
    spread: float

    def scenarios(self, time_s: float, dt_s: float, steps: int) -> Scenarios:
        """Equally likely powers at the middles of equal shares of probability; the same at every step."""
        levels = (np.arange(SCENARIOS) + 0.5) / SCENARIOS
        power_W = self.typical_W * np.exp(self.spread * ndtri(levels))
        return Scenarios(np.broadcast_to(power_W, (steps, SCENARIOS)), np.full(SCENARIOS, 1.0 / SCENARIOS))


@dataclass(frozen=True, slots=True)
class LoggedLoad:
    """The flight's own later power, read from its log: replay only, it tests the battery alone."""

    time_s: Array
    power_W: Array

    @property
    def typical_W(self) -> float:
        """Mean power of the rows."""
        return float(np.mean(self.power_W))

    def scenarios(self, time_s: float, dt_s: float, steps: int) -> Scenarios:
        """The one scenario that came true: means over each step; beyond the log, the mean of its last minute."""
        energy_J = np.concatenate(
            [[0.0], np.cumsum(0.5 * (self.power_W[1:] + self.power_W[:-1]) * np.diff(self.time_s))]
        )
        last_W = float(np.mean(self.power_W[self.time_s >= self.time_s[-1] - 60.0]))
        edges_s = time_s + dt_s * np.arange(steps + 1)
        beyond_s = np.maximum(edges_s - self.time_s[-1], 0.0)
        drawn_J = np.interp(edges_s, self.time_s, energy_J) + beyond_s * last_W
        return Scenarios(np.maximum(np.diff(drawn_J) / dt_s, 1.0)[:, None], np.ones(1))


@dataclass(frozen=True, slots=True)
class RecentLoad:
    """Exponentially weighted memory of the power [W]; a value, replaced by `after`."""

    time_s: float = math.nan
    mean_W: float = math.nan
    window_W: float = math.nan
    variance: float = PRIOR_SPREAD**2  # of window / mean

    def after(self, time_s: float, power_W: float) -> RecentLoad:
        """The memory with one more row; rows must come in order of time."""
        if not math.isfinite(self.time_s):
            return RecentLoad(time_s, power_W, power_W, self.variance)
        dt_s = max(time_s - self.time_s, 0.0)

        def blend(old: float, new: float, tau_s: float) -> float:
            return new + (old - new) * math.exp(-dt_s / tau_s)

        mean_W = blend(self.mean_W, power_W, MEAN_TAU_S)
        window_W = blend(self.window_W, power_W, WINDOW_TAU_S)
        strayed = (window_W / mean_W - 1.0) ** 2 if mean_W > 0.0 else self.variance
        return RecentLoad(time_s, mean_W, window_W, blend(self.variance, strayed, SPREAD_TAU_S))

    @property
    def spread(self) -> float:
        """Relative spread of the mean of a coming stretch of flight, at least 3 %."""
        return math.sqrt(max(self.variance, 0.03**2))
