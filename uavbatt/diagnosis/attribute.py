"""Which refit explains the records best, which others cannot be told from it, and whether it can be believed.

Rank: chi-square + k ln(n), n the number of independent stretches of the records (Schwarz 1978, with the
autocorrelation-corrected n). A rival is excluded only when it falls short by more than `INSIGHT` of what the winner
explains, and by more than the battery file's own errors could turn round, see `apart`. Among those that remain, what
is the same in all records goes before what is not, and a new effect before another size of one in the file.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.diagnosis.candidates import Candidate
from uavbatt.diagnosis.problem import Problem, Refit
from uavbatt.diagnosis.refit import refit, slopes_on_file

LEAST_GAIN = 10.0  # of BIC: "very strong" (Kass & Raftery 1995)
INSIGHT = 0.09
LEAST_SIGMAS = 2.5  # beyond what errors of the battery file alone would feign
APART_SIGMAS = 4.0
LARGEST_CLASS = 3
UNSTEADY = 0.35  # spread between records, relative to the value
FIRST_TURNS, FURTHER_TURNS = 14, 8
FURTHER_SHARE = 0.04  # of what all effects explain, for each of several
FURTHER_GAIN = 30.0  # of BIC, for an effect beside others
RIVALS = 3  # models that a further effect is tried on
# Effects of one family are hardly told apart, so that two of them together only cancel each other.
FAMILIES = (
    {"current_gain", "capacity_fade", "weak_cell", "rate_capacity"},
    {"current_offset", "unmetered_load"},
    {"voltage_gain", "voltage_offset"},
    {"polarisation", "slow_diffusion", "hysteresis"},
    {"resistance_growth", "harness_resistance"},
    {"temperature_offset", "temperature_lag"},
)


@dataclass(frozen=True, slots=True)
class Constancy:
    """Each record's own values, and whether they agree."""

    values: Array  # [records, freed]
    q: float  # Cochran's Q of the first quantity
    spread: float  # between-record sd of the first quantity, relative to its change
    held_out_gain: Array  # [records]: chi-square saved on a record by the value that the others give

    @property
    def steady(self) -> bool:
        """Whether the records agree on the value."""
        return self.spread <= UNSTEADY or self.q <= 3.0 * len(self.values)

    @property
    def predicts(self) -> bool:
        """Whether the others' value helps most of the records, and all of them together."""
        gain = self.held_out_gain
        return bool(np.sum(gain) > 0.0 and np.mean(gain > 0.0) > 0.5)


@dataclass(frozen=True, slots=True)
class Finding:
    """One round: the refits that cannot be told apart, best first, and what they explain."""

    members: tuple[Refit, ...]
    before: Refit
    gain: float  # of BIC over the model of the round before
    sigmas: float
    constancy: Constancy | None
    fits: tuple[Refit, ...]  # every model tried that earned its place, best first
    probability: float  # that the cause is among the members, were it one of the candidates


def bic(fit: Refit, problem: Problem) -> float:
    """Bayesian information criterion of a refit."""
    quantities = len(fit.candidate.freed)
    if fit.candidate.free_start:
        quantities += len(problem.evidence.names)
    return fit.total + quantities * float(np.log(problem.evidence.independent))


def sigmas(fit: Refit, problem: Problem) -> float:
    """How many considered standard errors the effect added last is away from the file's values."""
    freed = fit.candidate.freed
    if not freed:
        shift = fit.v[:, 0] * 0.2
        return float(abs(np.mean(shift)) / 0.01)
    last = fit.candidate.last
    base = np.array([problem.base[f.index] for f in freed])[-last:]
    away = (fit.values()[0][-last:] - base) / np.maximum(fit.errors()[-last:], 1e-12)
    return float(np.max(np.abs(away))) if last else float("inf")


def related(new: tuple[str, ...], old: tuple[str, ...]) -> bool:
    """Whether an effect is in the model already, or one that it could not be told from."""
    own = set(new).union(*(family for family in FAMILIES if family & set(new)))
    return bool(own & set(old))


