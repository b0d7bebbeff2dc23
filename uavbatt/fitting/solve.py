"""Maximum a posteriori fit of the cell to records with measured current.

Unknowns are the cell's slots, shared by all records, and for each record its starting charge and its two scales against
the type (resistance, capacity).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from uavbatt.battery.high_voltage import ORDINARY_FULL_V
from uavbatt.battery.initial_state import state_under_load
from uavbatt.battery.model import SOC_GRID, Array
from uavbatt.battery.openloop import Trajectory, simulate
from uavbatt.battery.tables import dense
from uavbatt.fitting import prior
from uavbatt.fitting.arrow import Optimum, robust_least_squares
from uavbatt.fitting.observed import Stack
from uavbatt.fitting.prior import Chemistry, Posterior, Slot

TEMPERATURE_SD_K = 0.6  # of a pack's thermometer and its place on the pack
ROBUST_SCALE = 4.0  # sds beyond which a residual counts as an outlier
START_DROP, LEAST_START = 1.5, 0.05  # a load of seconds drops 1.5 times what R0 does; no flight begins emptier
COLUMNS = 2000  # records times variants that are simulated side by side: more take memory and save no time
OWN = ("start_soc", "log_resistance", "log_capacity")
# A search may creep along a bend where the OCV is flat near empty, which no cell is, far from the least cost (38, not
# 18: the time was 101 s too long). It begins again with a deeper curve: its first slots, in sds of the prior.
FLAT_V, DEEPER = 0.01, (-2.0, -2.0, -1.0)


@dataclass(frozen=True, slots=True)
class OwnPrior:
    """OwnPrior holds the prior of each record's own unknowns.

    They are the sd of the starting charge of a rested record and of a loaded one, the sds of ln of the two scales, and
    the mean of ln of the capacity scale (that of the resistance scale is 0).
    """

    rested_soc: float = 0.005
    loaded_soc: float = 0.08
    log_resistance: float = 1e-4  # one pack
    log_capacity: float = 1e-4
    mean_log_capacity: float = 0.0


# Packs of flights are alike, or in service: a season takes 10 to 25 % of the capacity and adds resistance.
# `fitting.battery` keeps what the flights make more probable. They do not tell the mean capacity of their packs: with a
# mean of 1 the 5 % point was up to 59 s too long for packs of the type of a worn fleet, with exp(-0.02) 5 s.
ALIKE = OwnPrior(rested_soc=0.03, loaded_soc=0.05, log_resistance=0.04, log_capacity=0.02)
IN_SERVICE = OwnPrior(rested_soc=0.03, loaded_soc=0.05, log_resistance=0.10, log_capacity=0.06, mean_log_capacity=-0.02)
WORN, VERY_WORN = replace(IN_SERVICE, mean_log_capacity=-0.10), replace(IN_SERVICE, mean_log_capacity=-0.18)
# With ln of the odds before any flight: where no pack was flown to its end, flights hardly tell worn packs from others.
PACKS_OF_FLIGHTS = ((ALIKE, 0.0), (IN_SERVICE, 0.0), (WORN, -1.0), (VERY_WORN, -2.0))
SAMPLES = OwnPrior(log_resistance=0.04, log_capacity=0.02)  # bench tests beside flights: not the packs that fly


def freedom(tests: int, flights: int) -> tuple[tuple[str, ...], list[OwnPrior]]:
    """Return the effects to fit to bench tests and flights, and the spread of each record's own values, tests first.

    Only a slow, even load with a changing one separates the reaction at the electrodes from the other resistances;
    there it improves the prediction of flights that were left out (docs/diagnosis.md).
    """
    if not flights:
        return prior.BASE_EFFECTS, [OwnPrior()] * tests
    return (*prior.BASE_EFFECTS, "charge_transfer"), [SAMPLES] * tests + [OwnPrior()] * flights


@dataclass(frozen=True, slots=True, kw_only=True)
class CellFit(Posterior):
    """CellFit adds to the posterior of the shared slots each record's own: start soc and ln of its scales.

    log_evidence : ln of the probability of the records under the priors, up to a constant of the records. It compares
    two priors of the same records (Laplace's approximation: MacKay, Neural Computation 4, 1992, 415-447).
    """

    chemistry: Chemistry
    own: Array  # [records, 3]
    cost: float
    log_evidence: float


def fullest_V(stack: Stack) -> float:
    """Return the highest cell voltage at which a record begins at rest [V]; NaN if none begins at rest.

    Above what an ordinary cell charges to, a record that begins under load counts as well: at rest it showed more.
    """
    first_V = stack.voltage_V[0] / stack.cells
    shown_V = first_V[stack.rested | (first_V > ORDINARY_FULL_V)]
    return float(np.max(shown_V)) if shown_V.size else float("nan")


def start_guess(stack: Stack, chemistry: Chemistry = prior.LIPO) -> Array:
    """Return the starting charges [records] by the prior OCV at the first voltage (under load: plus a typical drop)."""
    table = dense(prior.OCV_SOC, prior.ocv_knots(fullest_V(stack), chemistry))
    drop_V = np.where(stack.rested, 0.0, stack.current_A[0] / stack.capacity_Ah * START_DROP * chemistry.ohmAh)
    guess: Array = np.interp(stack.voltage_V[0] / stack.cells + drop_V, table, SOC_GRID)
    return np.clip(guess, LEAST_START, 1.0)


def run(stack: Stack, slots: tuple[Slot, ...], effects: tuple[str, ...], x: Array, own: Array) -> Trajectory:
    """Simulate variants x [variants, slots], own [variants, records, 3]; the columns are variant-major."""
    variants, records = own.shape[:2]
    cell = prior.cell(slots, np.repeat(x, records, axis=0), effects)
    flat = own.reshape(variants * records, len(OWN))
    cell = cell._replace(resistance_gain=np.exp(flat[:, 1]))
    capacity = np.tile(stack.capacity_Ah, variants) * np.exp(flat[:, 2])
    rate = np.tile(stack.current_A, (1, variants)) / capacity
    start = state_under_load(cell, flat[:, 0], np.tile(stack.start_temp_C, variants), rate[0])
    return simulate(cell, start, rate, np.tile(stack.dt_s, (1, variants)), np.tile(stack.ambient_C, variants))


def residuals(stack: Stack, trajectory: Trajectory, variants: int) -> Array:
    """Return weighted residuals of voltage and temperature [variants, rows·2, records]; 0 where not measured."""
    shape = (stack.time_s.shape[0], variants, len(stack.names))
    volts = trajectory.voltage_V.reshape(shape) * stack.cells - stack.voltage_V[:, None, :]
    warmth = trajectory.sensor_C.reshape(shape) - stack.temp_C[:, None, :]
    weight = np.where(stack.compare, stack.weight, 0.0)[:, None, :]
    scaled = np.concatenate(
        [volts * weight / stack.sigma_V[:, None, :], np.nan_to_num(warmth) * weight / TEMPERATURE_SD_K]
    )
    return np.moveaxis(scaled, 1, 0)


@dataclass(frozen=True, slots=True)
class _Unknowns:
    """_Unknowns turns standard normal numbers, the slots' u and three v of each record, into residuals."""

    stack: Stack
    slots: tuple[Slot, ...]
    effects: tuple[str, ...]
    own_mean: Array  # [records, 3]
    own_sd: Array
    chemistry: Chemistry
    rising_ohms: bool

    def own(self, v: Array) -> Array:
        """Return the records' own values for v [.., records, 3]."""
        return self.own_mean + self.own_sd * v

    def evaluate(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Return the residuals [variants, rows·2, records] of u and v, and the OCV shape's [variants, differences]."""
        x = prior.values(self.slots, u)
        together = max(COLUMNS // len(self.stack.names), 1)
        parts = [
            residuals(self.stack, run(self.stack, self.slots, self.effects, x[some], self.own(v[some])), len(x[some]))
            for some in (slice(k, k + together) for k in range(0, len(x), together))
        ]
        shape = prior.shape_penalty(self.slots, x, self.chemistry)
        if self.rising_ohms:
            shape = np.concatenate([shape, prior.dips(self.slots, x) / prior.DIP_SD], axis=-1)
        return np.concatenate(parts), shape

    def best_from(self, u: Array, evaluations: int) -> Optimum:
        """Return the most probable unknowns that a search finds from the slots' u on."""
        return robust_least_squares(self.evaluate, u, self.own_mean.shape, ROBUST_SCALE, evaluations)


def _own_prior(stack: Stack, own_prior: OwnPrior | Sequence[OwnPrior], chemistry: Chemistry) -> tuple[Array, Array]:
    """Return the prior means and sds, both [records, 3], of each record's own unknowns."""
    priors = [own_prior] * len(stack.names) if isinstance(own_prior, OwnPrior) else own_prior
    pairs = zip(priors, stack.rested, strict=True)
    sd = [(p.rested_soc if at_rest else p.loaded_soc, p.log_resistance, p.log_capacity) for p, at_rest in pairs]
    mean_log_capacity = [p.mean_log_capacity for p in priors]
    mean = np.column_stack([start_guess(stack, chemistry), np.zeros(len(priors)), mean_log_capacity])
    return mean, np.array(sd)


def fit_cell(
    stack: Stack,
    effects: tuple[str, ...] = prior.BASE_EFFECTS,
    own_prior: OwnPrior | Sequence[OwnPrior] = OwnPrior(),
    evaluations: int = 40,
    chemistry: Chemistry = prior.LIPO,
    *,
    rising_ohms: bool = False,
) -> CellFit:
    """Find the most probable parameters and their covariance (robust beyond 4 sigma).

    own_prior : one for all records, or each record's own; evaluations : of the residuals, at most; chemistry : of the
    cells; rising_ohms : the resistance does not fall towards empty, which flights cannot show.
    """
    slots = prior.cell_slots(effects, fullest_V(stack), chemistry)
    own_mean, own_sd = _own_prior(stack, own_prior, chemistry)
    unknowns = _Unknowns(stack, slots, effects, own_mean, own_sd, chemistry, rising_ohms)
    best = unknowns.best_from(np.zeros(len(slots)), evaluations)
    if prior.lowest_fall_V(slots, best.u) < FLAT_V:
        deeper = np.concatenate([DEEPER, np.zeros(len(slots) - len(DEEPER))])
        best = min(best, unknowns.best_from(deeper, evaluations), key=lambda found: found.cost)
    return CellFit(
        slots=slots,
        effects=effects,
        chemistry=chemistry,
        u=best.u,
        covariance_u=np.asarray(np.linalg.inv(best.information)),
        own=unknowns.own(best.v),
        cost=best.cost,
        log_evidence=-best.cost - 0.5 * best.log_determinant,
    )


def replay_fit(stack: Stack, fit: CellFit, own: Array | None = None) -> Trajectory:
    """Simulate the stack's records open-loop with the fitted cell; own [records, 3] replaces the fitted if given."""
    return run(stack, fit.slots, fit.effects, fit.x[None], (fit.own if own is None else own)[None])
