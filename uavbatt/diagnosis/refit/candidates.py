"""Candidate effects for a residual: the quantities that each refit frees, their starting values and their bounds.

A candidate is a named effect with the quantities that its refit frees. In the solver's space a quantity is u with

    value = start + scale·u            or            value = start·exp(scale·u)

and bounds on the value. Effects of the aircraft (wiring, sensors, start) are always candidates. An effect of the cell
is a candidate only if the battery file lacks it; the lag of the temperature sensor is an exception, because the file
states it for another mounting.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from uavbatt.battery.battery_file import BatteryFile, EffectEntry
from uavbatt.battery.effects import EFFECTS, Effect, Quantity
from uavbatt.battery.model import Array, Parameters
from uavbatt.battery.pack import Installation

QUANTITIES = tuple(q for effect in EFFECTS.values() for q in effect.quantities)
INDEX = {q.name: i for i, q in enumerate(QUANTITIES)}
UNITS = {q.name: q.unit for q in QUANTITIES}
ALWAYS = ("temperature_lag", "charge_transfer", "polarisation", "slow_diffusion", "temperature_resistance")
PACKS_OWN = ("temperature_lag", "charge_transfer")  # sensor mounting and ageing: worth reporting if changed
ONE_WAY = ("fade", "growth")  # ageing has one direction
SLOWING = ("transfer_V",)  # reactions only become slower: never less than in the file
NEEDS_TEMPERATURE = (
    "temperature_lag",
    "temperature_offset",
    "airflow_cooling",
    "self_heating",
    "temperature_resistance",
)

# A sensor may drift along one of these: the time since the record began, or the measured temperature.
Course = Literal["time", "temperature"]
COURSES: tuple[Course, ...] = get_args(Course)


@dataclass(frozen=True, slots=True)
class FreeQuantity:
    """FreeQuantity is a quantity that a refit frees: QUANTITIES[index] = start + `scale` times u, within its bounds."""

    index: int
    start: float
    scale: float
    low: float
    high: float
    log: bool
    nuisance: bool = False  # u has a standard normal prior, and the value is added to that of the effects
    estimated: bool = True  # a nuisance that is not moved still counts in the standard errors
    shares: tuple[float, ...] = ()  # share of the change in each record; empty: all of it in every record
    along: Course | None = None  # if set, the value is the change of the quantity along that course

    def value(self, u: Array) -> Array:
        """Return the value at u, kept within the bounds."""
        raw = self.start * np.exp(self.scale * u) if self.log else self.start + self.scale * u
        clipped: Array = np.clip(raw, self.low, self.high)
        return clipped

    def at(self, value: float) -> float:
        """Return the u that gives a value."""
        return float(np.log(value / self.start) if self.log else value - self.start) / self.scale

    def bounds_u(self) -> tuple[float, float]:
        """Return the lower and the upper bound in u."""
        if not self.log:
            return (self.low - self.start) / self.scale, (self.high - self.start) / self.scale
        return float(np.log(self.low / self.start) / self.scale), float(np.log(self.high / self.start) / self.scale)


@dataclass(frozen=True, slots=True)
class Candidate:
    """A Candidate is one effect, or several that are refitted together.

    `names` has the name of each effect, `sizes` the number of its quantities among `freed`. With `free_start` every
    record has a starting charge of its own, around a shift that all share.
    """

    names: tuple[str, ...]
    freed: tuple[FreeQuantity, ...]
    sizes: tuple[int, ...] = ()
    free_start: bool = False
    resized: tuple[str, ...] = ()  # effects of the battery file, refitted with another size

    @property
    def name(self) -> str:
        """Return the name of the effect that was added last, "none" without any."""
        return self.names[-1] if self.names else "none"

    @property
    def last(self) -> int:
        """Return the number of quantities of the effect that was added last."""
        return self.sizes[-1] if self.sizes else 0

    def slice_of(self, name: str) -> slice:
        """Return the slice of the freed quantities that belongs to an effect."""
        k = self.names.index(name)
        first = sum(self.sizes[:k])
        return slice(first, first + self.sizes[k])

    def plus(self, other: Candidate) -> Candidate:
        """Return a candidate with the effects of both."""
        return Candidate(
            self.names + other.names,
            self.freed + other.freed,
            self.sizes + other.sizes,
            self.free_start or other.free_start,
            self.resized + other.resized,
        )


NOTHING = Candidate((), ())

# Possible errors of the battery file, equal for all records, and the delay between the readings of current and voltage.
# Each of them looks like an effect; only what exceeds them is an effect. A file fitted to metered records of this pack
# is right to about a percent; a file for all packs of a make, to a share of the scatter that it states.
CAPACITY_SD, RESISTANCE_SD, DELAY_SD_S = 0.008, 0.015, 0.25
CAPACITY_SHARE, RESISTANCE_SHARE = 0.4, 0.25
# Errors that the file states. The errors of other effects follow that of the resistance.
STATED = ("sensor_lag_s", "activation_K", "diffusion_activation_K", "heat_capacity_JpKAh", "cooling_WpKAh")
# A reaction slows down in the cold by another law than a resistance grows, and the model does not have that law. If the
# file has a slow reaction, its behaviour in the cold is known no better than this, however well it fits a few flights.
LEAST_ACTIVATION_SD_K = 300.0
FARTHEST = 6.0  # sds: bounds of an error of the file, so wide that only a diverging step meets them
NEARLY_NONE = 1e-3  # of its start, a quantity that has a logarithm: as good as none, which has no logarithm


def nuisances(
    file: BatteryFile, wear_sd: tuple[float, float] = (0.0, 0.0), least_activation_sd_K: float = LEAST_ACTIVATION_SD_K
) -> tuple[FreeQuantity, ...]:
    """List the errors of the battery file that all records share, each in u with sd 1.

    wear_sd : sd of the fade and growth of a known pack; least_activation_sd_K : least error of the activation
    temperature [K] for a file with slow reactions, 0 to use the error that the file states.
    """
    table = file.parameters
    resistance_sd = RESISTANCE_SHARE * table.resistance_scale_sd
    if file.is_measured and table.c_rate is None:
        resistance_sd = min(resistance_sd, RESISTANCE_SD)
    return (
        _nuisance("fade", math.hypot(capacity_sd(file), wear_sd[0])),
        _nuisance("growth", math.hypot(resistance_sd, wear_sd[1])),
        _nuisance("delay_s", DELAY_SD_S, estimated=True),
        *(
            _nuisance(name, sd)
            for entry in file.effects
            for name in STATED
            if (sd := _believed_sd(file, entry, name, least_activation_sd_K)) > 0.0
        ),
    )


def capacity_sd(file: BatteryFile) -> float:
    """Return the relative standard deviation of the file's capacity."""
    file_sd = CAPACITY_SHARE * file.parameters.capacity_scale_sd
    return min(file_sd, CAPACITY_SD) if file.is_measured and file.parameters.c_rate is None else file_sd


