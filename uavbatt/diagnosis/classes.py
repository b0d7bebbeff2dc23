"""A finding for the report: the effects that it may be, their values with intervals, and the readings that decide."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uavbatt.diagnosis.refit.candidates import QUANTITIES, UNITS
from uavbatt.diagnosis.refit.problem import Problem, Refit
from uavbatt.diagnosis.search.effects import FoundEffect
from uavbatt.diagnosis.search.rivals import LARGEST_CLASS
from uavbatt.diagnosis.search.trial import Trial
from uavbatt.diagnosis.words import separating

COVERAGE = 2.2  # standard errors on either side: 95 % with few independent parts of a record
SLOWEST_POLARISATION_S = 30.0
# The lag of a temperature sensor is estimated from the warming of the pack. The model lacks the heat of the reactions
# (the entropic term of Bernardi 1985), which grows as a pack empties: in 13 drawn cases the estimated lag was 0.55 to
# 0.69 of the true one.
LAG_SHARE = 0.25
START_ERROR = 0.01  # of the shift of the start, however well the records agree: chargers end at different charges
NEVER_SURE = 0.97  # largest total probability of the candidates: the cause may be none of them


@dataclass(frozen=True, slots=True)
class Interval:
    """Interval holds a value with its 95 % interval from `lo` to `hi`."""

    value: float
    lo: float
    hi: float
    unit: str


@dataclass(frozen=True, slots=True)
class EffectClass:
    """An EffectClass holds the effects that these records cannot tell apart, best first."""

    members: tuple[str, ...]
    probability: float
    parameters: dict[str, Interval]
    would_separate: str


def class_of(problem: Problem, finding: FoundEffect, believed: float) -> EffectClass:
    """Turn a finding into a class; `believed` is the probability that the cause is one of the candidates."""
    members = _with_second_names(problem, tuple(m.candidate.name for m in finding.members))
    parameters: dict[str, Interval] = {}
    for fit in finding.members:
        if fit.candidate.name in members:  # a second name may have taken its place
            parameters.update(intervals(fit))
    outside = [name for name in finding.outside if name not in members]
    return EffectClass(
        members, round(believed * finding.probability, 3), parameters, separating(members, next(iter(outside), None))
    )


def start_class(problem: Problem, unchanged: Refit) -> EffectClass:
    """Return the class of the starting charge, for records that rested well below full."""
    evidence = problem.evidence
    starts = evidence.start_soc + evidence.start_sd * unchanged.v[:, 0]
    shift = starts[evidence.charged_in_part] - evidence.full_soc
    mean, half = float(np.mean(shift)), float(np.hypot(START_ERROR, 2.0 * np.std(shift) / np.sqrt(len(shift))))
    name = "initial_charge"
    return EffectClass((name,), NEVER_SURE, {"start_soc_shift": Interval(mean, mean - half, mean + half, "1")},
                       separating((name,), None))  # fmt: skip


@dataclass(frozen=True, slots=True)
class HiddenSize:
    """HiddenSize says how large an effect could be unseen: its first quantity from `lo` to `hi` (95 % interval)."""

    name: str
    quantity: str
    lo: float
    hi: float
    unit: str


def hidden_sizes(trial: Trial) -> tuple[HiddenSize, ...]:
    """List, for each single effect that was tried, the size that could be present unseen, by name."""
    out = []
    for fit in trial.fits:
        name, one = next(iter(intervals(fit).items()))
        out.append(HiddenSize(fit.candidate.name, name, one.lo, one.hi, one.unit))
    return tuple(sorted(out, key=lambda h: h.name))


def _with_second_names(problem: Problem, members: tuple[str, ...]) -> tuple[str, ...]:
    """Return the members, each followed by its second name if it has one.

    A lag of a minute can be called fast diffusion or slow polarisation. A pack that is only discharged shows its branch
    of the hysteresis in the same way as a lag of minutes, and the reverse. The resistance of most packs grows because
    reactions become slower, and the resistance reading of a charger shows both.
    """
    slow = float(np.max(problem.pack.cell.polarisation_tau_s)) >= SLOWEST_POLARISATION_S
    twins = {"charge_transfer": "resistance_growth", "hysteresis": "slow_diffusion", "slow_diffusion": "hysteresis"}
    if slow:
        twins["polarisation"] = "slow_diffusion"
    both_names = [both for name in members for both in (name, twins.get(name, name))]
    return tuple(dict.fromkeys(both_names))[:LARGEST_CLASS]


def intervals(fit: Refit) -> dict[str, Interval]:
    """Return the values of the effect added last, with 95 % intervals that allow for errors of the battery file."""
    out = {}
    values, errors = fit.values()[0], fit.errors()
    for k in range(len(fit.candidate.freed))[fit.candidate.slice_of(fit.candidate.name)]:
        freed = fit.candidate.freed[k]
        name = QUANTITIES[freed.index].name
        value, error = float(values[k]), float(errors[k])
        lo, hi = value - COVERAGE * error, value + COVERAGE * error
        if name == "sensor_lag_s":
            widest = math.log(freed.high / freed.low)  # of a sensor without a lag, which has hardly any value
            factor = math.exp(min(COVERAGE * math.hypot(error / value, LAG_SHARE), widest))
            lo, hi = value / factor, value * factor
        out[name] = Interval(value, max(lo, freed.low), min(hi, freed.high), UNITS[name])
    return out
