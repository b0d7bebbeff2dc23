"""Rival effects: how likely each is beside the best one, and which of them share a class (three at most).

Let d be the difference of the two refits' whitened residuals. If the rival were the true cause, its chi-square would be
smaller than that of the best by |d|²; in fact it is larger by `behind`. An error e of the battery's model changes the
difference of the two chi-squares by 2 e·d, and its variance has three parts. Under load e is the same in all R records,
because it comes from one model: R |d|². At rest, where the voltage does not depend on a model of the load, e is
independent in each record: |d|². The errors J that the battery file states add |J'd|².
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.diagnosis.refit.batch import slopes_on_file
from uavbatt.diagnosis.refit.evidence import Evidence
from uavbatt.diagnosis.refit.problem import Problem, Refit

LARGEST_CLASS = 3
SAME = 10.0  # chi-square: two models closer than this are one; refits that have not fully converged differ a little
TWIN_SHARE = 0.1  # share of the explained chi-square: two names of one effect differ by less
RIVAL_SHARE = 1.0 / 3.0  # of the best effect's worth or likelihood; an effect below this share is no rival
TEMPER = 2.0  # a sigma of the model's error counts half, because the error is not normally distributed
FARTHEST = 30.0  # largest number of tempered sigmas: no weight becomes 0, so that weights can be divided by their sum
# Effects of one family look alike in a record; two of one family, refitted together, only cancel each other.
FAMILIES = (
    {"current_gain", "capacity_fade", "weak_cell", "rate_capacity"},
    {"current_offset", "unmetered_load"},
    {"voltage_gain", "voltage_offset"},
    {"polarisation", "slow_diffusion", "hysteresis"},
    {"resistance_growth", "charge_transfer", "harness_resistance", "sag_compensation"},
    {"temperature_offset", "temperature_lag"},
)


def family(name: str) -> frozenset[str]:
    """Return the effects that look much like this one in a record, itself included."""
    return frozenset({name}).union(*(kin for kin in FAMILIES if name in kin))


def related(new: Sequence[str], old: Sequence[str]) -> bool:
    """Return True if one of the `new` effects, or another of its family, is among the `old`."""
    return any(family(name) & set(old) for name in new)


def weights(problem: Problem, fits: list[Refit], first: int = 0) -> Array:
    """Return the likelihood of each refit relative to `fits[first]`, the best of its kind, which has 1.

    All refits must have the same number of quantities.
    """
    best = fits[first].residual
    slopes = slopes_on_file(problem, fits[first])
    resting = _at_rest(problem.evidence, best.shape[1])
    shared = np.where(resting, 1.0, float(len(best)))
    out = np.ones(len(fits))
    for i, fit in enumerate(fits):
        d = fit.residual - best
        behind = fit.total - fits[first].total
        declared = np.einsum("rme,rm->e", slopes, d)
        spread = np.sqrt(float(np.sum(shared * d**2)) + float(np.sum(declared**2)))
        sigmas = max(float(np.sum(d**2)) + behind, 0.0) / max(2.0 * spread, 1e-6)
        out[i] = np.exp(-0.5 * min(sigmas / TEMPER, FARTHEST) ** 2)
    return out


def _at_rest(evidence: Evidence, width: int) -> Array:
    """Return True for each whitened number that belongs to the rest before take-off, [records, numbers]."""
    out = np.zeros((len(evidence.names), width), dtype=bool)
    for j, volts in enumerate(evidence.volts):
        out[j, : volts.rows.size] = volts.rest
    return out


def same(one: Refit, other: Refit) -> bool:
    """Return True if two refits leave the same residual: two names of one effect, such as low gain and faded pack."""
    return _apart(one, other) < SAME


def _apart(one: Refit, other: Refit) -> float:
    """Return the chi-square between the residuals of two refits."""
    return float(np.sum((one.residual - other.residual) ** 2))


def members_of_class(fits: Sequence[Refit], likely: Array, before: Refit) -> list[int]:
    """Return the indices of the refits that form the class, at most LARGEST_CLASS of them.

    First come the refits that are the same as the best one, then the likeliest others. "The same" means that the
    residuals differ by less than SAME, and by less than TWIN_SHARE of what the best refit explains. The second limit is
    for small effects: all explanations of a small effect leave similar residuals, and yet they are different effects.

    A faded pack and a pack with a weak cell differ only in the last minute of a flight. If the class has the fade, and
    the records do not exclude a weak cell, the weak cell joins the class. It replaces another name of the fade if there
    is one, else the least likely member. likely : likelihood of each refit, likeliest first; before : the model without
    the effects.
    """
    names = [f.candidate.name for f in fits]
    near = min(SAME, TWIN_SHARE * _apart(before, fits[0]))
    twins = [i for i, f in enumerate(fits) if _apart(f, fits[0]) < near]
    seats = (twins + [i for i in range(len(fits)) if i not in twins])[:LARGEST_CLASS]
    faded, weak = (names.index(n) if n in names else -1 for n in ("capacity_fade", "weak_cell"))
    giving = [i for i in seats if i not in (*twins, faded)]
    if faded not in seats or weak in (*seats, -1) or not giving or likely[weak] < RIVAL_SHARE * likely[faded]:
        return seats
    gives = max(giving, key=lambda i: (same(fits[i], fits[faded]), seats.index(i)))
    return [i for i in seats if i != gives] + [weak]
