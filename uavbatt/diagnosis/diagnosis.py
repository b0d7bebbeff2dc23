"""From records and a battery file to a verdict: is an effect missing, which, how large, how sure.

One effect at a time. A further one is sought only while the residual is larger than what the battery's model leaves on
effect-free data; then the pairs are weighed as pairs, since two effects together can look like a third. What
still stands above that floor, or a value that differs from record to record, ends as `undeclared_effect`; such a
value is named as a suspect and does not enter the model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from uavbatt.battery import openloop
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.model import SOC_GRID, open_circuit_voltage
from uavbatt.battery.scaling import Pack
from uavbatt.diagnosis import attribute, residual
from uavbatt.diagnosis.attribute import Finding
from uavbatt.diagnosis.candidates import NOTHING, Candidate, base_values, candidates, nuisances
from uavbatt.diagnosis.classes import EffectClass, class_of
from uavbatt.diagnosis.evidence import IDLE_NOISE_A, NOT_HELD_OUT, idle_A, prepare
from uavbatt.diagnosis.heldout import helps
from uavbatt.diagnosis.problem import Problem, Refit, TableErrors
from uavbatt.diagnosis.refit import at_best, refit
from uavbatt.diagnosis.residual import Residual, Shape
from uavbatt.estimator import PLAIN, Engine
from uavbatt.fitting.observed import Observed

Verdict = Literal["no_missing_effect", "effect_found", "undeclared_effect"]
ABOVE_FLOOR = 1.35  # size of a residual against the discrepancy of the file
STRUCTURED = 1.12  # see residual.structure; effect-free flights show 0.96 to 1.07
LEAST_FLOOR_K = 0.4
MOST_EFFECTS = 3
RESISTANCE_KNOT_SD, OCV_KNOT_SD_V = 0.03, 0.01


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What was found, with the model before and after."""

    verdict: Verdict
    classes: tuple[EffectClass, ...]
    reasons: tuple[str, ...]
    problem: Problem
    before: Refit
    after: Refit
    residual_before: list[Residual]
    residual_after: list[Residual]
    floor_V: float
    floor_K: float
    left: Shape
    findings: tuple[Finding, ...] = field(default=())


def problem_of(
    records: list[Observed], file: BatteryFile, pack: Pack, states: openloop.States = openloop.states
) -> Problem:
    """Make records and battery file ready for refits; `states` simulates. Raises NotEnoughData with the reason."""
    ocv_V = np.maximum.accumulate(open_circuit_voltage(pack.cell, SOC_GRID) + 1e-6 * SOC_GRID)
    evidence = prepare(records, file, (SOC_GRID, ocv_V))
    base = base_values(pack.cell, pack.installation)
    return Problem(pack, evidence, base, nuisances(file), table_errors(file), states)


def table_errors(file: BatteryFile) -> TableErrors:
    """Standard errors of the file's tables: as stated, else what a fit usually leaves."""
    table = file.parameters
    ocv_sd = [table.standard_error.get(f"ocv_{z:g}", OCV_KNOT_SD_V) for z in table.ocv_soc]
    knots = np.array(table.resistance_soc)
    return TableErrors(np.array(table.ocv_soc), np.array(ocv_sd), knots, np.full(knots.size, RESISTANCE_KNOT_SD))


def diagnose(
    records: list[Observed],
    file: BatteryFile,
    pack: Pack,
    without: tuple[str, ...] = (),
    progress: Callable[[str], None] | None = None,
    engine: Engine = PLAIN,
) -> Diagnosis:
    """Diagnose records of one pack.

    without : effects that are no candidates; progress : told each step; engine : simulates many columns
    (`compiled.engine()` is some three times faster). Raises NotEnoughData with the reason.
    """
    tell = progress or (lambda _: None)
    tell("open-loop simulation")
    problem = problem_of(records, file, pack, engine.states)
    options = candidates(
        file,
        problem.base,
        has_temperature=problem.evidence.has_temperature,
        idle_A=idle_A(problem.evidence) + IDLE_NOISE_A,
        without=without,
    )
    nothing = refit(problem, [NOTHING])[0]
    floor_V, floor_K = floors(file, problem)
    best, findings = _search(problem, options, nothing, (floor_V, floor_K), tell)
    tell("residual")
    useless = bool(best.candidate.names) and not helps(problem, nothing, best)
    if useless:
        best = nothing
    after = residual.residuals(problem.evidence, at_best(problem, best))
    left = residual.shape(after)
    hangs = residual.structure(problem.evidence, best.residual)
    reasons = _doubts(findings, after, (floor_V, floor_K), (left, hangs), {e.name for e in file.effects})
    if useless:
        reasons += ("what was found does not help to predict a record that was left out: the battery file stays",)
    found = tuple(class_of(problem, f, bool(reasons)) for f in findings)
    verdict: Verdict = "undeclared_effect" if reasons else "effect_found" if found else "no_missing_effect"
    return Diagnosis(
        verdict=verdict,
        classes=found,
        reasons=reasons,
        problem=problem,
        before=nothing,
        after=best,
        residual_before=residual.residuals(problem.evidence, at_best(problem, nothing)),
        residual_after=after,
        floor_V=floor_V,
        floor_K=floor_K,
        left=left,
        findings=tuple(findings),
    )


