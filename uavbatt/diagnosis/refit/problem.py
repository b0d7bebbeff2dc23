"""The problem that all refits share, and the result of a refit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery import openloop
from uavbatt.battery.equations import REFERENCE_TEMP_C
from uavbatt.battery.model import Array, resistance
from uavbatt.battery.scaling import Pack
from uavbatt.diagnosis.refit.candidates import Candidate, FreeQuantity
from uavbatt.diagnosis.refit.evidence import Evidence
from uavbatt.diagnosis.refit.whitening import Rows

# A larger standard error of the OCV is that of a charge which no record behind the file reached. Bench tests down to
# the cut-off leave 0.07 V at the bottom, flights that land with a fifth of the charge 0.1 to 0.4 V.
GUESS_SD_V = 0.1


@dataclass(frozen=True, slots=True)
class TableErrors:
    """TableErrors holds the errors of the file's OCV [V] and R0 (relative) at their knots, one sd each.

    `instant_sd` is one more error: the share of R0 that in truth gives way with the polarisation, or the reverse.
    """

    ocv_soc: Array
    ocv_sd_V: Array
    resistance_soc: Array
    resistance_sd: Array
    instant_sd: float

    @property
    def count(self) -> int:
        """Return the number of errors: the knots of both tables and the instant share."""
        return self.ocv_soc.size + self.resistance_soc.size + 1

    @property
    def unseen(self) -> NDArray[np.bool_]:
        """Return True for the errors of the OCV at charges that no record behind the file reached, [errors].

        There the file holds a guess, which every refit corrects: otherwise a guess that is wrong would look like an
        effect of the pack.
        """
        out = np.zeros(self.count, dtype=bool)
        out[: self.ocv_soc.size] = self.ocv_sd_V > GUESS_SD_V
        return out

    @property
    def seen_from_soc(self) -> float:
        """Return the lowest charge at which the file's OCV is no guess; 1 if it is one throughout."""
        return float(np.append(self.ocv_soc, 1.0)[np.argmin(self.unseen)])

    def voltage(self, pack: Pack, soc: Array, current_A: Array, quick_A: Array, capacity_Ah: Array) -> Array:
        """Return the change of pack voltage [V] for one sd of every error, [..., errors].

        current_A : the load; quick_A : the part of it to which the polarisation has not responded yet [A]
        """
        ohm = resistance(pack.cell, soc, REFERENCE_TEMP_C)
        drop_V = (current_A / capacity_Ah * ohm)[..., None]
        instant = -self.instant_sd * (quick_A / capacity_Ah * ohm)[..., None]
        knots = (
            _hats(soc, self.ocv_soc) * self.ocv_sd_V,
            -_hats(soc, self.resistance_soc) * self.resistance_sd * drop_V,
        )
        out: Array = pack.installation.cells * np.concatenate([*knots, instant], axis=-1)
        return out


def _hats(soc: Array, knots: Array) -> Array:
    """Return the weights of linear interpolation [..., knots], constant beyond the ends."""
    inside = np.clip(soc, knots[0], knots[-1])
    right = np.clip(np.searchsorted(knots, inside), 1, knots.size - 1)
    share = (inside - knots[right - 1]) / (knots[right] - knots[right - 1])
    out = np.zeros((*np.shape(soc), knots.size))
    np.put_along_axis(out, (right - 1)[..., None], (1.0 - share)[..., None], axis=-1)
    np.put_along_axis(out, right[..., None], share[..., None], axis=-1)
    return out


@dataclass(frozen=True, slots=True)
class Problem:
    """Problem holds the data of all refits: the file's pack, the records, the values of the quantities (`base`)."""

    pack: Pack
    evidence: Evidence
    base: Array
    nuisances: tuple[FreeQuantity, ...]
    stated: tuple[FreeQuantity, ...]  # the same, but no larger than the file states
    tables: TableErrors | None = None
    states: openloop.States = openloop.states  # simulates the records; the command hands in the compiled function


@dataclass(frozen=True, slots=True)
class Refit:
    """Refit holds one candidate at its optimum: u [records, columns] of the solver, nuisances v [records, 3]."""

    candidate: Candidate
    columns: tuple[FreeQuantity, ...]  # shared errors of the file, then the candidate's quantities
    u: Array
    knots: Array  # [records, knots]: errors of the file's tables in standard deviations
    v: Array
    chi2: Array  # per record, priors of the nuisances included
    moves: NDArray[np.bool_]  # True for the columns and knots that the fit moves
    information: Array  # [records, columns and knots, same], nuisances eliminated
    score: Array  # [records, columns and knots]: half the negative gradient of each record's chi-square
    residual: Array  # whitened, [records, numbers]
    has_temperature: bool  # every record has one

    @property
    def total(self) -> float:
        """Return the chi-square of all records."""
        return float(np.sum(self.chi2))

    def values(self) -> Array:
        """Return the values of the candidate's quantities, [records, freed]."""
        first = len(self.columns) - len(self.candidate.freed)
        columns = [f.value(self.u[:, first + k]) for k, f in enumerate(self.candidate.freed)]
        return np.stack(columns, axis=-1) if columns else np.zeros((len(self.u), 0))

    @property
    def quantities(self) -> Rows:
        """Return the indices of the candidate's quantities among the columns."""
        return np.arange(len(self.columns) - len(self.candidate.freed), len(self.columns))

    @property
    def with_effects_swapped(self) -> Refit:
        """Return the same refit of two effects in reverse order: the first becomes the one added last."""
        candidate, first = self.candidate, self.quantities[0]
        second = first + candidate.sizes[0]
        size = len(self.columns)
        order = [*range(first), *range(second, size), *range(first, second), *range(size, self.moves.size)]
        return replace(
            self,
            candidate=replace(
                candidate,
                names=candidate.names[::-1],
                freed=candidate.freed[candidate.sizes[0] :] + candidate.freed[: candidate.sizes[0]],
                sizes=candidate.sizes[::-1],
            ),
            columns=tuple(self.columns[k] for k in order[:size]),
            u=self.u[:, order[:size]],
            moves=self.moves[order],
            information=self.information[:, order][:, :, order],
            score=self.score[:, order],
        )

    def covariance_u(self, *, considered: bool) -> Array:
        """Return the covariance of the candidate's quantities in u, [freed, freed].

        considered : add the influence of the file's errors n (unit sd, never estimated here) on the estimate,
        cov = A^-1 + A^-1 A_n A_n' A^-1 (Schmidt's consider covariance; Jazwinski 1970, section 8.4).
        """
        information = np.sum(self.information, axis=0)
        moved = np.flatnonzero(self.moves)
        inverse = np.linalg.inv(information[moved[:, None], moved] + 1e-9 * np.eye(moved.size))
        covariance = inverse
        if considered:
            shift = inverse @ information[moved[:, None], np.flatnonzero(~self.moves)]
            covariance = inverse + shift @ shift.T
        places = np.searchsorted(moved, self.quantities)
        out: Array = covariance[places[:, None], places]
        return out

    def errors(self) -> Array:
        """Return the standard errors of `values` [freed], including the influence of the file's errors."""
        sd_u = np.sqrt(np.diagonal(self.covariance_u(considered=True)))
        scale = np.array([f.scale for f in self.candidate.freed])
        factor = np.where([f.log for f in self.candidate.freed], self.values(), 1.0)
        out: Array = sd_u * scale * np.mean(factor, axis=0)
        return out