def _believed_sd(file: BatteryFile, entry: EffectEntry, name: str, least_activation_sd_K: float) -> float:
    """Return the assumed error of a quantity, 0 if the file states none."""
    file_sd = entry.standard_error.get(name, 0.0)
    reacts = name == "activation_K" and any(e.name == "charge_transfer" for e in file.effects)
    return max(file_sd, least_activation_sd_K) if reacts and file_sd > 0.0 else file_sd


def _nuisance(name: str, sd: float, *, estimated: bool = False) -> FreeQuantity:
    far = FARTHEST * sd
    return FreeQuantity(INDEX[name], 0.0, sd, -far, far, log=False, nuisance=True, estimated=estimated)


def base_values(cell: Parameters, installation: Installation) -> Array:
    """Return the battery file's value of every quantity, in the order of QUANTITIES; 0 if the file has none."""
    values = {**cell._asdict(), **installation._asdict()}
    return np.array([float(values.get(q.name, 0.0)) for q in QUANTITIES])


def candidates(
    file: BatteryFile, base: Array, *, has_temperature: bool, idle_A: float, without: tuple[str, ...]
) -> list[Candidate]:
    """List every effect worth trying on a battery of this file, except those in `without`.

    base : the file's values (`base_values`); idle_A : the current [A] that the sensor reports at rest, the upper limit
    of its offset, since no pack charges on the ground.
    """
    listed = {entry.name for entry in file.effects}
    options = []
    for effect in EFFECTS.values():
        if effect.name in without or (effect.name in listed and effect.name not in ALWAYS):
            continue
        if effect.name in NEEDS_TEMPERATURE and not has_temperature:
            continue
        free = [q for q in effect.quantities if q.prior_sd > 0.0 and q.fitted]
        if effect.name in listed:  # another size of an effect of the file, not another shape
            free = [q for q in effect.quantities if not q.fitted] or free[:1]
        freed = tuple(_free_quantity(q, base[INDEX[q.name]], effect) for q in free)
        if effect.name == "current_offset":
            freed = (replace(freed[0], high=min(freed[0].high, max(idle_A, freed[0].start))),)
        has_it = effect.name in listed and base[INDEX[free[0].name]] != free[0].neutral
        resized = (effect.name,) if has_it and effect.name not in PACKS_OWN else ()
        own_start = effect.name == "initial_charge"  # each flight had its own charge
        options.append(Candidate((effect.name,), freed, (len(freed),), own_start, resized))
    return options


def _free_quantity(quantity: Quantity, base: float, effect: Effect) -> FreeQuantity:
    """Return the freed quantity: it starts at the file's value if the quantity has an "off", else at its prior."""
    listed = len(effect.quantities) == 1 or base != quantity.neutral
    start = base if listed else quantity.prior
    log = quantity.log and start > 0.0
    scale = quantity.prior_sd if log or not quantity.log else max(quantity.prior, 1e-6)
    low = max(quantity.low, NEARLY_NONE * start) if log else 0.0 if quantity.name in ONE_WAY else quantity.low
    low = max(low, base) if quantity.name in SLOWING else low
    return FreeQuantity(INDEX[quantity.name], float(start), scale, low, quantity.high, log)
