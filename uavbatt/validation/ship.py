"""The battery file that ships if the gate's verdict is pass: the model fitted to all runs, with its certificate."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uavbatt.battery.battery_file import (
    Battery,
    BatteryFile,
    Certificate,
    CorridorSection,
    Discrepancy,
    EffectEntry,
    ParameterTable,
    Verdict,
)
from uavbatt.battery.sizing.remarks import ends_as_lithium_ion
from uavbatt.dataset import DataSet
from uavbatt.fitting import assemble, observed, prior, solve, unmetered
from uavbatt.fitting.assemble import rounded
from uavbatt.fitting.battery import MAKE_CAPACITY_SD, MAKE_RESISTANCE_SD
from uavbatt.fitting.wander import USUAL_TIME_S
from uavbatt.validation.gating.gate import Claim, Limits, judged_instants
from uavbatt.validation.gating.heldout import HeldOut, mean_test
from uavbatt.validation.judging.corridor import Corridor

UNMEASURED_RMSE_K = 2.0  # assumed of a model whose temperature nobody has measured


class ShippedModel(NamedTuple):
    """ShippedModel holds the model fitted to all runs, the capacity [Ah] that it is for, and statistics of the fit."""

    parameters: ParameterTable
    effects: list[EffectEntry]
    capacity_Ah: float | None
    statistics: dict[str, float]


def battery_file(
    dataset: DataSet,
    held_out: HeldOut,
    corridor: Corridor,
    claims: list[Claim],
    limits: Limits,
    statistics: dict[str, float],
) -> BatteryFile:
    """Build the battery file of a data set whose model passed; its certificate is not sealed yet.

    `claims`, judged by `limits`, go into the certificate, with `statistics` (names with their units) and the
    `corridor` of the voltage.
    """
    fitted = _metered(dataset) if dataset.is_metered else _unmetered(dataset, held_out.ambient_C)
    cells = dataset.cells_series
    kind = prior.LITHIUM_ION if ends_as_lithium_ion(cells, dataset.cutoff_V) else prior.LIPO
    return BatteryFile(
        battery=Battery(
            name=dataset.name,
            chemistry=dataset.chemistry,
            cells_series=cells,
            capacity_Ah=fitted.capacity_Ah,
            cutoff_V=dataset.cutoff_V,
            low_V=rounded(kind.low_V * cells),
            source=dataset.source,
            remarks=_remarks(fitted.capacity_Ah, claims),
        ),
        parameters=fitted.parameters,
        effects=fitted.effects,
        discrepancy=_held_out_discrepancy(held_out, dataset, limits),
        corridor=_entry(corridor),
        certificate=Certificate(
            status="certified",
            validated_ambient_C=[held_out.ambient_C],
            verdicts=[_verdict(c) for c in claims if not _beside(c)],
            statistics={k: rounded(v) for k, v in {**statistics, **fitted.statistics}.items() if math.isfinite(v)},
            data_sha256=dataset.sha256,
        ),
    )


def _beside(claim: Claim) -> bool:
    """Return True for a failed claim that does not gate: the certificate does not cover it."""
    return claim.verdict == "fail" and not claim.gates


def _remarks(capacity_Ah: float | None, claims: list[Claim]) -> list[str]:
    """Return remarks for the user, with the failed claims: among the verdicts these would forbid the whole file."""
    unknown = [] if capacity_Ah else ["capacity unknown: parameters are per ampere-hour; give --capacity-ah"]
    beside = [c for c in claims if _beside(c)]
    failed = []
    for name in dict.fromkeys(c.claim for c in beside):
        worst = max((c for c in beside if c.claim == name), key=lambda c: float(np.max(np.abs(c.bias), initial=0.0)))
        ambients = ", ".join(f"{c.ambient_C:+g}" for c in beside if c.claim == name)
        failed.append(
            f"not vouched for: {name} failed at {ambients} °C; worst at {worst.ambient_C:+g} °C: {worst.reason}"
        )
    return [*unknown, *failed]


def _unmetered(dataset: DataSet, ambient_C: float) -> ShippedModel:
    home = dataset.at(ambient_C)
    runs = [r for r in home if sum(q.sample == r.sample for q in home) > 1]
    test = mean_test(dataset, runs, ambient_C)
    fit, load = unmetered.fit_unmetered(test), unmetered.rate_slot(test)
    error = fit.standard_errors
    # With an unmetered load, ohm·Ah and capacity are as uncertain as the C-rate: by the prior, 1.5 of 8 C for the
    # study. The time of the knee shows the charge, which halves the uncertainty of the capacity.
    unknown_rate = load.sd / load.prior
    names = [s.name for s in fit.slots]
    i, j = names.index("c_rate"), names.index("r0_ohmAh")
    c = fit.covariance_u
    table = assemble.parameter_table(
        fit.slots,
        fit.x,
        error,
        resistance_scale_sd=math.hypot(MAKE_RESISTANCE_SD, unknown_rate),
        capacity_scale_sd=math.hypot(MAKE_CAPACITY_SD, unknown_rate / 2.0),
        c_rate=fit.value("c_rate"),
        c_rate_sd=load.sd,
    )
    entries = assemble.effect_entries(fit.slots, fit.x, error, fit.effects)
    extra = {"correlation_c_rate_resistance": float(c[i, j] / np.sqrt(c[i, i] * c[j, j]))}
    return ShippedModel(table, entries, dataset.capacity_Ah, extra)


def _metered(dataset: DataSet) -> ShippedModel:
    fit = solve.fit_cell(observed.stack(observed.from_dataset(dataset)))
    error = fit.standard_errors
    table = assemble.parameter_table(fit.slots, fit.x, error, MAKE_RESISTANCE_SD, MAKE_CAPACITY_SD)
    entries = assemble.effect_entries(fit.slots, fit.x, error, prior.BASE_EFFECTS)
    return ShippedModel(table, entries, dataset.capacity_Ah, {})


def _held_out_discrepancy(held_out: HeldOut, dataset: DataSet, limits: Limits) -> Discrepancy:
    """Return the discrepancy of the model on held-out occasions.

    Readings a minute apart are too coarse to measure its autocorrelation, so that the usual time is taken.
    """
    gap_V = (held_out.model_V - held_out.measured_V)[:, :, judged_instants(held_out, limits, dataset.cutoff_V)]
    with np.errstate(invalid="ignore"):
        gap_K = (
            None if held_out.model_C is None or held_out.measured_C is None else held_out.model_C - held_out.measured_C
        )
    return Discrepancy(
        voltage_bias_V=rounded(float(np.nanmean(gap_V))),
        voltage_rmse_V=rounded(float(np.sqrt(np.nanmean(gap_V**2)))),
        voltage_autocorrelation_s=USUAL_TIME_S,
        temperature_rmse_K=rounded(float(np.sqrt(np.nanmean(gap_K**2))) if gap_K is not None else UNMEASURED_RMSE_K),
        held_out=True,
        source=f"{held_out.measured_V.shape[0]} occasions at {held_out.ambient_C:g} °C, each left out in turn",
    )


def _entry(corridor: Corridor) -> CorridorSection:
    return CorridorSection(
        ambient_C=corridor.ambient_C,
        time_s=[rounded(t) for t in corridor.at],
        mean_V=[rounded(v) for v in corridor.mean],
        limit_V=[rounded(v) for v in corridor.C],
        runs=corridor.occasions * corridor.samples,
        occasions=corridor.occasions,
    )


def _verdict(claim: Claim) -> Verdict:
    numbers = {
        "limit": claim.limit,
        "largest_bias": float(np.max(np.abs(claim.bias))) if claim.bias.size else math.nan,
        "largest_half_width": float(np.max(claim.half_width)) if claim.half_width.size else math.nan,
    }
    return Verdict(
        claim=claim.claim,
        verdict=claim.verdict,
        ambient_C=claim.ambient_C,
        statistics={k: rounded(v) for k, v in {**numbers, **claim.statistics}.items() if math.isfinite(v)},
        reason=claim.reason,
    )
