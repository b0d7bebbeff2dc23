"""The load of a flight that has not begun, or has just begun: that of past flights, else of a typical multirotor.

The first seconds of load tell little: motors spool up, and the sag of a pack of unknown resistance says little about
its capacity. So the ends that were expected at take-off count among those of a forecast, less and less:

    end = share x (end as of take-off) + (1 - share) x (end as of now), rank by rank,    share = (1 - t/FORGOTTEN_S)²

The end as of take-off is that of the same charge at the power that is flown, once this is known. It never makes the
lower end later than that of the flight itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.battery.pack import typical_power_W
from uavbatt.battery.scaling import Pack
from uavbatt.prediction.load.library import (
    FEW_SPREAD,
    GRID_S,
    LEVELS,
    LearnedLoad,
    UnknownAircraft,
)
from uavbatt.prediction.load.power_history import LOWEST_POWER_W
from uavbatt.prediction.load.scenarios import ConstantLoad, FlightPoint, Load, Scenarios, equal_levels
from uavbatt.prediction.simulation.time_to_end import EndTimes

SETTLED_S = 60.0
FORGOTTEN_S = 240.0
NEAR_S = 120.0  # so near its end, a pack shows it
LOW_RANKS, SHORT_RANKS, SHORT_S = 0.25, 0.6, 240.0
SHOWN_TAU_S, MOST_CHANGE = 20.0, 4.0
MOST_ENDS = 1024
TYPICAL_SPREAD = 0.4  # as ln: nine of ten multirotors are within a factor of two


@dataclass(frozen=True, slots=True)
class FromTakeOff:
    """FromTakeOff flies past flights again from their take-off, each as it was, at levels around it."""

    library: LearnedLoad

    def typical_W(self, now: FlightPoint) -> float:
        """Return the median of the flights' mean powers [W], or less where the horizon would cut off a gentle one."""
        begun = self.library.mean_W[:, int(SETTLED_S / GRID_S) :]
        return float(min(np.median(self.library.mean_W[:, -1]), 1.5 * np.min(begun)))

    def scenarios(self, now: FlightPoint, dt_s: float, steps: int) -> Scenarios:
        """Return every past flight from its first second, whatever the charge: the pack may start part-used.

        Their levels vary too, because the payload and the wind of this flight are not known.
        """
        flown_W = self.library.power_W
        grid_s = GRID_S * np.arange(flown_W.shape[1])
        ahead_s = dt_s * (np.arange(steps) + 0.5)
        traces_W = np.stack([np.interp(ahead_s, grid_s, watts) for watts in flown_W], axis=1)
        levels = equal_levels(FEW_SPREAD, LEVELS)
        power_W = np.maximum((traces_W[:, :, None] * levels).reshape(steps, -1), LOWEST_POWER_W)
        return Scenarios(power_W, np.full(power_W.shape[1], 1.0 / power_W.shape[1]), np.full(steps, dt_s))


def is_open(load: Load) -> bool:
    """Return True if nobody says what the load to come is: the flight has to show it."""
    return isinstance(load, LearnedLoad | UnknownAircraft)


def load_before_take_off(load: Load, pack: Pack) -> Load:
    """Return the load as it is known on the ground: a stated power, past flights, else one by the pack's size."""
    if isinstance(load, ConstantLoad):
        return load
    if isinstance(load, LearnedLoad):
        return FromTakeOff(load)
    installation = pack.installation
    typical_W = typical_power_W(int(installation.cells), float(installation.present_capacity_Ah))
    return ConstantLoad(typical_W, TYPICAL_SPREAD)


class AtTakeOff(NamedTuple):
    """AtTakeOff holds what was expected at take-off: ends and low-voltage warnings of draws [s since then].

    It is a value of plain numbers, saved with the memory of the forecaster.
    """

    take_off_s: float
    power_W: float  # the expected power
    end_s: tuple[float, ...]  # sorted
    low_s: tuple[float, ...]  # sorted

    @property
    def is_possible(self) -> bool:
        """Return True if a forecast can have given this: a saved file may hold anything."""
        return self.power_W > 0.0 and all(_is_forecast(ends) for ends in (self.end_s, self.low_s))

    def moved(self, shift_s: float) -> AtTakeOff:
        """Return the same expectation on a clock that shows `shift_s` [s] more."""
        return self._replace(take_off_s=self.take_off_s + shift_s)

    def at_power(self, time_s: float, flight_W: float) -> AtTakeOff:
        """Return the ends of the same charge at the mean power flown so far [W], as far as that power is believed."""
        trust = 1.0 - math.exp(-max(time_s - self.take_off_s, 0.0) / SHOWN_TAU_S)
        longer = min(max(self.power_W / flight_W, 1.0 / MOST_CHANGE), MOST_CHANGE) ** trust
        return self._replace(
            end_s=tuple(longer * end_s for end_s in self.end_s), low_s=tuple(longer * low_s for low_s in self.low_s)
        )

    def share(self, time_s: float) -> float:
        """Return how much the expectation still counts, 0 to 1: the flight itself tells more and more."""
        return max(1.0 - (time_s - self.take_off_s) / FORGOTTEN_S, 0.0) ** 2

    def joined(self, time_s: float, fresh: EndTimes) -> EndTimes:
        """Return the draws of a forecast [s from now, sorted] joined with those of take-off by their share."""
        share, age_s = self.share(time_s), time_s - self.take_off_s
        if not share > 0.0:
            return fresh
        return EndTimes(
            _joined(fresh.end_s, np.array(self.end_s) - age_s, share),
            _joined(fresh.low_s, np.array(self.low_s) - age_s, share),
        )


def _is_forecast(ends_s: tuple[float, ...]) -> bool:
    """Return True if these can be the sorted ends of draws [s]."""
    return 0 < len(ends_s) <= MOST_ENDS and ends_s[0] >= 0.0 and all(a <= b for a, b in pairwise(ends_s))


def _joined(fresh_s: Array, expected_s: Array, share: float) -> Array:
    """Return both joined rank by rank; an expected end that should have shown itself by now is left out.

    The lower ranks, which alarms use, are never later than those of the flight itself. If the flight looks short, the
    middle is not later either, so that a weak pack is not made to look good.
    """
    expected_s = expected_s[expected_s > NEAR_S]
    if not expected_s.size:
        return fresh_s
    ranks = (np.arange(fresh_s.size) + 0.5) / fresh_s.size
    joined_s = share * np.quantile(expected_s, ranks) + (1.0 - share) * fresh_s
    careful = ranks < (SHORT_RANKS if np.median(fresh_s) < SHORT_S else LOW_RANKS)
    return np.where(careful, np.minimum(fresh_s, joined_s), joined_s)
