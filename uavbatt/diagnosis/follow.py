"""Flights of one pack in order of time: which effect is missing, since which flight, and does it grow?

The same evidence as `diagnosis`, with one question more. Every effect that can begin is tried with every course; an
effect is followed when what it is worth over the flights, each predicted by the others, is more than chance gives to
the best of so many courses. What has been found stays in the model while the next is looked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.scaling import Pack
from uavbatt.diagnosis.candidates import NOTHING, QUANTITIES, UNITS, Candidate
from uavbatt.diagnosis.classes import COVERAGE, EffectClass, Interval, class_of
from uavbatt.diagnosis.course import Course, OwnValues, courses, on_course, own_values
from uavbatt.diagnosis.diagnosis import Verdict, believed, doubts, left_per_number, options_of, problem_of
from uavbatt.diagnosis.problem import Problem, Refit
from uavbatt.diagnosis.refit import SETTLED, refit
from uavbatt.diagnosis.rivals import related
from uavbatt.diagnosis.search import FoundEffect, finding
from uavbatt.diagnosis.trial import FIRST_TURNS, FURTHER_TURNS, trial
from uavbatt.diagnosis.worth import at_bound, worth
from uavbatt.errors import NotEnoughData
from uavbatt.estimator import PLAIN, Engine
from uavbatt.fitting.observed import Observed

# What may befall an aircraft between two flights; the rest is the cell's nature, or each flight's own.
CAN_BEGIN = (
    "capacity_fade", "resistance_growth", "weak_cell", "charge_transfer", "harness_resistance", "current_gain",
    "current_offset", "unmetered_load", "voltage_gain", "voltage_offset", "temperature_offset", "temperature_lag",
    "current_delay", "airflow_cooling",
)  # fmt: skip
EARNED = 12.0  # the best of many courses: scripts/diagnose_cases_healthy.py
EARNED_ONCE = 36.0  # by one flight alone, whose own oddity it may be
GROWS = 6.0  # chi-square by which growing must be better than beginning at once
AS_GOOD = 6.0  # chi-square within which another beginning is as good
MOST_EFFECTS = 2
REFITTED = 12  # courses that are refitted after all are looked through
LEAST_FLIGHTS = 2


@dataclass(frozen=True, slots=True)
class Followed:
    """Followed holds one effect with its course; flights are counted from 0 in order of time."""

    found: EffectClass
    course: Course
    earliest: int  # the first and the last flight at which it may have begun as well
    latest: int
    values: tuple[Interval, ...]  # of each flight by itself, of the likeliest member's first quantity
    quantity: str
    off: float  # its value in the battery file
    worth: float


@dataclass(frozen=True, slots=True)
class Follow:
    """Follow holds the flights in order of time, the verdict and what was found in them."""

    verdict: Verdict
    flights: tuple[str, ...]
    left_out: tuple[str, ...]  # too short to tell anything
    effects: tuple[Followed, ...]
    reasons: tuple[str, ...]


def follow(
    records: Sequence[Observed],
    file: BatteryFile,
    pack: Pack,
    without: tuple[str, ...] = (),
    progress: Callable[[str], None] | None = None,
    engine: Engine = PLAIN,
) -> Follow:
    """Follow one pack over records in order of time. Raises NotEnoughData with the reason.

    without : effects that are no candidates; progress : told each step; engine : simulates many columns.
    """
    tell = progress or (lambda _: None)
    tell("open-loop simulation")
    problem = problem_of(list(records), file, pack, engine.states)
    names = list(problem.evidence.names)
    order = [names.index(r.name) for r in records if r.name in names]
    if len(order) < LEAST_FLIGHTS:
        raise NotEnoughData(f"{len(order)} flight is long enough to be followed: expected at least {LEAST_FLIGHTS}")
    options = [c for c in options_of(problem, file, without) if c.name in CAN_BEGIN]
    best = refit(problem, [NOTHING], iterations=SETTLED)[0]
    traces: list[_Trace] = []
    while len(traces) < MOST_EFFECTS:
        tell(f"{len(options)} effects, {len(courses(len(order)))} courses each")
        trace = _next(problem, options, best, order)
        if trace is None:
            break
        traces.append(trace)
        best = trace.effect.members[0]
    tell("residual")
    left = left_per_number(problem, best)
    why = doubts(problem, file, [t.effect for t in traces], best, left)
    verdict: Verdict = "undeclared_effect" if why else "effect_found" if traces else "no_missing_effect"
    return Follow(
        verdict=verdict,
        flights=tuple(names[i] for i in order),
        left_out=tuple(r.name for r in records if r.name not in names),
        effects=tuple(_told(problem, t, believed(left, why)) for t in traces),
        reasons=why,
    )


class _Tried(NamedTuple):
    """One effect on one course, refitted."""

    option: Candidate
    course: Course
    fit: Refit


class _Trace(NamedTuple):
    """An effect that earned its place, with its course and where else it may have begun."""

    effect: FoundEffect
    course: Course
    earliest: int
    latest: int
    own: OwnValues


def _next(problem: Problem, options: list[Candidate], before: Refit, order: Sequence[int]) -> _Trace | None:
    """The effect and course that explain most beside what `before` has; None when none earns its place."""
    free = [o for o in options if not related(o.names, before.candidate.names)]
    if not free:
        return None
    owns = _own_values(problem, free, before, order)
    best = _best(_refitted(problem, _shortlist(free, owns), before, order), before)
    if best is None:
        return None
    place = free.index(best.option)
    its = sorted(courses(len(order)), key=lambda c: -owns[place].saved(c))[:REFITTED]
    tried = _refitted(problem, [(best.option, c) for c in its], before, order)
    chosen = _chosen([best, *tried])
    if not _earned(chosen, before, len(order)):
        return None
    rivals = trial(problem, before, [on_course(o, chosen.course, order) for o in free], FIRST_TURNS)
    if not rivals.rivals:
        return None
    effect = finding(problem, rivals, EARNED)
    as_good = [
        t.course.begins
        for t in [best, *tried]
        if t.course.grows == chosen.course.grows and t.fit.total < chosen.fit.total + AS_GOOD
    ]
    own = owns[[o.name for o in free].index(effect.name)]
    return _Trace(effect, chosen.course, min(as_good), max(as_good), own)


def _own_values(problem: Problem, free: list[Candidate], before: Refit, order: Sequence[int]) -> list[OwnValues]:
    """The flights' own values of every effect, from a refit of each in which all flights have it."""
    tried = [before.candidate.plus(o) for o in free]
    fits = refit(problem, tried, start=[before] * len(tried), iterations=FURTHER_TURNS)
    return [own_values(problem, fit, order) for fit in fits]


