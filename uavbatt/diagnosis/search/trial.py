"""A trial of single effects: the worth of each beside the effects of the model, the rivals, and their likelihoods."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.diagnosis.refit.candidates import Candidate
from uavbatt.diagnosis.refit.problem import Problem, Refit
from uavbatt.diagnosis.refit.solver import refit
from uavbatt.diagnosis.search.rivals import RIVAL_SHARE, related, same, weights
from uavbatt.diagnosis.search.worth import Worth, at_bound, worth

EARNED = 3.0  # chance gave at most 2.84 in 140 effect-free sets, and half of EARNED in one of 20
RESIZED = 0.25  # prior of another size of an effect in the file, relative to an effect that the file lacks
FIRST_TURNS, FURTHER_TURNS = 14, 8  # iterations from the model without the effect, and from a fit with it


@dataclass(frozen=True, slots=True)
class Trial:
    """Trial holds the worth of each single effect beside the effects of the model."""

    before: Refit
    fits: tuple[Refit, ...]  # in order of chi-square
    worths: tuple[Worth, ...]
    least: float = 0.5 * EARNED  # least worth of a rival

    @property
    def largest_worth(self) -> float:
        """Return the largest worth of the effects that do not stand at a bound; 0 if all do."""
        return max((w.value for f, w in zip(self.fits, self.worths, strict=True) if not at_bound(f)), default=0.0)

    @property
    def rivals(self) -> list[int]:
        """Return the indices of the effects that could be the cause, if there is one, by chi-square.

        A rival need not be worth enough alone.
        """
        places, least = range(len(self.fits)), max(self.least, RIVAL_SHARE * self.largest_worth)
        possible = [i for i in places if not at_bound(self.fits[i])]
        worthy = [i for i in possible if self.worths[i].value > least]
        # An effect that explains more than these is a rival too. So is another name of the best of them, unless it
        # leaves the same residual as no effect at all.
        first = worthy[0] if worthy else -1
        return [
            i
            for i in possible
            if i in worthy
            or (i < first and self.worths[i].value > EARNED)
            or (worthy and same(self.fits[i], self.fits[first]) and self._is_something(i))
        ]

    def _is_something(self, i: int) -> bool:
        return self.worths[i].value > 0.5 * EARNED or not same(self.fits[i], self.before)


def trial(
    problem: Problem, before: Refit, options: list[Candidate], turns: int, reference: Refit | None = None
) -> Trial:
    """Try every option beside the effects of `before`.

    turns : iterations of the refits; known : a refit in which one of the options is known to end; that one starts
    there.
    """
    free = [o for o in options if not related(o.names, before.candidate.names)]
    with_option = [before.candidate.plus(o) for o in free]
    starts = [
        reference if reference is not None and c.names == reference.candidate.names else before for c in with_option
    ]
    fits = refit(problem, with_option, start=starts, iterations=turns)
    fits.sort(key=lambda f: f.total)
    return Trial(before, tuple(fits), tuple(worth(f, before) for f in fits))


def likeliness(problem: Problem, fits: list[Refit]) -> Array:
    """Return the likelihood of each of `fits`, which are ordered by chi-square.

    An effect of the file with another size often leaves the least chi-square because it is the easiest to bend. If it
    is not the likeliest after its prior, the other effects are compared with the best among themselves.
    """
    usual = np.array([RESIZED ** len(f.candidate.resized) for f in fits])
    likely: Array = weights(problem, fits) * usual
    if np.argmax(likely) and usual[0] < 1.0:
        likely = weights(problem, fits, int(np.argmax(usual))) * usual
    return likely
