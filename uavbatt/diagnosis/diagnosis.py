"""From records and a battery file to a verdict: is an effect missing, which, how large, how sure.

Everything is decided in one unit: the chi-square of left-out records against the whitened error of the battery's own
model, with allowance for errors that the file states (`worth`). The start of charge is settled first; then single
effects and pairs are searched. The result is doubted if it leaves more than the file's own model does, also with every
error of the file at its most probable value. Then, or if a value differs between records or drifts within them, the
verdict is `undeclared_effect` and the effect is a suspect: it enters the model only if it is the same throughout.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from uavbatt.battery import openloop
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.model import SOC_GRID, open_circuit_voltage
from uavbatt.battery.scaling import Pack
from uavbatt.diagnosis.classes import NEVER_SURE, EffectClass, HiddenSize, class_of, hidden_sizes, start_class
from uavbatt.diagnosis.refit import residual
from uavbatt.diagnosis.refit.batch import at_best
from uavbatt.diagnosis.refit.candidates import NOTHING, Candidate, base_values, candidates, nuisances
from uavbatt.diagnosis.refit.evidence import IDLE_NOISE_A, idle_A, prepare
from uavbatt.diagnosis.refit.misfit import (
    FAR,
    LEFT,
    USUAL,
    MisfitPerNumber,
    explains,
    floor_V,
    left_per_number,
    times_expected,
)
from uavbatt.diagnosis.refit.problem import Problem, Refit, TableErrors
from uavbatt.diagnosis.refit.residual import Residual, Shape
from uavbatt.diagnosis.refit.solver import SETTLED, refit
from uavbatt.diagnosis.search import drift, slow_sensor
from uavbatt.diagnosis.search.blocks import EvidenceBlock, evidence_by_block
from uavbatt.diagnosis.search.effects import SUSPECT, FoundEffect, search, small
from uavbatt.diagnosis.search.trial import Trial
from uavbatt.engine import PLAIN, Engine
from uavbatt.fitting.observed import ObservedRecord

Verdict = Literal["no_missing_effect", "effect_found", "undeclared_effect"]
RESISTANCE_KNOT_SD, OCV_KNOT_SD_V = 0.03, 0.01
# Of the error that a fit states of its polarisation; a fit counts rows of a minute as one. Unstated: as for good fits.
INSTANT_SHARE, INSTANT_SD = 1.0 / 3.0, 0.05


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """A diagnosis tells what was found, with the model before and after."""

    verdict: Verdict
    classes: tuple[EffectClass, ...]  # what was found; if nothing, the small effect that may hide
    reasons: tuple[str, ...]
    problem: Problem
    before: Refit
    after: Refit
    residual_before: list[Residual]
    residual_after: list[Residual]
    floor_V: float
    left: Shape
    findings: tuple[FoundEffect, ...] = ()
    blocks: tuple[EvidenceBlock, ...] = ()  # where in the records the evidence lies
    # The largest size of each effect that could be present unseen; filled if none was found.
    hidden: tuple[HiddenSize, ...] = ()

    @property
    def may_hide(self) -> bool:
        """Return True if no effect was found: then the class is the small effect that may be present unseen."""
        return self.verdict == "no_missing_effect" and bool(self.classes)

    @property
    def guess_below_soc(self) -> float | None:
        """Return the charge below which the file's OCV is a guess, if these records go there; else None."""
        tables = self.problem.tables
        lowest = min(float(np.min(r.soc)) for r in self.residual_after)
        return tables.seen_from_soc if tables is not None and lowest < tables.seen_from_soc else None


def problem_of(
    records: list[ObservedRecord],
    file: BatteryFile,
    pack: Pack,
    states: openloop.States = openloop.states,
    wear_sd: tuple[float, float] = (0.0, 0.0),
) -> Problem:
    """Make records and battery file ready for refits; `states` simulates. Raises NotEnoughData with the reason."""
    ocv_V = np.maximum.accumulate(open_circuit_voltage(pack.cell, SOC_GRID) + 1e-6 * SOC_GRID)
    evidence = prepare(records, file, (SOC_GRID, ocv_V), float(np.mean(pack.cell.polarisation_tau_s)))
    base = base_values(pack.cell, pack.installation)
    believed, declared = nuisances(file, wear_sd), nuisances(file, wear_sd, least_activation_sd_K=0.0)
    return Problem(pack, evidence, base, believed, declared, table_errors(file), states)


