"""Fit of the cell to bench tests whose current was not measured: the study's tables.

The motor draws a constant current of unknown C-rate until the limiter of the speed controller holds the voltage. All
tests have that load, so that one simulated test stands for all. Voltage and surface temperature are
fitted together, at the whole minutes at which the study reads them. The C-rate is not identifiable (OCV and
resistance move with it): it has a prior, that of the study's motor unless the duration of the test contradicts it, and
its covariance with the resistance goes into the battery file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeResult

from uavbatt.battery import model
from uavbatt.battery.model import Array
from uavbatt.fitting import prior
from uavbatt.fitting.limiter import limited_discharge
from uavbatt.fitting.most_probable import Residuals, most_probable
from uavbatt.fitting.prior import Posterior, Slot

STEP_S = 5.0  # of the simulation: a twelfth of the time between two readings
LEAST_VOLTAGE_SD_V = 0.02  # a pack's voltmeter, read by hand
SURFACE_SD_K = 0.25  # of a reading to 0.1 °C by hand, beside the place of the sensor

# A full pack that is not cold gives so much of its rated capacity until a cell shows EMPTY_CELL_V under load.
EMPTY_CELL_V, GIVEN, GIVEN_SD, NOT_COLD_C, CONTRADICTS_SDS = 3.2, 0.93, 0.15, 15.0, 1.5

LOAD_SLOTS = (
    Slot("c_rate", 8.0, 1.5),
    Slot("start_soc", 0.98, 0.02),
    Slot("limit_cell_V", 3.12, 0.02),
    Slot("start_offset_K", -2.0, 1.5),  # the pack comes from a room, the chamber is warmer
)


@dataclass(frozen=True, slots=True)
class MeanTest:
    """MeanTest holds mean voltage [V], its standard error and surface temperature [°C] at instants [s], for a fit."""

    time_s: Array
    voltage_V: Array
    voltage_sd_V: Array
    surface_C: Array
    cells: int
    ambient_C: float


def rate_slot(test: MeanTest) -> Slot:
    """Return the prior of the C-rate: the usual one, unless the test lasted too long for it.

    The duration tells the rate by GIVEN. That of a short test does not: a large load lets a full cell sag so far, too.
    """
    usual, empty_s = LOAD_SLOTS[0], _empty_s(test)
    rate = GIVEN * 3600.0 / (float(test.time_s[-1]) if math.isnan(empty_s) else empty_s)
    if rate >= usual.prior - CONTRADICTS_SDS * usual.sd or test.ambient_C < NOT_COLD_C:
        return usual
    return Slot(usual.name, rate, GIVEN_SD * rate)


def _empty_s(test: MeanTest) -> float:
    """Return the time [s] at which the cells fall to EMPTY_CELL_V, between two readings; NaN if they do not."""
    empty_V = EMPTY_CELL_V * test.cells
    low = np.flatnonzero(test.voltage_V <= empty_V)
    if not low.size:
        return math.nan
    around = slice(max(int(low[0]) - 1, 0), int(low[0]) + 1)
    return float(np.interp(-empty_V, -test.voltage_V[around], test.time_s[around]))


def slots_of(effects: tuple[str, ...], test: MeanTest) -> tuple[Slot, ...]:
    """Return the cell's slots, then those of the unknown load of a test."""
    return (*prior.cell_slots(effects), rate_slot(test), *LOAD_SLOTS[1:])


def predict_unmetered(
    slots: tuple[Slot, ...], effects: tuple[str, ...], x: Array, test: MeanTest, time_s: Array
) -> Array:
    """Predict pack voltage [V] and surface temperature [°C] at `time_s` [s] for values x [batch, slots].

    Returns [2, instants, batch].
    """
    at = prior.places(slots)
    load = {s.name: x[:, at[s.name]] for s in LOAD_SLOTS}
    start = model.rested(np.minimum(load["start_soc"], 1.0), test.ambient_C + load["start_offset_K"])
    cell = prior.cell(slots, x, effects)
    rate, limit_V = load["c_rate"], load["limit_cell_V"]
    out = limited_discharge(lambda _: cell, start, rate, limit_V, test.ambient_C, time_s, STEP_S)
    out[0] *= test.cells
    return out


def fit_unmetered(test: MeanTest) -> Posterior:
    """Find the most probable cell and load for the mean test."""
    return fit_each([test], prior.BASE_EFFECTS)[0]


def fit_each(tests: Sequence[MeanTest], effects: tuple[str, ...]) -> list[Posterior]:
    """Fit cell and load to each mean test by itself; they share ambient temperature and cells.

    Those read at the same instants, with the same prior of the load, are simulated side by side.
    """
    alike: dict[tuple[bytes, Slot], list[int]] = {}
    for k, test in enumerate(tests):
        alike.setdefault((test.time_s.tobytes(), rate_slot(test)), []).append(k)
    posteriors: dict[int, Posterior] = {}
    for which in alike.values():
        posteriors.update(zip(which, _fit_alike([tests[k] for k in which], effects), strict=True))
    return [posteriors[k] for k in range(len(tests))]


def _fit_alike(tests: list[MeanTest], effects: tuple[str, ...]) -> list[Posterior]:
    slots = slots_of(effects, tests[0])

    def simulate(u: Array) -> Array:
        return np.moveaxis(predict_unmetered(slots, effects, prior.values(slots, u), tests[0], tests[0].time_s), -1, 0)

    def residuals_of(test: MeanTest) -> Residuals:
        sigma_V = np.maximum(test.voltage_sd_V, LEAST_VOLTAGE_SD_V)

        def residuals(u: Array, simulated: Array) -> Array:
            misfit_V = (simulated[:, 0] - test.voltage_V) / sigma_V
            misfit_K = np.nan_to_num(simulated[:, 1] - test.surface_C) / SURFACE_SD_K
            shape = prior.shape_penalty(slots, prior.values(slots, u))
            return np.concatenate([misfit_V, misfit_K, shape, u], axis=1)

        return residuals

    starts = [np.zeros(len(slots)) for _ in tests]
    searches = most_probable(simulate, [residuals_of(t) for t in tests], starts, evaluations=60, xtol=1e-6, ftol=1e-8)
    return [_posterior(slots, effects, search) for search in searches]


def _posterior(slots: tuple[Slot, ...], effects: tuple[str, ...], search: OptimizeResult) -> Posterior:
    slopes = np.asarray(search.jac, dtype=float)
    return Posterior(slots=slots, effects=effects, u=search.x, covariance_u=np.linalg.inv(slopes.T @ slopes))
