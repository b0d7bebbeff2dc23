"""The prior of a flight of a known pack, from its health in the ledger, as members of the filter's bank.

The health is a Gaussian over the pack's scales. It replaces the prior of packs in service, but not completely: a
contact may be burnt, a cell may have died, the label may be of another pack. So a small part of the weight stays with
"the resistance has changed" and with "it is any pack in service", and the readings of the flight decide between them.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from uavbatt.battery import model
from uavbatt.battery.capacity_prior import OVERLAP, Capacities, capacities
from uavbatt.battery.equations import REFERENCE_TEMP_C
from uavbatt.battery.high_voltage import ORDINARY_FULL_V
from uavbatt.battery.model import Array
from uavbatt.battery.scaling import Pack
from uavbatt.battery.sizing.pack_size import PackOptions

REACH, FEWEST, LARGEST_STEP = 2.0, 5, 0.1  # members from -2 to +2 sd, at most so far apart in ln of the capacity
CHANGED_WEIGHT, ANY_WEIGHT = 0.05, 0.03  # the ohms have changed since the last flight; any pack in service

LEAST_UNLIKE, UNLIKE_SD = 0.2, 2.0
ANOTHER = "another pack under its name?"
CAUSES = f"damaged, or {ANOTHER}"


class PackHealth(NamedTuple):
    """PackHealth holds a pack's ln of ohms per cell and ln of Ah at 25 °C and half charge, and their covariance [2, 2].

    They are in ohms and ampere-hours, so that they do not depend on the battery file or on the stated capacity.
    """

    log_ohm: float
    log_Ah: float
    covariance: Array
    cells: int = 0  # in series; 0 where nobody says
    fullest_cell_V: float = ORDINARY_FULL_V  # voltage at which a full cell has rested [V]

    def may_be(self, pack: Pack) -> bool:
        """Return False if the pack has another number of cells, so that it is another pack under this name."""
        return self.cells in (0, int(pack.installation.cells))


class Scales(NamedTuple):
    """Scales holds ln of the resistance scale (of ohm·Ah) and ln of the capacity scale against a battery file.

    They are a mean [2] and a covariance [2, 2].
    """

    mean: Array
    covariance: Array


# Prior of a pack without memory and without assumptions: so wide that the belief shows what the flight itself says.
UNKNOWN = Scales(np.array([0.0, -0.05]), np.diag([0.3**2, 0.2**2]))
HALF_CHARGE, HOVER_C_RATE = 0.5, 2.5
REMEMBERED_REACTION_SD_V = 0.025  # for remembered ohms that are a reaction; half of that of any pack
REACTION_SHARE = 0.6  # with more, plans for aged packs are too long in the cold; with less, too short in the warmth
TO_SCALES = np.array([[1.0, 1.0], [0.0, 1.0]])  # an ohm·Ah is an ohm times an Ah
FROM_SCALES = np.array([[1.0, -1.0], [0.0, 1.0]])


def of_known_cells(options: PackOptions, health: PackHealth | None) -> PackOptions:
    """Return the options with the kind of cells (fullest voltage) that earlier flights have shown."""
    if health is None or health.fullest_cell_V <= options.fullest_cell_V:
        return options
    return replace(options, fullest_cell_V=health.fullest_cell_V)


def type_ohm(pack: Pack) -> float:
    """Return the resistance of one cell [ohm] as the battery file has it, at 25 °C and half charge."""
    resistance_ohmAh = float(model.resistance(pack.cell, HALF_CHARGE, REFERENCE_TEMP_C))
    return resistance_ohmAh / float(pack.installation.capacity_Ah)


def hover_drop_V(pack: Pack) -> float:
    """Return the voltage drop of a cell by the battery file's resistance at hover current [V]."""
    return HOVER_C_RATE * float(model.resistance(pack.cell, HALF_CHARGE, REFERENCE_TEMP_C))


def scales_of(pack: Pack, health: PackHealth) -> Scales:
    """Return the remembered ohms and ampere-hours as scales against the battery file."""
    own = np.log([type_ohm(pack), float(pack.installation.capacity_Ah)])
    covariance = TO_SCALES @ health.covariance @ TO_SCALES.T
    return Scales(TO_SCALES @ (np.array(health[:2]) - own), covariance)


def health_of(pack: Pack, scales: Scales) -> PackHealth:
    """Return scales against the battery file as ohms and ampere-hours."""
    log_ohm, log_Ah = FROM_SCALES @ scales.mean + np.log([type_ohm(pack), float(pack.installation.capacity_Ah)])
    return PackHealth(float(log_ohm), float(log_Ah), FROM_SCALES @ scales.covariance @ FROM_SCALES.T)


def prior_of(pack: Pack, health: PackHealth | None) -> Capacities:
    """Return the members of the prior, of a pack with health from the ledger or of an unknown pack."""
    return capacities(pack) if health is None or not health.may_be(pack) else remembered_capacities(pack, health)


