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
from uavbatt.diagnosis import drift, residual
from uavbatt.diagnosis.batch import at_best
from uavbatt.diagnosis.blocks import EvidenceBlock, evidence_by_block
from uavbatt.diagnosis.candidates import NOTHING, Candidate, base_values, candidates, nuisances
from uavbatt.diagnosis.classes import NEVER_SURE, EffectClass, HiddenSize, class_of, hidden_sizes, start_class
from uavbatt.diagnosis.evidence import IDLE_NOISE_A, idle_A, prepare
from uavbatt.diagnosis.problem import Problem, Refit, TableErrors
from uavbatt.diagnosis.refit import SETTLED, refit
from uavbatt.diagnosis.residual import Residual, Shape
from uavbatt.diagnosis.search import SUSPECT, FoundEffect, search, small
from uavbatt.diagnosis.trial import Trial
from uavbatt.engine import PLAIN, Engine
from uavbatt.fitting.observed import ObservedRecord

Verdict = Literal["no_missing_effect", "effect_found", "undeclared_effect"]
LEFT = 1.25  # chi-square per number that the model may leave; see scripts/diagnose_cases_chance.py
USUAL = 1.05  # largest value that effect-free flights leave for the voltage
FAR = 2.0  # times the error that the model is expected to have: no wander; 1.8 at most in healthy sets
RESISTANCE_KNOT_SD, OCV_KNOT_SD_V = 0.03, 0.01


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
        """Return True if the class was not found, and is only what small effect may hide."""
        return self.verdict == "no_missing_effect" and bool(self.classes)


def problem_of(
    records: list[ObservedRecord],
    file: BatteryFile,
    pack: Pack,
    states: openloop.States = openloop.states,
    wear_sd: tuple[float, float] = (0.0, 0.0),
) -> Problem:
    """Make records and battery file ready for refits; `states` simulates. Raises NotEnoughData with the reason."""
    ocv_V = np.maximum.accumulate(open_circuit_voltage(pack.cell, SOC_GRID) + 1e-6 * SOC_GRID)
    evidence = prepare(records, file, (SOC_GRID, ocv_V))
    base = base_values(pack.cell, pack.installation)
    believed, declared = nuisances(file, wear_sd), nuisances(file, wear_sd, least_activation_sd_K=0.0)
    return Problem(pack, evidence, base, believed, declared, table_errors(file), states)


def table_errors(file: BatteryFile) -> TableErrors:
    """Return the standard errors of the file's tables: as stated, else what a fit usually leaves."""
    table = file.parameters
    ocv_sd = [table.standard_error.get(f"ocv_{z:g}", OCV_KNOT_SD_V) for z in table.ocv_soc]
    knots = np.array(table.resistance_soc)
    return TableErrors(np.array(table.ocv_soc), np.array(ocv_sd), knots, np.full(knots.size, RESISTANCE_KNOT_SD))


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

    without : effects that are no candidates; progress : told each step; engine : simulates many columns
    (`compiled.engine()` takes two thirds of the time); wear_sd : sd of the fade and of the growth of `pack`, if the
    ledger knows the pack. Raises NotEnoughData with the reason.
    """
    tell = progress or (lambda _: None)
    tell("open-loop simulation")
    problem = problem_of(records, file, pack, engine.states, wear_sd)
    searched = _search_settled(problem, file, without, tell)
    if problem.evidence.charged_in_part.any():  # the rest of the flight tells if the voltage is wrong instead
        full = replace(problem, evidence=problem.evidence.believed_full)
        searched = min(searched, _search_settled(full, file, without, tell), key=lambda s: s.best.total)
    problem, unchanged, best, findings, singles = searched
    tell("residual")
    steady = all(f.steady for f in findings)
    misfit = left_per_number(problem, best)
    reasons = doubts(problem, file, findings, best, misfit)
    effect_classes = tuple(class_of(problem, f, candidate_probability(misfit, reasons)) for f in findings)
    if problem.evidence.charged_in_part.any() and "initial_charge" not in without:
        effect_classes = (start_class(problem, unchanged), *effect_classes)
    if not steady:  # a value that differs between records is a suspect, not for a battery file
        best = unchanged
    verdict: Verdict = "undeclared_effect" if reasons else "effect_found" if effect_classes else "no_missing_effect"
    after = residual.residuals(problem.evidence, at_best(problem, best))
    may_hide = small(problem, singles) if verdict == "no_missing_effect" else None
    return Diagnosis(
        verdict=verdict,
        classes=effect_classes
        if may_hide is None
        else (class_of(problem, may_hide, candidate_probability(misfit, reasons)),),
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


class _SearchResult(NamedTuple):
    problem: Problem
    nothing: Refit
    best: Refit
    findings: list[FoundEffect]
    singles: Trial


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


def explains(problem: Problem, fit: Refit) -> bool:
    """Return True if a refit leaves no more than the file's own model does."""
    misfit = left_per_number(problem, fit)
    return not max(misfit.voltage, misfit.temperature) > LEFT


