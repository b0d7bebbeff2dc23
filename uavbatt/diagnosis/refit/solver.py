"""Nonlinear refit of many candidates at once: Levenberg-Marquardt, all simulations of an iteration in one pass.

A nuisance v affects only its own record, so one simulation gives its slopes for all records. The normal equations for
the nuisances v and for the unknowns u that all records share (see `batch`),

    [sum_r A_uu   A_uv ] [du]   [g_u]
    [A_vu         A_vv ] [dv] = [g_v]

are solved by eliminating v record by record (Schur complement).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.diagnosis.refit.batch import NUDGE, NUISANCES, Batch
from uavbatt.diagnosis.refit.candidates import Candidate
from uavbatt.diagnosis.refit.problem import Problem, Refit
from uavbatt.diagnosis.refit.whitening import Rows

ITERATIONS = 12  # of a candidate, which starts at the fit without it
SETTLED = 40  # iterations for the model without an effect: what has not converged would be credited to every effect
SCAN = (0.0, 0.3, -0.3, 0.6, -0.6, 1.2, -1.2, 2.0, -2.0)  # starts of an effect, in sds of its prior
COLUMNS = 4000  # records times changes that are simulated side by side: more take memory and save no time
CONVERGED = 0.01  # smallest chi-square that a step must be expected to gain
# Marquardt's damping: a step that gains makes it smaller, one that does not makes it larger by more, so that a search
# that is stuck ends soon. Below the least the step is that of Gauss and Newton; at the most it no longer moves.
FIRST_DAMPING, EASED, TIGHTENED, LEAST_DAMPING, MOST_DAMPING = 1e-2, 0.2, 8.0, 1e-6, 1e6
LONGEST_STEP = 3.0  # sds of a quantity in one step: farther away the slopes say nothing
RIDGE = 1e-6  # added to the information, in sds: a quantity that no record shows stays where it is


class _Linearised(NamedTuple):
    """_Linearised holds candidates linearised at u and v, in some columns of u and in v."""

    r: Array  # [C, R, M]
    chi2: Array  # [C, R]
    gram: Array  # [C, R, 1+P+3, same]: products of all columns of [r, ju, jv]
    pull: Array  # [C, R, P]: towards the priors of the shared errors
    stiffness: Array  # [C, R, P]

    def of(self, few: Rows) -> _Linearised:
        """Return the rows of some candidates."""
        return _Linearised(*(values[few] for values in self))

    def put(self, few: Rows, new: _Linearised) -> None:
        """Write the rows of some candidates in place."""
        for values, part in zip(self, new, strict=True):
            values[few] = part


@np.errstate(over="ignore", invalid="ignore")  # a trial whose pack diverges gives NaN and is rejected
def refit(
    problem: Problem,
    candidates: list[Candidate],
    *,
    start: list[Refit] | None = None,
    iterations: int = ITERATIONS,
    file_errors: bool = False,
) -> list[Refit]:
    """Refit every candidate, beginning at `start`. `file_errors` also frees the errors that the battery file states.

    A candidate that has converged is left as it is while the others continue.
    """
    batch = Batch(problem, candidates, file_errors=file_errors)
    u = np.zeros((len(candidates), batch.records, batch.size))
    v = np.zeros((len(candidates), batch.records, NUISANCES))
    for i, values in enumerate(start or []):
        batch.fill_from(u[i], values)
        v[i] = values.v
    if not file_errors:
        for few in _groups(batch, len(SCAN)):
            u[few] = _best_of_scan(batch.part(few), u[few], v[few])
    damping = np.full(len(candidates), FIRST_DAMPING)
    moving, going = batch.moving, np.arange(len(candidates))
    state = _linearised(batch, u, v, moving)
    for _ in range(iterations):
        going = _turn(batch, going, moving, state, u, v, damping)
        if not going.size:
            break
    state = _linearised(batch, u, v, np.arange(batch.size))  # errors held fixed still count in the standard errors
    return [_refit_of(batch, state, u, v, i) for i in range(len(candidates))]


def _turn(batch: Batch, going: Rows, moving: Rows, state: _Linearised, u: Array, v: Array, damping: Array) -> Rows:
    """Take one step of the candidates that are `going`, in place, where it gains; return those that continue.

    A candidate has finished when its next step is expected to gain nothing, either at its optimum or because damping
    has made the step too small. The gain of the last step is no criterion: a step over a corner may gain nothing far
    from the optimum.
    """
    part, now = batch.part(going), state.of(going)
    du = np.zeros((going.size, *u.shape[1:]))
    du[..., moving] = _step(now, v[going], damping[going])
    du = np.clip(u[going] + du, part.low[:, None], part.high[:, None]) - u[going]
    dv = _nuisance_step(now, v[going], du[..., moving], damping[going])
    few = np.flatnonzero(_linear_gain(now, v[going], du[..., moving], dv) >= CONVERGED)
    going, now, to_u, to_v = going[few], now.of(few), (u[going] + du)[few], (v[going] + dv)[few]
    if not going.size:
        return going
    trial = _linearised(part.part(few), to_u, to_v, moving)
    gains = np.sum(now.chi2 - trial.chi2, axis=1) > 0.0
    better = np.flatnonzero(gains)
    u[going[better]], v[going[better]] = to_u[better], to_v[better]
    state.put(going[better], trial.of(better))
    damping[going] = np.clip(damping[going] * np.where(gains, EASED, TIGHTENED), LEAST_DAMPING, MOST_DAMPING)
    return going


def _linear_gain(s: _Linearised, v: Array, du: Array, dv: Array) -> Array:
    """Return the chi-square that a full step would gain if the model were linear, g'd."""
    *_, g_u, g_v = _blocks(s, v)
    out: Array = np.sum(g_u * du, axis=(1, 2)) + np.sum(g_v * dv, axis=(1, 2))
    return out


