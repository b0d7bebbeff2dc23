"""A trial of single effects: their worth beside what the model has, the rivals among them, and how likely each is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.diagnosis.candidates import Candidate
from uavbatt.diagnosis.problem import Problem, Refit
from uavbatt.diagnosis.refit import refit
from uavbatt.diagnosis.rivals import RIVAL_SHARE, related, same, weights
from uavbatt.diagnosis.worth import Worth, at_bound, worth

EARNED = 3.0  # more than chance gave in 140 effect-free sets, 2.84; half of it, one healthy set in twenty: a rival
RESIZED = 0.25  # how likely another size of what the file has is, against something that it lacks
FIRST_TURNS, FURTHER_TURNS = 14, 8


@dataclass(frozen=True, slots=True)
class Trial:
    """Trial tells what each single effect is worth beside what the model has."""

    before: Refit
    fits: tuple[Refit, ...]  # by chi-square
    worths: tuple[Worth, ...]
    least: float = 0.5 * EARNED  # that a rival is worth

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
            or (i < first and self.worths[i].value > EARNED)
            or (worthy and same(self.fits[i], self.fits[first]) and self._is_something(i))
        ]

    def _is_something(self, i: int) -> bool:
        return self.worths[i].value > 0.5 * EARNED or not same(self.fits[i], self.before)


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


def likeliness(problem: Problem, fits: list[Refit]) -> Array:
    """Return how likely each of `fits` is, which come by chi-square.

    Another size of what the file has leaves least by its ease of bending; where it is not the likeliest all the same,
    the others are held against the best of themselves and not against it.
    """
    usual = np.array([RESIZED ** len(f.candidate.resized) for f in fits])
    likely: Array = weights(problem, fits) * usual
    if np.argmax(likely) and usual[0] < 1.0:
        likely = weights(problem, fits, int(np.argmax(usual))) * usual
    return likely