def at_bound(fit: Refit) -> bool:
    """Whether a quantity ran into the end of what is physical: then it stands for something else."""
    values = fit.values()[0]
    for value, freed in zip(values, fit.candidate.freed, strict=True):
        span = 1e-3 * (freed.high - freed.low)
        if value > freed.high - span or (value < freed.low + span and abs(freed.low - freed.start) > span):
            return True
    return False


def find(
    problem: Problem, known: list[Refit], options: list[Candidate], explains: Callable[[Refit], bool]
) -> Finding | None:
    """The best effect to add to each of the `known` models; None when none earns its place.

    explains : whether a model leaves no more than what the battery's own model leaves anyway.
    """
    tried, starts = [], []
    for model in known:
        for option in options:
            if not related(option.names, model.candidate.names):
                tried.append(model.candidate.plus(option))
                starts.append(model)
    if not tried:
        return None
    turns = FIRST_TURNS if known == [model] and not model.candidate.names else FURTHER_TURNS
    fits = sorted(refit(problem, tried, start=starts, iterations=turns), key=lambda f: bic(f, problem))
    before = min(known, key=lambda f: bic(f, problem))
    floor = bic(before, problem)
    earned = [f for f in fits if floor - bic(f, problem) > LEAST_GAIN and not at_bound(f)]
    earned = [f for f in earned if sigmas(f, problem) >= LEAST_SIGMAS]  # less, errors of the file alone could feign
    if not earned:
        return None
    earned = _distinct(earned)
    gain = floor - bic(earned[0], problem)
    behind = np.array([bic(f, problem) - bic(earned[0], problem) for f in earned])
    far = apart(problem, earned, behind) / APART_SIGMAS
    alike = [i for i in range(len(earned)) if far[i] < 1.0 or behind[i] <= max(LEAST_GAIN, INSIGHT * gain)]
    checks = dict(zip(alike, constancies(problem, [earned[i] for i in alike], before), strict=True))
    alike = [i for i in alike if _predicts(checks[i])]
    if not alike:
        return None
    whole = {i: _steady(checks[i]) and explains(earned[i]) for i in alike}
    refuted = [i for i in alike if any(whole.values()) and not whole[i]]
    # errors of the model are the same in all records, so that chi-squares count as those of one
    unlikely = behind / len(problem.evidence.names) + np.array([implausible(f) for f in earned])
    order = sorted(
        (i for i in alike if i not in refuted),  # where one explains all, in all records, what does not is no rival
        key=lambda i: (not _steady(checks[i]), earned[i].candidate.resized, unlikely[i]),
    )
    members, best = order[:LARGEST_CLASS], order[0]
    weights = np.exp(-0.5 * (2.0 * far) ** 2)
    weights[refuted] = 0.0
    return Finding(
        members=tuple(earned[i] for i in members),
        before=before,
        gain=floor - bic(earned[best], problem),
        sigmas=sigmas(earned[best], problem),
        constancy=checks[best],
        fits=tuple(earned),
        probability=float(np.sum(weights[members]) / np.sum(weights)),
    )


def apart(problem: Problem, fits: list[Refit], behind: Array) -> Array:
    """Sigmas by which the best of `fits` is told from each: the first is the best, `behind` in BIC are the others.

    Were the other the truth, the difference of chi-squares would be D = |d|² with d what the two leave differently;
    it is -behind. An error b of the battery's model turns that round by 2 b·d. What b is: the same in all records
    (it is one model), so that unit numbers add up to R D instead of D over R records; and what the file's stated
    errors J do, |J'd|².
    """
    best = fits[0].residual
    slopes = slopes_on_file(problem, fits[0])
    out = np.zeros(len(fits))
    for i, fit in enumerate(fits):
        d = fit.residual - best
        size = float(np.sum(d**2))
        stated = np.einsum("rme,rm->e", slopes, d)
        spread = np.sqrt(len(best) * size + float(np.sum(stated**2)))
        out[i] = (size + behind[i]) / max(2.0 * spread, 1e-6)
    return out


