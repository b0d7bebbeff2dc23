"""Which effect, or which two, explain the records: every single one is tried, then every promising pair as a pair.

An effect earns its place by its `worth` and by nothing else. Two effects are named only when each of the two earns its
place beside the other; that the second looks like nothing as long as the first is not there is no obstacle then.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from uavbatt.diagnosis.candidates import Candidate
from uavbatt.diagnosis.drift import WARMS, drifting, saved
from uavbatt.diagnosis.pairs import EARNED_BESIDE, EARNED_IN_PART, EARNED_TOGETHER, Pair, asked_of_each, best_pair
from uavbatt.diagnosis.problem import Problem, Refit
from uavbatt.diagnosis.refit import SETTLED, refit
from uavbatt.diagnosis.rivals import FARTHEST, members_of_class, same
from uavbatt.diagnosis.trial import EARNED, FIRST_TURNS, FURTHER_TURNS, Trial, likeliness, trial
from uavbatt.diagnosis.worth import UNSTEADY, Worth, is_steady, left_out_chi2, worth

EVEN = 6.0  # what is worth no more than that is as likely as not a chance, and told as a suspect
SUSPECT = 0.4  # the most that is said of what is worth less than that, and of a model that is doubted
SEATED = 0.95  # of the rivals' probability: a class has room for so much of it before it leaves one out


@dataclass(frozen=True, slots=True)
class FoundEffect:
    """A missing effect is known by the refits that cannot be told apart, best first, and by what they are worth."""

    members: tuple[Refit, ...]
    worth: Worth
    outside: tuple[str, ...]  # the other rivals, in order
    probability: float  # that the cause is among the members, were it one of the candidates and no chance
    drift: Refit | None = None  # with the effect drifting within each record, where that explains much more

    @property
    def name(self) -> str:
        """Return the name of the likeliest effect."""
        return self.members[0].candidate.name

    @property
    def steady(self) -> bool:
        """Return True if the records agree on its value, and each of them from its beginning to its end."""
        return is_steady(self.worth.constancy) and self.drift is None


def search(
    problem: Problem,
    options: list[Candidate],
    nothing: Refit,
    explains: Callable[[Refit], bool],
    tell: Callable[[str], None],
) -> tuple[Refit, list[FoundEffect], Trial]:
    """Search for the missing effect, or two; return the best model, what was found and the trial of single effects.

    What was found comes with most evidence first. explains : says of a model if it leaves no more than the
    file's own; then no pair is built on a suspect.
    """
    tell(f"{len(options)} candidate effects")
    singles = trial(problem, nothing, options, FIRST_TURNS)
    in_part = problem.evidence.charged_in_part.any()  # the start is an effect already
    found: list[FoundEffect] = []
    best, least = nothing, EARNED_IN_PART if in_part else EARNED
    if singles.largest_worth >= least:
        found = [finding(problem, singles, max(least, EVEN))]
        best = found[0].members[0]
    found = [replace(found[0], drift=_drift(problem, found[0].members, singles))] if found else _warms(problem, singles)
    drift = found[0].drift if found else None
    # Nothing, or a suspect: no ground to build a pair on.
    if drift is None and singles.largest_worth < EVEN and explains(best):
        return best, found, singles
    tell("pairs of effects")
    pair = best_pair(problem, options, singles, drift or best)
    two = _two(problem, options, singles, pair) if pair is not None else []
    if not two:
        return best, found, singles
    return min((f.members[0] for f in two), key=lambda f: f.total), two, singles


def _two(problem: Problem, options: list[Candidate], singles: Trial, pair: Pair) -> list[FoundEffect]:
    """Return the two effects of a pair, each with its rivals beside the other; none if one of them falls there."""
    both = []
    for known in (pair.fit.with_effects_swapped, pair.fit):
        alone = next(f for f in singles.fits if f.candidate.name == known.candidate.names[0])
        alone = refit(problem, [alone.candidate], start=[alone], iterations=SETTLED)[0]  # else all get the credit
        beside = trial(problem, alone, options, FURTHER_TURNS, known)
        if not beside.rivals:  # refitted beside the other, it stands at a bound or is worth nothing
            return []
        found = finding(problem, beside, max(asked_of_each(problem, pair.fit.candidate), EARNED_BESIDE))
        share = max(pair.share(member.candidate.name) for member in found.members)
        both.append(replace(found, probability=min(found.probability, share)))
    if any(f.worth.value < EARNED for f in both):
        return []
    return sorted(both, key=lambda f: -f.worth.value)


def small(problem: Problem, singles: Trial) -> FoundEffect | None:
    """Return the small effect that may hide where nothing is found, if the records show more than most healthy ones."""
    if not 0.5 * EARNED < singles.largest_worth < EARNED:
        return None
    return finding(problem, replace(singles, least=0.5 * singles.largest_worth), EVEN)


def _drift(problem: Problem, members: tuple[Refit, ...], singles: Trial) -> Refit | None:
    """Return the refit with a drift within each record that saves most, if it saves as much as a second effect has to.

    Over time the best single effect may drift, by any of its names. Over temperature the gain of the voltage may, and
    is held against the member of the class that predicts best.
    """
    tried = [(drifting(problem, fit), fit) for fit in members if same(fit, members[0])]
    steadiest = min(members, key=lambda fit: float(np.sum(left_out_chi2(fit))))
    tried += [(drifting(problem, fit, "temperature"), steadiest) for fit in _that_warm(problem, singles)]
    saves = [(saved(drift, steady), drift) for drift, steady in tried if drift is not None]
    most, best = max(saves, key=lambda save: save[0], default=(0.0, None))
    return best if most > EARNED_TOGETHER else None


def _that_warm(problem: Problem, singles: Trial) -> list[Refit]:
    """The refit of the gain of the voltage, where there is a temperature that it could go with."""
    known = problem.evidence.has_temperature
    return [fit for fit in singles.fits if known and fit.candidate.name == WARMS]


def _warms(problem: Problem, singles: Trial) -> list[FoundEffect]:
    """Return a gain of the voltage that goes with the temperature as the finding, where no effect is named.

    What it saves is then in part the file's errors', so that it has to be worth what each of two effects is.
    """
    for fit in _that_warm(problem, singles):
        drift = drifting(problem, fit, "temperature")
        if drift is not None and (its := worth(drift, singles.before)).value > EARNED_BESIDE:
            sure = no_chance(problem, fit, singles.before, its, EARNED_BESIDE)
            return [FoundEffect(members=(fit,), worth=its, outside=(), probability=sure, drift=drift)]
    return []


def finding(problem: Problem, tried: Trial, earned: float) -> FoundEffect:
    """Return the class of the rivals that cannot be told from the best, which had to be worth more than `earned`.

    A rival is the less likely the more it differs from record to record, and a hair of steadiness decides nothing.

    What is hardly worth that is as likely as not a chance: the second of two that were worth 12 to 15 was right in
    five of eight cases.
    """
    fits = [tried.fits[i] for i in tried.rivals]
    spread = np.array([c.spread if (c := tried.worths[i].constancy) else 0.0 for i in tried.rivals])
    likely = likeliness(problem, fits) * np.exp(-0.5 * np.minimum(spread / UNSTEADY, FARTHEST) ** 2)
    likely = likely / np.sum(likely)
    order = np.argsort(-likely, kind="stable")
    order = order[: 1 + np.searchsorted(np.cumsum(likely[order]), SEATED)]
    members = [int(order[k]) for k in members_of_class([fits[i] for i in order], likely[order], tried.before)]
    its = tried.worths[tried.rivals[members[0]]]
    return FoundEffect(
        members=tuple(fits[i] for i in members),
        worth=its,
        outside=tuple(f.candidate.name for i, f in enumerate(fits) if i not in members),
        probability=float(np.sum(likely[members])) * no_chance(problem, fits[members[0]], tried.before, its, earned),
    )


def no_chance(problem: Problem, fit: Refit, before: Refit, its: Worth, earned: float) -> float:
    """Return how likely it is that an effect is no chance, by what it is worth against what it had to be worth.

    One of two is judged twice: with the errors of the file held, and with all of them at their most probable value,
    which may leave it nothing to explain. Either view has been wrong where the other was right. What it had to be worth
    has to come from flights no colder than those that the file's error was learned on: below, that error is a guess.
    """
    views = [max(its.value, 0.0)]
    if before.candidate.names:
        bent = refit(problem, [fit.candidate, before.candidate], start=[fit, before], file_errors=True)
        views.append(min(max(bent[1].total - bent[0].total, 0.0), views[0]))
    share = float(np.mean([view / (view + earned) for view in views]))
    known_there = min(its.value, its.on(problem.evidence.familiar))
    return share if known_there >= earned else min(share, SUSPECT)
