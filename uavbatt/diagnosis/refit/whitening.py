"""The covariance of a model's error along a record, and how it makes independent numbers of a residual.

The residual of the best model of a battery is not white noise: it changes slowly, over a minute or more, and is largest
at both ends of the charge. So the misfit of a record is judged by the covariance

    K(t, t') = (s(t) s(t') + e(t) e(t')) exp(-|t - t'|/tau) + noise²
    s² = sd(soc)² + (timing · slope)² + (charge error · dOCV/dsoc)²,   e = share · R0 (I - mean I of the last minute)

as the battery file's `[discrepancy.wander]` learned s from effect-free records (`fitting.wander`; Rasmussen & Williams,
Gaussian Processes, 2006, section 4.2.1, for the exponential kernel), with the error of the capacity where a pack is
discharged deeper than in those records. The error e counts from the first landing on: a voltage recovers in more ways
than a model has. The inverse Cholesky factor turns a residual into independent numbers of unit variance: their sum of
squares is the chi-square by which everything is decided. The rest before take-off is a block of its own, whose error is
one constant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from uavbatt.battery.battery_file import Wander
from uavbatt.battery.equations import SECONDS_PER_HOUR
from uavbatt.battery.initial_state import IDLE_C_RATE
from uavbatt.battery.model import Array
from uavbatt.diagnosis.refit.meter_noise import noise_K
from uavbatt.fitting import wander
from uavbatt.fitting.observed import ObservedRecord, Stack

LEAST_TEMPERATURES = 5  # fewer readings do not show how a temperature changes
COLD_DOUBLES_K = 6.0  # the model's error doubles for so many K below its coldest flight
# Of the drop of a load that has just ended or begun again: healthy packs of other makes err by a quarter of it at a
# landing, and by less a minute later.
RECOVERY_SHARE, RECOVERY_S = 0.3, 45.0

Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Whitener:
    """Whitener holds the rows of one record that count, and the inverse Cholesky factor of their covariance.

    `rest` marks those at rest before take-off; `sd` is the error that the model is expected to have in each row.
    """

    rows: Rows
    rest: NDArray[np.bool_]
    inverse: Array
    sd: Array


def quick_A(stack: Stack, tau_s: float) -> Array:
    """Return the current less its exponential mean of the last `tau_s` [s]: [A], [rows, records]."""
    slow_A = np.zeros_like(stack.current_A)
    for row in range(1, len(slow_A)):
        decay = np.exp(-stack.dt_s[row] / tau_s)
        between_A = 0.5 * (stack.current_A[row - 1] + stack.current_A[row])
        slow_A[row] = decay * slow_A[row - 1] + (1.0 - decay) * between_A
    out: Array = stack.current_A - slow_A
    return out


def flight_error_V(stack: Stack, spread: Wander, start_soc: Array, steep_V: tuple[Array, Array]) -> Array:
    """Return the error of the model in flight [V], one sd, [rows, records].

    start_soc : of each record; steep_V : (soc, error [V] that an error of the capacity causes there)
    """
    drawn_Ah = np.cumsum(stack.current_A * stack.dt_s, axis=0) / SECONDS_PER_HOUR
    soc = start_soc - drawn_Ah / stack.capacity_Ah
    # The error was learned on packs that took off full: near full it may belong to the charge or to the take-off.
    log_sd = np.log(np.maximum(spread.voltage_sd_V, 1e-6))
    sd_V = np.exp(np.maximum(*(np.interp(z, spread.soc, log_sd) for z in (soc, soc + 1.0 - start_soc))))
    sd_V *= [cold_factor(spread, start_C) for start_C in stack.start_temp_C]
    out: Array = np.hypot(np.hypot(sd_V, np.interp(soc, *steep_V)), wander.TIMING_S * stack.slope_Vps)
    return out


def recovery_error_V(stack: Stack, ohm: float) -> Array:
    """Return the error of the model from the first landing on [V], one sd, [rows, records]; `ohm` : R0 of the pack."""
    is_idle = np.abs(stack.current_A) <= IDLE_C_RATE * stack.capacity_Ah
    has_landed = np.maximum.accumulate(wander.has_flown(stack) & is_idle, axis=0)
    out: Array = np.where(has_landed, RECOVERY_SHARE * ohm * quick_A(stack, RECOVERY_S), 0.0)
    return out


def voltage_whiteners(
    stack: Stack, in_flight_V: Array, recovery_V: Array, spread: Wander, noises_V: list[tuple[float, float]]
) -> tuple[Whitener, ...]:
    """Return the whitening of each record's voltages.

    in_flight_V, recovery_V : errors of the model [rows, records] (`flight_error_V`, `recovery_error_V`)
    noises_V : of each record, noise [V] of all rows and of those at rest (0: the same)
    """
    has_flown, out = wander.has_flown(stack), []
    for j, (noise_V, resting_V) in enumerate(noises_V):
        rows = np.flatnonzero(stack.compare[:, j])
        time_s, flown, recovering_V = stack.time_s[rows, j], has_flown[rows, j], recovery_V[rows, j]
        sd_V = np.where(flown, in_flight_V[rows, j], spread.rest_sd_V)
        decay = np.exp(-np.abs(time_s[:, None] - time_s) / spread.voltage_time_s)
        kernel = np.where(flown[:, None] & flown, decay, 1.0)
        kernel *= sd_V[:, None] * sd_V + recovering_V[:, None] * recovering_V
        kernel *= flown[:, None] == flown
        white_V = np.maximum(np.where(flown, noise_V, resting_V or noise_V), spread.voltage_noise_V)
        out.append(_whitener(rows, ~flown, kernel, white_V))
    return tuple(out)


def cold_factor(spread: Wander, start_C: float) -> float:
    """Return the factor on the model's error for a flight that begins colder than all flights it was learned on."""
    if spread.coldest_C is None or not np.isfinite(start_C):
        return 1.0
    return float(2.0 ** (max(spread.coldest_C - start_C, 0.0) / COLD_DOUBLES_K))


def temperature_whitener(stack: Stack, j: int, spread: Wander, record: ObservedRecord) -> Whitener | None:
    """Return the whitening of a record's temperatures, `record` being column `j` of the stack; None if it has few."""
    rows = np.flatnonzero(stack.compare[:, j] & np.isfinite(stack.temp_C[:, j]))
    if rows.size < LEAST_TEMPERATURES:
        return None
    time_s = stack.time_s[rows, j]
    decay = np.exp(-np.abs(time_s[:, None] - time_s) / spread.temperature_time_s)
    nowhere = np.zeros(rows.size, dtype=bool)
    return _whitener(rows, nowhere, spread.temperature_sd_K**2 * decay, noise_K(record, spread.temperature_noise_K))


def _whitener(rows: Rows, rest: NDArray[np.bool_], kernel: Array, noise: Array | float) -> Whitener:
    factor = cholesky(kernel + noise**2 * np.eye(len(kernel)), lower=True)
    sd = np.sqrt(np.sum(factor**2, axis=1))
    return Whitener(rows, rest, solve_triangular(factor, np.eye(len(kernel)), lower=True), sd)
