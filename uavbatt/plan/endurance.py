"""Endurance before take-off: how long a rested pack of a battery file lasts under a load, over ambient temperature.

It is the same forecast as in flight (`prediction.forecaster`), from a belief without any measurement. So its width
comes from the spreads in the battery file and from the unknown load.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from uavbatt.battery import model
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.equations import REFERENCE_TEMP_C, arrhenius
from uavbatt.battery.remembered import PackHealth, prior_of, with_reaction
from uavbatt.battery.scaling import Pack
from uavbatt.battery.sections import FITTED_HIGH, FITTED_LOW
from uavbatt.battery.sizing.log_statements import check_statements, size_from_rows
from uavbatt.battery.sizing.pack_size import FROM_BATTERY_FILE, PackOptions, PackSize, size_of_pack, sized
from uavbatt.battery.state_space import SIZE, Belief, X, voltage
from uavbatt.errors import UsageError
from uavbatt.estimation.noise import start_covariances
from uavbatt.limits import rate_doubt, refuse_certain
from uavbatt.prediction.forecaster import Forecaster, ForecastSettings
from uavbatt.prediction.load.scenarios import ConstantLoad, Load
from uavbatt.records import NAN, Flight, PackFacts

TABLE_C = tuple(float(t) for t in range(-20, 51, 10))
CURVE_C = tuple(float(t) for t in range(-20, 51, 5))
START_SOC_SD = 0.01  # by a charger that says full, or a rested voltage
AMBIENT_SD_K = 2.0
NOMINAL_CELL_V = 3.7
VALID_WITHIN_K = 5.0


@dataclass(frozen=True, slots=True)
class Endurance:
    """Endurance gives the seconds in the air at one ambient temperature; NaN with the reason in `remark` if unknown.

    lo_s, hi_s : 5 % and 95 % point; to_low_s : until the low-voltage warning, NaN where the pack has none.
    """

    ambient_C: float
    median_s: float
    lo_s: float
    hi_s: float
    to_low_s: float
    remark: str = ""


@dataclass(frozen=True, slots=True)
class Plan:
    """A plan holds the pack, the load, and the endurance at the planned temperature, as table and as finer curve."""

    resolved: PackSize
    load: str
    start_soc: float
    here: Endurance
    rows: tuple[Endurance, ...]
    curve: tuple[Endurance, ...]
    warnings: tuple[str, ...]


def resolve(battery: BatteryFile, options: PackOptions, like: Flight | None = None) -> PackSize:
    """Return the pack's size from the options, else from the past flight `like`, else from the battery file.

    Raises UsageError when nobody states the cells or the capacity, and for statements that the past flight contradicts.
    """
    if like is not None:
        check_statements(battery, options, like)
        return size_from_rows(battery, options, like, like.facts_at(math.inf))
    typed = battery.battery
    if options.cells is None and not battery.is_measured:
        raise UsageError(f"cells: battery `{typed.name}` is per cell: give --cells")
    found = size_of_pack(battery, options, PackFacts(), typed.cells_series, FROM_BATTERY_FILE)
    if found.refusal:
        raise UsageError(found.refusal)
    return found


class TakeOff(NamedTuple):
    """TakeOff says how a flight begins: the air [°C], the charge, the charge that ends it, and the pack's health."""

    ambient_C: float
    start_soc: float = 1.0
    reserve_soc: float = 0.0
    remembered: PackHealth | None = None  # by the ledger


def make_plan(battery: BatteryFile, resolved: PackSize, load: tuple[Load, str], take_off: TakeOff) -> Plan:
    """Return the plan for a load and its name. Raises UsageError for a power that the pack cannot give."""

    def at(ambients_C: Sequence[float]) -> tuple[Endurance, ...]:
        return tuple(endurance(battery, resolved, load[0], take_off._replace(ambient_C=t)) for t in ambients_C)

    doubt = None
    if isinstance(load[0], ConstantLoad):
        at_rate = load[0].power_W / (NOMINAL_CELL_V * resolved.cells * resolved.capacity_Ah)
        doubt = rate_doubt(f"{load[1]} on {resolved.cells}S {resolved.capacity_Ah:g} Ah is", at_rate)
    refuse_certain(doubt)
    curve = at(CURVE_C)
    rows = tuple(e for e in curve if e.ambient_C in TABLE_C)
    warnings = (*filter(None, (resolved.uncertified, doubt.words if doubt is not None else "")), *resolved.notices)
    here = _headline(battery, at([take_off.ambient_C])[0])
    return Plan(resolved, load[1], take_off.start_soc, here, rows, curve, warnings)


def _headline(battery: BatteryFile, found: Endurance) -> Endurance:
    """Return the endurance, without numbers at a temperature that the battery file does not cover."""
    if not is_outside(battery, found.ambient_C):
        return found
    return Endurance(found.ambient_C, NAN, NAN, NAN, NAN, f"not known: {range_remark(battery, found.ambient_C)}")


