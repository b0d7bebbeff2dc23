"""Nonlinear refit of many candidates at once: Levenberg-Marquardt, all simulations of an iteration in one pass.

Per candidate the unknowns are its quantities u, shared by all records, and per record three nuisances v in units of
their prior sd: starting charge, starting temperature, ambient. A nuisance touches its own record only, so one nudge
serves all records, and the normal equations

    [sum_r A_uu   A_uv ] [du]   [g_u]
    [A_vu         A_vv ] [dv] = [g_v]

are solved by eliminating v record by record (Schur complement).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uavbatt.battery.model import Array
from uavbatt.diagnosis.candidates import INDEX, Candidate
from uavbatt.diagnosis.evidence import Evidence
from uavbatt.diagnosis.problem import Problem, Refit
from uavbatt.diagnosis.simulation import Own, Simulated, simulate

NUDGE = 2e-3
NUISANCES = 3
START_SD_K, AMBIENT_SD_K, UNMEASURED_SD_K = 0.4, 1.0, 8.0
FREE_START_SD = 0.02  # of a record around the shift that all share
ITERATIONS = 12
SETTLED = 40  # of the model with nothing added: what it has not settled would be credited to every effect
SCAN = (0.0, 0.3, -0.3, 0.6, -0.6, 1.2, -1.2, 2.0, -2.0)
HELD = 1e4
CONVERGED = 0.05  # change of chi-square below which a candidate is done


class _Batch:
    """Whitened residuals of candidates: the only place that knows how columns are laid out."""

    def __init__(self, problem: Problem, candidates: list[Candidate]) -> None:
        self.problem, self.candidates = problem, candidates
        evidence = problem.evidence
        self.records = len(evidence.names)
        self.columns = [(*problem.nuisances, *c.freed) for c in candidates]
        self.freed = max((len(c) for c in self.columns), default=0)
        self.knots = problem.tables.count if problem.tables is not None else 0
        self.size = self.freed + self.knots
        self.low = np.full((len(candidates), self.size), -1e9)
        self.high = np.full((len(candidates), self.size), 1e9)
        self.stiffness = np.zeros((len(candidates), self.size))
        self.shared = np.zeros((len(candidates), self.size), dtype=bool)
        self.stiffness[:, self.freed :] = HELD
        for i, columns in enumerate(self.columns):
            for k, f in enumerate(columns):
                self.low[i, k], self.high[i, k] = f.bounds_u()
                self.shared[i, k] = f.nuisance and f.estimated
                self.stiffness[i, k] = HELD if f.nuisance and not f.estimated else 0.0
        self.lengths = [
            w.rows.size + (t.rows.size if t is not None else 0)
            for w, t in zip(evidence.volts, evidence.temps, strict=True)
        ]
        self.start_sd = np.array(
            [[max(s, FREE_START_SD) if c.free_start else s for s in evidence.start_sd] for c in candidates]
        )

    def release(self) -> None:
        """Estimate every error of the file, each with its prior."""
        self.shared = self.shared | (self.stiffness == HELD)

    def hold(self) -> None:
        """The priors of the shared errors that are estimated, one share a record: an error has one prior."""
        self.stiffness = np.where(self.shared, 1.0 / self.records, self.stiffness)

    def place(self, u: Array, given: Refit) -> None:
        """Start from an earlier refit with the same leading quantities: u [records, size] is filled."""
        quantities = len(given.columns)
        u[:, :quantities] = given.u
        if self.knots:
            u[:, self.freed :] = given.knots

    def settings(self, u: Array, v: Array) -> tuple[Array, Own]:
        """Quantities [variants, C, records, Q] and own values for u [variants, C, records, P], v [.., 3]."""
        evidence = self.problem.evidence
        x = np.broadcast_to(self.problem.base, (*u.shape[:3], self.problem.base.size)).copy()
        for i, columns in enumerate(self.columns):
            for k, f in sorted(enumerate(columns), key=lambda kf: kf[1].nuisance):
                value = f.value(u[:, i, :, k])
                if f.shares:
                    off = self.problem.base[f.index]
                    value = off + np.array(f.shares) * (value - off)
                x[:, i, :, f.index] = x[:, i, :, f.index] + value if f.nuisance else value
        warm = np.where([t is None for t in evidence.temps], UNMEASURED_SD_K, START_SD_K)
        believed = evidence.start_soc + x[..., INDEX["start_soc_shift"]]
        soc = np.minimum(believed + self.start_sd * v[..., 0], 1.03)
        return x, Own(soc, warm * v[..., 1], AMBIENT_SD_K * v[..., 2])

    def shown(self, u: Array, v: Array) -> Simulated:
        """Simulate; the variants are variants × candidates."""
        x, own = self.settings(u, v)
        flat = (-1, self.records)
        owns = Own(*(o.reshape(flat) for o in own))
        made = x.reshape(*flat, x.shape[-1])
        return simulate(self.problem.pack, self.problem.evidence, made, owns, self.problem.states)

    def residuals(self, us: Array, vs: Array) -> tuple[Array, Array]:
        """Whitened [variants, C, records, numbers], and the slopes of the first variant on the knots [C, .., knots]."""
        shown = self.shown(us, vs)
        out = whitened(self.problem.evidence, shown, max(self.lengths)).reshape(*us.shape[:3], -1)
        slopes = np.zeros((*out.shape[1:], self.knots))
        if self.problem.tables is not None:
            self._fill(slopes, shown.soc[:, : len(self.candidates)])
        return out, slopes

    def _fill(self, slopes: Array, soc: Array) -> None:
        tables, stack = self.problem.tables, self.problem.evidence.stack
        assert tables is not None
        for j, volts in enumerate(self.problem.evidence.volts):
            amps = stack.current_A[volts.rows, j, None]
            change = tables.voltage(self.problem.pack, soc[volts.rows, :, j], amps, stack.capacity_Ah[j])
            flat = volts.inverse @ change.reshape(volts.rows.size, -1)
            slopes[:, j, : volts.rows.size] = np.moveaxis(flat.reshape(change.shape), 1, 0)


def at_best(problem: Problem, fit: Refit) -> Simulated:
    """Return what the sensors should show with the refit's values (one variant)."""
    batch = _Batch(problem, [fit.candidate])
    return batch.shown(fit.u[None, None], fit.v[None, None])


