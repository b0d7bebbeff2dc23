"""A finding in the words of the diagnosis: which effects it may be, their values with intervals, what would tell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uavbatt.diagnosis import attribute
from uavbatt.diagnosis.attribute import Finding
from uavbatt.diagnosis.candidates import QUANTITIES, UNITS
from uavbatt.diagnosis.problem import Problem, Refit
from uavbatt.diagnosis.words import separating

COVERAGE = 2.2  # standard errors either side: 95 % with few independent stretches
SLOWEST_POLARISATION_S = 30.0


@dataclass(frozen=True, slots=True)
class Interval:
    """A value with its 95 % interval."""

    value: float
    lo: float
    hi: float
    unit: str


@dataclass(frozen=True, slots=True)
class EffectClass:
    """Effects that these records cannot tell apart, best first."""

    members: tuple[str, ...]
    probability: float
    parameters: dict[str, Interval]
    would_separate: str


def class_of(problem: Problem, finding: Finding, doubted: bool) -> EffectClass:
    """A finding as it is told; `doubted` when the model is not believed to be complete."""
    members = _named(problem, tuple(m.candidate.name for m in finding.members))
    parameters: dict[str, Interval] = {}
    for fit in finding.members:
        parameters.update(intervals(problem, fit))
    outside = next((f.candidate.name for f in finding.fits if f.candidate.name not in members), None)
    sure = finding.probability * (0.5 if doubted else 0.97)
    return EffectClass(members, round(sure, 3), parameters, separating(members, outside))


def _named(problem: Problem, members: tuple[str, ...]) -> tuple[str, ...]:
    """The members, with the other name of what goes by two.

    A lag of a minute is the fast end of diffusion as much as the slow end of polarisation. A pack that is only ever
    discharged shows its branch of the hysteresis as it would show a lag of minutes. And slower reactions are how the
    resistance of most packs grows: a charger that reads it shows both.
    """
    slow = float(np.max(problem.pack.cell.polarisation_tau_s)) >= SLOWEST_POLARISATION_S
    twins = {"charge_transfer": "resistance_growth", "hysteresis": "slow_diffusion"}
    if slow:
        twins["polarisation"] = "slow_diffusion"
    for name, twin in twins.items():
        if name in members and twin not in members:
            members = (*members, twin)
    return members[: attribute.LARGEST_CLASS]


def intervals(problem: Problem, fit: Refit) -> dict[str, Interval]:
    """Values of the effect that was added last, with 95 % intervals that allow for errors of the battery file."""
    if not fit.candidate.last:
        shift = fit.v[:, 0] * np.maximum(problem.evidence.start_sd, 0.2)
        mean, half = float(np.mean(shift)), float(0.01 + 2.0 * np.std(shift) / np.sqrt(len(shift)))
        return {"start_soc_shift": Interval(mean, mean - half, mean + half, "1")}
    out = {}
    values, errors = fit.values()[0], fit.errors()
    for k in range(len(fit.candidate.freed) - fit.candidate.last, len(fit.candidate.freed)):
        freed = fit.candidate.freed[k]
        name = QUANTITIES[freed.index].name
        value, half = float(values[k]), COVERAGE * float(errors[k])
        lo, hi = max(value - half, freed.low), min(value + half, freed.high)
        out[name] = Interval(value, lo, hi, UNITS[name])
    return out
