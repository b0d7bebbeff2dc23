"""Worth of an effect: the one unit in which every decision is taken.

    worth = (chi-square saved on records left out) · (variance of the estimate / variance with the file's errors)

The first factor says how much better a record is predicted with the value that the others give, in whitened model
error. The second says how much of it an error that the battery file itself states could not feign. Both follow from
the refit's own quadratic: with b_j half the descent of record j's chi-square at the common optimum and A_j its
information, the optimum of the others is off by d_j = -(A - A_j)^-1 b_j, and record j loses

    chi2_j(left out) = chi2_j - 2 b_j'd_j + d_j'A_j d_j

(Cook & Weisberg 1982, section 5.2: the one-step approximation of leaving a case out).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.model import Array
from uavbatt.diagnosis.evidence import Rows
from uavbatt.diagnosis.problem import Problem, Refit

DOUBTS = 6.0  # standard errors, those of the file considered: a spread of two of them is no inconstancy
UNSTEADY = 0.35  # spread between records, relative to the value: an sd, and the most that is called steady
WEAK = 0.05  # information that stands for the prior where the other records tell nothing of a quantity


@dataclass(frozen=True, slots=True)
class Constancy:
    """Constancy tells how far the records agree on an effect's first quantity (Cochran's Q, as a spread).

    The spread is the sd between records, relative to the change or to what errors of the file make of nothing.
    """

    values: Array  # each record's own
    spread: float


@dataclass(frozen=True, slots=True)
class Worth:
    """Worth holds the evidence for one effect of a refit, over the model without it."""

    gains: Array  # chi-square saved on each record by the values that the others give
    most: float  # what the refit saves where nothing is left out: what only steadies the rest is not the effect's
    known: float  # share of the estimate's variance that is not the file's own errors
    constancy: Constancy | None  # None where each record has its own value anyway

    @property
    def value(self) -> float:
        """Return the chi-square saved on records left out that errors of the file could not feign."""
        return self.on(np.ones(len(self.gains), dtype=bool))

    def on(self, some: NDArray[np.bool_]) -> float:
        """Return the worth on some of the records alone."""
        return min(float(np.sum(self.gains[some])), self.most) * self.known


def at_bound(fit: Refit) -> bool:
    """Return True if a quantity ran into the end of what is physical: then it stands for something else."""
    return any(
        value > f.high - 1e-3 * (f.high - f.low)
        or (value < f.low + 1e-3 * (f.high - f.low) and abs(f.low - f.start) > 1e-3 * (f.high - f.low))
        for value, f in zip(fit.values()[0], fit.candidate.freed, strict=True)
    )


def worth(fit: Refit, before: Refit, name: str = "") -> Worth:
    """Return what an effect of the refit is worth over `before`, which lacks it; the one added last if not named."""
    name = name or fit.candidate.name
    gains = left_out_chi2(before) - left_out_chi2(fit)
    if name == "initial_charge":  # what the records' own starts save says nothing of a start that they share
        k = fit.quantities[fit.candidate.slice_of(name)][0]
        gains = np.minimum(gains, fit.u[:, k] ** 2 * fit.information[:, k, k])
    return Worth(gains, before.total - fit.total, known_share(fit, name), constancy(fit, name))


def known_share(fit: Refit, name: str) -> float:
    """Return the share of an effect's variance that is not the file's own errors, of its best known quantity."""
    its = fit.candidate.slice_of(name)
    alone, considered = (np.diagonal(fit.covariance_u(considered=c))[its] for c in (False, True))
    return float(np.max(alone / considered))


def _free(fit: Refit) -> Rows:
    """Columns that the fit moves and that do not stand at a bound."""
    low, high = np.array([f.bounds_u() for f in fit.columns]).T.reshape(2, -1)
    inside = (fit.u[0] > low + 1e-6) & (fit.u[0] < high - 1e-6)
    free: Rows = np.flatnonzero(fit.moves[: len(fit.columns)] & inside)
    return free


def shifts_u(fit: Refit) -> Array:
    """Return how far the optimum of the other records is from the common one, [records, columns]."""
    out = np.zeros_like(fit.u)
    free = _free(fit)
    if len(out) < 2 or not free.size:
        return out
    own = fit.information[:, free[:, None], free]
    others = np.sum(own, axis=0) - own + WEAK * np.eye(free.size)
    out[:, free] = -np.linalg.solve(others, fit.score[:, free, None])[..., 0]
    return out


def left_out_chi2(fit: Refit) -> Array:
    """Return the chi-square of each record with the values that the others give.

    With one record only it is the record's own and two for each quantity.
    """
    free = _free(fit)
    if len(fit.chi2) < 2:
        return fit.chi2 + 2.0 * free.size
    own, d = fit.information[:, free[:, None], free], shifts_u(fit)[:, free]
    descent = np.einsum("ri,ri->r", fit.score[:, free], d)
    loss: Array = fit.chi2 - 2.0 * descent + np.einsum("ri,rij,rj->r", d, own, d)
    return loss


def left_out_values(problem: Problem, fit: Refit) -> list[Array]:
    """Return per record the values of the quantities that the other records give."""
    u = fit.u + shifts_u(fit)
    places = zip(fit.quantities, fit.candidate.freed, strict=True)
    columns = [f.value(u[:, k]) for k, f in places]
    return list(np.stack(columns, axis=-1)) if columns else [np.zeros(0)] * len(problem.evidence.names)


def constancy(fit: Refit, name: str) -> Constancy | None:
    """Compare the records' own values of an effect's first quantity, all else as it is.

    Returns None with one record only, and for a start, of which each record has its own anyway.
    """
    if len(fit.chi2) < 2 or name == "initial_charge":
        return None
    k = int(fit.quantities[fit.candidate.slice_of(name)][0])
    freed = fit.columns[k]
    weight = fit.information[:, k, k] + WEAK
    own_u = fit.u[:, k] + fit.score[:, k] / weight
    mean = np.sum(weight * own_u) / np.sum(weight)
    q = float(np.sum(weight * (own_u - mean) ** 2))
    between = max(q - (len(own_u) - 1), 0.0) / max(np.sum(weight) - np.sum(weight**2) / np.sum(weight), 1e-12)
    apart, common = freed.value(np.array([mean + np.sqrt(between), mean]))
    change = abs(common if freed.log else common - freed.start)
    doubt = fit.errors()[fit.candidate.slice_of(name)][0]
    return Constancy(freed.value(own_u), float(abs(apart - common) / max(change, DOUBTS * doubt)))


def is_steady(found: Constancy | None) -> bool:
    """Return True if the records agree on the value, or each has its own anyway."""
    return found is None or found.spread <= UNSTEADY