def slopes_on_file(problem: Problem, fit: Refit) -> Array:
    """Return what one sd of each error of the battery file does to `fit.residual`, [records, numbers, errors]."""
    batch = _Batch(problem, [fit.candidate])
    u = np.zeros((1, len(fit.u), batch.size))
    batch.place(u[0], fit)
    held = np.flatnonzero(~fit.moves[: len(fit.columns)])
    us = np.repeat(u[None], 1 + held.size, axis=0)
    us[1 + np.arange(held.size), ..., held] += NUDGE
    values, tables = batch.residuals(us, np.repeat(fit.v[None, None], 1 + held.size, axis=0))
    shared = np.moveaxis(values[1:, 0] - values[0, 0], 0, -1) / NUDGE
    both: Array = np.concatenate([shared, tables[0]], axis=-1)
    return both


def whitened(evidence: Evidence, shown: Simulated, width: int) -> Array:
    """Model minus measurement as independent unit numbers, [variants, records, width]."""
    stack = evidence.stack
    out = np.zeros((shown.voltage_V.shape[1], len(evidence.names), width))
    for j, (volts, temps) in enumerate(zip(evidence.volts, evidence.temps, strict=True)):
        misfit = shown.voltage_V[volts.rows, :, j] - stack.voltage_V[volts.rows, j, None]
        size = volts.rows.size
        out[:, j, :size] = (volts.inverse @ misfit).T
        if temps is not None:
            warmth = shown.temp_C[temps.rows, :, j] - stack.temp_C[temps.rows, j, None]
            out[:, j, size : size + temps.rows.size] = (temps.inverse @ warmth).T
    return out


