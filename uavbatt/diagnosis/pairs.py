"""The pair of effects that explains the records where one effect does not: every promising pair is refitted as a pair.

Each effect of a pair must be worth enough beside the other. The pairs that pass are grouped into families: pairs of the
same two causes under other names. The family with the largest total likelihood is chosen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.diagnosis.candidates import Candidate
from uavbatt.diagnosis.problem import Problem, Refit
from uavbatt.diagnosis.refit import refit
from uavbatt.diagnosis.rivals import family, related
from uavbatt.diagnosis.trial import EARNED_EACH, FURTHER_TURNS, Trial, likeliness
from uavbatt.diagnosis.worth import at_bound, is_steady, left_out_chi2, worth

EARNED_BESIDE = 12.0  # each of two: what is not quite the one named leaves most of that
EARNED_IN_PART = 24.0  # beside a start in part
EARNED_TOGETHER = 36.0  # chi-square by which two leave less than the best single effect
SEEDS, SEEDS_IN_ALL = 4, 7  # singles that pairs are built on: by what they explain, and with the other families
SEED_SHARE = 0.3  # of what the best explains: the least of a seed
TRIED = 12  # pairs that are weighed against each other


@dataclass(frozen=True, slots=True)
class Pair:
    """The refit of two effects, with the families and the likelihoods of all pairs that passed."""

    fit: Refit
    kinds: tuple[frozenset[frozenset[str]], ...]
    likely: Array

    def share(self, name: str) -> float:
        """Return the probability that one of the two is of the family of `name`, over all pairs that passed."""
        those = [family(name) in kind for kind in self.kinds]
        return float(np.sum(self.likely[those]) / np.sum(self.likely))


def earned_beside(problem: Problem, pair: Candidate, *, is_explained: bool) -> float:
    """Return what each of two effects must be worth.

    It is more beside a start in part, which the file has never seen, and less where no single effect explains the
    flights.
    """
    if "initial_charge" in pair.names or problem.evidence.charged_in_part.any():
        return EARNED_IN_PART
    return EARNED_BESIDE if is_explained else EARNED_EACH


def best_pair(
    problem: Problem, options: list[Candidate], singles: Trial, best: Refit, is_explained: bool
) -> Pair | None:
    """Return the two effects that explain most, each worth enough beside the other; None if no pair passes."""
    earned = _earned(problem, options, singles, best, is_explained)[:TRIED]
    if not earned:
        return None
    likely = likeliness(problem, earned)
    kinds = tuple(frozenset(family(name) for name in fit.candidate.names) for fit in earned)
    likeliest = max(kinds, key=lambda kind: float(np.sum(likely[[other == kind for other in kinds]])))
    of_kind = np.where([kind == likeliest for kind in kinds], likely, 0.0)
    return Pair(earned[int(np.argmax(of_kind))], kinds, likely)


def _seeds(singles: Trial) -> list[Refit]:
    """Return the single effects that pairs are built on: those that explain most, and the best of each other family.

    The best of each family is needed because the four largest may all be names of one voltage drop under load, while
    the two missing effects are a sensor error and a loss of capacity.
    """
    gains = [singles.before.total - f.total for f in singles.fits]
    promising = [f for f, g in zip(singles.fits, gains, strict=True) if g > SEED_SHARE * gains[0]]
    seeds = promising[:SEEDS]
    for fit in promising[SEEDS:]:
        known = [name for seed in seeds for name in seed.candidate.names]
        if len(seeds) < SEEDS_IN_ALL and not related(fit.candidate.names, known):
            seeds.append(fit)
    return seeds


def _earned(problem: Problem, options: list[Candidate], singles: Trial, best: Refit, is_explained: bool) -> list[Refit]:
    """The pairs of which each effect earns its place beside the other, by chi-square."""
    tried: list[Candidate] = []
    starts: list[Refit] = []
    for seed in _seeds(singles):
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
        if all(w.value > least and is_steady(w.constancy) for w in beside):
            earned.append(fit)
    return earned