def table_errors(file: BatteryFile) -> TableErrors:
    """Return the standard errors of the file's tables: as stated, else what a fit usually leaves."""
    table = file.parameters
    ocv_sd = [table.standard_error.get(f"ocv_{z:g}", OCV_KNOT_SD_V) for z in table.ocv_soc]
    knots = np.array(table.resistance_soc)
    return TableErrors(
        np.array(table.ocv_soc), np.array(ocv_sd), knots, np.full(knots.size, RESISTANCE_KNOT_SD), instant_sd(file)
    )


def instant_sd(file: BatteryFile) -> float:
    """Return the share of R0 that may be polarisation in truth, or the reverse, one sd.

    Rows that come slowly, or a load that hardly changes, show only the sum of the two.
    """
    stated = [entry.standard_error.get("polarisation_ratio") for entry in file.effects if entry.name == "polarisation"]
    return next((INSTANT_SHARE * sd for sd in stated if sd is not None), INSTANT_SD)


def diagnose(
    records: list[ObservedRecord],
    file: BatteryFile,
    pack: Pack,
    without: tuple[str, ...] = (),
    progress: Callable[[str], None] | None = None,
    engine: Engine = PLAIN,
    wear_sd: tuple[float, float] = (0.0, 0.0),
) -> Diagnosis:
    """Diagnose records of one pack.

    without : effects that are no candidates; progress : is called with the name of each step
    engine : simulates many columns (`compiled.engine()` takes two thirds of the time)
    wear_sd : sd of the fade and of the growth of `pack`, if the ledger knows the pack

    Raises NotEnoughData with the reason.
    """
    tell = progress or (lambda _: None)
    tell("open-loop simulation")
    problem = problem_of(records, file, pack, engine.states, wear_sd)
    searched = _search(problem, file, without, tell)
    tell("residual")
    return _concluded(searched, file, without)


class _SearchResult(NamedTuple):
    """_SearchResult holds the refit without a new effect, the best refit, and the effects that it has."""

    problem: Problem
    unchanged: Refit
    best: Refit
    findings: list[FoundEffect]
    singles: Trial


def _concluded(searched: _SearchResult, file: BatteryFile, without: tuple[str, ...]) -> Diagnosis:
    """Return the diagnosis of a finished search."""
    problem, unchanged, best, findings, singles = searched
    misfit = left_per_number(problem, best)
    reasons = doubts(problem, file, findings, best, misfit)
    probability = candidate_probability(misfit, reasons)
    classes = _classes(searched, probability, without)
    verdict: Verdict = "undeclared_effect" if reasons else "effect_found" if classes else "no_missing_effect"
    may_hide = small(problem, singles) if verdict == "no_missing_effect" else None
    if may_hide is not None:
        classes = (class_of(problem, may_hide, probability),)
    if not all(f.steady for f in findings):  # a value that differs between records is a suspect, not for a battery file
        best = unchanged
    after = residual.residuals(problem.evidence, at_best(problem, best))
    return Diagnosis(
        verdict=verdict,
        classes=classes,
        reasons=reasons,
        problem=problem,
        before=unchanged,
        after=best,
        residual_before=residual.residuals(problem.evidence, at_best(problem, unchanged)),
        residual_after=after,
        floor_V=floor_V(file, problem),
        left=residual.shape(after),
        findings=tuple(findings),
        blocks=evidence_by_block(problem, unchanged, best) if best is not unchanged else (),
        hidden=hidden_sizes(singles) if not findings else (),
    )


def _classes(searched: _SearchResult, probability: float, without: tuple[str, ...]) -> tuple[EffectClass, ...]:
    """Return the classes of the effects that were found, before them the charge at the start if it was below full."""
    problem, found = searched.problem, searched.findings
    classes = tuple(class_of(problem, finding, probability) for finding in found)
    if not problem.evidence.charged_in_part.any() or "initial_charge" in without:
        return classes
    return (start_class(problem, searched.unchanged), *classes)


