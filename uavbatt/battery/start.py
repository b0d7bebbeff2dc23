"""The first row of a record: what it tells of the charge, and of the overpotentials that nobody saw build up.

A pack that idles on its avionics shows nearly its open-circuit voltage. A log that begins in mid-air shows a cell
that has been drained for as long as the charge that is gone took, at the present current as a first guess: without
that, its polarisation and diffusion would be read as charge that is missing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uavbatt.battery import equations as eq
from uavbatt.battery import model
from uavbatt.battery.equations import Number
from uavbatt.battery.model import SOC_GRID, Parameters, State

IDLE_C_RATE = 0.3  # avionics and a companion computer draw up to 0.2 C of a small pack; a hover 2 to 6 C
# Of every five flights four begin with a pack straight from the charger, which stops within a percent of full.
FULL_SHARE, FULL_SD = 0.8, 0.01


class Charge(NamedTuple):
    """State of charge and its standard deviation."""

    soc: float
    sd: float


def underway(p: Parameters, soc: Number, temp_C: Number, c_rate: Number) -> State:
    """A cell at `soc` that came down from full under `c_rate` [1/h], one temperature throughout [°C]."""
    at_rest = model.rested(soc, temp_C)
    rate = np.maximum(c_rate, 1e-6)
    drained_s = np.maximum(1.0 - at_rest.soc, 0.0) * eq.SECONDS_PER_HOUR / rate
    drop_V = rate * model.resistance(p, at_rest.soc, at_rest.core_C)
    sluggish = eq.arrhenius(at_rest.core_C, p.diffusion_activation_K)
    return at_rest._replace(
        polarisation_V=eq.relax(0.0, drop_V * p.polarisation_ratio, drained_s, p.polarisation_tau_s),
        diffusion_V=eq.relax(0.0, drop_V * p.diffusion_ratio * sluggish, drained_s, p.diffusion_tau_s),
    )


def charge_at(p: Parameters, emf_V: float, sd_V: float) -> Charge:
    """The charge whose OCV is `emf_V` [V], known to `sd_V`: the sd comes from the slope there."""
    table = np.maximum.accumulate(np.asarray(model.open_circuit_voltage(p, SOC_GRID)) + 1e-9 * SOC_GRID)
    low, soc, high = np.interp([emf_V - sd_V, emf_V, emf_V + sd_V], table, SOC_GRID)
    return Charge(float(np.clip(soc, 0.0, 1.0)), float(max(0.5 * (high - low), 0.01)))


def perhaps_full(read: Charge) -> Charge:
    """The charge of a pack before its flight: the reading, weighed with the habit of flying full packs.

    The mean and variance of the mixture of "just charged" (FULL_SHARE, FULL_SD below full) and "any charge".
    """
    variance, full = read.sd**2, FULL_SD**2
    together = variance + full
    as_full = FULL_SHARE * np.exp(-0.5 * (1.0 - read.soc) ** 2 / together) / np.sqrt(2.0 * np.pi * together)
    share = as_full / (as_full + (1.0 - FULL_SHARE))
    combined = Charge(read.soc + variance / together * (1.0 - read.soc), np.sqrt(variance * full / together))
    soc = share * combined.soc + (1.0 - share) * read.soc
    second = share * (combined.sd**2 + combined.soc**2) + (1.0 - share) * (variance + read.soc**2)
    return Charge(float(soc), float(np.sqrt(second - soc**2)))
