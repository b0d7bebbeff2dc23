"""Residual of the model, for each record and split by its possible causes.

The size of a residual is that of its slow part, the mean product of neighbouring rows: the part that is uncorrelated
from row to row is noise of the sensor. Rows are weighted by how flat the voltage is, as in [discrepancy] of a file.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.initial_state import IDLE_C_RATE
from uavbatt.battery.model import Array
from uavbatt.diagnosis.refit.evidence import Evidence
from uavbatt.diagnosis.refit.simulation import Simulated

PARTS = 3  # early, middle, late: what a person can tell apart in a short sentence


@dataclass(frozen=True, slots=True)
class Residual:
    """Residual holds measured minus modelled voltage [V] and temperature [K] at the measured rows of one record.

    The other columns are variables that the two may depend on; `flatness` is the weight of each row, `rest` marks the
    rows at rest.
    """

    name: str
    time_s: Array
    voltage_V: Array
    temp_K: Array
    flatness: Array
    current_A: Array
    soc: Array
    temp_C: Array
    rest: NDArray[np.bool_]

    @property
    def voltage_rmse_V(self) -> float:
        """Return the size of the slow part of the voltage residual under load [V]; NaN with too few rows."""
        error = (self.voltage_V * self.flatness)[~self.rest]
        return float(np.sqrt(max(float(np.mean(error[:-1] * error[1:])), 0.0))) if error.size > 2 else float("nan")

    @property
    def temp_rmse_K(self) -> float:
        """Return the size of the temperature residual [K]; NaN when it was not measured."""
        finite = self.temp_K[np.isfinite(self.temp_K)]
        return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")


def residuals(evidence: Evidence, simulated: Simulated, variant: int = 0) -> list[Residual]:
    """Return the residuals of every record under one simulated variant."""
    stack = evidence.stack
    out = []
    for j, (name, volts) in enumerate(zip(evidence.names, evidence.volts, strict=True)):
        rows = volts.rows
        amps = stack.current_A[rows, j]
        loaded = np.maximum.accumulate(np.abs(amps) > IDLE_C_RATE * stack.capacity_Ah[j])
        sigma = stack.sigma_V[rows, j]
        out.append(
            Residual(
                name=name,
                time_s=stack.time_s[rows, j],
                voltage_V=stack.voltage_V[rows, j] - simulated.voltage_V[rows, variant, j],
                temp_K=stack.temp_C[rows, j] - simulated.temp_C[rows, variant, j],
                flatness=float(np.min(sigma)) / sigma,
                current_A=amps,
                soc=simulated.soc[rows, variant, j],
                temp_C=stack.temp_C[rows, j],
                rest=~loaded,
            )
        )
    return out


def size_V(records: list[Residual]) -> float:
    """Return the size of the voltage residual over all records [V]."""
    return float(np.sqrt(np.nanmean([r.voltage_rmse_V**2 for r in records])))


def size_K(records: list[Residual]) -> float:
    """Return the size of the temperature residual over all records [K]; NaN when none was measured."""
    sizes = np.array([r.temp_rmse_K for r in records])
    return float(np.sqrt(np.nanmean(sizes**2))) if np.isfinite(sizes).any() else float("nan")


@dataclass(frozen=True, slots=True)
class Shape:
    """Shape names the `variable` a residual goes with, its `share` of the mean square, and how long it lasts [s]."""

    variable: str
    share: float
    time_scale_s: float


def shape(records: list[Residual]) -> Shape:
    """Find the variable whose thirds explain most of the voltage residual, and its correlation time [s]."""
    error = np.concatenate([(r.voltage_V * r.flatness)[~r.rest] for r in records])
    since = np.concatenate([(r.time_s - r.time_s[0])[~r.rest] for r in records])
    columns = {
        "current": np.concatenate([r.current_A[~r.rest] for r in records]),
        "state of charge": np.concatenate([r.soc[~r.rest] for r in records]),
        "temperature": np.concatenate([r.temp_C[~r.rest] for r in records]),
        "time since take-off": since,
    }
    shares = {name: _explained_share(error, by) for name, by in columns.items() if np.isfinite(by).all()}
    best = max(shares, key=lambda k: shares[k])
    return Shape(best, shares[best], float(np.median([_lasting(r) for r in records])))


def _explained_share(error: Array, by: Array) -> float:
    """Return the share of the mean square that the means of PARTS equal groups explain."""
    group = np.searchsorted(np.quantile(by, np.arange(1, PARTS) / PARTS), by)
    means = np.array([error[group == g].mean() if (group == g).any() else 0.0 for g in range(PARTS)])
    return float(np.mean(means[group] ** 2) / max(float(np.mean(error**2)), 1e-12))


def _lasting(record: Residual) -> float:
    error = (record.voltage_V * record.flatness)[~record.rest]
    if error.size < 4:
        return 0.0
    power = np.abs(np.fft.rfft(error - error.mean(), 2 * error.size)) ** 2
    correlation = np.fft.irfft(power)[: error.size]
    below = np.flatnonzero(correlation < correlation[1] / np.e)
    return float((below[0] if below.size else error.size) * np.median(np.diff(record.time_s)))
