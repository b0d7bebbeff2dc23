"""Outlook of a pack for its owner: health with intervals, trend, and when to retire it."""

from __future__ import annotations

import math

import numpy as np

from uavbatt.battery.battery_file import is_generic
from uavbatt.packs.records import Outlook, PackBelief

RETIRED_AT = 0.8  # share of the rated capacity
INTERVAL_SD = 1.645  # 5 % to 95 %
# The battery file's own error is the same in every flight, so that no number of flights averages it out.
SHARED_SD = (0.04, 0.02)  # ln of ohms, ln of Ah
# With the generic file the capacity was 6 % too small on average over four packs of one make, 9 % too
# large over twenty of six makes.
GENERIC_SHARED_SD = (0.30, 0.17)
FARTHEST_FLIGHTS = 500.0
# 5, 15 .. 95 % points of a standard normal: an even sample without randomness.
LEVELS = np.array([-1.645, -1.036, -0.674, -0.385, -0.126, 0.126, 0.385, 0.674, 1.036, 1.645])


def shared_sd(battery: str) -> tuple[float, float]:
    """Return the sd of ln ohm and ln Ah that all flights share which are read with a battery file of this name."""
    return GENERIC_SHARED_SD if is_generic(battery) else SHARED_SD


def outlook(known: PackBelief, rated_Ah: float, flights: int, battery: str) -> Outlook:
    """Return the outlook of a pack of `rated_Ah` [Ah] after so many flights, read with a battery file of this name."""
    sd, shared = np.sqrt(np.diag(known.covariance)), shared_sd(battery)
    ohm = np.exp(known.mean[0] + np.array([0.0, -1.0, 1.0]) * INTERVAL_SD * math.hypot(sd[0], shared[0]))
    charge = np.exp(known.mean[1] + np.array([0.0, -1.0, 1.0]) * INTERVAL_SD * math.hypot(sd[1], shared[1]))
    (ohms, ohms_lo, ohms_hi), (now, lo, hi) = ohm.tolist(), charge.tolist()
    median, soonest, latest = retirement(known, rated_Ah, shared[1])
    return Outlook(
        flights=flights,
        capacity_Ah=now,
        capacity_lo_Ah=lo,
        capacity_hi_Ah=hi,
        resistance_ohm=ohms,
        resistance_lo_ohm=ohms_lo,
        resistance_hi_ohm=ohms_hi,
        capacity_trend=float(known.mean[3]),
        capacity_trend_sd=float(sd[3]),
        resistance_trend=float(known.mean[2]),
        resistance_trend_sd=float(sd[2]),
        retire_flights=median,
        retire_lo_flights=soonest,
        retire_hi_flights=latest,
    )


def retirement(known: PackBelief, rated_Ah: float, file_sd: float) -> tuple[float, float, float]:
    """Return the flights left until the capacity is RETIRED_AT of the rated one [Ah]: median, 5 %, 95 % points.

    file_sd : sd of ln Ah by the error of the battery file, which all flights share
    A number beyond FARTHEST_FLIGHTS is given as infinite.
    """
    left = known.mean[1] - math.log(RETIRED_AT * rated_Ah)
    level_sd, trend_sd = math.hypot(math.sqrt(known.covariance[1, 1]), file_sd), math.sqrt(known.covariance[3, 3])
    shared = known.covariance[1, 3] / level_sd
    own_sd = math.sqrt(max(trend_sd**2 - shared**2, 0.0))
    level, change = np.meshgrid(LEVELS, LEVELS)
    above = left + level_sd * level
    lost = -(known.mean[3] + shared * level + own_sd * change)
    with np.errstate(divide="ignore"):
        flights = np.where(above <= 0.0, 0.0, np.where(lost > 0.0, above / np.maximum(lost, 1e-12), np.inf))
    found = np.quantile(flights, [0.5, 0.05, 0.95], method="nearest")
    median, low, high = (float(n) if n <= FARTHEST_FLIGHTS else math.inf for n in found)
    return median, low, high
