"""Evidence of one flight about a pack, out of the filter's belief at its end.

The flight is run from a prior so wide (`remembered.UNKNOWN`) that what is believed at the end is nearly the
flight's own word; the little that the prior had in it is taken out again:

    information told = information at the end - information before

Drop under load that the model lacks shows as ohms, as discrepancy, or as both, whichever the first minutes made of it.
So the discrepancy under load counts as ohms at the current of a hover: their sum is known five times better than
either. What the belief holds for a reaction does not count: handed on as ohms it made plans too long in the cold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from uavbatt.battery.equations import REFERENCE_TEMP_C
from uavbatt.battery.remembered import UNKNOWN, Scales, health_of, hover_drop_V
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import Belief, X
from uavbatt.packs.records import Told

ELECTRODE_SD_V = 0.025  # what sluggish electrodes take over the life of a pack; one flight leaves room for twice that
# From flight to flight of one pack the beliefs scatter by a part of what each says of itself: the other part is the
# error of the battery file, which is the same in all of them. Of the charge that part falls with what a flight tells:
# one that lands half full extrapolates, and errs by all of its sd.
OHM_SHARE, ALL_CHANCE_SD = 0.35, 0.16
LEAST_SD = np.array([0.015, 0.01])
# A flight in the cold says less of 25 °C: the file's temperature dependence is not known better [per K].
COLD_SD_PER_K = np.array([0.005, 0.002])
UNKNOWN_AWAY_K = 12.0
# Of the prior's variance: what a flight leaves at least and at most, and up to which it counts as if all were its own.
SMALLEST_SHARE, LARGEST_SHARE, MAGNIFIED_SHARE = 1e-6, 0.98, 0.5


def told(pack: Pack, loaded: Sequence[Belief], last: Belief, temp_C: float) -> Told:
    """Return what the flight says, from its beliefs in order of time under load and that at its last row of all.

    `temp_C` is the pack's mean temperature under load [°C]; NaN where it was not measured.
    """
    said = _with_rest(_under_load(pack, loaded), loaded[-1], last)
    log_ohm, log_Ah, covariance = health_of(pack, said)[:3]
    away_K = abs(temp_C - REFERENCE_TEMP_C) if math.isfinite(temp_C) else UNKNOWN_AWAY_K
    share = np.array([OHM_SHARE, min(math.sqrt(covariance[1, 1]) / ALL_CHANCE_SD, 1.0)])
    scatter = covariance * np.outer(share, share)
    scatter += np.diag(LEAST_SD**2 + (COLD_SD_PER_K * away_K) ** 2)
    return Told(log_ohm, log_Ah, float(scatter[0, 0]), float(scatter[1, 1]), float(scatter[0, 1]))


def _under_load(pack: Pack, loaded: Sequence[Belief]) -> Scales:
    """Return what the rows under load say: of the capacity all of them, of the ohms when they were known best.

    At the knee the discrepancy is not known, and nor is its sum with the ohms.
    """
    said = [_without_prior(_scales(pack, belief), _prior(pack)) for belief in loaded]
    best = min(said, key=lambda s: float(s.covariance[0, 0]))
    ratio = math.sqrt(said[-1].covariance[1, 1] / best.covariance[1, 1])
    return Scales(
        np.array([best.mean[0], said[-1].mean[1]]), best.covariance * np.array([[1.0, ratio], [ratio, ratio**2]])
    )


def _prior(pack: Pack) -> Scales:
    """Return what the flight's run began with: nothing known of the pack, and the discrepancy that its type may
    have.
    """
    discrepancy_sd = _ohms_per_volt(pack) * math.hypot(pack.bias_sd_V, ELECTRODE_SD_V)
    return Scales(UNKNOWN.mean, UNKNOWN.covariance + np.diag([discrepancy_sd**2, 0.0]))


def _ohms_per_volt(pack: Pack) -> float:
    """Return how much a volt of discrepancy counts in ln of the resistance: as at the current of a hover.

    Less where the battery file's own discrepancy is so large that it would drown the ohms.
    """
    most = math.sqrt(UNKNOWN.covariance[0, 0]) / math.hypot(pack.bias_sd_V, ELECTRODE_SD_V)
    return min(1.0 / hover_drop_V(pack), most)


def _scales(pack: Pack, belief: Belief) -> Scales:
    """The belief's resistance and capacity, the discrepancy in it counted as ohms."""
    read = np.zeros((2, len(X)))
    read[0, X.LOG_RESISTANCE], read[0, X.BIAS] = 1.0, -_ohms_per_volt(pack)
    read[1, X.LOG_CAPACITY] = 1.0
    return Scales(read @ belief.mean, read @ belief.covariance @ read.T)


def _without_prior(belief: Scales, prior: Scales) -> Scales:
    """Return what a belief says beyond its prior: along the axes on which it knows more than that.

    Where it hardly does, its distance from the prior is chance, and is not magnified without bound.
    """
    sd = np.sqrt(np.diag(prior.covariance))
    share, axes = np.linalg.eigh(belief.covariance / np.outer(sd, sd))
    share = np.clip(share, SMALLEST_SHARE, LARGEST_SHARE)
    away = axes.T @ ((belief.mean - prior.mean) / sd)
    own = (axes * (share / (1.0 - share))) @ axes.T  # variance of what was said
    return Scales(
        prior.mean + sd * (axes @ (away / (1.0 - np.minimum(share, MAGNIFIED_SHARE)))), own * np.outer(sd, sd)
    )


def _with_rest(said: Scales, loaded: Belief, last: Belief) -> Scales:
    """Return what the rows after the load say of the capacity besides: the rested voltage after landing."""
    k = X.LOG_CAPACITY
    before, after = float(loaded.covariance[k, k]), float(last.covariance[k, k])
    if not after < LARGEST_SHARE * before:
        return said
    variance = before * after / (before - after)
    value = float(last.mean[k] * before - loaded.mean[k] * after) / (before - after)
    gain = said.covariance[:, 1] / (said.covariance[1, 1] + variance)
    return Scales(said.mean + gain * (value - said.mean[1]), said.covariance - np.outer(gain, said.covariance[1]))
