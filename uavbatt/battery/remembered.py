"""A pack that was met before: the prior of its next flight, as members of the filter's bank.

What is remembered is a Gaussian over the pack's scales. It replaces the prior of packs in service, but never wholly: a
contact may have burnt, a cell may have died, the label may be another pack's. So a small part of the weight stays with
"the ohms have changed" and with "it is any pack in service", and the flight's own readings decide between them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uavbatt.battery.build import Pack
from uavbatt.battery.model import Array
from uavbatt.battery.service import OVERLAP, Capacities, capacities

REACH, FEWEST, LARGEST_STEP = 2.0, 5, 0.1  # members from -2 to +2 sd, at most so far apart in ln of the capacity
CHANGED_WEIGHT, ANY_WEIGHT = 0.05, 0.03  # the ohms have changed since the last flight; any pack in service


class PackHealth(NamedTuple):
    """Health of one pack against its battery file at 25 °C: ln of its two scales, and their covariance [2, 2]."""

    log_resistance: float
    log_capacity: float
    covariance: Array


# A pack of which nothing is remembered nor assumed, so wide that a flight's belief tells what the flight itself said.
UNKNOWN_HEALTH = PackHealth(0.0, -0.05, np.diag([0.3**2, 0.2**2]))


def prior_of(pack: Pack, health: PackHealth | None) -> Capacities:
    """The members of a pack that was met before, or of one that nobody knows."""
    return capacities(pack) if health is None else remembered_capacities(pack, health)


def remembered_capacities(pack: Pack, health: PackHealth) -> Capacities:
    """The members of a pack that was met before: around what is remembered, and the doubt about it."""
    resistance_sd, capacity_sd = (math.sqrt(variance) for variance in np.diag(health.covariance))
    told_by_capacity = float(health.covariance[0, 1]) / capacity_sd  # ln of the resistance per sd of the capacity
    count = max(FEWEST, math.ceil(2.0 * REACH * capacity_sd / LARGEST_STEP) + 1)
    away = np.linspace(-REACH, REACH, count)
    member_sd = OVERLAP * float(away[1] - away[0])
    likely = np.exp(-0.5 * away**2 / (1.0 - member_sd**2))
    own_sd = math.sqrt(max(resistance_sd**2 - told_by_capacity**2 * (1.0 - member_sd**2), 1e-6))
    core = Capacities(
        log_scale=health.log_capacity + capacity_sd * away,
        sd=np.full(count, member_sd * capacity_sd),
        weight=(1.0 - CHANGED_WEIGHT - ANY_WEIGHT) * likely / likely.sum(),
        log_resistance=health.log_resistance + told_by_capacity * away,
        resistance_sd=np.full(count, own_sd),
    )
    changed = Capacities(
        log_scale=np.array([health.log_capacity]),
        sd=np.array([capacity_sd]),
        weight=np.array([CHANGED_WEIGHT]),
        log_resistance=np.array([health.log_resistance]),
        resistance_sd=np.array([math.hypot(resistance_sd, pack.resistance_scale_sd)]),
    )
    stranger = capacities(pack)
    return _together(core, changed, stranger._replace(weight=ANY_WEIGHT * stranger.weight))


def _together(*parts: Capacities) -> Capacities:
    return Capacities(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
