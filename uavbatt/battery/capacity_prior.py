"""Prior of the capacity that packs in service still hold, as a bank of members (a sum of Gaussians).

A season of use takes 10 to 25 % of a pack's capacity. So an unmeasured pack holds between 0.7 and 1.05 of its printed
capacity. Rarely it is a different pack than stated, or the current sensor reads low or high, which looks the same. A
single Gaussian around 1 cannot describe that, and a filter linearised at one capacity does not see the knee of a
smaller one. So the belief is a sum of Gaussians, one for every tenth of the capacity.

For a known make all members begin with its ohm·Ah, which fading does not change. For an unknown make they begin with
the same ohms, so that the scale of ohm·Ah is that of capacity: otherwise a pack of low resistance, which depends on the
make, would be evidence against every small capacity.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.battery.scaling import Pack

MEMBERS = 13
SMALLEST, LARGEST = math.log(0.35), math.log(1.25)
NEW_SHORT = 0.3  # share of the doubt about a printed capacity that remains for a new pack
SHARPEST = 0.02  # a narrower mode would be lost between two members
REACH = 2.2  # standard deviations that the members cover where the capacity is known even less
OVERLAP, UNKNOWN_MAKE_OVERLAP = 0.35, 0.6  # sd of a member as a share of the distance to the next
# Covers a capacity that is stated ten times too large, and all between.
ABSURD, ABSURD_SD, ABSURD_WEIGHT = (math.log(0.11), math.log(0.21)), 0.25, 0.004
# Shares, means and sds of ln(capacity / stated), added to the spread of the file's own packs: packs as good as new,
# packs in service, and packs about which something was stated wrongly.
PRIOR = ((0.68, 0.0, 0.0), (0.25, -0.14, 0.09), (0.07, -0.30, 0.35))
UNKNOWN_MAKE_PRIOR = ((0.53, 0.0, 0.03), (0.35, -0.14, 0.09), (0.12, -0.30, 0.35))


class Capacities(NamedTuple):
    """Capacities holds the prior's members, [members] each: ln of capacity scale, its sd within the member, its weight.

    With them go ln of the resistance scale (of ohm times Ah) and its sd.
    """

    log_scale: Array
    sd: Array
    weight: Array
    log_resistance: Array
    resistance_sd: Array


def capacities(pack: Pack) -> Capacities:
    """Return the prior of an unmeasured pack; `pack.spread.capacity_scale_sd` widens it."""
    is_known = pack.spread.capacity_short_sd == 0.0  # the make was measured
    prior, overlap = (PRIOR, OVERLAP) if is_known else (UNKNOWN_MAKE_PRIOR, UNKNOWN_MAKE_OVERLAP)
    widest = math.hypot(prior[1][2], pack.spread.capacity_scale_sd)
    scale = np.linspace(min(SMALLEST, -REACH * widest), max(LARGEST, REACH * widest), MEMBERS)
    weight = np.zeros(MEMBERS)
    for share, mean, own_sd in prior:
        above = max(math.hypot(own_sd, pack.spread.capacity_scale_sd), SHARPEST)
        short_sd = pack.spread.capacity_short_sd * (1.0 if mean < 0.0 else NEW_SHORT)
        sd = np.where(scale > mean, above, math.hypot(above, short_sd))
        weight += share * np.exp(-0.5 * ((scale - mean) / sd) ** 2) / (above + sd.max())
    weight *= (1.0 - len(ABSURD) * ABSURD_WEIGHT) / weight.sum()
    member_sd = np.full(MEMBERS, overlap * float(scale[1] - scale[0]))
    every = np.concatenate([ABSURD, scale])
    return Capacities(
        every,
        np.concatenate([np.full(len(ABSURD), ABSURD_SD), member_sd]),
        np.concatenate([np.full(len(ABSURD), ABSURD_WEIGHT), weight]),
        np.zeros(every.size) if is_known else every,
        np.full(every.size, pack.spread.resistance_scale_sd),
    )


def known_capacity(pack: Pack) -> Capacities:
    """Return one member around the stated capacity, for a measured pack."""
    capacity_sd, resistance_sd = np.full(1, pack.spread.capacity_scale_sd), np.full(1, pack.spread.resistance_scale_sd)
    return Capacities(np.zeros(1), capacity_sd, np.ones(1), np.zeros(1), resistance_sd)
