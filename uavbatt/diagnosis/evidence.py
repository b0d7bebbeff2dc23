"""Flights and bench tests, made ready to be held against the model.

What the best model of a battery leaves is no white noise: it wanders for a minute or more. So the misfit of a record
is judged by the covariance

    K(t, t') = sd(t) sd(t') exp(-|t - t'|/tau) + white²

with sd and tau from the battery file's [discrepancy] (Rasmussen & Williams, Gaussian Processes, 2006, section 4.2.1,
for the exponential kernel). Its inverse Cholesky factor turns a residual into independent numbers of unit variance:
their sum of squares is the chi-square that all decisions rest on. The rest before take-off is a block of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.initial_state import IDLE_C_RATE
from uavbatt.battery.model import Array
from uavbatt.errors import NotEnoughData
from uavbatt.fitting import observed
from uavbatt.fitting.observed import Observed, Stack

LEAST_CELL_SD_V, REST_CELL_SD_V, WHITE_CELL_SD_V = 0.007, 0.004, 0.003
TIMING_SD_S = 6.0
LEAST_TAU_S = 60.0
NOT_HELD_OUT = 1.25  # a discrepancy seen by the fit itself is too small
LEAST_TEMP_SD_K, TEMP_TAU_S, WHITE_K = 0.5, 400.0, 0.15
SHORTEST_S, LEAST_DRAWN = 240.0, 0.15
LEAST_RECORDS = 2
LEAST_CHANGE = 0.04  # of the current, relative, over the records
IDLE_NOISE_A = 0.15
FAST_ROW_S = 1.5
SHIFTS_S = np.arange(-8.0, 8.01, 0.5)


Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Whitener:
    """Rows of one record that count, and the inverse factor of their covariance."""

    rows: Rows
    inverse: Array


@dataclass(frozen=True, slots=True)
class Evidence:
    """Records side by side with their whitening; `shifted_A` [shifts, rows, records] is the current read late."""

    stack: Stack
    volts: tuple[Whitener, ...]
    temps: tuple[Whitener | None, ...]
    shifted_A: Array
    known_ambient: Array
    start_soc: Array
    start_sd: Array
    independent: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the records."""
        return self.stack.names

    @property
    def has_temperature(self) -> bool:
        """Whether every record has a temperature."""
        return all(t is not None for t in self.temps)


def idle_A(evidence: Evidence) -> float:
    """The smallest mean current that the sensor reports before take-off; inf when no record begins at rest."""
    stack = evidence.stack
    seen = np.abs(stack.current_A) < IDLE_C_RATE * stack.capacity_Ah
    lengths = np.argmin(seen, axis=0)  # rows before the first under load
    means = [float(np.mean(stack.current_A[:n, j])) for j, n in enumerate(lengths) if n and seen[0, j]]
    return min(means, default=float("inf"))


def check(records: list[Observed]) -> None:
    """NotEnoughData, with the reason, when the records cannot tell effects apart."""
    if not records:
        raise NotEnoughData("no record has a measured current: nothing can be traced without it")
    sizes = {(r.cells, round(r.capacity_Ah, 2)) for r in records}
    if len(sizes) > 1:
        listed = ", ".join(f"{n}S {q:g} Ah" for n, q in sorted(sizes))
        raise NotEnoughData(f"the records are of different packs ({listed}): expected flights of one")
    if all(np.nanmax(np.abs(r.current_A)) < 0.02 * r.capacity_Ah for r in records):
        raise NotEnoughData("the current is zero throughout: expected a working current sensor")
    useful = [r for r in records if _long_enough(r)]
    if len(useful) < LEAST_RECORDS and (not useful or not np.isfinite(useful[0].ambient_C)):
        raise NotEnoughData(
            f"{len(useful)} of {len(records)} records last {SHORTEST_S:.0f} s and draw {LEAST_DRAWN:.0%} of the "
            f"charge: expected at least {LEAST_RECORDS}, to show that what is found is the same in each"
        )
    if _change(useful) < LEAST_CHANGE:
        raise NotEnoughData("the load is constant: expected changes of current, or nothing can be told apart")


def _long_enough(record: Observed) -> bool:
    drawn_Ah = float(np.sum(record.current_A[1:] * np.diff(record.time_s))) / 3600.0
    return record.time_s[-1] - record.time_s[0] >= SHORTEST_S and drawn_Ah >= LEAST_DRAWN * record.capacity_Ah


def _change(records: list[Observed]) -> float:
    """Spread of the current under load over all records, rest left out, relative."""
    loads = []
    for record in records:
        binned = observed.binned(record).current_A
        loads.append(binned[binned > 0.3 * np.percentile(binned, 90)] / record.capacity_Ah)
    together = np.concatenate(loads)
    return float(np.std(together) / np.mean(together))


