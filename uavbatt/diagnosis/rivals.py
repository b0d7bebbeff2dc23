"""Which effects the records cannot tell apart, and who is seated in a class of three.

Were a rival the truth, the difference of the two chi-squares would be |d|², with d what the two leave differently; it
is -behind. An error e of the battery's model turns that round by 2 e·d. What e is: the same in all records under load
(it is one model), so that unit numbers add up to R |d|² over R records; each record's own at rest, where the voltage
needs no model of the load; and what the file's stated errors J do, |J'd|².
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.diagnosis.batch import slopes_on_file
from uavbatt.diagnosis.evidence import Evidence
from uavbatt.diagnosis.problem import Problem, Refit

LARGEST_CLASS = 3
SAME = 10.0  # chi-square between two models that no record could tell apart, refits not quite at their end
TWIN_SHARE = 0.1  # of what an effect explains: two names of it leave within that of each other
RIVAL_SHARE = 1.0 / 3.0  # of what the best is worth or explains, or of how likely it is: less is no rival
TEMPER = 2.0  # sigmas of the model's error count half: it is no normal number
FARTHEST = 30.0  # of these: no weight is nothing, so that shares of what is left are numbers
# Effects of one family are hardly told apart: two of them together only cancel each other.
FAMILIES = (
    {"current_gain", "capacity_fade", "weak_cell", "rate_capacity"},
    {"current_offset", "unmetered_load"},
    {"voltage_gain", "voltage_offset"},
    {"polarisation", "slow_diffusion", "hysteresis"},
    {"resistance_growth", "charge_transfer", "harness_resistance"},
    {"temperature_offset", "temperature_lag"},
)


def family(name: str) -> frozenset[str]:
    """Return the effects that are hardly told from one, itself among them."""
    return frozenset({name}).union(*(kin for kin in FAMILIES if name in kin))


def related(new: Sequence[str], old: Sequence[str]) -> bool:
    """Return True if one of the `new` effects is among the `old`, or one of its family, hardly told from it."""
    return any(family(name) & set(old) for name in new)


def weights(problem: Problem, fits: list[Refit], first: int = 0) -> Array:
    """Return how likely each of `fits` is beside `fits[first]`, the best of its kind, which has 1.

    Their quantities have to be as many.
    """
    best = fits[first].residual
    slopes = slopes_on_file(problem, fits[first])
    resting = _at_rest(problem.evidence, best.shape[1])
    shared = np.where(resting, 1.0, float(len(best)))
    out = np.ones(len(fits))
    for i, fit in enumerate(fits):
        d = fit.residual - best
        behind = fit.total - fits[first].total
        stated = np.einsum("rme,rm->e", slopes, d)
        spread = np.sqrt(float(np.sum(shared * d**2)) + float(np.sum(stated**2)))
        sigmas = max(float(np.sum(d**2)) + behind, 0.0) / max(2.0 * spread, 1e-6)
        out[i] = np.exp(-0.5 * min(sigmas / TEMPER, FARTHEST) ** 2)
    return out


def _at_rest(evidence: Evidence, width: int) -> Array:
    """Return True if a whitened number is of the rest before take-off, [records, numbers]."""
    out = np.zeros((len(evidence.names), width), dtype=bool)
    for j, volts in enumerate(evidence.volts):
        out[j, : volts.rows.size] = volts.rest
    return out


def same(one: Refit, other: Refit) -> bool:
    """Return True if two refits leave the same: one effect by two names, as a gain below one and a faded pack are."""
    return _apart(one, other) < SAME


def _apart(one: Refit, other: Refit) -> float:
    """Return the chi-square between what two refits leave."""
    return float(np.sum((one.residual - other.residual) ** 2))


def members_of_class(fits: Sequence[Refit], likely: Array, before: Refit) -> list[int]:
    """Return the places of the refits that a class has room for: those the same as the best, then the likeliest.

    The same is what leaves within SAME of the best, and within TWIN_SHARE of what the best explains: all explanations
    of a small effect leave nearly the same, which does not make them one.

    A pack that has faded and one with a weak cell differ in the last minute only: where one is named, so is the other,
    if these records do not tell it from the fade, in the seat of what is but another name of the fade or else of the
    least likely. likely : how likely each is, likeliest first; before : the model without them.
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
