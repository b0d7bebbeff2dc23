"""The effects: named physical or sensing mechanisms that a battery file switches on.

An effect is a name, its parameters with unit, bounds and prior, and where they act. The cell's own effects fill
fields of `model.Parameters`; those of wiring, sensors and start fill fields of `pack.Installation`. The names are
fixed: other programs read them in battery files and diagnoses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from uavbatt.battery.model import DIFFUSION_TAU_S, POLARISATION_TAU_S


@dataclass(frozen=True, slots=True)
class Quantity:
    """Quantity holds one parameter of an effect, with its prior and bounds.

    `prior`, `prior_sd` and the bounds `low` and `high` are in `unit`; with `log`, the sd is relative (a factor).
    `neutral` means "effect off".
    """

    name: str
    unit: str
    neutral: float
    low: float
    high: float
    prior: float
    prior_sd: float
    log: bool = False
    fitted: bool = True  # False: `fit` leaves it neutral (it earned no place there), diagnosis alone moves it


@dataclass(frozen=True, slots=True)
class Effect:
    """An effect is a mechanism that a battery file switches on; `acts_on` says which record has its parameters."""

    name: str
    summary: str
    acts_on: Literal["cell", "installation"]
    quantities: tuple[Quantity, ...]


def _ratio(name: str, prior: float, spread: float = 0.7) -> Quantity:
    return Quantity(name, "1", 0.0, 0.0, 20.0, prior, spread, log=True)


def _tau(name: str, low: float, high: float, prior: float) -> Quantity:
    return Quantity(name, "s", prior, low, high, prior, 0.7, log=True)


CELL_EFFECTS = (
    Effect(
        "polarisation",
        "voltage that lags a load step by seconds",
        "cell",
        (_ratio("polarisation_ratio", 0.5), _tau("polarisation_tau_s", 1.0, 120.0, POLARISATION_TAU_S)),
    ),
    Effect(
        "slow_diffusion",
        "voltage that sinks and recovers over minutes",
        "cell",
        (
            _ratio("diffusion_ratio", 0.8),
            _tau("diffusion_tau_s", 60.0, 20000.0, DIFFUSION_TAU_S),
            Quantity("surface_h", "h", 0.0, 0.0, 0.2, 0.0, 0.01, fitted=False),
        ),
    ),
    Effect(
        "temperature_resistance",
        "resistance falls as the cell warms",
        "cell",
        (
            Quantity("activation_K", "K", 0.0, 0.0, 8000.0, 1500.0, 800.0),
            Quantity("diffusion_activation_K", "K", 0.0, -4000.0, 8000.0, 500.0, 1500.0),
        ),
    ),
    Effect(
        "self_heating",
        "losses warm the cell, air cools it",
        "cell",
        (
            Quantity("heat_gain", "1", 0.0, 0.0, 2.0, 1.0, 0.0),
            Quantity("heat_capacity_JpKAh", "J/(K·Ah)", 40.0, 8.0, 200.0, 40.0, 0.3, log=True),
            Quantity("cooling_WpKAh", "W/(K·Ah)", 0.1, 0.0005, 5.0, 0.1, 0.8, log=True),
        ),
    ),
    Effect(
        "airflow_cooling",
        "cooling grows with the load",
        "cell",
        (Quantity("airflow_gain_h", "h", 0.0, 0.0, 5.0, 0.1, 1.0, log=True),),
    ),
    Effect(
        "rate_capacity",
        "less charge comes out at a high rate",
        "cell",
        (Quantity("rate_gain_h", "h", 0.0, -0.02, 0.1, 0.0, 0.01),),
    ),
    Effect(
        "temperature_lag",
        "the sensor follows the core late",
        "cell",
        (Quantity("sensor_lag_s", "s", 1.0, 0.5, 300.0, 20.0, 1.0, log=True),),
    ),
    Effect(
        "charge_transfer",
        "the electrodes react sluggishly: a drop that saturates with the load",
        "cell",
        (
            Quantity("transfer_V", "V", 0.0, 0.0, 0.3, 0.0, 0.03),
            Quantity("transfer_half_rate", "1/h", 0.3, 0.05, 5.0, 0.3, 0.0, log=True),
        ),
    ),
    Effect(
        "hysteresis",
        "voltage sinks once the direction of the current has turned from charge to discharge",
        "cell",
        (Quantity("hysteresis_V", "V", 0.0, 0.0, 0.1, 0.0, 0.01),),
    ),
)

INSTALLATION_EFFECTS = (
    Effect(
        "capacity_fade",
        "the pack holds less charge than it did; its ohms grow in proportion",
        "installation",
        (Quantity("fade", "1", 0.0, -0.2, 0.6, 0.0, 0.15),),
    ),
    Effect(
        "resistance_growth",
        "every resistance of the cells has grown by a factor",
        "installation",
        (Quantity("growth", "1", 0.0, -0.5, 3.0, 0.0, 0.3),),
    ),
    Effect(
        "weak_cell",
        "one cell of the series holds less charge than the others",
        "installation",
        (Quantity("deficit", "1", 0.0, 0.0, 0.5, 0.0, 0.15),),
    ),
    Effect(
        "harness_resistance",
        "leads and plugs between the cells and the voltage sensor",
        "installation",
        (Quantity("harness_ohm", "ohm", 0.0, 0.0, 0.1, 0.0, 0.01),),
    ),
    Effect(
        "current_gain",
        "the current sensor reads this many times the true current",
        "installation",
        (Quantity("gain_I", "1", 1.0, 0.5, 1.5, 1.0, 0.1),),
    ),
    Effect(
        "current_offset",
        "the current sensor adds a constant",
        "installation",
        (Quantity("offset_A", "A", 0.0, -5.0, 5.0, 0.0, 0.5),),
    ),
    Effect(
        "unmetered_load",
        "a load wired past the current sensor",
        "installation",
        (Quantity("unmetered_W", "W", 0.0, 0.0, 200.0, 0.0, 20.0),),
    ),
    Effect(
        "voltage_gain",
        "the voltage sensor reads this many times the true voltage",
        "installation",
        (Quantity("gain_V", "1", 1.0, 0.9, 1.1, 1.0, 0.01),),
    ),
    Effect(
        "voltage_offset",
        "the voltage sensor adds a constant",
        "installation",
        (Quantity("offset_V", "V", 0.0, -1.0, 1.0, 0.0, 0.1),),
    ),
    Effect(
        "sag_compensation",
        "the autopilot adds current times a resistance to the voltage that it reports",
        "installation",
        (Quantity("compensation_ohm", "ohm", 0.0, 0.0, 0.2, 0.0, 0.02),),
    ),
    Effect(
        "temperature_offset",
        "the temperature sensor adds a constant",
        "installation",
        (Quantity("offset_K", "K", 0.0, -40.0, 40.0, 0.0, 5.0),),
    ),
    Effect(
        "current_delay",
        "the current is reported later than the voltage",
        "installation",
        (Quantity("delay_s", "s", 0.0, -8.0, 8.0, 0.0, 1.0),),
    ),
    Effect(
        "initial_charge",
        "packs start with another charge than is believed of them",
        "installation",
        (Quantity("start_soc_shift", "1", 0.0, -0.7, 0.05, 0.0, 0.1),),
    ),
)

EFFECTS = {effect.name: effect for effect in CELL_EFFECTS + INSTALLATION_EFFECTS}


def unit_words(unit: str) -> str:
    """Return a unit in the form that is shown; empty for a pure number."""
    return "" if unit == "1" else unit


def effect_named(name: str) -> Effect:
    """Return the effect of that name; raises KeyError with the known names if there is none."""
    try:
        return EFFECTS[name]
    except KeyError:
        raise KeyError(f"unknown effect {name!r}; known: {', '.join(EFFECTS)}") from None
