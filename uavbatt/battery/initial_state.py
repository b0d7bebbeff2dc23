"""The initial state from the first row of a record: the charge, and the overpotentials that have built up before it.

A pack that idles on its avionics shows nearly its open-circuit voltage. If a log begins in the air, the missing charge
is assumed to have been drawn at the present current. This gives the polarisation and diffusion at the first row;
without them, their voltage would be read as missing charge.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uavbatt.battery import equations as eq
from uavbatt.battery import model
from uavbatt.battery.equations import Number
from uavbatt.battery.model import SOC_GRID, Array, Parameters, State

IDLE_C_RATE = 0.3  # avionics and a companion computer draw up to 0.2 C of a small pack; a hover 2 to 6 C
# Four of five flights begin with a pack straight from the charger, which stops within a percent of full.
FULL_SHARE, FULL_SD = 0.8, 0.01
ANY_SD = 0.4  # sd of a charge that is not known at all
SLOPE_WITHIN, LEAST_SLOPE_V = 0.04, 0.1  # the OCV's slope at a charge is that over so far on both sides [V per charge]


class Charge(NamedTuple):
    """Charge holds a state of charge and its standard deviation."""

    soc: float
    sd: float


def state_under_load(p: Parameters, soc: Number, temp_C: Number, c_rate: Number) -> State:
    """Return the state of a cell that came down from full to `soc` under `c_rate` [1/h], at one temperature [°C]."""
    at_rest = model.rested(soc, temp_C)
    rate = np.maximum(c_rate, 1e-6)
    drained_s = np.maximum(1.0 - at_rest.soc, 0.0) * eq.SECONDS_PER_HOUR / rate
    drop_V = rate * model.resistance(p, at_rest.soc, at_rest.core_C)
    fast_V = drop_V * p.polarisation_ratio + model.depletion(p, at_rest.soc, rate)
    sluggish = eq.arrhenius(at_rest.core_C, p.diffusion_activation_K)
    return at_rest._replace(
        polarisation_V=eq.relax(0.0, fast_V, drained_s, p.polarisation_tau_s),
        diffusion_V=eq.relax(0.0, drop_V * p.diffusion_ratio * sluggish, drained_s, p.diffusion_tau_s),
    )


def charge_at(p: Parameters, emf_V: float, sd_V: float) -> Charge:
    """Return the charge whose OCV is `emf_V` [V], known to `sd_V` [V]; its sd comes from the slope there."""
    table = np.maximum.accumulate(np.asarray(model.open_circuit_voltage(p, SOC_GRID)) + 1e-9 * SOC_GRID)
    low, soc, high = np.interp([emf_V - sd_V, emf_V, emf_V + sd_V], table, SOC_GRID)
    return Charge(float(np.clip(soc, 0.0, 1.0)), float(max(0.5 * (high - low), 0.01)))


def joint(
    p: Parameters, emf_V: float, reading_sd_V: float, bias_sd_V: float, may_be_full: bool, full_share: float = 1.0
) -> tuple[Array, Array]:
    """Return mean [2] and covariance [2, 2] of (charge, discrepancy [V]) after a reading of OCV(charge) + discrepancy.

    Before a flight (`may_be_full`) the habit of flying full packs weighs in: the mixture of "just charged" (FULL_SHARE,
    FULL_SD, `full_share` of the discrepancy) and "any charge", by its moments.
    """
    reading = charge_at(p, emf_V, math.hypot(reading_sd_V, bias_sd_V))
    any_charge = _after_reading(p, emf_V, reading.soc, ANY_SD, reading_sd_V, bias_sd_V)
    if not may_be_full:
        return any_charge.mean, any_charge.covariance
    as_full = _after_reading(p, emf_V, 1.0, FULL_SD, reading_sd_V, full_share * bias_sd_V)
    weight = np.array([FULL_SHARE * as_full.likelihood, (1.0 - FULL_SHARE) * any_charge.likelihood])
    weight = weight / weight.sum() if weight.sum() > 0.0 else np.array([0.0, 1.0])
    mean = weight[0] * as_full.mean + weight[1] * any_charge.mean
    covariance = np.zeros((2, 2))
    for share, part in zip(weight, (as_full, any_charge), strict=True):
        apart = part.mean - mean
        covariance += share * (part.covariance + np.outer(apart, apart))
    return np.array([min(float(mean[0]), 1.0), float(mean[1])]), covariance


class _Hypothesis(NamedTuple):
    """_Hypothesis holds one possible charge after the reading."""

    likelihood: float
    mean: Array
    covariance: Array


def _after_reading(
    p: Parameters, emf_V: float, soc: float, soc_sd: float, reading_sd_V: float, bias_sd_V: float
) -> _Hypothesis:
    """Update (charge, discrepancy) by the reading with a Kalman filter that is linear around `soc`."""
    below, above = max(soc - SLOPE_WITHIN, 0.0), min(soc + SLOPE_WITHIN, 1.0)
    rise_V = float(model.open_circuit_voltage(p, above)) - float(model.open_circuit_voltage(p, below))
    row = np.array([max(rise_V / (above - below), LEAST_SLOPE_V), 1.0])
    before = np.diag([soc_sd**2, bias_sd_V**2])
    variance = float(row @ before @ row) + reading_sd_V**2
    gain = before @ row / variance
    surprise_V = emf_V - float(model.open_circuit_voltage(p, soc))
    likelihood = math.exp(-0.5 * surprise_V**2 / variance) / math.sqrt(variance)
    return _Hypothesis(likelihood, np.array([soc, 0.0]) + gain * surprise_V, before - np.outer(gain, row @ before))