def floor_V(file: BatteryFile, problem: Problem) -> float:
    """Return the size of residual that the battery's own model leaves on this pack [V]."""
    share = problem.pack.installation.cells / file.battery.cells_series
    return float(file.discrepancy.voltage_rmse_V * share)


class MisfitPerNumber(NamedTuple):
    """MisfitPerNumber holds the chi-square per number that a model leaves."""

    voltage: float
    temperature: float  # NaN: not measured


def left_per_number(problem: Problem, best: Refit) -> MisfitPerNumber:
    """Return the chi-square per number that is left once the file's stated errors are at their most probable.

    The prior of those errors counts with the voltage: an error of six standard errors explains nothing.
    """
    problem = replace(problem, nuisances=problem.stated)
    fit = refit(problem, [best.candidate], start=[best], iterations=6, file_errors=True)[0]
    misfit = per_number(problem, fit)
    numbers = sum(v.rows.size for v in problem.evidence.volts)
    return misfit._replace(voltage=misfit.voltage + (fit.total - float(np.sum(fit.residual**2))) / numbers)


def per_number(problem: Problem, fit: Refit) -> MisfitPerNumber:
    """Return the chi-square per number that a refit leaves of voltage and of temperature."""
    squares, numbers = np.zeros(2), np.zeros(2)
    for row, volts, temps in zip(fit.residual, problem.evidence.volts, problem.evidence.temps, strict=True):
        first, size = volts.rows.size, temps.rows.size if temps is not None else 0
        squares += [np.sum(row[:first] ** 2), np.sum(row[first : first + size] ** 2)]
        numbers += [first, size]
    return MisfitPerNumber(
        float(squares[0] / numbers[0]), float(squares[1] / numbers[1]) if numbers[1] else float("nan")
    )


def times_expected(problem: Problem, file: BatteryFile, after: list[Residual]) -> float:
    """Return the voltage residual under load as a multiple of the error that the model is expected to have there.

    In the chi-square per number an error that lasts for a whole flight counts as a single error, and is hardly seen. A
    file without a learned wander has one error for all charges.
    """
    if file.discrepancy.wander is None:
        return residual.size_V(after) / floor_V(file, problem)
    shares = [r.voltage_V / v.sd for r, v in zip(after, problem.evidence.volts, strict=True)]
    return float(np.sqrt(np.mean([np.mean(s[~r.rest] ** 2) for s, r in zip(shares, after, strict=True)])))


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
    elif constancy is not None and not finding.steady:
        yield f"{finding.name} is not the same in all records (they differ by {constancy.spread:.0%} of it)"
    if all(m.candidate.name in m.candidate.resized for m in finding.members):
        yield f"no new effect explains it, only another size of {finding.name}, which the file already has"