def _groups(batch: Batch, changes: int) -> list[Rows]:
    """Return the candidates in groups, so small that their changes are at most COLUMNS; one empty group of none."""
    together, count = max(COLUMNS // (batch.records * changes), 1), len(batch.candidates)
    return [np.arange(k, min(k + together, count)) for k in range(0, max(count, 1), together)]


def _best_of_scan(batch: Batch, u: Array, v: Array) -> Array:
    """Return the best of a few sizes of the last quantity: the slope at zero does not lead to a large effect."""
    us = np.repeat(u[None], len(SCAN), axis=0)
    for i, c in enumerate(batch.candidates):
        if c.last:
            k = len(batch.columns[i]) - c.last
            us[:, i, :, k] = np.clip(np.array(SCAN)[:, None] + u[i, :, k], batch.low[i, k], batch.high[i, k])
    every = np.ones(us.shape[:2], dtype=bool)
    values, soc = batch.residuals(us, np.repeat(v[None], len(SCAN), axis=0), every)
    if np.any(knots := u[..., batch.freed :]):
        values += _from_knots(batch.slopes_on_knots(soc), knots)
    best = np.argmin(np.nan_to_num(np.sum(values**2, axis=(2, 3)), nan=np.inf), axis=0)
    chosen: Array = us[best, np.arange(len(batch.candidates))]
    return chosen


def _linearised(batch: Batch, u: Array, v: Array, columns: Rows) -> _Linearised:
    """Linearise the candidates at u and v for some columns of u and for all of v, as many at a time as COLUMNS says."""
    groups = _groups(batch, 1 + columns.size + NUISANCES)
    parts = [_linearised_together(batch.part(few), u[few], v[few], columns) for few in groups]
    return _Linearised(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def _linearised_together(batch: Batch, u: Array, v: Array, columns: Rows) -> _Linearised:
    """Compute the slopes for some columns of u and for all of v by small changes of each."""
    nudged = columns[columns < batch.freed]
    first_v = 1 + nudged.size
    side = np.where(u + NUDGE > batch.high[:, None], -NUDGE, NUDGE)
    us = np.repeat(u[None], first_v + NUISANCES, axis=0)
    vs = np.repeat(v[None], first_v + NUISANCES, axis=0)
    every = np.ones(us.shape[:2], dtype=bool)
    for place, k in enumerate(nudged, start=1):
        us[place, ..., k] += side[..., k]
        every[place] = batch.has(k)
    for k in range(NUISANCES):
        vs[first_v + k, ..., k] -= NUDGE  # downwards, because the charge cannot exceed full
    values, soc = batch.residuals(us, vs, every)
    values[1:] -= values[0]
    values[1:first_v] /= np.moveaxis(side[..., nudged], -1, 0)[..., None]
    values[first_v:] /= -NUDGE
    values[1:][~every[1:]] = 0.0
    if nudged.size < columns.size:
        slopes = batch.slopes_on_knots(soc)
        values[0] += _from_knots(slopes, u[..., batch.freed :])
        values = np.concatenate([values[:first_v], slopes[columns[nudged.size :] - batch.freed], values[first_v:]])
    r, moved = values[0], u[..., columns]
    stiffness = np.repeat(batch.stiffness[:, None, columns], batch.records, axis=1)
    chi2 = np.sum(r**2, axis=-1) + np.sum(v**2, axis=-1) + np.sum(stiffness * moved**2, axis=-1)
    slopes = np.moveaxis(values, 0, 2)
    return _Linearised(r, chi2, slopes @ np.swapaxes(slopes, -1, -2), -stiffness * moved, stiffness)


def _from_knots(slopes: Array, knots: Array) -> Array:
    """Return the change of the residuals [C, R, M] by the errors of the file's tables, [C, R, knots]."""
    return np.asarray(np.einsum("kcrm,crk->crm", slopes, knots))


def _blocks(s: _Linearised, v: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Return A_uu, A_uv, A_vv and the right-hand sides g_u, g_v."""
    size = s.stiffness.shape[-1]
    shared, own = slice(1, 1 + size), slice(1 + size, None)
    a_uu = s.gram[..., shared, shared] + s.stiffness[..., None] * np.eye(size)
    g_u, g_v = s.pull - s.gram[..., shared, 0], -s.gram[..., own, 0] - v
    return a_uu, s.gram[..., shared, own], s.gram[..., own, own] + np.eye(NUISANCES), g_u, g_v


def _nuisances_solved(a_uv: Array, a_vv: Array, g_v: Array) -> Array:
    """Return A_vv^-1 (A_vu, g_v), by which the nuisances are eliminated."""
    return np.asarray(np.linalg.solve(a_vv, np.concatenate([np.swapaxes(a_uv, -1, -2), g_v[..., None]], axis=-1)))


def _step(s: _Linearised, v: Array, damping: Array) -> Array:
    """Return the step of the quantities, with the nuisances eliminated; it is limited to LONGEST_STEP."""
    a_uu, a_uv, a_vv, g_u, g_v = _blocks(s, v)
    hold = damping[:, None, None, None]
    a_vv = a_vv * (1.0 + hold * np.eye(NUISANCES))
    size = a_uu.shape[-1]
    solved = _nuisances_solved(a_uv, a_vv, g_v)
    schur = a_uu * (1.0 + hold * np.eye(size)) - a_uv @ solved[..., :size]
    right = g_u - (a_uv @ solved[..., size:])[..., 0]
    schur, right = np.sum(schur, axis=1, keepdims=True), np.sum(right, axis=1, keepdims=True)
    du: Array = np.linalg.solve(schur + RIDGE * np.eye(size), right[..., None])[..., 0]
    return np.clip(du, -LONGEST_STEP, LONGEST_STEP)


def _nuisance_step(s: _Linearised, v: Array, du: Array, damping: Array) -> Array:
    """Return the step of the nuisances for a given step of the quantities."""
    _, a_uv, a_vv, _, g_v = _blocks(s, v)
    a_vv = a_vv * (1.0 + damping[:, None, None, None] * np.eye(NUISANCES))
    right = g_v[..., None] - np.swapaxes(a_uv, -1, -2) @ du[..., None]
    return np.asarray(np.linalg.solve(a_vv, right)[..., 0], dtype=np.float64)


def _refit_of(batch: Batch, state: _Linearised, u: Array, v: Array, i: int) -> Refit:
    one = slice(i, i + 1)
    a_uu, a_uv, a_vv, g_u, g_v = (block[0] for block in _blocks(_Linearised(*(s[one] for s in state)), v[one]))
    solved = _nuisances_solved(a_uv, a_vv, g_v)
    information = a_uu - a_uv @ solved[..., :-1]
    score = g_u - (a_uv @ solved[..., -1:])[..., 0]
    width = len(batch.columns[i])
    order = [*range(width), *range(batch.freed, batch.size)]
    return Refit(
        candidate=batch.candidates[i],
        columns=batch.columns[i],
        u=u[i, :, :width].copy(),
        knots=u[i, :, batch.freed :].copy(),
        v=v[i].copy(),
        chi2=state.chi2[i].copy(),
        moves=batch.moves[i, order],
        information=information[:, order][:, :, order],
        score=score[:, order],
        residual=state.r[i].copy(),
        has_temperature=batch.problem.evidence.has_temperature,
    )
