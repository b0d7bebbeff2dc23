"""Correlation of a model's error along a record, learned from records without a missing effect.

No circuit model is exact, so that its error is not white noise. It is modelled as an Ornstein-Uhlenbeck process,

    misfit(t) = s(t) z(t) + noise,   z' = -z/tau + white,  var z = 1
    s(t)²     = sd(soc)² + (TIMING_S dV/dt)²

whose sd is large at both ends of the charge, where tables are steep and reactions slow. The most probable sd, tau and
noise follow from the likelihood of the records, by a Kalman filter of z (Kennedy & O'Hagan 2001 for the idea of a
discrepancy, Särkkä 2013, chapter 12, for the parameters). At rest before take-off the error is a constant.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from uavbatt.battery.battery_file import Wander
from uavbatt.battery.initial_state import IDLE_C_RATE
from uavbatt.battery.model import Array
from uavbatt.battery.openloop import Trajectory
from uavbatt.fitting.assemble import rounded
from uavbatt.fitting.observed import Stack
from uavbatt.fitting.prior import FARTHEST_LN

SOC = np.array([0.0, 0.1, 0.2, 0.35, 0.65, 0.8, 0.9, 1.0])
TIMING_S = 3.0  # near empty a model that is late by so much is good, although its error is some volts
LEAST_CELL_V, LEAST_NOISE_CELL_V, LEAST_REST_CELL_V = 0.003, 0.0005, 0.0015  # no circuit model has a smaller error
LEAST_K, LEAST_NOISE_K = 0.15, 0.02
USUAL_CELL_V, USUAL_REST_CELL_V, USUAL_TIME_S, USUAL_NOISE_CELL_V = 0.007, 0.0025, 120.0, 0.002
USUAL_K, USUAL_TIME_K_S, USUAL_NOISE_K = 0.3, 700.0, 0.05
NOT_FULL, FULL = 0.85, 0.99  # chargers end within a hundredth of full; far lower a pack was not charged
DIGITS = 4  # significant: the sds are known to two
PRIOR_SD, NEIGHBOUR_SD = 1.0, 0.5  # sds of logarithms
NUDGE = 1e-3  # finite difference in the logarithms


class Misfit(NamedTuple):
    """Misfit holds the model's error on records side by side, [rows, records], and the quantities that scale it.

    slope : of the voltage [V/s], 0 for temperatures; known : marks the rows that count
    """

    value: Array
    time_s: Array
    soc: Array
    slope: Array
    known: NDArray[np.bool_]


def likelihood(misfit: Misfit, log_sd: Array, log_time: Array, log_noise: Array) -> Array:
    """Return the negative logarithm of the likelihood [variants] of a misfit.

    log_sd : ln sd at SOC [variants, knots]; log_time, log_noise : ln tau and ln noise [variants].
    """
    soc = np.clip(misfit.soc, SOC[0], SOC[-1])
    lower = np.clip(np.searchsorted(SOC, soc) - 1, 0, SOC.size - 2)
    share = (soc - SOC[lower]) / (SOC[lower + 1] - SOC[lower])
    sd = np.exp((1.0 - share) * log_sd[:, lower] + share * log_sd[:, lower + 1])  # [variants, rows, records]
    scale = np.hypot(sd, TIMING_S * misfit.slope)
    noise = np.exp(2.0 * log_noise)[:, None]
    decay = np.exp(-np.diff(misfit.time_s, axis=0, prepend=misfit.time_s[:1]) / np.exp(log_time)[:, None, None])
    z, p = np.zeros(scale.shape[::2]), np.ones(scale.shape[::2])
    total = np.zeros(scale.shape[::2])
    for k in range(misfit.value.shape[0]):
        z, p = decay[:, k] * z, 1.0 + decay[:, k] ** 2 * (p - 1.0)
        h, known = scale[:, k], misfit.known[k]
        spread = h * h * p + noise
        surprise = misfit.value[k] - h * z
        total += np.where(known, 0.5 * (surprise**2 / spread + np.log(spread)), 0.0)
        gain = np.where(known, p * h / spread, 0.0)
        z, p = z + gain * surprise, p * (1.0 - gain * h)
    out: Array = total.sum(axis=-1)
    return out


def _most_probable(misfit: Misfit, usual: Array, least: Array, neighbours: bool) -> Array:
    """Return exp of the most probable (ln sd at SOC, ln tau, ln noise); without `neighbours` one sd for all charges."""

    def unpacked(u: Array) -> tuple[Array, Array, Array]:
        sd = u[:, :-2] if neighbours else np.repeat(u[:, :1], SOC.size, axis=1)
        return sd, u[:, -2], u[:, -1]

    def objective(u: Array) -> tuple[float, Array]:
        us = np.vstack([u, u + NUDGE * np.eye(u.size)])
        steps = np.diff(us[:, :-2], axis=1) / NEIGHBOUR_SD
        charged = 0.5 * np.sum(((us - usual) / PRIOR_SD) ** 2, axis=1) + 0.5 * np.sum(steps**2, axis=1)
        values = likelihood(misfit, *unpacked(us)) + charged
        return float(values[0]), (values[1:] - values[0]) / NUDGE

    bounds = [(low, low + FARTHEST_LN) for low in least]
    minimum = minimize(objective, usual, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 60})
    best: Array = np.exp(minimum.x)
    return best


def has_flown(stack: Stack) -> NDArray[np.bool_]:
    """Mark the rows from the first load on, [rows, records]."""
    marks: NDArray[np.bool_] = np.maximum.accumulate(np.abs(stack.current_A) > IDLE_C_RATE * stack.capacity_Ah, axis=0)
    return marks


def learn(stack: Stack, trajectory: Trajectory, records: list[int], cells: int) -> Wander:
    """Return the wander of `records` (columns of the stack) around an open-loop simulation of them.

    cells : cells of the pack for which it is stated; records of other packs are scaled to it
    """
    loaded = has_flown(stack)
    share = cells / stack.cells
    gap_V = ((stack.voltage_V - trajectory.voltage_V * stack.cells) * share)[:, records]
    at = (stack.time_s[:, records], trajectory.soc[:, records], (stack.slope_Vps * share)[:, records])
    flying = (stack.compare & loaded)[:, records]
    usual = np.log([*[USUAL_CELL_V * cells] * SOC.size, USUAL_TIME_S, USUAL_NOISE_CELL_V * cells])
    least = np.log([*[LEAST_CELL_V * cells] * SOC.size, 10.0, LEAST_NOISE_CELL_V * cells])
    volts = _most_probable(Misfit(gap_V, *at, flying), usual, least, neighbours=True)
    gap_K = (stack.temp_C - trajectory.sensor_C)[:, records]
    felt = stack.compare[:, records] & np.isfinite(gap_K)
    usual, least = np.log([USUAL_K, USUAL_TIME_K_S, USUAL_NOISE_K]), np.log([LEAST_K, 60.0, LEAST_NOISE_K])
    flat = Misfit(np.nan_to_num(gap_K), at[0], at[1], np.zeros_like(gap_K), felt)
    warmth = _most_probable(flat, usual, least, neighbours=False)
    resting = (stack.compare & ~loaded)[:, records]
    starts_C = stack.start_temp_C[records]
    return Wander(
        soc=[float(z) for z in SOC],
        voltage_sd_V=[rounded(v, DIGITS) for v in volts[:-2]],
        voltage_time_s=rounded(volts[-2], DIGITS),
        voltage_noise_V=rounded(volts[-1], DIGITS),
        rest_sd_V=rounded(_rest_sd_V(gap_V, resting, cells), DIGITS),
        temperature_sd_K=rounded(warmth[0], DIGITS),
        temperature_time_s=rounded(warmth[1], DIGITS),
        temperature_noise_K=rounded(warmth[2], DIGITS),
        coldest_C=rounded(float(np.min(starts_C)), DIGITS) if np.isfinite(starts_C).all() else None,
        start_soc=_usual_start(trajectory.soc[0, records][stack.rested[records]]),
    )


def _rest_sd_V(gap_V: Array, resting: NDArray[np.bool_], cells: int) -> float:
    """Return the sd of the error at rest before take-off [V of the pack].

    gap_V [rows, records] : the errors; resting [rows, records] : marks the rows at rest. The usual error counts as one
    record more, so that two records do not decide alone.
    """
    has_rest = resting.any(axis=0)
    means = np.sum(np.where(resting, gap_V, 0.0), axis=0)[has_rest] / resting.sum(axis=0)[has_rest]
    one_more = np.append(means, USUAL_REST_CELL_V * cells)
    return max(float(np.sqrt(np.mean(one_more**2))), LEAST_REST_CELL_V * cells)


def _usual_start(started: Array) -> float | None:
    """Return the mean charge with which rested records began, or None if they began full or not full on purpose."""
    mean = float(np.mean(started)) if started.size else 1.0
    return rounded(mean, DIGITS) if NOT_FULL < mean < FULL else None
