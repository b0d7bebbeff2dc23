"""Evidence of one flight about a pack, from the filter's belief at its end.

The flight is run from a very wide prior (`remembered.UNKNOWN`), and the small part of the prior is subtracted again:

    information of the flight = information at the end - information before

A voltage drop under load that the model lacks appears as resistance, as discrepancy, or as both; the first minutes
decide. So the discrepancy under load is converted to ohms at the hover current and added: the sum is known five times
better than either. The reaction overpotential is not added: counted as ohms it made plans too long in the cold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from uavbatt.battery.equations import REFERENCE_TEMP_C
from uavbatt.battery.remembered import UNKNOWN, Scales, health_of, hover_drop_V
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import Belief, X
from uavbatt.packs.records import FlightEvidence

ELECTRODE_SD_V = 0.025  # drop by slow electrodes over the life of a pack; one flight leaves room for twice that
# Closer to the knee the error of the battery file's shape is read as ohms.
LEAST_SOC_FOR_OHMS = 0.25
# The evidence of flights of one pack scatters by only a part of its stated sd; the other part is the error of the
# battery file, which is the same in all flights. For the capacity the scatter is smaller after a deep discharge: a
# flight that lands half full extrapolates, and all of its sd is scatter.
OHM_SHARE, ALL_CHANCE_SD = 0.35, 0.16
LEAST_SD = np.array([0.015, 0.01])
# A flight in the cold shows less of the values at 25 °C: the file's temperature dependence has this error [per K].
COLD_SD_PER_K = np.array([0.005, 0.002])
# Without a thermometer a cold pack looks like a worn one: 8 K are a quarter of the resistance, and seven flights at
# 6 °C were read with 25 % too little capacity (32 flights of 6 to 33 °C: an error of 0.16).
UNMEASURED_SD = np.array([0.25, 0.17])
# A log that begins in the air does not show how far the voltage has fallen by then: one of four minutes after
# take-off was read with 43 to 90 % more resistance.
BEGUN_LATER_SD = np.array([0.60, 0.15])
# With the generic file the evidence is worse than it says: over 128 flights of 24 packs of six makes ln Ah lay 1.1 to
# 1.8 of its sd from the truth (root mean square).
GENERIC_FACTOR = 2.0
# Shares of the prior's variance that a flight leaves, least and most, and the limit of magnifying its shift.
SMALLEST_SHARE, LARGEST_SHARE, MAGNIFIED_SHARE = 1e-6, 0.98, 0.5


def evidence_of_flight(
    pack: Pack, loaded: Sequence[Belief], last: Belief, temp_C: float, *, is_generic: bool, is_begun_later: bool
) -> FlightEvidence:
    """Return the evidence of a flight.

    loaded : beliefs under load in order of time; last : belief at the last row of all
    temp_C : mean temperature of the pack under load [°C]; NaN if not measured
    is_generic : the flight is read with the generic battery file; is_begun_later : its log begins in the air
    """
    # An unknown make's discrepancy is mostly its open-circuit voltage, which is no resistance.
    ohms_per_V = 0.0 if is_generic else _ohms_per_volt(pack)
    said = with_rest(_under_load(pack, loaded, ohms_per_V), loaded[-1], last)
    log_ohm, log_Ah, covariance = health_of(pack, said)[:3]
    away_sd = COLD_SD_PER_K * abs(temp_C - REFERENCE_TEMP_C) if math.isfinite(temp_C) else UNMEASURED_SD
    later_sd = BEGUN_LATER_SD if is_begun_later else np.zeros(2)
    share = np.array([OHM_SHARE, min(math.sqrt(covariance[1, 1]) / ALL_CHANCE_SD, 1.0)])
    scatter = covariance * np.outer(share, share)
    scatter += np.diag(LEAST_SD**2 + away_sd**2 + later_sd**2)
    scatter *= GENERIC_FACTOR**2 if is_generic else 1.0
    return FlightEvidence(log_ohm, log_Ah, float(scatter[0, 0]), float(scatter[1, 1]), float(scatter[0, 1]))


def _under_load(pack: Pack, loaded: Sequence[Belief], ohms_per_V: float) -> Scales:
    """Return the evidence of the rows under load: the last capacity, and the resistance when it was known best.

    At the knee the discrepancy is not known, and so neither is its sum with the resistance. What the rows after that
    instant say of the capacity is passed on to the resistance.
    """
    prior = _prior(pack, ohms_per_V)
    said = [without_prior(_scales(belief, ohms_per_V), prior) for belief in loaded]
    flat = [s for s, belief in zip(said, loaded, strict=True) if belief.mean[X.SOC] > LEAST_SOC_FOR_OHMS]
    best = min(flat or said[:1], key=lambda s: float(s.covariance[0, 0]))
    return _with_capacity(best, said[-1])


def _with_capacity(said: Scales, last: Scales) -> Scales:
    """Return the evidence with its capacity as it was known last, and with what that says of the resistance."""
    slope = said.covariance[:, 1] / said.covariance[1, 1]
    return Scales(
        said.mean + slope * (last.mean[1] - said.mean[1]),
        said.covariance + np.outer(slope, slope) * (last.covariance[1, 1] - said.covariance[1, 1]),
    )


def _prior(pack: Pack, ohms_per_V: float) -> Scales:
    """Return the prior of the run: a pack of which nothing is known, and the discrepancy that its type may have."""
    discrepancy_sd = ohms_per_V * math.hypot(pack.spread.bias_sd_V, ELECTRODE_SD_V)
    return Scales(UNKNOWN.mean, UNKNOWN.covariance + np.diag([discrepancy_sd**2, 0.0]))


def _ohms_per_volt(pack: Pack) -> float:
    """Return the change of ln resistance per volt of discrepancy [1/V], at the hover current.

    It is limited if the battery file's own discrepancy is so large that it would hide the resistance.
    """
    most = math.sqrt(UNKNOWN.covariance[0, 0]) / math.hypot(pack.spread.bias_sd_V, ELECTRODE_SD_V)
    return min(1.0 / hover_drop_V(pack), most)


def _scales(belief: Belief, ohms_per_V: float) -> Scales:
    """Return resistance and capacity of a belief, with its discrepancy counted as resistance."""
    read = np.zeros((2, len(X)))
    read[0, X.LOG_RESISTANCE], read[0, X.BIAS] = 1.0, -ohms_per_V
    read[1, X.LOG_CAPACITY] = 1.0
    return Scales(read @ belief.mean, read @ belief.covariance @ read.T)


def without_prior(belief: Scales, prior: Scales) -> Scales:
    """Return the evidence in a belief without its prior, worked out along the principal axes.

    On an axis where the belief is hardly better than the prior, its distance from the prior is chance: that distance
    is magnified by a bounded factor only.
    """
    sd = np.sqrt(np.diag(prior.covariance))
    share, axes = np.linalg.eigh(belief.covariance / np.outer(sd, sd))
    share = np.clip(share, SMALLEST_SHARE, LARGEST_SHARE)
    away = axes.T @ ((belief.mean - prior.mean) / sd)
    own = (axes * (share / (1.0 - share))) @ axes.T  # variance of the evidence
    return Scales(
        prior.mean + sd * (axes @ (away / (1.0 - np.minimum(share, MAGNIFIED_SHARE)))), own * np.outer(sd, sd)
    )


def with_rest(said: Scales, loaded: Belief, last: Belief) -> Scales:
    """Return the evidence with what the rested voltage after landing adds about the capacity."""
    k = X.LOG_CAPACITY
    before, after = float(loaded.covariance[k, k]), float(last.covariance[k, k])
    if not after < LARGEST_SHARE * before:
        return said
    variance = before * after / (before - after)
    value = float(last.mean[k] * before - loaded.mean[k] * after) / (before - after)
    gain = said.covariance[:, 1] / (said.covariance[1, 1] + variance)
    return Scales(said.mean + gain * (value - said.mean[1]), said.covariance - np.outer(gain, said.covariance[1]))
