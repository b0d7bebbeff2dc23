"""Flights of one pack in order of time: which effect is missing, since which flight, and does it grow?

The evidence is that of `diagnosis`. Every effect that can begin between two flights is tried with every course. An
effect is reported when its worth (each flight predicted from the others) exceeds what chance gives to the best of that
many courses. An effect that has been found stays in the model while the next one is searched for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.scaling import Pack
from uavbatt.diagnosis.classes import COVERAGE, EffectClass, Interval, class_of
from uavbatt.diagnosis.course import Course, FlightValues, courses, on_course, own_values
from uavbatt.diagnosis.diagnosis import Verdict, candidate_probability, doubts, options_of, problem_of
from uavbatt.diagnosis.refit.candidates import NOTHING, QUANTITIES, UNITS, Candidate
from uavbatt.diagnosis.refit.misfit import left_per_number
from uavbatt.diagnosis.refit.problem import Problem, Refit
from uavbatt.diagnosis.refit.solver import SETTLED, refit
from uavbatt.diagnosis.search.effects import FoundEffect, finding
from uavbatt.diagnosis.search.rivals import related
from uavbatt.diagnosis.search.trial import FIRST_TURNS, FURTHER_TURNS, trial
from uavbatt.diagnosis.search.worth import at_bound, worth
from uavbatt.engine import PLAIN, Engine
from uavbatt.errors import NotEnoughData
from uavbatt.fitting.observed import ObservedRecord

# Effects that can begin between two flights. The others are properties of the cell, or differ in every flight.
CAN_BEGIN = (
    "capacity_fade", "resistance_growth", "weak_cell", "charge_transfer", "harness_resistance", "current_gain",
    "current_offset", "unmetered_load", "voltage_gain", "voltage_offset", "temperature_offset", "temperature_lag",
    "current_delay", "airflow_cooling", "sag_compensation",
)  # fmt: skip
EARNED = 12.0  # least worth of the best of many courses (scripts/diagnose_cases_healthy.py)
EARNED_ONCE = 36.0  # for an effect in one flight only, which may be a peculiarity of that flight
GROWS = 6.0  # chi-square by which a growing effect must fit better than one that begins at once
AS_GOOD = 6.0  # chi-square difference within which another first flight is as good
MOST_EFFECTS = 2  # with their courses; every further one leaves less evidence for the others
REFITTED = 12  # courses that are refitted after all are looked through
LEAST_FLIGHTS = 2  # a course needs a flight before and one after it begins


@dataclass(frozen=True, slots=True)
class FollowedEffect:
    """A FollowedEffect is one effect with its course; flights are counted from 0 in order of time."""

    found: EffectClass
    course: Course
    earliest: int  # the first and the last flight at which it may also have begun
    latest: int
    values: tuple[Interval, ...]  # first quantity of the likeliest member, from each flight alone
    quantity: str
    off: float  # its value in the battery file
    worth: float


@dataclass(frozen=True, slots=True)
class Follow:
    """Follow holds the flights in order of time, the verdict, and the effects that were found."""

    verdict: Verdict
    flights: tuple[str, ...]
    left_out: tuple[str, ...]  # too short to tell anything
    effects: tuple[FollowedEffect, ...]
    reasons: tuple[str, ...]


def follow(
    records: Sequence[ObservedRecord],
    file: BatteryFile,
    pack: Pack,
    without: tuple[str, ...] = (),
    progress: Callable[[str], None] | None = None,
    engine: Engine = PLAIN,
) -> Follow:
    """Follow one pack over records in order of time. Raises NotEnoughData with the reason.

    without : effects to leave out; progress : is called with the name of each step; engine : simulates many columns.
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
    misfit = left_per_number(problem, best)
    why = doubts(problem, file, [t.effect for t in traces], best, misfit)
    verdict: Verdict = "undeclared_effect" if why else "effect_found" if traces else "no_missing_effect"
    return Follow(
        verdict=verdict,
        flights=tuple(names[i] for i in order),
        left_out=tuple(r.name for r in records if r.name not in names),
        effects=tuple(_followed_effect(problem, t, candidate_probability(misfit, why)) for t in traces),
        reasons=why,
    )


class _CourseFit(NamedTuple):
    """_CourseFit holds the refit of one effect on one course."""

    option: Candidate
    course: Course
    fit: Refit


class _Trace(NamedTuple):
    """_Trace holds a found effect with its course, and the other flights at which it may have begun."""

    effect: FoundEffect
    course: Course
    earliest: int
    latest: int
    own: FlightValues