def _shortlist(free: list[Candidate], owns: list[OwnValues]) -> list[tuple[Candidate, Course]]:
    """The best beginning of every effect, steady and growing; the most promising of these."""
    found = []
    for option, own in zip(free, owns, strict=True):
        for grows in (False, True):
            its = [c for c in courses(own.change.size) if c.grows == grows]
            if its:
                best = max(its, key=own.saved)
                found.append((own.saved(best), option, best))
    found.sort(key=lambda f: -f[0])
    return [(option, course) for _, option, course in found[:REFITTED]]


def _refitted(
    problem: Problem, asked: list[tuple[Candidate, Course]], before: Refit, order: Sequence[int]
) -> list[_Tried]:
    tried = [before.candidate.plus(on_course(option, course, order)) for option, course in asked]
    fits = refit(problem, tried, start=[before] * len(tried), iterations=FIRST_TURNS)
    return [_Tried(option, course, fit) for (option, course), fit in zip(asked, fits, strict=True)]


def _best(tried: list[_Tried], before: Refit) -> _Tried | None:
    """The one that leaves least of those that earn a place; not one that ran into the end of what is physical."""
    flights = len(before.chi2)
    earned = [t for t in tried if not at_bound(t.fit) and _earned(t, before, flights)]
    return min(earned, key=lambda t: t.fit.total, default=None)


def _earned(tried: _Tried, before: Refit, flights: int) -> bool:
    """Return True if it is worth more than chance gives; of one flight alone, more than its oddity does."""
    its = worth(tried.fit, before)
    if not tried.course.grows and tried.course.begins == flights - 1:  # no other flight can speak for it
        return its.most * its.known > EARNED_ONCE
    return its.value > EARNED


def _chosen(tried: list[_Tried]) -> _Tried:
    """The best course; one that grows only if it is clearly better than any that does not."""
    possible = [t for t in tried if not at_bound(t.fit)]
    return min(possible, key=lambda t: t.fit.total - (GROWS if not t.course.grows else 0.0))


def _told(problem: Problem, trace: _Trace, sure: float) -> Followed:
    """A trace with each flight's own value, as it is shown."""
    fit = trace.effect.members[0]
    freed = fit.candidate.freed[fit.candidate.slice_of(trace.effect.name)][0]
    name = QUANTITIES[freed.index].name
    off, half = problem.base[freed.index], COVERAGE * trace.own.sd
    values = [off + change for change in trace.own.change]
    own = tuple(
        Interval(float(v), float(max(v - h, freed.low)), float(min(v + h, freed.high)), UNITS[name])
        for v, h in zip(values, half, strict=True)
    )
    told = class_of(problem, trace.effect, sure)
    return Followed(told, trace.course, trace.earliest, trace.latest, own, name, float(off), trace.effect.worth.value)