def prepare(records: list[Observed], file: BatteryFile, ocv_soc: tuple[Array, Array]) -> Evidence:
    """Check, bin and whiten the records. ocv_soc: (soc, OCV) of the battery file, ascending."""
    check(records)
    records = sorted((r for r in records if _long_enough(r)), key=_content)
    left = file.discrepancy
    cells = float(records[0].cells)
    strict = 1.0 if left.held_out else NOT_HELD_OUT
    cell_sd_V = max(left.voltage_rmse_V / file.battery.cells_series * strict, LEAST_CELL_SD_V)
    tau_s = max(left.voltage_autocorrelation_s, LEAST_TAU_S)
    ohm = float(np.mean(file.parameters.resistance_ohmAh)) * cells / records[0].capacity_Ah
    temp_sd_K = max(left.temperature_rmse_K * strict, LEAST_TEMP_SD_K)
    stack = observed.stack(records, voltage_sd_V=cell_sd_V, timing_sd_s=TIMING_SD_S)
    numbers = range(len(records))
    start_soc, start_sd = _starts(stack, ocv_soc)
    duration_s = sum(float(r.time_s[-1] - r.time_s[0]) for r in records)
    return Evidence(
        stack=stack,
        volts=tuple(
            _voltage_whitener(stack, j, tau_s, max(WHITE_CELL_SD_V * cells, noise_V(r, ohm)))
            for j, r in enumerate(records)
        ),
        temps=tuple(_temperature_whitener(stack, j, temp_sd_K) for j in numbers),
        shifted_A=_shifted(records, stack),
        known_ambient=np.array([np.isfinite(r.ambient_C) for r in records]),
        start_soc=start_soc,
        start_sd=start_sd,
        independent=max(duration_s / (2.0 * tau_s), 10.0),
    )


def _content(record: Observed) -> tuple[float, ...]:
    """Order that depends on what was measured, not on names: sums of the columns."""
    return (float(np.sum(record.voltage_V)), float(np.sum(record.current_A)), float(record.time_s[-1]))


def _starts(stack: Stack, ocv_soc: tuple[Array, Array]) -> tuple[Array, Array]:
    """Start of charge and its sd: full when rested near full, else by the rested voltage, else a guess."""
    volts = stack.voltage_V[0] / stack.cells
    drop = np.where(stack.rested, 0.0, stack.current_A[0] / stack.capacity_Ah * 0.05)
    guess = np.interp(volts + drop, ocv_soc[1], ocv_soc[0])
    full = stack.rested & (guess > 0.85)
    centre = np.where(full, 1.0, np.clip(guess, 0.05, 1.0))
    return centre, np.where(full, 0.008, np.where(stack.rested, 0.03, 0.06))


def noise_V(record: Observed, ohm: float) -> float:
    """Noise of both sensors that a mean over BIN_S keeps [V]; 0 where rows are too slow to tell it from the load.

    From second differences, which a load that moves over many rows hardly has. The current's, through the pack's
    resistance, is a voltage that the model says and the pack does not show: without it, resistances come out too small.
    """
    spacing_s = float(np.median(np.diff(record.time_s)))
    if spacing_s > FAST_ROW_S:
        return 0.0
    bent = [np.median(np.abs(np.diff(column, 2))) for column in (record.voltage_V, ohm * record.current_A)]
    return float(1.4826 * np.hypot(*bent) / np.sqrt(6.0 * observed.BIN_S / spacing_s))


def _voltage_whitener(stack: Stack, j: int, tau_s: float, white_V: float) -> Whitener:
    rows = np.flatnonzero(stack.compare[:, j])
    time_s, amps = stack.time_s[rows, j], stack.current_A[rows, j]
    loaded = np.maximum.accumulate(np.abs(amps) > IDLE_C_RATE * stack.capacity_Ah[j])
    sd = np.where(loaded, stack.sigma_V[rows, j], REST_CELL_SD_V * stack.cells[j])
    kernel = np.exp(-np.abs(time_s[:, None] - time_s) / tau_s) * sd[:, None] * sd
    kernel *= loaded[:, None] == loaded
    return _whitener(rows, kernel, white_V)


def _temperature_whitener(stack: Stack, j: int, sd_K: float) -> Whitener | None:
    rows = np.flatnonzero(stack.compare[:, j] & np.isfinite(stack.temp_C[:, j]))
    if rows.size < 5:
        return None
    time_s = stack.time_s[rows, j]
    kernel = sd_K**2 * np.exp(-np.abs(time_s[:, None] - time_s) / TEMP_TAU_S)
    return _whitener(rows, kernel, WHITE_K)


def _whitener(rows: Rows, kernel: Array, white: float) -> Whitener:
    factor = cholesky(kernel + white**2 * np.eye(len(kernel)), lower=True)
    return Whitener(rows, solve_triangular(factor, np.eye(len(kernel)), lower=True))


def _shifted(records: list[Observed], stack: Stack) -> Array:
    """The current `SHIFTS_S` later, averaged like the record itself."""
    out = np.empty((len(SHIFTS_S), *stack.current_A.shape))
    for j, record in enumerate(records):
        bin_s = observed.BIN_S if np.median(np.diff(record.time_s)) < 0.9 * observed.BIN_S else 0.0
        charge = np.concatenate(
            [[0.0], np.cumsum(0.5 * (record.current_A[1:] + record.current_A[:-1]) * np.diff(record.time_s))]
        )
        for i, shift_s in enumerate(SHIFTS_S):
            at_s = stack.time_s[:, j] + shift_s
            if not bin_s:
                out[i, :, j] = np.interp(at_s, record.time_s, record.current_A)
                continue
            ends_s = np.clip(np.stack([at_s - bin_s / 2, at_s + bin_s / 2]), *record.time_s[[0, -1]])
            width_s = np.diff(ends_s, axis=0)[0]
            drawn = np.diff(np.interp(ends_s, record.time_s, charge), axis=0)[0]
            held_A = np.where(at_s < record.time_s[0], record.current_A[0], stack.current_A[-1, j])
            out[i, :, j] = np.where(width_s > 0.5, drawn / np.maximum(width_s, 0.5), held_A)
    return out
