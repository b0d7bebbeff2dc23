"""The models that the loop over ambient temperatures compares: one circuit, with heat or without, per test.

    isothermal       the core stays at the ambient temperature: R = R₀(soc)·exp(E(1/T - 1/T_25))
    self heating     C_th T' = losses - h(T - T_ambient), the cell of `battery.model`
    steeper cold     R also times exp(k x²), x = (1/T - 1/T_25)/(1/T_-20 - 1/T_25) for T below 25 °C
    series           per further series of tests ln of load and of resistance: a nuisance, no property of the cell

One table of readings at whole minutes per ambient temperature, the load unmetered (`fitting.unmetered`): a constant
C-rate that the speed controller cuts back at its limit. The OCV stays at its prior, since under one load it cannot be
told from R₀(soc).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery import model
from uavbatt.battery.effects import EFFECTS
from uavbatt.battery.equations import KELVIN, REFERENCE_TEMP_C, Number
from uavbatt.battery.model import Array, Parameters, State
from uavbatt.battery.tables import dense, dense_resistance
from uavbatt.fitting import prior
from uavbatt.fitting.limiter import limited_discharge
from uavbatt.fitting.most_probable import Residuals, most_probable
from uavbatt.fitting.prior import Slot
from uavbatt.fitting.unmetered import LOAD_SLOTS

STEP_S = 10.0  # of the simulation: a sixth of the time between two readings
MISFIT_SD_V = 0.08  # usual misfit of such a model, which weighs readings against priors
COLD_C = -20.0  # where `steeper_cold` is ln of the additional factor on the resistance
EVALUATIONS = 30  # at most, of each search
# Number of starts, and their sd around the priors in units of the prior's sd: see `fit_cold_model`.
FRESH, START_SPREAD, SEED = 10, 0.6, 5725
KEPT = ("slow_diffusion", "temperature_resistance")
HEAT = ("heat_capacity_JpKAh", "cooling_WpKAh")
OCV_V = dense(prior.OCV_SOC, prior.OCV_V)


@dataclass(frozen=True, slots=True)
class Variant:
    """A Variant is one of the models to compare, named by its terms that are on."""

    name: str
    self_heating: bool
    steeper_cold: bool
    series: bool


@dataclass(frozen=True, slots=True)
class OneTimeTests:
    """OneTimeTests holds the voltage [V] per test (rows) and instant [s], NaN where it is flagged.

    `series` is the number of the series of each test, from 0.
    """

    ambient_C: Array
    time_s: Array
    voltage_V: Array
    series: NDArray[np.intp]
    cells: int

    def of(self, rows: NDArray[np.bool_]) -> OneTimeTests:
        """Return the tests in `rows`; the numbers of the series stay."""
        return OneTimeTests(self.ambient_C[rows], self.time_s, self.voltage_V[rows], self.series[rows], self.cells)


@dataclass(frozen=True, slots=True)
class ColdFit:
    """A fit holds the unknowns (slots) of its variant and their values `u` in the optimiser's space."""

    variant: Variant
    slots: tuple[Slot, ...]
    u: Array

    def values(self) -> dict[str, float]:
        """Return the value of every slot by name."""
        x = prior.values(self.slots, self.u)
        return {s.name: float(v) for s, v in zip(self.slots, x, strict=True)}


def slots_of(variant: Variant, series: int) -> tuple[Slot, ...]:
    """List the unknowns of a variant for tests that come from `series` series."""
    cell = [s for s in prior.cell_slots(KEPT) if not s.name.startswith("ocv_")]
    heat = [Slot(q.name, q.prior, q.prior_sd, q.log) for q in EFFECTS["self_heating"].quantities if q.name in HEAT]
    load = [s for s in LOAD_SLOTS if s.name != "start_offset_K"]
    steep = [Slot("steeper_cold", 0.0, 1.0)]
    nuisance = [Slot(f"{term}_{k}", 0.0, 0.1) for k in range(1, series) for term in ("ln_load", "ln_resistance")]
    return (
        *cell,
        *(heat if variant.self_heating else []),
        *load,
        *(steep if variant.steeper_cold else []),
        *(nuisance if variant.series else []),
    )


def predict_cold(variant: Variant, slots: tuple[Slot, ...], x: Array, tests: OneTimeTests) -> Array:
    """Simulate the pack voltage [V], [batch, test, instant], for the values x [batch, slots]."""
    at = {s.name: x[:, i] for i, s in enumerate(slots)}
    ambient, series = tests.ambient_C[:, None], tests.series[:, None]  # simulated as [test, batch]
    cell = _cell(variant, slots, x, at)
    ln_load, ln_resistance = (_nuisance(term, at, series) for term in ("ln_load", "ln_resistance"))
    gain, rate = np.exp(ln_resistance), at["c_rate"] * np.exp(ln_load)
    start = model.rested(np.minimum(at["start_soc"], 1.0), ambient)

    level = cell._replace(resistance_gain=gain)

    def cell_in(state: State) -> Parameters:
        if "steeper_cold" not in at:
            return level
        return cell._replace(resistance_gain=gain * _steeper(at["steeper_cold"], state.core_C))

    volts, _ = limited_discharge(cell_in, start, rate, at["limit_cell_V"], ambient, tests.time_s, STEP_S)
    out: Array = np.moveaxis(volts, (0, 1, 2), (2, 1, 0)) * tests.cells
    return out


