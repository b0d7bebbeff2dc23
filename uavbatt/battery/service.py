"""How much charge packs in service hold: the prior over a pack's capacity, as a bank of members.

A season takes 10 to 25 % of a pack's capacity, and nobody writes it down: a pack that nobody measured holds between
0.7 and 1.05 of what is printed on it. Rarely it is quite another pack than stated, or the current sensor reads low or
high, which looks the same. A Gaussian around 1 cannot say that, and a filter linearised at one capacity does not see
the knee of a smaller one. So the belief is a sum of Gaussians, one every tenth of the capacity.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uavbatt.battery.build import Pack
from uavbatt.battery.model import Array

MEMBERS = 13
# ln of the capacity against the stated one: packs in service, and those of which something stated is wrong.
SERVICE_MEAN, SERVICE_SD = -0.07, 0.12
WRONG_SHARE, WRONG_MEAN, WRONG_SD = 0.12, -0.3, 0.35
SMALLEST, LARGEST = math.log(0.35), math.log(1.25)
REACH = 2.2  # standard deviations that the members cover where the capacity is known even less
OVERLAP = 0.6  # sd of a member as a share of the distance to the next


class Capacities(NamedTuple):
    """Members of the prior: ln of the capacity scale [members], its sd within each, their weights [members]."""

    log_scale: Array
    sd: float
    weight: Array


def capacities(pack: Pack) -> Capacities:
    """The prior of a pack that nobody measured; `pack.capacity_scale_sd` widens it."""
    sd = math.hypot(SERVICE_SD, pack.capacity_scale_sd)
    low = min(SMALLEST, SERVICE_MEAN - REACH * sd)
    high = max(LARGEST, SERVICE_MEAN + REACH * sd)
    scale = np.linspace(low, high, MEMBERS)
    wrong_sd = max(WRONG_SD, sd)
    weight = (1.0 - WRONG_SHARE) * _normal((scale - SERVICE_MEAN) / sd) / sd
    weight += WRONG_SHARE * _normal((scale - WRONG_MEAN) / wrong_sd) / wrong_sd
    return Capacities(scale, OVERLAP * float(scale[1] - scale[0]), weight / weight.sum())


def known_capacity(pack: Pack) -> Capacities:
    """One member, around what is stated: for a pack that was measured."""
    return Capacities(np.zeros(1), pack.capacity_scale_sd, np.ones(1))


def _normal(z: Array) -> Array:
    return np.asarray(np.exp(-0.5 * z**2))
