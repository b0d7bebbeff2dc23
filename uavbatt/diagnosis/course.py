"""The course of an effect over flights in order of time: at which flight does it begin, and does it grow?

An effect that begins at flight k is absent in all flights before k. From flight k on it has its full size, or it grows:

    value_j = off + share_j (value - off)       share_j = 0 before k, then 1, or (j - k + 1) / (n - k + 1)

One refit in which all flights have the effect gives each flight's own value and its standard error. The saving of every
course follows from these without another simulation, so that only the best courses are refitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.diagnosis.refit.candidates import Candidate
from uavbatt.diagnosis.refit.problem import Problem, Refit

LEAST_TO_GROW = 3  # flights needed to see growth: two flights with different sizes could also be a step


@dataclass(frozen=True, slots=True)
class Course:
    """A course tells at which flight an effect begins, counted from 0, and whether it grows from there to the last."""

    begins: int
    grows: bool

    def shares(self, flights: int) -> Array:
        """Return the share of the effect's last size that each of the flights has, in order of time."""
        since = np.arange(flights) - self.begins + 1.0
        return np.clip(since / (flights - self.begins), 0.0, 1.0) if self.grows else (since > 0.0).astype(float)


def courses(flights: int) -> list[Course]:
    """List every course that so many flights can show."""
    steady = [Course(k, grows=False) for k in range(flights)]
    return steady + [Course(k, grows=True) for k in range(flights - LEAST_TO_GROW + 1)]


@dataclass(frozen=True, slots=True)
class FlightValues:
    """FlightValues holds each flight's change of an effect's first quantity from the file's, in order of time."""

    change: Array
    sd: Array

    def saved(self, course: Course) -> float:
        """Return the chi-square that an effect of this course saves, by weighted least squares of its one size."""
        shares, weight = course.shares(self.change.size), self.sd**-2.0
        return float(np.sum(weight * shares * self.change) ** 2 / max(np.sum(weight * shares**2), 1e-12))


def own_values(problem: Problem, whole: Refit, order: Sequence[int]) -> FlightValues:
    """Return each flight's own values of the effect that a refit of all flights added last.

    order : the places of the flights among the records of the refit, in order of time.
    """
    k = int(whole.quantities[whole.candidate.slice_of(whole.candidate.name)][0])
    freed = whole.columns[k]
    places = list(order)
    precision = np.maximum(whole.information[places, k, k], 1e-6)
    at = freed.value(whole.u[places, k])
    slope = freed.scale * at if freed.log else np.full(len(places), freed.scale)
    return FlightValues(
        at + slope * whole.score[places, k] / precision - problem.base[freed.index], np.abs(slope) / np.sqrt(precision)
    )


def on_course(option: Candidate, course: Course, order: Sequence[int]) -> Candidate:
    """Return the option as an effect that takes this course; `order` has the records' places in order of time."""
    shares = np.empty(len(order))
    shares[list(order)] = course.shares(len(order))
    values = tuple(float(s) for s in shares)
    return replace(option, freed=tuple(replace(f, shares=values) for f in option.freed))
