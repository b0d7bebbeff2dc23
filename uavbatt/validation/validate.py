"""The whole ISO 5725 stage on one data set: judge the tests, build the corridor, gate the models.

Two models are gated on the same held-out occasions: the circuit model, which ships, and the regression model, its
rival. Fast records are read at the whole minutes first (`reading`), for the statistics as for the models.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.dataset import DataSet, Levels, whole_minutes
from uavbatt.errors import NotEnoughData
from uavbatt.validation import gate, heldout, reading, regression, ship, temperatures
from uavbatt.validation.ambient_claims import ambient_claims
from uavbatt.validation.corridor import Corridor, corridor, corridors
from uavbatt.validation.drift import Drift, drift
from uavbatt.validation.findings import Finding, findings
from uavbatt.validation.gate import Claim, Limits, Method, Verdict
from uavbatt.validation.heldout import HeldOut
from uavbatt.validation.iso5725 import Precision, precision
from uavbatt.validation.outliers import Mandel, mandel
from uavbatt.validation.precision_claims import repeatability_claim, reproducibility_claim
from uavbatt.validation.temperatures import TemperatureLoop

LEAST_DRIFT_RUNS = 4


@dataclass(frozen=True, slots=True)
class LevelPrecision:
    """Precision of one quantity at one instant; Mandel's h and k of the samples, None where undefined."""

    quantity: str
    time_s: float
    precision: Precision
    consistency: Mandel | None = None


@dataclass(frozen=True, slots=True)
class LevelDrift:
    """Drift over the runs of one sample at one instant."""

    quantity: str
    sample: str
    time_s: float
    drift: Drift


@dataclass(frozen=True, slots=True)
class Validation:
    """Everything the stage found; `battery` is None unless the verdict is pass.

    `rivals` are other models, held out alike, with their claims in `rival_claims`; they do not ship. `held` and
    `claims` are those of the circuit model. `temperatures` closes the loop over one-time tests, None without them.
    """

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
    rivals: tuple[HeldOut, ...] = ()
    rival_claims: tuple[tuple[Claim, ...], ...] = ()
    drifts: tuple[LevelDrift, ...] = ()
    surface_corridors: dict[float, Corridor] = field(default_factory=dict)
    temperatures: TemperatureLoop | None = None
    method: Method = "iso"


def validate(
    dataset: DataSet,
    limits: Limits | None = None,
    progress: Callable[[int], None] | None = None,
    method: Method = "iso",
    close_loop: bool = True,
) -> Validation:
    """Judge, fit with one occasion left out at a time, gate. Raises NotEnoughData without repeated runs.

    `method` says which claims decide: equivalence (`iso`) or the study's corridor (`paper`); both are reported.
    `close_loop` off leaves out the analysis over ambient temperatures.
    """
    tests = reading.at_minutes(dataset)
    ambient_C = heldout.repeated_ambient(dataset)
    declared = (limits or Limits()).for_cells(dataset.cells_series)
    levels, found = whole_minutes(tests, ambient_C), corridor(tests, ambient_C)
    if levels is None or found is None or len(levels.occasions) < gate.LEAST_OCCASIONS:
        n = 0 if levels is None else len(levels.occasions)
        raise NotEnoughData(
            f"{dataset.path}: {n} occasion(s) at {ambient_C:g} °C: expected at least {gate.LEAST_OCCASIONS} repeated "
            "runs at one ambient temperature to judge dispersion"
        )
    said = findings(tests, ambient_C)
    held = heldout.circuit(dataset, progress)
    rival = regression.held_out(dataset)
    claims = _claims(dataset, held, found, declared, levels, said, method)
    verdict = gate.overall(claims)
    table = _precision_table(tests, ambient_C)
    passed = verdict == "pass"
    return Validation(
        dataset=dataset,
        ambient_C=ambient_C,
        limits=declared,
        findings=said,
        precision=table,
        corridors=corridors(tests),
        held=held,
        claims=tuple(claims),
        verdict=verdict,
        battery=ship.battery_file(dataset, held, found, claims, _statistics(held, table)) if passed else None,
        rivals=(rival,),
        rival_claims=(tuple(model_claims(dataset, rival, found, declared, method)),),
        drifts=_drifts(tests, ambient_C),
        surface_corridors=corridors(tests, "surface_C"),
        temperatures=temperatures.close_loop(dataset, limits or Limits()) if close_loop else None,
        method=method,
    )


def model_claims(
    dataset: DataSet, held: HeldOut, found: Corridor, limits: Limits, method: Method = "iso"
) -> list[Claim]:
    """The claims that a model can be judged by: voltage, corridor, times, surface temperature, other temperatures."""
    known, cutoff_V = dataset.uncertainty, dataset.cutoff_V
    equivalences = [
        gate.voltage_claim(held, limits, cutoff_V, known),
        gate.crossing_claim(held, limits, known),
        gate.knee_claim(held, limits, cutoff_V, known),
    ]
    decides = method == "paper"
    claims = [gate.gating(c, not decides) for c in equivalences]
    claims.insert(1, gate.corridor_claim(held, found.mean, found.C, limits, cutoff_V, gates=decides))
    surface = gate.surface_claim(held, limits, known)
    return [*claims, *([] if surface is None else [surface]), *ambient_claims(dataset, held, limits)]


def _claims(
    dataset: DataSet,
    held: HeldOut,
    found: Corridor,
    limits: Limits,
    levels: Levels,
    said: tuple[Finding, ...],
    method: Method,
) -> list[Claim]:
    """The circuit model's claims, with those about the tests before the single temperatures."""
    claims = model_claims(dataset, held, found, limits, method)
    home = [c for c in claims if c.ambient_C == held.ambient_C]
    about_tests = [
        gate.gating(repeatability_claim(levels, limits, said), method == "iso"),
        reproducibility_claim(held, levels, limits, dataset.cutoff_V, dataset.uncertainty),
    ]
    return [*home, *about_tests, *(c for c in claims if c.ambient_C != held.ambient_C)]


def _precision_table(tests: DataSet, ambient_C: float) -> tuple[LevelPrecision, ...]:
    table = []
    for quantity in ("voltage_V", "surface_C"):
        levels = whole_minutes(tests, ambient_C, quantity)
        if levels is None:
            continue
        for i, t in enumerate(levels.time_s):
            cells = levels.cells(i)
            consistency = mandel(cells) if len(cells) >= 3 and min(len(c) for c in cells) > 1 else None
            table.append(LevelPrecision(quantity, float(t), precision(cells), consistency))
    return tuple(table)


def _drifts(tests: DataSet, ambient_C: float) -> tuple[LevelDrift, ...]:
    out = []
    for quantity in ("voltage_V", "surface_C"):
        levels = whole_minutes(tests, ambient_C, quantity)
        if levels is None:
            continue
        for j, sample in enumerate(levels.samples):
            table = levels.curves(j)
            columns = zip(levels.time_s, table.T, strict=True) if len(table) >= LEAST_DRIFT_RUNS else ()
            out += [LevelDrift(quantity, sample, float(t), drift(column)) for t, column in columns]
    return tuple(out)


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