def _cell(variant: Variant, slots: tuple[Slot, ...], x: Array, at: dict[str, Array]) -> Parameters:
    names = [s.name for s in slots]
    first = names.index(f"r0_{prior.RESISTANCE_SOC[0]:g}")
    shape = x[:, first : first + prior.RESISTANCE_SOC.size] * x[:, [names.index("r0_ohmAh")]]
    table = dense_resistance(prior.RESISTANCE_SOC, shape)
    fields = {q.name: at[q.name] for e in (*KEPT, "self_heating") for q in EFFECTS[e].quantities if q.name in at}
    return Parameters(ocv_V=OCV_V, r0_ohmAh=table, heat_gain=float(variant.self_heating), **fields)


def _nuisance(term: str, at: dict[str, Array], series: NDArray[np.intp]) -> Array:
    out = np.zeros(series.shape)
    for k in range(1, int(np.max(series, initial=0)) + 1):
        out = np.where(series == k, at.get(f"{term}_{k}", 0.0), out)
    return out


def _steeper(steeper_cold: Array, core_C: Number) -> Array:
    """Return the factor on the resistance at a core temperature [°C]: 1 at 25 °C, exp(steeper_cold) at COLD_C."""
    at_25 = 1.0 / (REFERENCE_TEMP_C + KELVIN)
    x = (1.0 / (core_C + KELVIN) - at_25) / (1.0 / (COLD_C + KELVIN) - at_25)
    factor: Array = np.exp(steeper_cold * np.minimum(np.maximum(x, 0.0), 2.0) ** 2)
    return factor


def fit_cold_model(
    variant: Variant, tests: OneTimeTests, series: int, starts: tuple[ColdFit, ...] = (), fresh: int = FRESH
) -> ColdFit:
    """Fit a variant by least squares over all readings, under the priors; the best of several starts counts.

    Where the speed controller holds the voltage, nothing but its limit has a slope, so that the sum of squares has
    minima of its own there. Hence `fresh` starts, at the priors and (seeded) around them, each by a robust loss first.
    `starts` from smaller variants have their new terms at the priors: a variant does not come out worse than what it
    contains.
    """
    slots = slots_of(variant, series)
    rng, begin = np.random.default_rng(SEED), [np.zeros(len(slots))][:fresh]
    begin += [rng.normal(0.0, START_SPREAD, len(slots)) for _ in range(fresh - 1)]
    every = np.ones(tests.ambient_C.size, dtype=bool)
    first = [u for _, u in _solve(variant, slots, tests, [every] * len(begin), begin, robust=True)]
    for start in starts:
        by_name = dict(zip((s.name for s in start.slots), start.u, strict=True))
        first.append(np.array([by_name.get(s.name, 0.0) for s in slots]))
    minima = _solve(variant, slots, tests, [every] * len(first), first, robust=False)
    return ColdFit(variant, slots, min(minima, key=lambda f: f[0])[1])


def fit_parts(fit: ColdFit, tests: OneTimeTests, parts: Sequence[NDArray[np.bool_]]) -> list[ColdFit]:
    """Fit anew to each of the `parts` of the tests alone, from where the fit of all of them ended."""
    starts = [fit.u] * len(parts)
    fits = _solve(fit.variant, fit.slots, tests, parts, starts, robust=False)
    return [ColdFit(fit.variant, fit.slots, u) for _, u in fits]


def _solve(
    variant: Variant,
    slots: tuple[Slot, ...],
    tests: OneTimeTests,
    parts: Sequence[NDArray[np.bool_]],
    starts: Sequence[Array],
    robust: bool,
) -> list[tuple[float, Array]]:
    """Return (cost, u) of the minimum that each start leads to, fitted to its part of the tests."""

    def simulate(u: Array) -> Array:
        return predict_cold(variant, slots, prior.values(slots, u), tests)

    def misfit_of(part: NDArray[np.bool_]) -> Residuals:
        def misfit(u: Array, simulated: Array) -> Array:
            gap = simulated[:, part] - tests.voltage_V[part]
            out: Array = np.concatenate([np.nan_to_num(gap).reshape(u.shape[0], -1) / MISFIT_SD_V, u], axis=1)
            return out

        return misfit

    searches = most_probable(
        simulate,
        [misfit_of(p) for p in parts],
        starts,
        is_robust=robust,
        evaluations=EVALUATIONS,
        xtol=1e-4,
        ftol=1e-3 if robust else 1e-4,
    )
    return [(float(s.cost), np.asarray(s.x, dtype=float)) for s in searches]


def residuals(fit: ColdFit, tests: OneTimeTests) -> Array:
    """Return model minus measured voltage [V], [test, instant]."""
    x = prior.values(fit.slots, fit.u)[None]
    out: Array = predict_cold(fit.variant, fit.slots, x, tests)[0] - tests.voltage_V
    return out
