"""Worth of an effect: the unit of every decision of the diagnosis.

    worth = (chi-square saved on records left out) · (variance of the estimate / variance with the file's errors)

The first factor measures how much better a record is predicted with the effect's value from the other records, in units
of the whitened model error. The second factor is the share that the errors stated in the battery file cannot imitate.
Both follow from the refit's quadratic approximation. With b_j half the negative gradient of record j's chi-square at
the common optimum and A_j its information matrix, the optimum of the other records is shifted by
d_j = -(A - A_j)^-1 b_j, and the chi-square of record j becomes

    chi2_j(left out) = chi2_j - 2 b_j'd_j + d_j'A_j d_j

(Cook & Weisberg 1982, section 5.2: the one-step approximation of leaving a case out).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.model import Array
from uavbatt.diagnosis.refit.problem import Problem, Refit
from uavbatt.diagnosis.refit.whitening import Rows

DOUBTS = 6.0  # standard errors (errors of the file included): a spread of two of them still counts as steady
UNSTEADY = 0.35  # spread (sd) between records, relative to the value: the largest that is called steady
# Without a thermometer each flight has a temperature of its own to bend. In 66 healthy sets the worth by chance was up
# to 11.2 then, and 2.8 with one.
UNMEASURED_SHARE = 0.25
WEAK = 0.05  # information of the prior, used where the other records say nothing about a quantity


@dataclass(frozen=True, slots=True)
class Constancy:
    """Constancy tells how well the records agree on an effect's first quantity (Cochran's Q, as a spread).

    The spread is the sd between records, relative to the change of the quantity, or to the change that errors of the
    file alone can cause if that is larger.
    """

    values: Array  # the value of each record
    spread: float


@dataclass(frozen=True, slots=True)
class Worth:
    """Worth holds the evidence for one effect of a refit, compared with the model without it."""

    gains: Array  # chi-square saved on each record with the values from the other records
    most: float  # chi-square saved with no record left out; the worth cannot be more than that
    known: float  # share of the estimate's variance that does not come from errors of the file, nor of the temperature
    constancy: Constancy | None  # None where each record has its own value anyway
    imitable: float = math.inf  # squared change of the quantity, in errors that the file states: no worth is above it

    @property
    def value(self) -> float:
        """Return the chi-square saved on left-out records that errors of the file cannot imitate."""
        return self.on(np.ones(len(self.gains), dtype=bool))

    def on(self, some: NDArray[np.bool_]) -> float:
        """Return the worth on a selection of the records."""
        return min(min(float(np.sum(self.gains[some])), self.most) * self.known, self.imitable)


def at_bound(fit: Refit) -> bool:
    """Return True if a quantity stands at a physical bound: then the effect stands in for another cause."""
    return any(
        value > f.high - 1e-3 * (f.high - f.low)
        or (value < f.low + 1e-3 * (f.high - f.low) and abs(f.low - f.start) > 1e-3 * (f.high - f.low))
        for value, f in zip(fit.values()[0], fit.candidate.freed, strict=True)
    )


def worth(fit: Refit, before: Refit, name: str = "") -> Worth:
    """Return the worth of an effect of the refit over `before`, which lacks it. The default is the last one added."""
    name = name or fit.candidate.name
    gains = left_out_chi2(before) - left_out_chi2(fit)
    if name == "initial_charge":  # a start of its own in each record says nothing about a common shift
        k = fit.quantities[fit.candidate.slice_of(name)][0]
        gains = np.minimum(gains, fit.u[:, k] ** 2 * fit.information[:, k, k])
    return Worth(gains, before.total - fit.total, known_share(fit, name), constancy(fit, name), imitable(fit, name))


def known_share(fit: Refit, name: str) -> float:
    """Return the share of an effect's variance that is not due to errors of the file, for its best known quantity.

    A temperature that nobody measured is such an error, too.
    """
    columns = fit.candidate.slice_of(name)
    alone, considered = (np.diagonal(fit.covariance_u(considered=c))[columns] for c in (False, True))
    return float(np.max(alone / considered)) * (1.0 if fit.has_temperature else UNMEASURED_SHARE)


def imitable(fit: Refit, name: str) -> float:
    """Return the squared change of an effect's quantity in standard errors that the file states of that very quantity.

    It is the least chi-square by which the file itself could be wrong instead, so that no worth is above it; inf for an
    effect with a quantity of which the file states no error. Where all is linear the share that is known says the same.
    A lag that becomes none is not: it ends where the records say nothing about its logarithm.
    """
    stated = {f.index: f.scale for f in fit.columns if f.nuisance}
    columns = range(len(fit.candidate.freed))[fit.candidate.slice_of(name)]
    values, freed = fit.values()[0], fit.candidate.freed
    return max(
        ((values[k] - freed[k].start) / stated[freed[k].index]) ** 2 if freed[k].index in stated else math.inf
        for k in columns
    )


def _free(fit: Refit) -> Rows:
    """Return the columns that the fit moves and that do not stand at a bound."""
    low, high = np.array([f.bounds_u() for f in fit.columns]).T.reshape(2, -1)
    inside = (fit.u[0] > low + 1e-6) & (fit.u[0] < high - 1e-6)
    free: Rows = np.flatnonzero(fit.moves[: len(fit.columns)] & inside)
    return free


def shifts_u(fit: Refit) -> Array:
    """Return the shift from the common optimum to the optimum of the other records, [records, columns]."""
    out = np.zeros_like(fit.u)
    free = _free(fit)
    if len(out) < 2 or not free.size:
        return out
    own = fit.information[:, free[:, None], free]
    others = np.sum(own, axis=0) - own + WEAK * np.eye(free.size)
    out[:, free] = -np.linalg.solve(others, fit.score[:, free, None])[..., 0]
    return out


def left_out_chi2(fit: Refit) -> Array:
    """Return the chi-square of each record, predicted with the values from the other records.

    For a single record it is the record's own chi-square plus two for each quantity.
    """
    free = _free(fit)
    if len(fit.chi2) < 2:
        return fit.chi2 + 2.0 * free.size
    own, d = fit.information[:, free[:, None], free], shifts_u(fit)[:, free]
    descent = np.einsum("ri,ri->r", fit.score[:, free], d)
    loss: Array = fit.chi2 - 2.0 * descent + np.einsum("ri,rij,rj->r", d, own, d)
    return loss


def saved(fit: Refit, before: Refit) -> float:
    """Return the chi-square that a refit saves on left-out records over another one."""
    return float(np.sum(left_out_chi2(before)) - np.sum(left_out_chi2(fit)))


def left_out_values(problem: Problem, fit: Refit) -> list[Array]:
    """Return, for each record, the values of the quantities from the other records."""
    u = fit.u + shifts_u(fit)
    places = zip(fit.quantities, fit.candidate.freed, strict=True)
    columns = [f.value(u[:, k]) for k, f in places]
    return list(np.stack(columns, axis=-1)) if columns else [np.zeros(0)] * len(problem.evidence.names)


def constancy(fit: Refit, name: str) -> Constancy | None:
    """Compare the records' own values of an effect's first quantity, all other quantities held.

    Returns None for a single record, and for the start of charge, which is different in each record anyway.
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


def is_steady(constancy: Constancy | None) -> bool:
    """Return True if the records agree on the value, or if there is nothing to compare."""
    return constancy is None or constancy.spread <= UNSTEADY
