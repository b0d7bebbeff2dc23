"""The whole ISO 5725 stage on one data set: judge the tests, build the corridor, gate the models.

Two models are gated on the same held-out occasions: the circuit model, which ships, and the regression model, its
rival. Fast records are read at the whole minutes first (`Readings`), for the statistics as for the models.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.dataset import DataSet, Levels
from uavbatt.errors import NotEnoughData
from uavbatt.validation import ship
from uavbatt.validation.gating import gate, heldout, regression, temperatures
from uavbatt.validation.gating.ambient_claims import ambient_claims
from uavbatt.validation.gating.gate import Claim, Limits, Method, Verdict
from uavbatt.validation.gating.heldout import HeldOut
from uavbatt.validation.gating.precision_claims import repeatability_claim, reproducibility_claim
from uavbatt.validation.gating.temperatures import TemperatureLoop
from uavbatt.validation.iso5725 import Precision, precision
from uavbatt.validation.iso5725.outliers import Mandel, mandel
from uavbatt.validation.judging.corridor import LEAST_OCCASIONS, Corridor, corridors
from uavbatt.validation.judging.drift import Drift, drift
from uavbatt.validation.judging.finding import Finding
from uavbatt.validation.judging.findings import findings
from uavbatt.validation.judging.readings import SURFACE, VOLTAGE, Readings, read_once

LEAST_DRIFT_RUNS = 4  # as many as the tests of `drift` need


@dataclass(frozen=True, slots=True)
class LevelPrecision:
    """LevelPrecision holds the precision of a quantity at an instant, with Mandel's h and k (None if undefined)."""

    quantity: str
    time_s: float
    precision: Precision
    consistency: Mandel | None = None


@dataclass(frozen=True, slots=True)
class LevelDrift:
    """LevelDrift holds the drift tests of one quantity over the runs of one sample at one instant."""

    quantity: str
    sample: str
    time_s: float
    drift: Drift


@dataclass(frozen=True, slots=True)
class Validation:
    """Validation holds everything the stage found; `battery` is None unless the verdict is pass.

    `rivals` are other models, held out alike, with their claims in `rival_claims`; they do not ship. `held` and
    `claims` are those of the circuit model. `temperatures` closes the loop over one-time tests, None without them.
    """

    readings: Readings
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

    @property
    def dataset(self) -> DataSet:
        """Return the tests as they were recorded."""
        return self.readings.dataset

    @property
    def ambient_C(self) -> float:
        """Return the ambient temperature that was gated [°C]: the one with the most runs."""
        return self.readings.ambient_C


def validate(
    dataset: DataSet,
    limits: Limits | None = None,
    progress: Callable[[float], None] | None = None,
    method: Method = "iso",
    close_loop: bool = True,
) -> Validation:
    """Judge the tests, fit with one occasion left out at a time, and gate the model.

    dataset : repeated discharge tests, runs of one occasion under one run number
    limits : declared limits for a 3S pack, scaled to the cells of the data set
    progress : called with the share of the work that was just done; the shares add up to 1
    method : "iso" lets equivalence decide, "paper" the study's corridor; both are reported
    close_loop : False leaves out the analysis over ambient temperatures, which takes most of the time

    Raises NotEnoughData below three occasions at one ambient temperature, and for tests that begin at the cut-off.
    """
    readings = read_once(dataset)
    declared = (limits or Limits()).for_cells(dataset.cells_series)
    levels = _judged_repeats(readings, declared)
    volts = corridors(readings)
    band = volts[readings.ambient_C]
    test_findings = findings(readings, readings.ambient_C, band)
    count_fits = _shares(progress, len(levels.occasions) + (temperatures.fits(readings) if close_loop else 0.0))
    held_out = heldout.circuit(readings, count_fits)
    rival = regression.held_out(readings)
    claims = _claims(readings, held_out, band, declared, levels, test_findings, method)
    verdict = gate.overall(claims)
    table = _precision_table(readings)
    passed = verdict == "pass"
    return Validation(
        readings=readings,
        limits=declared,
        findings=test_findings,
        precision=table,
        corridors=volts,
        held=held_out,
        claims=tuple(claims),
        verdict=verdict,
        battery=ship.battery_file(dataset, held_out, band, claims, declared, _statistics(held_out, table))
        if passed
        else None,
        rivals=(rival,),
        rival_claims=(tuple(model_claims(readings, rival, band, declared, method)),),
        drifts=_drifts(readings),
        surface_corridors=corridors(readings, SURFACE),
        temperatures=temperatures.close_loop(readings, limits or Limits(), count_fits) if close_loop else None,
        method=method,
    )


