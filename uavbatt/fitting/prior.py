"""Prior of a LiPo cell or, of flights, a lithium-ion cell before any data: it keeps a fit physical.

The fit's unknowns are `Slot`s. In the optimiser's space every slot is a standard normal number u; its value is
prior + sd·u, or prior·exp(sd·u) for a positive quantity, within the bounds of a battery file. So the penalty of the
prior is |u|².
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uavbatt.battery.effects import EFFECTS
from uavbatt.battery.high_voltage import ocv_of_fuller
from uavbatt.battery.model import Array, Parameters
from uavbatt.battery.tables import dense, dense_resistance

# Rested voltage of a LiPo cell (LiCoO2/graphite) against state of charge: rounded averages of published
# discharge tables; ±30 mV over makes, more below 5 % and, as cells are sold that charge to 4.35 V, near full.
OCV_SOC = np.array([0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0])
OCV_V = np.array([3.27, 3.45, 3.61, 3.69, 3.71, 3.73, 3.77, 3.80, 3.84, 3.88, 3.95, 4.02, 4.11, 4.15, 4.20])
OCV_SD_V = np.array([0.25, 0.2, 0.06, 0.04, *[0.03] * 8, 0.04, 0.05, 0.05])

# Makes differ less in the fall of the OCV from knot to knot than in its level. Without this prior a fit to few rows
# made steps. A fit to flights, which end at a few C and do not reach the last hundredths of the charge, made the OCV
# flat there: the time was too long for packs that were emptied deeper or more slowly than on those flights. From the
# fourth knot on, 0.03 to 0.04 V do alike on the study, the simulated laboratory and flights of packs of every age.
FALL_SD_V = np.array([0.15, 0.08, 0.08, *[0.037] * 11])  # between neighbouring knots

# Rested voltage of a cylindrical lithium-ion cell (NMC or NCA): rounded averages of measured cells (Chen et al., J.
# Electrochem. Soc. 167, 2020, 080534; Kim et al., ibid. 158, 2011, A955) and of typical cells.
LITHIUM_ION_V = np.array([2.6, 2.93, 3.13, 3.3, 3.39, 3.45, 3.55, 3.63, 3.7, 3.79, 3.89, 3.99, 4.08, 4.12, 4.18])
LITHIUM_ION_SD_V = np.array([0.25, 0.18, 0.1, 0.08, 0.07, 0.07, 0.06, *[0.05] * 4, *[0.04] * 4])

OCV_SLOPE_V = 0.02  # per unit of charge: the flattest that a cell of this chemistry is
DISORDER_SD_V = 0.003  # an OCV may fall short of the flattest slope by the resolution of a cell's meter

RESISTANCE_SOC = np.array([0.0, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0])
# 5.6 mohm for a cell of 5 Ah, without the polarisation. Packs differ by a factor of 1.6 either way: in all 0.04 ohm·Ah
# for a racing pack, 0.06 in the study, 0.1 for packs built for energy.
RESISTANCE_OHMAH = 0.028
RESISTANCE_SD = 0.8  # in ln: a factor of 2.2, beyond the 1.6 between packs
FARTHEST_LN = 8.0  # a factor of 3000: farther out only a diverging step goes
RESISTANCE_SHAPE_SD = 0.4  # factor between neighbouring charges
# Towards empty a resistance does not fall, but for this share of it: the knee of a worn pack is no bump of the ohms.
RISES_BELOW_SOC, DIP_SD = 0.3, 0.1
BUMP = 0.3  # in ln: a larger fall of a fitted resistance stands for something else

LITHIUM_ION_OHMAH = 0.06  # 20 mohm for a cell of 3 Ah: the large ones have less, the small ones more

BASE_EFFECTS = ("polarisation", "slow_diffusion", "temperature_resistance", "self_heating", "temperature_lag")


@dataclass(frozen=True, slots=True)
class Slot:
    """A slot is one unknown of a fit with its prior and bounds; `log` slots are positive and their sd is relative."""

    name: str
    prior: float
    sd: float
    log: bool = False
    low: float = -np.inf
    high: float = np.inf


@dataclass(frozen=True, slots=True, eq=False)
class Chemistry:
    """A Chemistry is what is known of the cells of a kind before any data: the OCV at OCV_SOC [V], its sd, and R0.

    cutoff_V, low_V : of a cell under load, where crews end a flight and are warned, if nobody states it [V]
    """

    name: str
    ocv_V: Array
    ocv_sd_V: Array
    ohmAh: float
    cutoff_V: float
    low_V: float


LIPO = Chemistry("LiPo", OCV_V, OCV_SD_V, RESISTANCE_OHMAH, 3.3, 3.5)  # 10.5 V is the usual warning of a 3S pack
LITHIUM_ION = Chemistry("Li-ion", LITHIUM_ION_V, LITHIUM_ION_SD_V, LITHIUM_ION_OHMAH, 3.0, 3.2)


def ocv_knots(fullest_V: float, chemistry: Chemistry = LIPO) -> Array:
    """Return the OCV [V] at OCV_SOC of cells that have rested at `fullest_V` [V] and no higher."""
    return ocv_of_fuller(OCV_SOC, chemistry.ocv_V, fullest_V)


def cell_slots(
    effects: tuple[str, ...] = BASE_EFFECTS, fullest_V: float = np.nan, chemistry: Chemistry = LIPO
) -> tuple[Slot, ...]:
    """Return the slots of OCV and R0 at their knots, the level of R0, and the quantities of the effects that are on.

    fullest_V : the highest voltage at which a cell of the type has rested [V], NaN where none was seen.
    """
    known = zip(OCV_SOC, ocv_knots(fullest_V, chemistry), chemistry.ocv_sd_V, strict=True)
    ocv = [Slot(f"ocv_{z:g}", float(v), float(sd)) for z, v, sd in known]
    shape = [Slot(f"r0_{z:g}", 1.0, RESISTANCE_SHAPE_SD, log=True) for z in RESISTANCE_SOC]
    level = Slot("r0_ohmAh", chemistry.ohmAh, RESISTANCE_SD, log=True)
    quantities = [
        Slot(q.name, q.prior, q.prior_sd, q.log, q.low, q.high)  # within the bounds of a battery file
        for name in effects
        for q in EFFECTS[name].quantities
        if q.prior_sd > 0.0 and q.fitted
    ]
    return (*ocv, *shape, level, *quantities)


def values(slots: tuple[Slot, ...], u: Array) -> Array:
    """Return the values of the slots for u [..., slots], each within the slot's bounds."""
    prior = np.array([s.prior for s in slots])
    shift = u * np.array([s.sd for s in slots])
    log = np.array([s.log for s in slots])
    raw = np.where(log, prior * np.exp(np.where(log, np.clip(shift, -FARTHEST_LN, FARTHEST_LN), 0.0)), prior + shift)
    return np.clip(raw, [s.low for s in slots], [s.high for s in slots])