def with_reaction(pack: Pack, health: PackHealth | None) -> Pack:
    """Return the pack with part of its additional resistance as a slow reaction, whose drop does not grow at the knee.

    Additional resistance alone, which grows as the cell empties, would end a warm flight too early; the reaction alone
    would hide the effect of cold. The flights of a pack do not show which of the two has aged, so that each gets a
    share.
    """
    if health is None or not health.may_be(pack):
        return pack
    return pack._replace(
        cell=pack.cell._replace(transfer_V=_reacting_V(pack, float(scales_of(pack, health).mean[0]))),
        spread=pack.spread._replace(reaction_sd_V=REMEMBERED_REACTION_SD_V),
    )


def _reacting_V(pack: Pack, log_resistance: float) -> float:
    """Return the drop of the reaction [V] in a pack of this resistance (ln of its ratio to the battery file's)."""
    reacting_V = REACTION_SHARE * math.expm1(log_resistance) * hover_drop_V(pack)
    return float(pack.cell.transfer_V) + max(reacting_V, 0.0)


def _without_reaction(log_resistance: float) -> float:
    """Return the resistance without the share of the reaction (ln of its ratio to the battery file's)."""
    if log_resistance <= 0.0:
        return log_resistance
    return math.log1p((1.0 - REACTION_SHARE) * math.expm1(log_resistance))


def wear_of(pack: Pack, health: PackHealth) -> tuple[dict[str, dict[str, float]], tuple[float, float]]:
    """Return the wear in the health as effects of a battery file, and the sd of fade and resistance growth."""
    (log_resistance, log_capacity), covariance = scales_of(pack, health)
    growth = max(math.expm1(_without_reaction(float(log_resistance))), 0.0)  # packs age in one direction
    effects = {
        "capacity_fade": {"fade": max(-math.expm1(float(log_capacity)), 0.0)},
        "resistance_growth": {"growth": growth},
        "charge_transfer": {"transfer_V": _reacting_V(pack, float(log_resistance))},
    }
    resistance_sd, capacity_sd = np.sqrt(np.diag(covariance)).tolist()
    return effects, (capacity_sd * math.exp(float(log_capacity)), resistance_sd * (1.0 + growth))


def remembered_capacities(pack: Pack, health: PackHealth) -> Capacities:
    """Return the members of the prior of a known pack: around its health, and for the doubts about it."""
    (log_resistance, log_capacity), covariance = scales_of(pack, health)
    log_resistance = _without_reaction(log_resistance)
    resistance_sd, capacity_sd = np.sqrt(np.diag(covariance)).tolist()
    told_by_capacity = float(covariance[0, 1]) / capacity_sd  # ln of the resistance per sd of the capacity
    count = max(FEWEST, math.ceil(2.0 * REACH * capacity_sd / LARGEST_STEP) + 1)
    away = np.linspace(-REACH, REACH, count)
    member_sd = OVERLAP * float(away[1] - away[0])
    likely = np.exp(-0.5 * away**2 / (1.0 - member_sd**2))
    own_sd = math.sqrt(max(resistance_sd**2 - told_by_capacity**2 * (1.0 - member_sd**2), 1e-6))
    core = Capacities(
        log_scale=log_capacity + capacity_sd * away,
        sd=np.full(count, member_sd * capacity_sd),
        weight=(1.0 - CHANGED_WEIGHT - ANY_WEIGHT) * likely / likely.sum(),
        log_resistance=log_resistance + told_by_capacity * away,
        resistance_sd=np.full(count, own_sd),
    )
    changed = Capacities(
        log_scale=np.array([log_capacity]),
        sd=np.array([capacity_sd]),
        weight=np.array([CHANGED_WEIGHT]),
        log_resistance=np.array([log_resistance]),
        resistance_sd=np.array([math.hypot(resistance_sd, pack.spread.resistance_scale_sd)]),
    )
    stranger = capacities(pack)
    return _together(core, changed, stranger._replace(weight=ANY_WEIGHT * stranger.weight))


def _together(*parts: Capacities) -> Capacities:
    return Capacities(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def unlike(pack: Pack, health: PackHealth, wear: float, wear_sd: float) -> str:
    """Return in words why the pack in flight is hardly the one in the ledger, by cells or ohms; empty if it may be.

    wear : ohms above the type's by the flight, relative, without the share of the reaction (`with_reaction`)
    wear_sd : sd of ln(1 + wear)
    """
    if not health.may_be(pack):
        return f"{pack.installation.cells} cells, {health.cells} remembered of this pack: {ANOTHER}"
    if not wear > -1.0:
        return ""
    log_resistance, log_capacity = scales_of(pack, health).mean
    expected = _without_reaction(float(log_resistance)) - float(log_capacity)
    apart = math.log1p(wear) - expected
    sd = math.hypot(wear_sd, math.sqrt(health.covariance[0, 0]))
    if abs(apart) < max(LEAST_UNLIKE, UNLIKE_SD * sd):
        return ""
    tens = 10 * round(10.0 * abs(math.expm1(apart)))  # rounded, so that the text does not change with every per cent
    direction, causes = ("more", CAUSES) if apart > 0.0 else ("less", ANOTHER)
    return f"about {tens}% {direction} resistance than remembered of this pack: {causes}"
