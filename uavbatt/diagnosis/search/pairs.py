"""The pair of effects that explains the records, if no single effect does: every promising pair is refitted as a pair.

Each effect of a pair must be worth enough beside the other. The pairs that pass are grouped into families: pairs of the
same two causes under other names. The family with the largest total likelihood is chosen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.diagnosis.refit.candidates import Candidate
from uavbatt.diagnosis.refit.problem import Problem, Refit
from uavbatt.diagnosis.refit.solver import refit
from uavbatt.diagnosis.search.rivals import RIVAL_SHARE, family, related
from uavbatt.diagnosis.search.trial import EARNED, FURTHER_TURNS, Trial, likeliness
from uavbatt.diagnosis.search.worth import at_bound, is_steady, left_out_chi2, worth

EARNED_BESIDE = 12.0  # least worth of the weaker effect of a pair that leaves EARNED_TOGETHER less
EARNED_IN_PART = 24.0  # least worth of each effect of a pair, if packs began charged in part
EARNED_TOGETHER = (
    36.0  # chi-square by which a pair, or one effect that drifts, must leave less than the best single one
)
SEEDS, SEEDS_IN_ALL = 4, 7  # singles that pairs are built on: by what they explain, and with the other families
TRIED = 12  # pairs that are weighed against each other


@dataclass(frozen=True, slots=True)
class Pair:
    """Pair holds the refit of two effects, with the families and the likelihoods of all pairs that passed."""

    fit: Refit
    kinds: tuple[frozenset[frozenset[str]], ...]
    likely: Array

    def share(self, name: str) -> float:
        """Return the probability that one of the two is of the family of `name`, over all pairs that passed."""
        those = [family(name) in kind for kind in self.kinds]
        return float(np.sum(self.likely[those]) / np.sum(self.likely))


def asked_of_each(problem: Problem, pair: Candidate) -> float:
    """Return the least worth of each effect of a pair; it is larger if packs began charged in part."""
    in_part = "initial_charge" in pair.names or problem.evidence.charged_in_part.any()
    return EARNED_IN_PART if in_part else EARNED


def best_pair(problem: Problem, options: list[Candidate], singles: Trial, best: Refit) -> Pair | None:
    """Return the two effects that explain most, each worth enough beside the other; None if no pair passes."""
    earned = complete(problem, _earning_pairs(problem, options, singles, best)[:TRIED], singles)
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
    promising = [f for f, g in zip(singles.fits, gains, strict=True) if g > RIVAL_SHARE * gains[0]]
    seeds = promising[:SEEDS]
    for fit in promising[SEEDS:]:
        names = [name for seed in seeds for name in seed.candidate.names]
        if len(seeds) < SEEDS_IN_ALL and not related(fit.candidate.names, names):
            seeds.append(fit)
    return seeds


def _earning_pairs(problem: Problem, options: list[Candidate], singles: Trial, best: Refit) -> list[Refit]:
    """Return, by chi-square, the pairs in which each effect is worth enough beside the other."""
    pairs: list[Candidate] = []
    starts: list[Refit] = []
    for seed in _seeds(singles):
        for option in options:
            names = {*seed.candidate.names, option.name}
            if not related(option.names, seed.candidate.names) and names not in [set(c.names) for c in pairs]:
                pairs.append(seed.candidate.plus(option))
                starts.append(seed)
    fits = sorted(refit(problem, pairs, start=starts, iterations=FURTHER_TURNS), key=lambda f: f.total)
    alone = {f.candidate.name: f for f in singles.fits}
    one_leaves = float(np.sum(left_out_chi2(best)))
    earned = []
    for fit in fits:
        one, other = fit.candidate.names
        saves = one_leaves - float(np.sum(left_out_chi2(fit)))
        if at_bound(fit):
            continue
        beside = [worth(fit, alone[a], b) for a, b in ((one, other), (other, one))]
        lesser = min(w.value for w in beside)
        enough = lesser > asked_of_each(problem, fit.candidate) and are_two(lesser, saves)
        if enough and all(is_steady(w.constancy) for w in beside):
            earned.append(fit)
    return earned


def are_two(lesser: float, saves: float) -> bool:
    """Return True if a pair is not chance: the less its weaker effect is worth, the more the pair has to save.

    lesser : worth of the weaker effect; saves : chi-square that the pair leaves less than the best single effect
    """
    return saves > 0.0 and lesser * saves > EARNED_BESIDE * EARNED_TOGETHER


def complete(problem: Problem, pairs: list[Refit], singles: Trial) -> list[Refit]:
    """Return the pairs that lack no third effect: the worthiest single effect adds little to them."""
    worths = [-np.inf if at_bound(f) else w.value for f, w in zip(singles.fits, singles.worths, strict=True)]
    worthiest = singles.fits[int(np.argmax(worths))].candidate
    without = [fit for fit in pairs if not related(worthiest.names, fit.candidate.names)]
    if not without:
        return pairs
    wholes = [fit.candidate.plus(worthiest) for fit in without]
    three = refit(problem, wholes, start=without, iterations=FURTHER_TURNS)
    lacking = [
        one for one, all_three in zip(without, three, strict=True) if worth(all_three, one).value > EARNED_BESIDE
    ]
    return [fit for fit in pairs if not any(fit is one for one in lacking)]