def places(slots: tuple[Slot, ...]) -> dict[str, int]:
    """Return the place of each slot, by its name."""
    return {s.name: i for i, s in enumerate(slots)}


def knots(slots: tuple[Slot, ...], x: Array) -> tuple[Array, Array]:
    """Return OCV [V] and R0 [ohm·Ah] at their knots for values x [..., slots]."""
    at = places(slots)
    first = at[f"ocv_{OCV_SOC[0]:g}"]
    ocv_V = x[..., first : first + OCV_SOC.size]
    first = at[f"r0_{RESISTANCE_SOC[0]:g}"]
    shape = x[..., first : first + RESISTANCE_SOC.size]
    return ocv_V, x[..., at["r0_ohmAh"], None] * shape


def lowest_fall_V(slots: tuple[Slot, ...], u: Array) -> float:
    """Return by how much the OCV falls between the two lowest knots [V], for u [slots]."""
    ocv_V, _ = knots(slots, values(slots, u))
    return float(ocv_V[1] - ocv_V[0])


def shape_penalty(slots: tuple[Slot, ...], x: Array, chemistry: Chemistry = LIPO) -> Array:
    """Return the residuals [..., 2 (knots - 1)] of the OCV's shape for values x [..., slots].

    First those where the OCV does not rise with the charge by OCV_SLOPE_V, else 0; then those of its falls from knot to
    knot, against the falls of the chemistry.
    """
    ocv_V, _ = knots(slots, x)
    rise_V = np.diff(ocv_V, axis=-1)
    short_V = np.maximum(OCV_SLOPE_V * np.diff(OCV_SOC) - rise_V, 0.0)
    return np.concatenate([short_V / DISORDER_SD_V, (rise_V - np.diff(chemistry.ocv_V)) / FALL_SD_V], axis=-1)


def dips(slots: tuple[Slot, ...], x: Array) -> Array:
    """Return by how much ln R0 falls towards empty, from knot to knot near empty [..., knots - 1]; 0 where it rises."""
    _, ohmAh = knots(slots, x)
    out: Array = np.maximum(np.diff(np.log(ohmAh[..., RESISTANCE_SOC <= RISES_BELOW_SOC]), axis=-1), 0.0)
    return out


def made_monotone(ocv_V: Array) -> Array:
    """Return the OCV at its knots [V] without the last millivolts of disorder that a fit may leave."""
    least_V = OCV_SLOPE_V * OCV_SOC
    return np.asarray(np.maximum.accumulate(ocv_V - least_V) + least_V)


def cell(slots: tuple[Slot, ...], x: Array, effects: tuple[str, ...] = BASE_EFFECTS) -> Parameters:
    """Return model parameters for values x [batch, slots]; effects with a fixed quantity (heat_gain) get its prior."""
    at = places(slots)
    ocv_V, r0_ohmAh = knots(slots, x)
    fields = {
        q.name: (x[..., at[q.name]] if q.name in at else q.prior)
        for name in effects
        if EFFECTS[name].acts_on == "cell"
        for q in EFFECTS[name].quantities
    }
    return Parameters(ocv_V=dense(OCV_SOC, ocv_V), r0_ohmAh=dense_resistance(RESISTANCE_SOC, r0_ohmAh), **fields)


@dataclass(frozen=True, slots=True, kw_only=True)
class Posterior:
    """Posterior holds a fit's result: the slots' most probable u with its covariance, and the effects that were on."""

    slots: tuple[Slot, ...]
    effects: tuple[str, ...]
    u: Array
    covariance_u: Array

    @property
    def x(self) -> Array:
        """Return the values of the slots [slots]."""
        return values(self.slots, self.u)

    def value(self, name: str) -> float:
        """Return the value of one slot."""
        return float(self.x[places(self.slots)[name]])

    def standard_error(self, name: str) -> float:
        """Return the standard error of one slot, to first order."""
        i = places(self.slots)[name]
        slot, sd_u = self.slots[i], float(np.sqrt(self.covariance_u[i, i]))
        return sd_u * slot.sd * (float(self.x[i]) if slot.log else 1.0)

    @property
    def standard_errors(self) -> dict[str, float]:
        """Return the standard error of every slot, by its name."""
        return {s.name: self.standard_error(s.name) for s in self.slots}
