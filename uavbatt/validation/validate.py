"""The whole ISO 5725 stage on one data set: judge the tests, build the corridor, gate the model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from uavbatt.battery.file import BatteryFile
from uavbatt.dataset import DataSet, Levels, whole_minutes
from uavbatt.errors import NotEnoughData
from uavbatt.validation import gate, heldout, ship
from uavbatt.validation.corridor import Corridor, corridor, corridors
from uavbatt.validation.findings import Finding, findings
from uavbatt.validation.gate import Claim, Limits, Verdict
from uavbatt.validation.heldout import HeldOut
from uavbatt.validation.iso5725 import Precision, precision

LEAST_SAMPLES = 3


@dataclass(frozen=True, slots=True)
class LevelPrecision:
    """Precision of one quantity at one instant."""

    quantity: str
    time_s: float
    precision: Precision


@dataclass(frozen=True, slots=True)
class Validation:
    """Everything the stage found; `battery` is None unless the verdict is pass."""

    dataset: DataSet
    ambient_C: float
    limits: Limits
    findings: tuple[Finding, ...]
    precision: tuple[LevelPrecision, ...]
    corridors: dict[float, Corridor]
    held: HeldOut
    claims: tuple[Claim, ...]
    verdict: Verdict
    battery: BatteryFile | None


def validate(
    dataset: DataSet, limits: Limits | None = None, progress: Callable[[int], None] | None = None
) -> Validation:
    """Judge, fit with one occasion left out at a time, gate. Raises NotEnoughData without repeated runs."""
    ambient_C = heldout.repeated_ambient(dataset)
    declared = (limits or Limits()).for_cells(dataset.cells_series)
    levels = whole_minutes(dataset, ambient_C)
    found = corridor(dataset, ambient_C)
    if levels is None or found is None or len(levels.occasions) < gate.LEAST_OCCASIONS:
        n = 0 if levels is None else len(levels.occasions)
        raise NotEnoughData(
            f"{dataset.path}: {n} occasion(s) at {ambient_C:g} °C: expected at least {gate.LEAST_OCCASIONS} repeated "
            "runs at one ambient temperature to judge dispersion"
        )
    held = heldout.circuit(dataset, progress)
    claims = _claims(dataset, held, found, declared, levels)
    verdict = gate.overall(claims)
    table = _precision_table(dataset, ambient_C)
    statistics = _statistics(held, table)
    return Validation(
        dataset=dataset,
        ambient_C=ambient_C,
        limits=declared,
        findings=findings(dataset),
        precision=table,
        corridors=corridors(dataset),
        held=held,
        claims=tuple(claims),
        verdict=verdict,
        battery=ship.battery_file(dataset, held, found, claims, statistics) if verdict == "pass" else None,
    )


def _claims(dataset: DataSet, held: HeldOut, found: Corridor, limits: Limits, levels: Levels) -> list[Claim]:
    known = dataset.uncertainty
    claims = [
        gate.voltage_claim(held, limits, dataset.cutoff_V, known),
        gate.corridor_claim(held, found.mean, found.C, limits, dataset.cutoff_V),
        gate.crossing_claim(held, limits, known),
    ]
    surface = gate.surface_claim(held, limits, known)
    if surface is not None:
        claims.append(surface)
    claims.append(_reproducibility_claim(held.ambient_C, levels))
    singles = [t for t in dataset.ambients_C if t != held.ambient_C]
    claims.extend(
        _informing(t, "voltage bias at this temperature", "one run: nothing tells its dispersion") for t in singles
    )
    return claims


def _reproducibility_claim(ambient_C: float, levels: Levels) -> Claim:
    """Between samples: with fewer than three nothing can be said; with more it is still for issue-of-precision."""
    count = len(levels.samples)
    if count < LEAST_SAMPLES:
        return _informing(
            ambient_C, "reproducibility", f"{count} samples, and they are not independent of each other: at least 3"
            if count == 2 else f"{count} sample(s), at least {LEAST_SAMPLES} are needed",
        )  # fmt: skip
    return _informing(ambient_C, "reproducibility", f"{count} samples of one make in one laboratory")


def _informing(ambient_C: float, claim: str, reason: str) -> Claim:
    nothing = np.empty(0)
    return Claim(claim, ambient_C, "not enough data", reason, False, nothing, nothing, nothing, nothing, np.nan, "")


def _precision_table(dataset: DataSet, ambient_C: float) -> tuple[LevelPrecision, ...]:
    table = []
    for quantity in ("voltage_V", "surface_C"):
        levels = whole_minutes(dataset, ambient_C, quantity)
        if levels is None:
            continue
        table.extend(
            LevelPrecision(quantity, float(t), precision(levels.cells(i))) for i, t in enumerate(levels.time_s)
        )
    return tuple(table)


def _statistics(held: HeldOut, table: tuple[LevelPrecision, ...]) -> dict[str, float]:
    """The figures that the certificate carries."""
    volts = [row.precision for row in table if row.quantity == "voltage_V"]
    residual = held.residual_V()
    return {
        "occasions": float(residual.shape[0]),
        "held_out_rmse_V": float(np.sqrt(np.nanmean(residual**2))),
        "largest_s_r_V": max(p.s_r for p in volts),
        "largest_s_R_V": max(p.s_R for p in volts),
    }
