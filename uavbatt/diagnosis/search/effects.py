"""Search for the effect, or the two effects, that explain the records: first single effects, then promising pairs.

The only criterion for an effect is its `worth`. Two effects are named only if each of them is worth enough beside the
other. A pair is refitted as a pair, so that an effect can be found that looks like nothing while the other is missing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from uavbatt.diagnosis.refit.candidates import Candidate, Course
from uavbatt.diagnosis.refit.problem import Problem, Refit
from uavbatt.diagnosis.refit.solver import SETTLED, refit
from uavbatt.diagnosis.search.drift import VARIES_WITH_TEMPERATURE, drifting
from uavbatt.diagnosis.search.pairs import (
    EARNED_BESIDE,
    EARNED_IN_PART,
    EARNED_TOGETHER,
    Pair,
    asked_of_each,
    best_pair,
)
from uavbatt.diagnosis.search.rivals import FARTHEST, members_of_class
from uavbatt.diagnosis.search.slow_sensor import following
from uavbatt.diagnosis.search.trial import EARNED, FIRST_TURNS, FURTHER_TURNS, Trial, likeliness, trial
from uavbatt.diagnosis.search.worth import UNSTEADY, Worth, is_steady, left_out_chi2, saved, worth

EVEN = 6.0  # an effect worth no more is a suspect: it may well be chance
SUSPECT = 0.4  # highest probability of a suspect, and under a doubted model
SEATED = 0.95  # share of the rivals' probability that a class should hold


@dataclass(frozen=True, slots=True)
class FoundEffect:
    """FoundEffect holds the refits (`members`) that the records cannot tell apart, best first, and their worth."""

    members: tuple[Refit, ...]
    worth: Worth
    outside: tuple[str, ...]  # the other rivals, in order
    probability: float  # that the cause is a member, if it is a candidate and not chance
    drift: Refit | None = None  # the refit in which the effect drifts within each record, if that explains much more
    slow: Refit | None = None  # the refit in which a delay is a filter instead, if that explains much more

    @property
    def name(self) -> str:
        """Return the name of the likeliest effect."""
        return self.members[0].candidate.name

    @property
    def steady(self) -> bool:
        """Return True if the records agree on the value, it does not drift within a record, and a delay is one."""
        return is_steady(self.worth.constancy) and self.drift is None and self.slow is None


def search(
    problem: Problem,
    options: list[Candidate],
    unchanged: Refit,
    explains: Callable[[Refit], bool],
    tell: Callable[[str], None],
) -> tuple[Refit, list[FoundEffect], Trial]:
    """Search for the missing effect, or two; return the best model, what was found and the trial of single effects.

    The found effects come in order of evidence. explains : returns True if a model leaves no more than the file's own;
    then no pair is built on a suspect.
    """
    tell(f"{len(options)} candidate effects")
    singles = trial(problem, unchanged, options, FIRST_TURNS)
    in_part = problem.evidence.charged_in_part.any()  # the start is an effect already
    effects: list[FoundEffect] = []
    best, least = unchanged, EARNED_IN_PART if in_part else EARNED
    if singles.largest_worth >= least:
        effects = [finding(problem, singles, max(least, EVEN))]
        best = effects[0].members[0]
    effects = (
        [replace(effects[0], drift=_drift(problem, effects[0].members, singles))]
        if effects
        else _drifting_gain(problem, singles)
    )
    drift = effects[0].drift if effects else None
    # Nothing was found, or only a suspect: no pair is built on it.
    if drift is None and singles.largest_worth < EVEN and explains(best):
        return best, effects, singles
    tell("pairs of effects")
    pair = best_pair(problem, options, singles, drift or best)
    if pair is not None and drift is not None and saved(pair.fit, drift) <= EARNED_TOGETHER:
        pair = None  # a drift says as much with one effect as the pair with two
    two = _two(problem, options, singles, pair) if pair is not None else []
    if not two:
        return best, effects, singles
    return min((f.members[0] for f in two), key=lambda f: f.total), two, singles


def _two(problem: Problem, options: list[Candidate], singles: Trial, pair: Pair) -> list[FoundEffect]:
    """Return the two effects of a pair, each with its rivals beside the other; none if one is worth too little."""
    both = []
    for alternative in (pair.fit.with_effects_swapped, pair.fit):
        alone = next(f for f in singles.fits if f.candidate.name == alternative.candidate.names[0])
        beside = trial(problem, _settled(problem, alone), options, FURTHER_TURNS, alternative)
        if not beside.rivals:  # refitted beside the other, it stands at a bound or is worth nothing
            return []
        pair_finding = finding(problem, beside, max(asked_of_each(problem, pair.fit.candidate), EARNED_BESIDE))
        share = max(pair.share(member.candidate.name) for member in pair_finding.members)
        if share == 0.0:  # no pair that passed has such a member: what stands there now is another model
            return []
        both.append(replace(pair_finding, probability=min(pair_finding.probability, share)))
    if any(f.worth.value < EARNED for f in both):
        return []
    return sorted(both, key=lambda f: -f.worth.value)


def _settled(problem: Problem, fit: Refit) -> Refit:
    """Return a refit that has converged: what has not would be credited to the next effect."""
    return refit(problem, [fit.candidate], start=[fit], iterations=SETTLED)[0]


def small(problem: Problem, singles: Trial) -> FoundEffect | None:
    """Return a small effect that may be present although none was found; None if the records look like healthy ones."""
    if not 0.5 * EARNED < singles.largest_worth < EARNED:
        return None
    return finding(problem, replace(singles, least=0.5 * singles.largest_worth), EVEN)


def _drift(problem: Problem, members: tuple[Refit, ...], singles: Trial) -> Refit | None:
    """Return the best refit with a drift within each record, if it saves as much as a second effect would have to.

    Every effect of a sensor or of the wiring may drift with time, whatever the best single effect is: a steady value
    may fit it badly, so that another effect stands in its place. The voltage gain may drift with temperature, too. What
    drifts must save as much beside the member of the class that predicts best.
    """
    steadiest = min(members, key=lambda fit: float(np.sum(left_out_chi2(fit))))
    saves = []
    for fit in singles.fits:
        drifts = [drift for along in _courses(problem, fit) if (drift := drifting(problem, fit, along)) is not None]
        steady = (_settled(problem, fit), steadiest) if drifts else ()
        saves += [(min(saved(drift, s) for s in steady), drift) for drift in drifts]
    most, best = max(saves, key=lambda save: save[0], default=(0.0, None))
    return best if most > EARNED_TOGETHER else None


def _courses(problem: Problem, fit: Refit) -> tuple[Course, ...]:
    """Return along what an effect may drift: time, and for the voltage gain the temperature if every record has it."""
    warms = fit.candidate.name == VARIES_WITH_TEMPERATURE and problem.evidence.has_temperature
    return ("time", "temperature") if warms else ("time",)


def _drifting_gain(problem: Problem, singles: Trial) -> list[FoundEffect]:
    """Return a voltage gain that changes with temperature as the finding, for records in which no effect was found.

    Part of its saving may come from errors of the file; it must therefore be worth as much as each effect of a pair,
    and the drift must save something beside the same gain without it.
    """
    for fit in [fit for fit in singles.fits if "temperature" in _courses(problem, fit)]:
        drift = drifting(problem, fit, "temperature")
        if drift is None or not saved(drift, _settled(problem, fit)) > EARNED_TOGETHER:
            continue
        if (gain := worth(drift, singles.before)).value > EARNED_BESIDE:
            sure = no_chance(problem, fit, singles.before, gain, EARNED_BESIDE)
            return [FoundEffect(members=(fit,), worth=gain, outside=(), probability=sure, drift=drift)]
    return []


def finding(problem: Problem, trial: Trial, earned: float) -> FoundEffect:
    """Return the class of the rivals that the records cannot tell from the best one.

    The likelihood of a rival falls with the spread of its value between records; small differences of that spread have
    little influence. `earned` is the worth that the best one had to exceed. An effect that barely exceeds it may well
    be chance: of eight second effects with a worth of 12 to 15, five were right.
    """
    fits = [trial.fits[i] for i in trial.rivals]
    spread = np.array([c.spread if (c := trial.worths[i].constancy) else 0.0 for i in trial.rivals])
    likely = likeliness(problem, fits) * np.exp(-0.5 * np.minimum(spread / UNSTEADY, FARTHEST) ** 2)
    likely = likely / np.sum(likely)
    order = np.argsort(-likely, kind="stable")
    order = order[: 1 + np.searchsorted(np.cumsum(likely[order]), SEATED)]
    members = [int(order[k]) for k in members_of_class([fits[i] for i in order], likely[order], trial.before)]
    gain = trial.worths[trial.rivals[members[0]]]
    return FoundEffect(
        members=tuple(fits[i] for i in members),
        worth=gain,
        outside=tuple(f.candidate.name for i, f in enumerate(fits) if i not in members),
        probability=float(np.sum(likely[members])) * no_chance(problem, fits[members[0]], trial.before, gain, earned),
        slow=_slow(problem, fits[members[0]]),
    )


def _slow(problem: Problem, fit: Refit) -> Refit | None:
    """Return the refit of a delay as a filter, if it saves as much as a second effect would have to."""
    filtered = following(problem, fit)
    return filtered if filtered and saved(filtered, _settled(problem, fit)) > EARNED_TOGETHER else None


def no_chance(problem: Problem, fit: Refit, before: Refit, gain: Worth, earned: float) -> float:
    """Return the probability that an effect is not chance, from its worth and the worth that it had to exceed.

    An effect of a pair is judged in two ways, and the mean counts, because each way was wrong in cases where the other
    was right: with the errors of the file held fixed, and with all of them at their most probable values, which may
    explain the effect away. The probability is limited to SUSPECT unless flights that are no colder than those which
    the file's error was learned on give the required worth: in the cold that error is only a guess.
    """
    views = [max(gain.value, 0.0)]
    if before.candidate.names:
        bent = refit(problem, [fit.candidate, before.candidate], start=[fit, before], file_errors=True)
        views.append(min(max(bent[1].total - bent[0].total, 0.0), views[0]))
    share = float(np.mean([view / (view + earned) for view in views]))
    known_there = min(gain.value, gain.on(problem.evidence.familiar))
    return share if known_there >= earned else min(share, SUSPECT)