def endurance(battery: BatteryFile, resolved: PackSize, load: Load, take_off: TakeOff) -> Endurance:
    """Return the time from take-off to the end of flight, the pack rested and as warm as the air."""
    ambient_C, start_soc, reserve_soc, remembered = take_off
    pack = with_reaction(sized(battery, resolved), remembered)
    forecaster = Forecaster(pack, ForecastSettings(load, reserve_soc))
    belief = rested(pack, start_soc, ambient_C, remembered, unseen_temperature_sd(battery, ambient_C))
    found = forecaster.forecast(belief, 0.0)
    if found is None:
        beyond = "the end may lie beyond six hours: this is not the load of a flight"
        return Endurance(ambient_C, NAN, NAN, NAN, NAN, beyond)
    times_s = (found.median_s, found.lo_s, found.hi_s, found.low_warning_s)
    remark = range_remark(battery, ambient_C)
    if found.median_s <= 0.0:
        why = _why_no_flight(pack, start_soc, reserve_soc, ambient_C)
        remark = f"{why}; {remark}" if is_outside(battery, ambient_C) else why
    return Endurance(ambient_C, *times_s, remark)


def _why_no_flight(pack: Pack, start_soc: float, reserve_soc: float, ambient_C: float) -> str:
    """Say why a pack does not carry the aircraft for a second."""
    belief = rested(pack, start_soc, ambient_C)
    volts = float(belief.weights @ voltage(pack, belief.means.T, 0.0))
    if start_soc <= reserve_soc or volts <= pack.cutoff_V:
        return "the pack is at its cut-off or its reserve before take-off"
    return "the pack sags below its cut-off when the motors start"


def rested(
    pack: Pack, start_soc: float, ambient_C: float, remembered: PackHealth | None = None, unseen_sd: float = 0.0
) -> Belief:
    """Return the belief about a pack before take-off: its stated charge, the air temperature, the file's spreads.

    For a pack in the ledger, its health replaces the spreads. unseen_sd : added error of ln of the resistance at this
    temperature (`unseen_temperature_sd`).
    """
    state, members = model.rested(start_soc, ambient_C), prior_of(pack, remembered)
    members = members._replace(resistance_sd=np.hypot(members.resistance_sd, unseen_sd))
    means = np.zeros((members.log_scale.size, SIZE))
    means[:, : X.SENSOR + 1], means[:, X.LOG_CAPACITY] = state, members.log_scale
    charge = np.diag([START_SOC_SD**2, pack.spread.bias_sd_V**2])
    means[:, X.LOG_RESISTANCE] = members.log_resistance
    covariances = start_covariances(pack, state, charge, AMBIENT_SD_K, members)
    return Belief(means, covariances, np.log(members.weight), ambient_C)


def unseen_temperature_sd(battery: BatteryFile, ambient_C: float) -> float:
    """Return the error of ln of the resistance at a temperature [°C] outside those that the file covers.

    It is the error of the activation energy over the distance. In flight the voltage shows the resistance at once;
    before take-off a file of summer flights knew the endurance at -20 °C as well as that at 20 °C. A file without
    temperatures covers the reference temperature.
    """
    low_C, high_C, _ = _range(battery)
    if math.isnan(low_C):
        low_C = high_C = REFERENCE_TEMP_C
    nearest_C = min(max(ambient_C, low_C - VALID_WITHIN_K), high_C + VALID_WITHIN_K)
    law = next((entry for entry in battery.effects if entry.name == "temperature_resistance"), None)
    error_K = law.standard_error.get("activation_K", 0.0) if law is not None else 0.0
    return abs(math.log(arrhenius(ambient_C, error_K) / arrhenius(nearest_C, error_K)))


def range_remark(battery: BatteryFile, ambient_C: float) -> str:
    """Say if the certificate does not reach this temperature [°C], give or take VALID_WITHIN_K; else empty."""
    low, high, how = _range(battery)
    if math.isnan(low):
        return "not tested at any temperature"
    if not is_outside(battery, ambient_C):
        return "" if how == "validated" else "not tested at any temperature"
    if how == "validated":
        return f"outside the validated range: {low:g} °C{'' if high == low else f' to {high:g} °C'}"
    return f"outside the fitted range: {low:.0f} °C to {high:.0f} °C"


def is_outside(battery: BatteryFile, ambient_C: float) -> bool:
    """Return True at a temperature [°C] that neither certificate nor fit has seen, give or take VALID_WITHIN_K."""
    low, high, _ = _range(battery)
    return ambient_C < low - VALID_WITHIN_K or ambient_C > high + VALID_WITHIN_K  # NaN: no range is stated


def _range(battery: BatteryFile) -> tuple[float, float, str]:
    """Return the lowest and the highest validated temperature [°C], else the fitted ones; NaN if none is stated."""
    certificate = battery.certificate
    if certificate.validated_ambient_C:
        return min(certificate.validated_ambient_C), max(certificate.validated_ambient_C), "validated"
    stated = certificate.statistics
    return stated.get(FITTED_LOW, NAN), stated.get(FITTED_HIGH, NAN), "fitted"
