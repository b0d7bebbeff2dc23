"""Maximum a posteriori fit of the cell to records with measured current.

Unknowns: the cell's slots, shared by all records, and per record its starting charge and the two scales that tell
one pack from its type. A record's own unknowns touch only its own rows, so that one simulation with all records
nudged at once gives the whole block of the Jacobian.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from uavbatt.battery.initial_state import state_under_load
from uavbatt.battery.model import SOC_GRID, Array
from uavbatt.battery.openloop import Trajectory, simulate
from uavbatt.battery.scaling import dense
from uavbatt.fitting import prior
from uavbatt.fitting.observed import Stack
from uavbatt.fitting.prior import Posterior, Slot

TEMPERATURE_SD_K = 0.6
ROBUST_SCALE = 4.0
NUDGE = 1e-4
OWN = ("start_soc", "log_resistance", "log_capacity")


@dataclass(frozen=True, slots=True)
class OwnPrior:
    """OwnPrior holds the prior sds of what each record has of its own, beside the cell that all share.

    They are those of the starting charge of a rested and of a loaded record, and of ln of its pack's scales.
    """

    rested_soc: float = 0.005
    loaded_soc: float = 0.08
    log_resistance: float = 1e-4  # one pack; 0.04 for flights with whatever pack was at hand
    log_capacity: float = 1e-4


FLEET = OwnPrior(rested_soc=0.03, loaded_soc=0.05, log_resistance=0.04, log_capacity=0.02)
SAMPLES = OwnPrior(log_resistance=0.04, log_capacity=0.02)  # bench tests beside flights: not the packs that fly


@dataclass(frozen=True, slots=True, kw_only=True)
class BatteryFit(Posterior):
    """BatteryFit adds to the posterior of the shared slots each record's own: start soc and ln of its scales."""

    own: Array  # [records, 3]
    cost: float


def fullest_V(stack: Stack) -> float:
    """Return the highest voltage of a cell at which a record begins at rest [V]; NaN where none does."""
    first_V = (stack.voltage_V[0] / stack.cells)[stack.rested]
    return float(np.max(first_V)) if first_V.size else float("nan")


def start_guess(stack: Stack) -> Array:
    """Return the starting charges [records] by the prior OCV at the first voltage (under load: plus a typical drop)."""
    table = dense(prior.OCV_SOC, prior.ocv_knots(fullest_V(stack)))
    drop_V = np.where(stack.rested, 0.0, stack.current_A[0] / stack.capacity_Ah * 1.5 * prior.RESISTANCE_OHMAH)
    guess: Array = np.interp(stack.voltage_V[0] / stack.cells + drop_V, table, SOC_GRID)
    return np.clip(guess, 0.05, 1.0)


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


def fit_battery(
    stack: Stack,
    effects: tuple[str, ...] = prior.BASE_EFFECTS,
    own_prior: OwnPrior | Sequence[OwnPrior] = OwnPrior(),
    start_u: Array | None = None,
    progress: Callable[[int], None] | None = None,
    evaluations: int = 40,
) -> BatteryFit:
    """Find the most probable parameters and their covariance (Gauss-Newton, Huber-like loss beyond 4 sigma).

    own_prior : one for all records, or each record's own; start_u : the slots' u to start from [slots]; progress : is
    called with 1 at each Jacobian; evaluations : of the residuals, at most.
    """
    slots = prior.cell_slots(effects, fullest_V(stack))
    given = [own_prior] * len(stack.names) if isinstance(own_prior, OwnPrior) else own_prior
    own_mean = np.column_stack([start_guess(stack), np.zeros((len(stack.names), 2))])
    own_sd = np.array(
        [
            (p.rested_soc if rested else p.loaded_soc, p.log_resistance, p.log_capacity)
            for p, rested in zip(given, stack.rested, strict=True)
        ]
    )
    shared, records = len(slots), len(stack.names)

    def evaluate(v: Array) -> Array:
        """Residuals [variants, rows·2, records] of vectors v [variants, shared + 3·records]."""
        x = prior.values(slots, v[:, :shared])
        own = own_mean + own_sd * v[:, shared:].reshape(-1, records, len(OWN))
        return residuals(stack, run(stack, slots, effects, x, own), v.shape[0])

    def objective(v: Array) -> Array:
        return np.concatenate([evaluate(v[None])[0].ravel(), disordered(v[None])[0], v])

    def disordered(v: Array) -> Array:
        return prior.monotonicity_penalty(slots, prior.values(slots, v[:, :shared]))

    def jacobian(v: Array) -> Array:
        nudges = np.zeros((shared + len(OWN), v.size))
        nudges[:shared, :shared] = np.eye(shared) * NUDGE
        for k in range(len(OWN)):  # every record's k-th own unknown at once
            nudges[shared + k, shared + k :: len(OWN)] = NUDGE
        values = evaluate(np.vstack([v, v + nudges]))
        slopes = (values[1:] - values[0]) / NUDGE
        block = np.zeros((slopes.shape[1], records, v.size))
        block[:, :, :shared] = np.moveaxis(slopes[:shared], 0, -1)
        for r in range(records):
            for k in range(len(OWN)):
                block[:, r, shared + r * len(OWN) + k] = slopes[shared + k, :, r]
        if progress is not None:
            progress(1)
        order = disordered(np.vstack([v, v + nudges]))
        order_slopes = np.zeros((order.shape[1], v.size))
        order_slopes[:, :shared] = ((order[1 : shared + 1] - order[0]) / NUDGE).T
        return np.vstack([block.reshape(-1, v.size), order_slopes, np.eye(v.size)])

    start = np.zeros(shared + records * len(OWN))
    if start_u is not None:
        start[:shared] = start_u
    found = least_squares(
        objective, start, jacobian, loss="soft_l1", f_scale=ROBUST_SCALE, max_nfev=evaluations, xtol=1e-4, ftol=1e-4
    )
    slopes = np.asarray(found.jac, dtype=float)
    covariance = np.linalg.inv(slopes.T @ slopes)
    own = own_mean + own_sd * found.x[shared:].reshape(records, len(OWN))
    return BatteryFit(
        slots=slots,
        effects=effects,
        u=found.x[:shared],
        covariance_u=covariance[:shared, :shared],
        own=own,
        cost=float(found.cost),
    )


def replay_fit(stack: Stack, found: BatteryFit, own: Array | None = None) -> Trajectory:
    """Simulate the stack's records open-loop with the fitted cell; own [records, 3] replaces the fitted if given."""
    return run(stack, found.slots, found.effects, found.x[None], (found.own if own is None else own)[None])
