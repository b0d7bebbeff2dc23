"""What one flight by itself says of a pack, out of the filter's belief at its end.

The flight is run from a prior so wide (`remembered.UNKNOWN_HEALTH`) that what is believed at the end is nearly the
flight's own word; the little that the prior had in it is taken out again:

    information told = information at the end - information before

Drop under load that the model lacks shows as ohms, as discrepancy, or as both, whichever the first minutes made of it.
So the discrepancy under load counts as ohms at the current of a hover: their sum is known five times better than
either.
"""

from __future__ import annotations

import math

import numpy as np

from uavbatt.battery import model
from uavbatt.battery.belief import Belief, C
from uavbatt.battery.build import Pack
from uavbatt.battery.equations import REFERENCE_TEMP_C
from uavbatt.battery.model import Array
from uavbatt.battery.remembered import UNKNOWN_HEALTH, PackHealth
from uavbatt.packs.records import Told

HALF_CHARGE, HOVER_C_RATE = 0.5, 2.5
# From flight to flight of one pack the beliefs scatter by half of what each says of itself: the other half is the
# error of the battery file, which is the same in all of them.
SCATTER_SHARE = np.array([0.35, 0.5])  # of the sd: of ohms, of charge
LEAST_SD = np.array([0.015, 0.01])
# A flight in the cold says less of 25 °C: the file's temperature dependence is not known better [per K].
COLD_SD_PER_K = np.array([0.005, 0.002])
UNKNOWN_AWAY_K = 12.0
LARGEST_SHARE = 0.98  # of the prior's variance that a flight may leave


def reference_ohm(pack: Pack) -> float:
    """Resistance of one cell of the type [ohm] at 25 °C and half charge."""
    resistance_ohmAh = float(model.resistance(pack.cell, HALF_CHARGE, REFERENCE_TEMP_C))
    return resistance_ohmAh / float(pack.installation.capacity_Ah)


def told(pack: Pack, loaded: Belief, last: Belief, temp_C: float) -> Told:
    """What the flight says, from the beliefs at its last row under load and at its last row of all.

    `temp_C` is the pack's mean temperature under load [°C]; NaN where it was not measured.
    """
    mean, covariance = scales(pack, loaded)
    mean, covariance = _without_prior(mean, covariance, UNKNOWN_HEALTH)
    mean, covariance = _with_rest(mean, covariance, loaded, last)
    # (ln of ohm·Ah, ln of capacity scale) -> (ln of ohms, ln of Ah)
    turn = np.array([[1.0, -1.0], [0.0, 1.0]])
    log_ohm, log_Ah = turn @ mean + np.log([reference_ohm(pack), float(pack.installation.capacity_Ah)])
    away_K = abs(temp_C - REFERENCE_TEMP_C) if math.isfinite(temp_C) else UNKNOWN_AWAY_K
    scatter = turn @ covariance @ turn.T * np.outer(SCATTER_SHARE, SCATTER_SHARE)
    scatter += np.diag(LEAST_SD**2 + (COLD_SD_PER_K * away_K) ** 2)
    return Told(float(log_ohm), float(log_Ah), float(scatter[0, 0]), float(scatter[1, 1]), float(scatter[0, 1]))


def scales(pack: Pack, belief: Belief) -> tuple[Array, Array]:
    """Mean [2] and covariance [2, 2] of ln of the resistance and capacity scales, the discrepancy's share in it."""
    drop_V = HOVER_C_RATE * float(model.resistance(pack.cell, HALF_CHARGE, REFERENCE_TEMP_C))
    read = np.zeros((2, len(C)))
    read[0, C.LOG_RESISTANCE], read[0, C.BIAS] = 1.0, -1.0 / drop_V
    read[1, C.LOG_CAPACITY] = 1.0
    return read @ belief.mean, read @ belief.covariance @ read.T


def _without_prior(mean: Array, covariance: Array, prior: PackHealth) -> tuple[Array, Array]:
    """What a belief says beyond its prior; never less than (1 - LARGEST_SHARE) of the prior's information."""
    sd = np.sqrt(np.diag(prior.covariance))
    share, axes = np.linalg.eigh(covariance / np.outer(sd, sd))
    share = np.clip(share, 1e-6, LARGEST_SHARE)
    own = share / (1.0 - share)  # variance of what was said, along the axes
    away = axes.T @ ((mean - np.array(prior[:2])) / sd)
    return np.array(prior[:2]) + sd * (axes @ (away / (1.0 - share))), (axes * own) @ axes.T * np.outer(sd, sd)


def _with_rest(mean: Array, covariance: Array, loaded: Belief, last: Belief) -> tuple[Array, Array]:
    """What the rows after the load say of the capacity besides: the rested voltage after landing."""
    k = C.LOG_CAPACITY
    before, after = float(loaded.covariance[k, k]), float(last.covariance[k, k])
    if not after < LARGEST_SHARE * before:
        return mean, covariance
    variance = before * after / (before - after)
    value = (last.mean[k] * before - loaded.mean[k] * after) / (before - after)
    gain = covariance[:, 1] / (covariance[1, 1] + variance)
    return mean + gain * (value - mean[1]), covariance - np.outer(gain, covariance[1])


def health(log_ohm: float, log_Ah: float, covariance: Array, pack_ohm: float, rated_Ah: float) -> PackHealth:
    """Ohms and ampere-hours as scales of a battery file whose cell has `pack_ohm` [ohm] at `rated_Ah` [Ah]."""
    turn = np.array([[1.0, 1.0], [0.0, 1.0]])
    mean = turn @ np.array([log_ohm - math.log(pack_ohm), log_Ah - math.log(rated_Ah)])
    return PackHealth(float(mean[0]), float(mean[1]), turn @ covariance @ turn.T)
