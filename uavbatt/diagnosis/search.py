"""Which effect, or which two, explain the records: every single one is tried, then every promising pair as a pair.

An effect earns its place by its `worth` and by nothing else. Two effects are named only when each of the two earns its
place beside the other; that the second looks like nothing as long as the first is not there is no obstacle then.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.diagnosis.candidates import Candidate
from uavbatt.diagnosis.drift import WARMS, drifting, saved
from uavbatt.diagnosis.problem import Problem, Refit
from uavbatt.diagnosis.refit import SETTLED, refit
from uavbatt.diagnosis.rivals import FARTHEST, RIVAL_SHARE, members_of_class, related, same, weights
from uavbatt.diagnosis.worth import Constancy, Worth, at_bound, left_out_chi2, worth

EARNED = 3.0  # more than chance gave in 140 effect-free sets, 2.84: docs/diagnosis.md
EARNED_EACH = 3.5  # each of two where no single effect explains the flights; half of it: a rival, not a chance
SMALL = 1.5  # what may hide where nothing is told: one healthy set in twenty shows more
EVEN = 6.0  # what is worth no more than that is as likely as not a chance, and told as a suspect
SUSPECT = 0.4  # the most that is said of what is worth less than that, and of a model that is doubted
EARNED_BESIDE = 12.0  # each of two: what is not quite the one named leaves most of that
EARNED_IN_PART = 24.0  # beside a start in part
EARNED_TOGETHER = 36.0  # chi-square by which two leave less than the best single effect
UNSTEADY = 0.35  # spread between records, relative to the value: an sd, and the most that is called steady
SEATED = 0.95  # of the rivals' probability: a class has room for so much of it before it leaves one out
RESIZED = 0.25  # how likely another size of what the file has is, against something that it lacks
SEEDS, SEED_SHARE = 4, 0.3  # singles that pairs are built on: how many at most, with which share of the best's gain
TRIED = 6  # pairs that are weighed against each other
FIRST_TURNS, FURTHER_TURNS = 14, 8


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
        return _steady(self.worth.constancy) and self.drift is None


@dataclass(frozen=True, slots=True)
class Trial:
    """Trial tells what each single effect is worth beside what the model has."""

    before: Refit
    fits: tuple[Refit, ...]  # by chi-square
    worths: tuple[Worth, ...]
    least: float = 0.5 * EARNED_EACH  # that a rival is worth

    @property
    def largest_worth(self) -> float:
        """Return the largest worth of all that do not stand at a bound; 0 if all do."""
        return max((w.value for f, w in zip(self.fits, self.worths, strict=True) if not at_bound(f)), default=0.0)

    @property
    def rivals(self) -> list[int]:
        """Return the places of those that could be the cause if there is one, by chi-square.

        They need not earn their place alone.
        """
        places, least = range(len(self.fits)), max(self.least, RIVAL_SHARE * self.largest_worth)
        possible = [i for i in places if not at_bound(self.fits[i])]
        worthy = [i for i in possible if self.worths[i].value > least]
        # What explains more than they do is a rival too, and what leaves the same as the best of them by another name,
        # if that is not the same as nothing.
        first = worthy[0] if worthy else -1
        return [
            i
            for i in possible
            if i in worthy
            or (i < first and self.worths[i].value > EARNED_EACH)
            or (worthy and same(self.fits[i], self.fits[first]) and self._is_something(i))
        ]

    def _is_something(self, i: int) -> bool:
        return self.worths[i].value > 0.5 * EARNED_EACH or not same(self.fits[i], self.before)


def search(
    problem: Problem,
    options: list[Candidate],
    nothing: Refit,
    explains: Callable[[Refit, bool], bool],
    tell: Callable[[str], None],
) -> tuple[Refit, list[FoundEffect], Trial]:
    """Search for the missing effect, or two; return the best model, what was found and the trial of single effects.

    What was found comes with most evidence first. explains : asked with a model, and True if it is more than a suspect,
    says if it leaves no more than the file's own; two effects are asked for less where no single one does.
    """
    tell(f"{len(options)} candidate effects")
    singles = trial(problem, nothing, options, FIRST_TURNS)
    in_part = problem.evidence.charged_in_part.any()  # the start is an effect already
    found: list[FoundEffect] = []
    best, least = nothing, EARNED_IN_PART if in_part else EARNED
    if singles.largest_worth >= least:
        found = [finding(problem, singles, max(least, EVEN))]
        best = found[0].members[0]
    is_explained = explains(best, singles.largest_worth >= EVEN)
    found = [replace(found[0], drift=_drift(problem, found[0].members, singles))] if found else _warms(problem, singles)
    drift = found[0].drift if found else None
    # Nothing, or a suspect: no ground to build a pair on.
    if drift is None and is_explained and singles.largest_worth < EVEN:
        return best, found, singles
    tell("pairs of effects")
    pair = _best_pair(problem, options, singles, drift or best, is_explained)
    if pair is None:
        return best, found, singles
    trials = []
    for known in (pair.with_effects_swapped, pair):
        alone = next(f for f in singles.fits if f.candidate.name == known.candidate.names[0])
        alone = refit(problem, [alone.candidate], start=[alone], iterations=SETTLED)[0]  # else all get the credit
        trials.append(trial(problem, alone, options, FURTHER_TURNS, known))
    if not all(t.rivals for t in trials):  # refitted beside the other, it stands at a bound or is worth nothing
        return best, found, singles
    both = [finding(problem, t, earned_beside(problem, pair.candidate, is_explained=True)) for t in trials]
    if any(f.worth.value < EARNED_EACH for f in both):
        return best, found, singles
    best = min((f.members[0] for f in both), key=lambda f: f.total)
    return best, sorted(both, key=lambda f: -f.worth.value), singles


def small(problem: Problem, singles: Trial) -> FoundEffect | None:
    """Return the small effect that may hide where nothing is found, if the records show more than most healthy ones."""
    if not SMALL < singles.largest_worth < EARNED:
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


def trial(problem: Problem, before: Refit, options: list[Candidate], turns: int, known: Refit | None = None) -> Trial:
    """Try every option beside what `before` has.

    turns : iterations of the refits; known : the refit that one of them is known to end in, where that one starts.
    """
    free = [o for o in options if not related(o.names, before.candidate.names)]
    tried = [before.candidate.plus(o) for o in free]
    starts = [known if known is not None and c.names == known.candidate.names else before for c in tried]
    fits = refit(problem, tried, start=starts, iterations=turns)
    fits.sort(key=lambda f: f.total)
    return Trial(before, tuple(fits), tuple(worth(f, before) for f in fits))


def finding(problem: Problem, tried: Trial, earned: float) -> FoundEffect:
    """Return the class of the rivals that cannot be told from the best, which had to be worth more than `earned`.

    A rival is the less likely the more it differs from record to record, and a hair of steadiness decides nothing.

    What is hardly worth that is as likely as not a chance: the second of two that were worth 12 to 15 was right in
    five of eight cases.
    """
    fits = [tried.fits[i] for i in tried.rivals]
    spread = np.array([c.spread if (c := tried.worths[i].constancy) else 0.0 for i in tried.rivals])
    likely = _likely(problem, fits) * np.exp(-0.5 * np.minimum(spread / UNSTEADY, FARTHEST) ** 2)
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


def earned_beside(problem: Problem, pair: Candidate, *, is_explained: bool) -> float:
    """Return what each of two effects must be worth.

    It is more beside a start in part, which the file has never seen, and less where no single effect explains the
    flights.
    """
    if "initial_charge" in pair.names or problem.evidence.charged_in_part.any():
        return EARNED_IN_PART
    return EARNED_BESIDE if is_explained else EARNED_EACH


def _steady(found: Constancy | None) -> bool:
    return found is None or found.spread <= UNSTEADY


def _best_pair(
    problem: Problem, options: list[Candidate], singles: Trial, best: Refit, is_explained: bool
) -> Refit | None:
    """The two effects that explain most, each of which earns its place beside the other; None if no two do."""
    most = singles.before.total - singles.fits[0].total
    gains = [singles.before.total - f.total for f in singles.fits]
    seeds = [f for f, g in zip(singles.fits, gains, strict=True) if g > SEED_SHARE * most][:SEEDS]
    tried: list[Candidate] = []
    starts: list[Refit] = []
    for seed in seeds:
        for option in options:
            names = {*seed.candidate.names, option.name}
            if not related(option.names, seed.candidate.names) and names not in [set(c.names) for c in tried]:
                tried.append(seed.candidate.plus(option))
                starts.append(seed)
    fits = sorted(refit(problem, tried, start=starts, iterations=FURTHER_TURNS), key=lambda f: f.total)
    alone = {f.candidate.name: f for f in singles.fits}
    one_leaves, together = float(np.sum(left_out_chi2(best))), EARNED_TOGETHER if is_explained else EARNED_BESIDE
    earned = []
    for fit in fits:
        one, other = fit.candidate.names
        if at_bound(fit) or one_leaves - float(np.sum(left_out_chi2(fit))) < together:
            continue
        least = earned_beside(problem, fit.candidate, is_explained=is_explained)
        beside = [worth(fit, alone[a], b) for a, b in ((one, other), (other, one))]
        if all(w.value > least and _steady(w.constancy) for w in beside):
            earned.append(fit)
    if not earned:
        return None
    return earned[int(np.argmax(_likely(problem, earned[:TRIED])))]


def _likely(problem: Problem, fits: list[Refit]) -> Array:
    """Return how likely each of `fits` is, which come by chi-square.

    Another size of what the file has leaves least by its ease of bending; where it is not the likeliest all the same,
    the others are held against the best of themselves and not against it.
    """
    usual = np.array([RESIZED ** len(f.candidate.resized) for f in fits])
    likely: Array = weights(problem, fits) * usual
    if np.argmax(likely) and usual[0] < 1.0:
        likely = weights(problem, fits, int(np.argmax(usual))) * usual
    return likely
