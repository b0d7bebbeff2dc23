"""The means and standard deviations of a belief that an estimate shows."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uavbatt.battery.state_space import Belief, X
from uavbatt.records import NAN


class BeliefSummary(NamedTuple):
    """BeliefSummary holds the means and sds of a belief that an estimate shows, by the names of `records.Estimate`.

    They change when a block is closed.
    """

    soc: float = NAN
    soc_sd: float = NAN
    core_temp_C: float = NAN
    resistance_scale: float = NAN
    resistance_scale_sd: float = NAN
    capacity_scale: float = NAN
    capacity_scale_sd: float = NAN
    wear: float = NAN
    wear_sd: float = NAN


def summary(belief: Belief, empty_soc_sd: float) -> BeliefSummary:
    """Return the means and standard deviations that an estimate shows of a belief.

    empty_soc_sd : uncertainty of the charge that a make leaves in its cells, as a share of the charge drawn. The filter
    counts down to the empty of the battery file; no voltage shows how far that of the pack differs from it.
    """
    x, covariance = belief.mean, belief.covariance
    sd = np.sqrt(np.diag(covariance))
    resistance, capacity = float(x[X.LOG_RESISTANCE]), float(x[X.LOG_CAPACITY])
    shared = covariance[X.LOG_RESISTANCE, X.LOG_CAPACITY]
    return BeliefSummary(
        soc=float(x[X.SOC]),
        soc_sd=math.hypot(sd[X.SOC], empty_soc_sd * min(max(1.0 - float(x[X.SOC]), 0.0), 1.0)),
        core_temp_C=float(x[X.CORE]),
        resistance_scale=math.exp(resistance),
        resistance_scale_sd=math.exp(resistance) * float(sd[X.LOG_RESISTANCE]),
        capacity_scale=math.exp(capacity),
        capacity_scale_sd=math.exp(capacity) * float(sd[X.LOG_CAPACITY]),
        wear=math.expm1(resistance - capacity),
        wear_sd=math.sqrt(max(sd[X.LOG_RESISTANCE] ** 2 + sd[X.LOG_CAPACITY] ** 2 - 2.0 * shared, 0.0)),
    )
