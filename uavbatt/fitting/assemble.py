"""From a fit to a battery file: values, standard errors, and what the model leaves unexplained."""

from __future__ import annotations

import numpy as np

from uavbatt.battery.battery_file import Discrepancy, EffectEntry, ParameterTable
from uavbatt.battery.effects import EFFECTS
from uavbatt.battery.model import SOC_GRID, Array
from uavbatt.battery.openloop import Trajectory
from uavbatt.battery.tables import dense
from uavbatt.fitting import prior
from uavbatt.fitting.observed import Stack
from uavbatt.fitting.prior import Slot

# How much less than stated the packs of a fleet hold, and its sd, as shares of it: a season takes 0.10 to 0.25.
FLEET_SHORT, FLEET_SHORT_SD = 0.03, 0.08


def rounded(value: float, digits: int = 6) -> float:
    """Return a value rounded to so many significant digits."""
    return float(f"{value:.{digits}g}")


def parameter_table(
    slots: tuple[Slot, ...],
    x: Array,
    standard_error: dict[str, float],
    resistance_scale_sd: float,
    capacity_scale_sd: float,
    c_rate: float | None = None,
    c_rate_sd: float | None = None,
    spread_flights: int | None = None,
) -> ParameterTable:
    """Return the section [parameters] of the values x [slots].

    spread_flights : the flights over which the two scales' sds were measured, None where they are assumed.
    """
    ocv_V, r0_ohmAh = prior.knots(slots, x)
    return ParameterTable(
        ocv_soc=[float(z) for z in prior.OCV_SOC],
        ocv_V=[rounded(v) for v in prior.made_monotone(ocv_V)],
        resistance_soc=[float(z) for z in prior.RESISTANCE_SOC],
        resistance_ohmAh=[rounded(r) for r in r0_ohmAh],
        resistance_scale_sd=rounded(resistance_scale_sd),
        capacity_scale_sd=rounded(capacity_scale_sd),
        c_rate=None if c_rate is None else rounded(c_rate),
        c_rate_sd=None if c_rate_sd is None else rounded(c_rate_sd),
        spread_flights=spread_flights,
        standard_error={k: rounded(v) for k, v in standard_error.items()},
    )


def with_unseen_ocv(
    slots: tuple[Slot, ...], x: Array, standard_error: dict[str, float], lowest_soc: float
) -> tuple[Array, dict[str, float]]:
    """Return the values of the slots and their standard errors, with the OCV below the charge that flights reached.

    There the fitted curve is that of a pack that holds what is stated. Nothing in the flights shows what their packs
    hold; packs in service hold less (FLEET_SHORT) and are empty sooner. The error is half of what the voltage loses at
    twice FLEET_SHORT_SD: the curve bends, so that a knee which comes sooner costs more than the slope above it tells.
    """
    first = prior.places(slots)[f"ocv_{prior.OCV_SOC[0]:g}"]
    knots = slice(first, first + prior.OCV_SOC.size)
    unseen, table = np.maximum(1.0 - prior.OCV_SOC / lowest_soc, 0.0), dense(prior.OCV_SOC, x[knots])

    def of_smaller(short: float) -> Array:
        return np.interp(prior.OCV_SOC - short * unseen, SOC_GRID, table)

    lowered, errors = x.copy(), dict(standard_error)
    lowered[knots] = of_smaller(FLEET_SHORT)
    for soc, lost_V in zip(prior.OCV_SOC, x[knots] - of_smaller(2.0 * FLEET_SHORT_SD), strict=True):
        errors[f"ocv_{soc:g}"] = float(np.hypot(errors[f"ocv_{soc:g}"], 0.5 * lost_V))
    return lowered, errors


def effect_entries(
    slots: tuple[Slot, ...], x: Array, standard_error: dict[str, float], effects: tuple[str, ...]
) -> list[EffectEntry]:
    """Return the sections [[effects]] of the values x [slots]."""
    at = prior.places(slots)
    entries = []
    for name in effects:
        quantities = [q for q in EFFECTS[name].quantities if q.fitted]
        entries.append(
            EffectEntry(
                name=name,
                parameters={q.name: rounded(float(x[at[q.name]]) if q.name in at else q.prior) for q in quantities},
                standard_error={q.name: rounded(standard_error[q.name]) for q in quantities if q.name in at},
            )
        )
    return entries


def discrepancy(stack: Stack, trajectory: Trajectory, cells: int, *, held_out: bool, source: str) -> Discrepancy:
    """Measure the model's error on these records: bias, RMSE and correlation time of voltage; RMSE of temperature.

    cells : cells of the pack for which it is stated; records of other packs are scaled to it

    The RMSE is that of the slow part: the part that is uncorrelated from row to row is noise of the sensor. Rows are
    weighted by how flat the voltage is (`Stack.sigma_V`), because near the end an error of volts is one of seconds.
    """
    bias, squares, lagged, temps = [], [], [], []
    for j in range(len(stack.names)):
        rows = stack.compare[:, j]
        flat = np.min(stack.sigma_V[rows, j]) / stack.sigma_V[rows, j]
        error_V = trajectory.voltage_V[rows, j] * stack.cells[j] - stack.voltage_V[rows, j]
        error = error_V * (cells / stack.cells[j]) * flat
        bias.append(float(np.mean(error)))
        squares.append(float(np.mean(error[:-1] * error[1:])))  # lag one: without the white part
        lagged.append(_correlation_time(error, stack.time_s[rows, j]))
        gap_K = trajectory.sensor_C[rows, j] - stack.temp_C[rows, j]
        temps.append(float(np.nanmean(gap_K**2)) if np.isfinite(gap_K).any() else np.nan)
    temperature = float(np.sqrt(np.nanmean(temps))) if np.isfinite(temps).any() else 2.0
    return Discrepancy(
        voltage_bias_V=rounded(float(np.mean(bias))),
        voltage_rmse_V=rounded(float(np.sqrt(max(float(np.mean(squares)), 1e-6)))),
        voltage_autocorrelation_s=rounded(float(np.median(lagged))),
        temperature_rmse_K=rounded(temperature),
        held_out=held_out,
        source=source,
    )


def _correlation_time(error: Array, time_s: Array) -> float:
    """Return the lag [s] at which the autocorrelation is below 1/e of that at lag one (without the white part)."""
    centred = error - np.mean(error)
    spectrum = np.fft.rfft(centred, 2 * len(centred))
    correlation = np.fft.irfft(np.abs(spectrum) ** 2)[: len(centred)]
    below = np.flatnonzero(correlation < correlation[1] / np.e)
    lag = int(below[0]) if below.size else len(centred) - 1
    return float(lag * np.median(np.diff(time_s)))