@np.errstate(over="ignore", invalid="ignore")  # a trial whose pack runs away is no number, and is not taken
def refit(
    problem: Problem,
    candidates: list[Candidate],
    *,
    start: list[Refit] | None = None,
    iterations: int = ITERATIONS,
    file_errors: bool = False,
) -> list[Refit]:
    """Refit every candidate, from `start` on; with `file_errors` the errors that the battery file states move, too."""
    batch = _Batch(problem, candidates)
    if file_errors:
        batch.release()
    batch.hold()
    count, records = len(candidates), batch.records
    u = np.zeros((count, records, batch.size))
    v = np.zeros((count, records, NUISANCES))
    for i, given in enumerate(start or []):
        batch.place(u[i], given)
        v[i] = given.v
    damping = np.full((count, 1), 1e-2)
    if not file_errors:
        u = _scanned(batch, u, v)
    state = _linearised(batch, u, v)
    for _ in range(iterations):
        du = _step(state, u, v, damping)
        trial_u = np.clip(u + du, batch.low[:, None], batch.high[:, None])
        dv = _given(state, v, trial_u - u, damping)
        trial = _linearised(batch, trial_u, v + dv)
        gain = np.sum(state.chi2 - trial.chi2, axis=1, keepdims=True)
        better = gain > 0.0
        take = np.broadcast_to(better, (count, records))
        u = np.where(take[..., None], trial_u, u)
        v = np.where(take[..., None], v + dv, v)
        state = _merged(take, trial, state)
        damping = np.clip(np.where(better, damping * 0.2, damping * 8.0), 1e-6, 1e6)
        if np.all((np.abs(gain) < CONVERGED) | (damping > 1e4)):
            break
    return [_refit_of(batch, state, u, v, i) for i in range(count)]


def _scanned(batch: _Batch, u: Array, v: Array) -> Array:
    """The best of a few sizes of the quantity added last: a large effect has no slope that leads there from zero."""
    us = np.repeat(u[None], len(SCAN), axis=0)
    for i, c in enumerate(batch.candidates):
        if c.last:
            k = len(batch.columns[i]) - c.last
            us[:, i, :, k] = np.clip(np.array(SCAN)[:, None] + u[i, :, k], batch.low[i, k], batch.high[i, k])
    values, _ = batch.residuals(us, np.repeat(v[None], len(SCAN), axis=0))
    best = np.argmin(np.nan_to_num(np.sum(values**2, axis=(2, 3)), nan=np.inf), axis=0)
    chosen: Array = us[best, np.arange(len(batch.candidates))]
    return chosen


@dataclass(frozen=True, slots=True)
class _Linearised:
    r: Array  # [C, R, M]
    chi2: Array  # [C, R]
    gram: Array  # [C, R, P+3+1, same]: products of all columns of [ju, jv, r]
    pull: Array  # [C, R, P]: towards the priors of the shared errors
    stiffness: Array  # [C, R, P]


def _linearised(batch: _Batch, u: Array, v: Array) -> _Linearised:
    freed = batch.freed
    side = np.where(u + NUDGE > batch.high[:, None], -NUDGE, NUDGE)
    us = np.repeat(u[None], 1 + freed + NUISANCES, axis=0)
    vs = np.repeat(v[None], 1 + freed + NUISANCES, axis=0)
    for k in range(freed):
        us[1 + k, ..., k] += side[..., k]
    for k in range(NUISANCES):
        vs[1 + freed + k, ..., k] -= NUDGE  # downwards: the charge has its ceiling above
    values, slopes = batch.residuals(us, vs)
    ju = np.moveaxis(values[1 : 1 + freed] - values[0], 0, -1) / side[:, :, None, :freed]
    ju = np.concatenate([ju, slopes], axis=-1)
    jv = np.moveaxis(values[1 + freed :] - values[0], 0, -1) / -NUDGE
    r = values[0] + (slopes @ u[..., freed:, None])[..., 0]
    stiffness = np.broadcast_to(batch.stiffness[:, None], u.shape)
    chi2 = np.sum(r**2, axis=-1) + np.sum(v**2, axis=-1) + np.sum(stiffness * u**2, axis=-1)
    columns = np.concatenate([ju, jv, r[..., None]], axis=-1)
    gram = np.swapaxes(columns, -1, -2) @ columns
    return _Linearised(r, chi2, gram, -stiffness * u, stiffness)


