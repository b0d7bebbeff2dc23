"""Fit of the cell to bench tests whose current was not measured: the study's tables.

The motor asks a constant current of unknown C-rate until the speed controller's limiter takes over and holds the
voltage; the tests share that load, so that one simulated test stands for all. Voltage and surface temperature are
fitted together, at the whole minutes at which the study reads them. The C-rate is not identifiable (OCV and
resistance move with it): it has a prior, and its covariance with the resistance goes into the battery file.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uavbatt.battery import model
from uavbatt.battery.model import Array
from uavbatt.fitting import prior
from uavbatt.fitting.limiter import limited_discharge
from uavbatt.fitting.most_probable import most_probable
from uavbatt.fitting.prior import Posterior, Slot

STEP_S = 5.0
LEAST_VOLTAGE_SD_V = 0.02  # a pack's voltmeter, read by hand
SURFACE_SD_K = 0.25

LOAD_SLOTS = (
    Slot("c_rate", 8.0, 1.5),
    Slot("start_soc", 0.98, 0.02),
    Slot("limit_cell_V", 3.12, 0.02),
    Slot("start_offset_K", -2.0, 1.5),  # the pack comes from a room, the chamber is warmer
)


@dataclass(frozen=True, slots=True)
class MeanTest:
    """It holds mean voltage [V], its standard error and mean surface temperature [°C] at instants [s], for a fit."""

    time_s: Array
    voltage_V: Array
    voltage_sd_V: Array
    surface_C: Array
    cells: int
    ambient_C: float


def slots_of(effects: tuple[str, ...]) -> tuple[Slot, ...]:
    """Return the cell's slots, then those of the unknown load."""
    return (*prior.cell_slots(effects), *LOAD_SLOTS)


def predict_unmetered(
    slots: tuple[Slot, ...], effects: tuple[str, ...], x: Array, test: MeanTest, time_s: Array
) -> Array:
    """Predict pack voltage [V] and surface temperature [°C] at `time_s` [s] for values x [batch, slots].

    Returns [2, instants, batch].
    """
    at = {s.name: i for i, s in enumerate(slots)}
    load = {s.name: x[:, at[s.name]] for s in LOAD_SLOTS}
    start = model.rested(np.minimum(load["start_soc"], 1.0), test.ambient_C + load["start_offset_K"])
    cell = prior.cell(slots, x, effects)
    rate, limit_V = load["c_rate"], load["limit_cell_V"]
    out = limited_discharge(lambda _: cell, start, rate, limit_V, test.ambient_C, time_s, STEP_S)
    out[0] *= test.cells
    return out


def fit_unmetered(test: MeanTest, effects: tuple[str, ...] = prior.BASE_EFFECTS) -> Posterior:
    """Find the most probable cell and load for the mean test."""
    slots = slots_of(effects)
    sigma_V = np.maximum(test.voltage_sd_V, LEAST_VOLTAGE_SD_V)

    def residuals(u: Array) -> Array:
        x = prior.values(slots, u)
        volts, surface = predict_unmetered(slots, effects, x, test, test.time_s)
        misfit_V = (volts - test.voltage_V[:, None]) / sigma_V[:, None]
        misfit_K = np.nan_to_num(surface - test.surface_C[:, None]) / SURFACE_SD_K
        return np.concatenate([misfit_V.T, misfit_K.T, prior.monotonicity_penalty(slots, x), u], axis=1)

    found = most_probable(residuals, np.zeros(len(slots)), evaluations=60, xtol=1e-6, ftol=1e-8)
    slopes = np.asarray(found.jac, dtype=float)
    return Posterior(slots=slots, effects=effects, u=found.x, covariance_u=np.linalg.inv(slopes.T @ slopes))