def options_of(problem: Problem, file: BatteryFile, without: tuple[str, ...]) -> list[Candidate]:
    """Return the effects that these records could show, less those that are left out."""
    alone = ("weak_cell",) if problem.pack.installation.cells == 1 else ()
    slow = () if problem.evidence.shows_delay else ("current_delay",)
    return candidates(
        file,
        problem.base,
        has_temperature=problem.evidence.has_temperature,
        idle_A=idle_A(problem.evidence) + IDLE_NOISE_A,
        without=(*without, *alone, *slow),
    )


def _search(
    problem: Problem, file: BatteryFile, without: tuple[str, ...], tell: Callable[[str], None]
) -> _SearchResult:
    """Search for effects. Records that seem to begin below full are also tried as full; the better fit counts.

    The voltage at the start may be wrong instead of the charge: the rest of the flight tells which.
    """
    searched = _search_settled(problem, file, without, tell)
    if not problem.evidence.charged_in_part.any():
        return searched
    full = replace(problem, evidence=problem.evidence.believed_full)
    return min(searched, _search_settled(full, file, without, tell), key=lambda one: one.best.total)


def _search_settled(
    problem: Problem, file: BatteryFile, without: tuple[str, ...], tell: Callable[[str], None]
) -> _SearchResult:
    """Search for effects in records whose starts are settled; impossible and known effects are no candidates."""
    start_effects = ("initial_charge",) if problem.evidence.charged_in_part.any() else ()
    options = options_of(problem, file, (*without, *start_effects))
    unchanged = refit(problem, [NOTHING], iterations=SETTLED)[0]
    return _SearchResult(
        problem, unchanged, *search(problem, options, unchanged, lambda fit: explains(problem, fit), tell)
    )


def candidate_probability(misfit: MisfitPerNumber, reasons: tuple[str, ...]) -> float:
    """Return how likely the cause is one of the candidates: the less, the nearer the model is to being doubted."""
    return SUSPECT if reasons else float(np.interp(misfit.voltage, (USUAL, LEFT), (NEVER_SURE, SUSPECT)))


def doubts(
    problem: Problem, file: BatteryFile, findings: list[FoundEffect], best: Refit, misfit: MisfitPerNumber
) -> tuple[str, ...]:
    """List the reasons why the model is not believed to be complete after all; empty when it is.

    misfit : chi-square per number (`left_per_number`).
    """
    reasons = []
    after = residual.residuals(problem.evidence, at_best(problem, best))
    if misfit.voltage > LEFT:
        shape = residual.shape(after)
        reasons.append(
            f"the voltage residual is still {1000 * residual.size_V(after):.0f} mV, {misfit.voltage:.1f} times what "
            f"this battery's model leaves (chi-square); it goes with {shape.variable} ({shape.share:.0%} of it) and "
            f"lasts about {shape.time_scale_s:.0f} s"
        )
    elif findings and (times := times_expected(problem, file, after)) > FAR:
        reasons.append(
            f"the voltage residual is still {1000 * residual.size_V(after):.0f} mV, {times:.1f} times what this "
            "battery's model leaves there: what is named is the smaller part of it, or none"
        )
    if misfit.temperature > LEFT:
        reasons.append(
            f"the temperature residual is still {residual.size_K(after):.1f} K, {misfit.temperature:.1f} times what "
            "this battery's model leaves (chi-square)"
        )
    return (*reasons, *(reason for finding in findings for reason in _doubts_of(finding)))


def _doubts_of(finding: FoundEffect) -> Iterator[str]:
    """Yield the reasons why an effect that was found is not believed to be the cause."""
    constancy = finding.worth.constancy
    if finding.drift is not None:
        yield drift.words(finding.drift)
    elif finding.slow is not None:
        yield slow_sensor.words(finding.slow)
    elif constancy is not None and not finding.steady:
        yield f"{finding.name} is not the same in all records (they differ by {constancy.spread:.0%} of it)"
    if all(m.candidate.name in m.candidate.resized for m in finding.members):
        yield f"no new effect explains it, only another size of {finding.name}, which the file already has"
