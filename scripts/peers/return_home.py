"""The way home by the rules of INAV and PX4: seconds until one must turn back.

    INAV   t = (E (1 - 0.05) - drawn - P d/v) / P     P mean power of the flight, d distance home, v speed home
    PX4    t = t_battery - (1.1 t_home + 100 s)       it returns when the time left is not more than that

INAV gives this for fixed wings alone, by their cruise speed and power; here its rule is given a multirotor's speed home
and the power of the flight. PX4 compares and returns; that the difference is a time until then is the kindest reading.
`t_home` is climb, run, descent and landing at the vehicle's own speeds. Neither knows the wind here, nor the mission.

Source: inav src/main/flight/rth_estimator.c (rth_energy_margin 5 %); PX4-Autopilot src/lib/rtl, RTL_TIME_FACTOR 1.1,
RTL_TIME_MARGIN 100 s, and the commander's check of the remaining flight time; equations only.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from peers.columns import FloatArray
from uavbatt.navigation import Navigation
from uavbatt.prediction.route.legs import Leg
from uavbatt.prediction.route.progress import here_at
from uavbatt.prediction.route.way_home import way_home

INAV_MARGIN = 0.05
PX4_FACTOR, PX4_MARGIN_S = 1.1, 100.0


def px4_turn_s(remaining_s: FloatArray, home_s: FloatArray) -> FloatArray:
    """Return the time until PX4 returns by itself [s], from its time left and the planned way home [s]."""
    return remaining_s - (PX4_FACTOR * home_s + PX4_MARGIN_S)


def inav_turn_s(remaining_s: FloatArray, flown_s: FloatArray, run_s: FloatArray) -> FloatArray:
    """Return the time [s] until INAV's rule says to turn, from its time left, the time flown and the run home [s].

    At the flight's mean power P the energy E is P (flown + left), so that its margin is a share of that time.
    """
    return remaining_s - INAV_MARGIN * (remaining_s + flown_s) - run_s


def home_times(navigation_at: Callable[[float], Navigation], time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the planned time of the whole way home and of its run alone at each row [s]; NaN without a place."""
    found = np.full((2, time_s.size), math.nan)
    for row, at_s in enumerate(time_s):
        known = navigation_at(float(at_s))
        here = here_at(float(at_s), known)
        if here is not None:
            legs = way_home(here, known.settings)
            found[:, row] = sum(leg.moving_s + leg.hold_s for leg in legs), sum(_run_s(leg) for leg in legs)
    return found[0], found[1]


def _run_s(leg: Leg) -> float:
    return leg.run_m / leg.speed_ms if leg.run_m > 0.0 else 0.0