def floors(file: BatteryFile, problem: Problem) -> tuple[float, float]:
    """Size of residual that the battery's own model leaves: voltage of this pack [V], temperature [K]."""
    left = file.discrepancy
    strict = 1.0 if left.held_out else NOT_HELD_OUT
    share = problem.pack.installation.cells / file.battery.cells_series
    least_V = 0.005 * problem.pack.installation.cells
    return max(left.voltage_rmse_V * share, least_V), max(left.temperature_rmse_K * strict, LEAST_FLOOR_K)


def _search(
    problem: Problem,
    options: list[Candidate],
    nothing: Refit,
    floor: tuple[float, float],
    tell: Callable[[str], None],
) -> tuple[Refit, list[Finding]]:
    """Add effects while the residual stands above the floor and each earns its place."""
    tell(f"{len(options)} candidate effects")
    explains = _explaining(problem, floor)
    step = attribute.find(problem, [nothing], options, explains)
    if step is None:
        return nothing, []
    alone = step.constancy is None or step.constancy.steady
    resized = all(m.candidate.resized for m in step.members)
    if (resized or not alone) and explains(nothing):  # no more is left than the file says: nothing to be explained
        return nothing, []
    findings = [step]
    best = step.members[0]
    while len(findings) < MOST_EFFECTS and not explains(best):
        tell(f"a further effect beside {', '.join(best.candidate.names)}")
        further = attribute.find(problem, _rivals(findings[-1]), options, explains)
        explained = nothing.total - best.total
        if further is None or further.gain < max(attribute.FURTHER_GAIN, attribute.FURTHER_SHARE * explained):
            break
        if further.constancy is not None and not further.constancy.steady:
            break
        best, alone = further.members[0], True
        findings = _reweighed(problem, best, options, explains) or [further]
    # a value that differs from record to record makes a suspect, and cannot stand in a battery file
    return (best, findings) if alone else (nothing, [step])


def _rivals(finding: Finding) -> list[Refit]:
    """The best models of the round, beyond the class: with a second effect a worse first may turn out better."""
    kept: list[Refit] = []
    for fit in finding.fits:
        if not any(attribute.related(fit.candidate.names[-1:], k.candidate.names[-1:]) for k in kept):
            kept.append(fit)
    return kept[: attribute.RIVALS]


def _reweighed(
    problem: Problem, best: Refit, options: list[Candidate], explains: Callable[[Refit], bool]
) -> list[Finding]:
    """For every effect of the model: which others could stand in its place, the rest kept; most evidence first."""
    by_name = {o.name: o for o in options}
    found = []
    for name in best.candidate.names:
        others = NOTHING
        for kept in best.candidate.names:
            if kept != name:
                others = others.plus(by_name[kept])
        rest = refit(problem, [others])[0]
        again = attribute.find(problem, [rest], options, explains)
        if again is not None:
            found.append(again)
    return sorted(found, key=lambda f: -f.gain)


def _explaining(problem: Problem, floor: tuple[float, float]) -> Callable[[Refit], bool]:
    """The test whether a model leaves no more than the floor: size of voltage and temperature, and their shape."""

    def explains(fit: Refit) -> bool:
        if residual.structure(problem.evidence, fit.residual) > STRUCTURED:
            return False
        left = residual.residuals(problem.evidence, at_best(problem, fit))
        small_V = residual.size_V(left) <= ABOVE_FLOOR * floor[0]
        return small_V and not residual.size_K(left) > ABOVE_FLOOR * floor[1]  # NaN: not measured

    return explains


def _doubts(
    findings: list[Finding],
    after: list[Residual],
    floor: tuple[float, float],
    shape: tuple[Shape, float],
    listed: set[str],
) -> tuple[str, ...]:
    """Why the model after all is not believed to be complete; empty when it is."""
    doubts = []
    (floor_V, floor_K), (left, hangs) = floor, shape
    size_V, size_K = residual.size_V(after), residual.size_K(after)
    if size_V > ABOVE_FLOOR * floor_V:
        doubts.append(
            f"the voltage residual is still {1000 * size_V:.0f} mV where the battery's model leaves "
            f"{1000 * floor_V:.0f} mV; it goes with {left.variable} ({left.share:.0%} of it) and lasts about "
            f"{left.time_scale_s:.0f} s"
        )
    elif hangs > STRUCTURED:
        doubts.append(
            f"the voltage residual of {1000 * size_V:.0f} mV still hangs together from row to row ({hangs:.2f}, 1 is "
            f"chance); it goes with {left.variable} and lasts about {left.time_scale_s:.0f} s"
        )
    if size_K > ABOVE_FLOOR * floor_K:
        doubts.append(f"the temperature residual is still {size_K:.1f} K where the model leaves {floor_K:.1f} K")
    for finding in findings:
        steady = finding.constancy
        if steady is not None and not steady.steady:
            name = finding.members[0].candidate.name
            doubts.append(f"{name} is not the same in all records (they differ by {steady.spread:.0%} of it)")
        if {m.candidate.name for m in finding.members} <= listed - {"temperature_lag"}:
            name = finding.members[0].candidate.name
            doubts.append(f"no new effect explains it, only another size of {name}, which the file already has")
    return tuple(doubts)