def implausible(fit: Refit) -> float:
    """Squared sizes of the effect added last in units of what is usual: decides between what fits alike."""
    first = len(fit.candidate.freed) - fit.candidate.last
    sizes = [
        (value - freed.start) / freed.scale
        for value, freed in zip(fit.values()[0][first:], fit.candidate.freed[first:], strict=True)
        if not freed.log
    ]
    return float(np.sum(np.square(sizes)))


def _predicts(check: Constancy | None) -> bool:
    return check is None or check.predicts


def _steady(check: Constancy | None) -> bool:
    return check is None or check.steady


def _distinct(fits: list[Refit]) -> list[Refit]:
    """The best refit of each name added last."""
    kept: dict[str, Refit] = {}
    for fit in fits:
        kept.setdefault(fit.candidate.name, fit)
    return list(kept.values())


def constancies(problem: Problem, fits: list[Refit], before: Refit) -> list[Constancy | None]:
    """Refit the effect added last to every record by itself, what else the model has held at the shared values.

    None for a single record, and for a start, which each record has of its own anyway.
    """
    useful = [f for f in fits if f.candidate.last and len(problem.evidence.names) > 1]
    candidates = [f.candidate for f in useful]
    owns = refit(problem, candidates, own=True, last_only=True, start=useful, iterations=8) if useful else []
    known = {id(f): _constancy(problem, f, own, before) for f, own in zip(useful, owns, strict=True)}
    return [known.get(id(f)) for f in fits]


def _constancy(problem: Problem, fit: Refit, own: Refit, before: Refit) -> Constancy:
    first = len(fit.columns) - len(fit.candidate.freed)
    k = len(fit.columns) - fit.candidate.last
    u, size = own.u[:, first:], len(fit.candidate.freed)
    weight = own.information[:, first : first + size, first : first + size]
    predicted = np.array([_others(u, weight, j) for j in range(len(u))])
    away = (predicted - u)[..., None]
    loss = own.chi2 + (np.swapaxes(away, -1, -2) @ weight @ away)[:, 0, 0]
    precision = weight[:, k - first, k - first]
    mean = np.sum(precision * own.u[:, k]) / np.sum(precision)
    q = float(np.sum(precision * (own.u[:, k] - mean) ** 2))
    between = max(q - (len(u) - 1), 0.0) / max(np.sum(precision) - np.sum(precision**2) / np.sum(precision), 1e-12)
    freed = fit.columns[k]
    change = freed.value(np.array([mean + np.sqrt(between), mean])) - problem.base[freed.index]
    spread = float(abs(change[0] - change[1]) / max(abs(change[1]), 1e-12))
    return Constancy(own.values(), q, spread, before.chi2 - loss)


def left_out(problem: Problem, fit: Refit) -> list[Array]:
    """Per record, the values of the quantities that the other records give."""
    own = refit(problem, [fit.candidate], own=True, start=[fit], iterations=8)[0]
    first, size = len(fit.columns) - len(fit.candidate.freed), len(fit.candidate.freed)
    u, weight = own.u[:, first:], own.information[:, first : first + size, first : first + size]
    found = []
    for j in range(len(u)):
        best = _others(u, weight, j)
        found.append(np.array([f.value(best[k : k + 1])[0] for k, f in enumerate(fit.candidate.freed)]))
    return found


def _others(u: Array, weight: Array, j: int) -> Array:
    """Precision-weighted mean of the other records' values."""
    rest = np.arange(len(u)) != j
    total = np.sum(weight[rest], axis=0) + 1e-9 * np.eye(u.shape[1])
    mean: Array = np.linalg.solve(total, np.sum((weight[rest] @ u[rest][..., None])[..., 0], axis=0))
    return mean