def _blocks(s: _Linearised, v: Array) -> tuple[Array, Array, Array, Array, Array]:
    """A_uu, A_uv, A_vv and the right-hand sides g_u, g_v."""
    own, gram = slice(-1 - NUISANCES, -1), s.gram
    size = s.stiffness.shape[-1]
    a_uu = gram[..., :size, :size] + s.stiffness[..., None] * np.eye(size)
    g_u, g_v = s.pull - gram[..., :size, -1], -gram[..., own, -1] - v
    return a_uu, gram[..., :size, own], gram[..., own, own] + np.eye(NUISANCES), g_u, g_v


def _step(s: _Linearised, u: Array, v: Array, damping: Array) -> Array:
    a_uu, a_uv, a_vv, g_u, g_v = _blocks(s, v)
    hold = damping[..., None, None]
    a_vv = a_vv * (1.0 + hold * np.eye(NUISANCES))
    freed = u.shape[-1]
    solved = np.linalg.solve(a_vv, np.concatenate([np.swapaxes(a_uv, -1, -2), g_v[..., None]], axis=-1))
    schur = a_uu * (1.0 + hold * np.eye(freed)) - a_uv @ solved[..., :freed]
    right = g_u - (a_uv @ solved[..., freed:])[..., 0]
    schur, right = np.sum(schur, axis=1, keepdims=True), np.sum(right, axis=1, keepdims=True)
    du = np.linalg.solve(schur + 1e-6 * np.eye(freed), right[..., None])[..., 0]
    return np.broadcast_to(np.clip(du, -3.0, 3.0), u.shape)


def _given(s: _Linearised, v: Array, du: Array, damping: Array) -> Array:
    """The nuisances' step for a given step of the quantities."""
    _, a_uv, a_vv, _, g_v = _blocks(s, v)
    a_vv = a_vv * (1.0 + damping[..., None, None] * np.eye(NUISANCES))
    right = g_v[..., None] - np.swapaxes(a_uv, -1, -2) @ du[..., None]
    return np.clip(np.linalg.solve(a_vv, right)[..., 0], -5.0, 5.0)


def _merged(take: Array, new: _Linearised, old: _Linearised) -> _Linearised:
    def pick(a: Array, b: Array) -> Array:
        return np.where(take.reshape(take.shape + (1,) * (a.ndim - 2)), a, b)

    names = ("r", "chi2", "gram", "pull", "stiffness")
    return _Linearised(*(pick(getattr(new, n), getattr(old, n)) for n in names))


def _refit_of(batch: _Batch, state: _Linearised, u: Array, v: Array, i: int) -> Refit:
    a_uu, a_uv, a_vv, g_u, g_v = (block[i] for block in _blocks(state, v))
    solved = np.linalg.solve(a_vv, np.concatenate([np.swapaxes(a_uv, -1, -2), g_v[..., None]], axis=-1))
    information = a_uu - a_uv @ solved[..., :-1]
    score = g_u - (a_uv @ solved[..., -1:])[..., 0]
    kept = len(batch.columns[i])
    order = [*range(kept), *range(batch.freed, batch.size)]
    return Refit(
        candidate=batch.candidates[i],
        columns=batch.columns[i],
        u=u[i, :, :kept].copy(),
        knots=u[i, :, batch.freed :].copy(),
        v=v[i].copy(),
        chi2=state.chi2[i].copy(),
        moves=batch.stiffness[i, order] < HELD,
        information=information[:, order][:, :, order],
        score=score[:, order],
        residual=state.r[i].copy(),
    )