def _judged_repeats(readings: Readings, limits: Limits) -> Levels:
    """Return the repeated runs that are gated. Raises NotEnoughData if too few, or if none is above the limiter."""
    dataset, ambient_C = readings.dataset, readings.ambient_C
    levels = readings.levels(ambient_C)
    if levels is None or len(levels.occasions) < LEAST_OCCASIONS:
        n = 0 if levels is None else len(levels.occasions)
        raise NotEnoughData(
            f"{dataset.path}: {n} occasion(s) at {ambient_C:g} °C: expected at least {LEAST_OCCASIONS} repeated "
            "runs at one ambient temperature to judge dispersion"
        )
    if not gate.before_limiter(np.nanmean(levels.values, axis=(0, 1)), limits, dataset.cutoff_V).size:
        raise NotEnoughData(
            f"{dataset.path}: expected instants at {ambient_C:g} °C at which the mean voltage is more than "
            f"{limits.limiter_margin_V:.2g} V above the cut-off of {dataset.cutoff_V:g} V, found none"
        )
    return levels


def _shares(progress: Callable[[float], None] | None, fits: float) -> Callable[[float], None]:
    """Turn counts of fits into shares of all `fits`; the regression is left out, as it is fast."""
    return (lambda _: None) if progress is None else (lambda count: progress(count / fits))


def model_claims(
    readings: Readings, held_out: HeldOut, band: Corridor, limits: Limits, method: Method = "iso"
) -> list[Claim]:
    """List the claims about a model: voltage, corridor, times, surface and other temperatures.

    `held_out` are its predictions of held-out runs, `band` the corridor of the voltage at the same ambient temperature.
    """
    cutoff_V, decides = readings.dataset.cutoff_V, method == "paper"
    equivalences = gate.equivalence_claims(held_out, limits, cutoff_V, readings.dataset.uncertainty)
    claims = [replace(c, gates=c.gates and not decides) for c in equivalences]
    claims.insert(1, gate.corridor_claim(held_out, band.mean, band.C, limits, cutoff_V, gates=decides))
    return [*claims, *ambient_claims(readings, held_out, limits)]


def _claims(
    readings: Readings,
    held_out: HeldOut,
    band: Corridor,
    limits: Limits,
    levels: Levels,
    test_findings: tuple[Finding, ...],
    method: Method,
) -> list[Claim]:
    """List the circuit model's claims, those about the tests before those at single temperatures."""
    dataset, claims = readings.dataset, model_claims(readings, held_out, band, limits, method)
    home = [c for c in claims if c.ambient_C == held_out.ambient_C]
    about_tests = [
        replace(repeatability_claim(levels, limits, test_findings, dataset.uncertainty), gates=method == "iso"),
        reproducibility_claim(held_out, levels, limits, dataset.cutoff_V, dataset.uncertainty),
    ]
    return [*home, *about_tests, *(c for c in claims if c.ambient_C != held_out.ambient_C)]


def _precision_table(readings: Readings) -> tuple[LevelPrecision, ...]:
    table = []
    for quantity in (VOLTAGE, SURFACE):
        levels = readings.levels(readings.ambient_C, quantity)
        if levels is None:
            continue
        for i, t in enumerate(levels.time_s):
            cells = levels.cells(i)
            consistency = mandel(cells) if len(cells) >= 3 and min(len(c) for c in cells) > 1 else None
            table.append(LevelPrecision(quantity, float(t), precision(cells), consistency))
    return tuple(table)


def _drifts(readings: Readings) -> tuple[LevelDrift, ...]:
    out = []
    for quantity in (VOLTAGE, SURFACE):
        levels = readings.levels(readings.ambient_C, quantity)
        if levels is None:
            continue
        for j, sample in enumerate(levels.samples):
            table = levels.curves(j)
            columns = zip(levels.time_s, table.T, strict=True) if len(table) >= LEAST_DRIFT_RUNS else ()
            out += [LevelDrift(quantity, sample, float(t), drift(column)) for t, column in columns]
    return tuple(out)


def _statistics(held_out: HeldOut, table: tuple[LevelPrecision, ...]) -> dict[str, float]:
    """Return the figures that the certificate carries, by name with unit."""
    volts = [row.precision for row in table if row.quantity == "voltage_V"]
    residual = held_out.residual_V()
    return {
        "occasions": float(residual.shape[0]),
        "held_out_rmse_V": float(np.sqrt(np.nanmean(residual**2))),
        "largest_s_r_V": max(p.s_r for p in volts),
        "largest_s_R_V": max(p.s_R for p in volts),
    }