def _next(problem: Problem, options: list[Candidate], before: Refit, order: Sequence[int]) -> _Trace | None:
    """Return the effect and course that explain most beside the effects of `before`; None if none is worth enough."""
    free = [o for o in options if not related(o.names, before.candidate.names)]
    if not free:
        return None
    owns = _own_values(problem, free, before, order)
    best = _best(_refitted(problem, _shortlist(free, owns), before, order), before)
    if best is None:
        return None
    place = free.index(best.option)
    likeliest = sorted(courses(len(order)), key=lambda c: -owns[place].saved(c))[:REFITTED]
    fits = _refitted(problem, [(best.option, c) for c in likeliest], before, order)
    chosen = _chosen([best, *fits])
    if not _is_earned(chosen, before, len(order)):
        return None
    rivals = trial(problem, before, [on_course(o, chosen.course, order) for o in free], FIRST_TURNS)
    if not rivals.rivals:
        return None
    effect = finding(problem, rivals, EARNED)
    as_good = [
        t.course.begins
        for t in [best, *fits]
        if t.course.grows == chosen.course.grows and t.fit.total < chosen.fit.total + AS_GOOD
    ]
    own = owns[[o.name for o in free].index(effect.name)]
    return _Trace(effect, chosen.course, min(as_good), max(as_good), own)


def _own_values(problem: Problem, free: list[Candidate], before: Refit, order: Sequence[int]) -> list[FlightValues]:
    """Return each flight's own value of every effect, from refits in which all flights have that effect."""
    with_option = [before.candidate.plus(o) for o in free]
    fits = refit(problem, with_option, start=[before] * len(with_option), iterations=FURTHER_TURNS)
    return [own_values(problem, fit, order) for fit in fits]


def _shortlist(free: list[Candidate], owns: list[FlightValues]) -> list[tuple[Candidate, Course]]:
    """Return the most promising courses: for every effect the best first flight, both steady and growing."""
    shortlist = []
    for option, own in zip(free, owns, strict=True):
        for grows in (False, True):
            likely = [c for c in courses(own.change.size) if c.grows == grows]
            if likely:
                best = max(likely, key=own.saved)
                shortlist.append((own.saved(best), option, best))
    shortlist.sort(key=lambda f: -f[0])
    return [(option, course) for _, option, course in shortlist[:REFITTED]]


def _refitted(
    problem: Problem, options: list[tuple[Candidate, Course]], before: Refit, order: Sequence[int]
) -> list[_CourseFit]:
    starts = [before.candidate.plus(on_course(option, course, order)) for option, course in options]
    fits = refit(problem, starts, start=[before] * len(starts), iterations=FIRST_TURNS)
    return [_CourseFit(option, course, fit) for (option, course), fit in zip(options, fits, strict=True)]


def _best(fits: list[_CourseFit], before: Refit) -> _CourseFit | None:
    """Return the refit with the least chi-square among those worth enough; none that stands at a physical bound."""
    flights = len(before.chi2)
    earned = [t for t in fits if not at_bound(t.fit) and _is_earned(t, before, flights)]
    return min(earned, key=lambda t: t.fit.total, default=None)


def _is_earned(course_fit: _CourseFit, before: Refit, flights: int) -> bool:
    """Return True if an effect is worth more than chance gives; in one flight only, more than a peculiarity gives."""
    gain = worth(course_fit.fit, before)
    if not course_fit.course.grows and course_fit.course.begins == flights - 1:  # no other flight can confirm it
        return gain.most * gain.known > EARNED_ONCE
    return gain.value > EARNED


def _chosen(fits: list[_CourseFit]) -> _CourseFit:
    """Return the best course; a growing one only if it is clearly better than every steady one."""
    possible = [t for t in fits if not at_bound(t.fit)]
    return min(possible, key=lambda t: t.fit.total - (GROWS if not t.course.grows else 0.0))


def _followed_effect(problem: Problem, trace: _Trace, sure: float) -> FollowedEffect:
    """Return the effect for display, with each flight's own value."""
    fit = trace.effect.members[0]
    freed = fit.candidate.freed[fit.candidate.slice_of(trace.effect.name)][0]
    name = QUANTITIES[freed.index].name
    off, half = problem.base[freed.index], COVERAGE * trace.own.sd
    values = [off + change for change in trace.own.change]
    own = tuple(
        Interval(float(v), float(max(v - h, freed.low)), float(min(v + h, freed.high)), UNITS[name])
        for v, h in zip(values, half, strict=True)
    )
    effect_class = class_of(problem, trace.effect, sure)
    course, saved = trace.course, trace.effect.worth.value
    return FollowedEffect(effect_class, course, trace.earliest, trace.latest, own, name, float(off), saved)
