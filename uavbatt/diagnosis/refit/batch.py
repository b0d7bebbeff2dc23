"""Candidates side by side: the columns of their unknowns, and the whitened residuals for given values of these.

The unknowns of a candidate are u, shared by all records (the errors of the battery file and the quantities of the
candidate), and three nuisances v for each record, in units of their prior sd: starting charge, starting temperature,
ambient temperature. The last columns are the errors of the file's tables at their knots, whose influence is linear.
"""

from __future__ import annotations

from copy import copy

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.model import Array
from uavbatt.diagnosis.refit.candidates import COURSES, INDEX, Candidate
from uavbatt.diagnosis.refit.evidence import Evidence
from uavbatt.diagnosis.refit.problem import Problem, Refit
from uavbatt.diagnosis.refit.simulation import OwnValues, Simulated, simulate
from uavbatt.diagnosis.refit.whitening import Rows

NUDGE = 2e-3  # finite difference in sds: far above rounding, far below a bend of the model
NUISANCES = 3  # of each record: start of charge, start temperature, ambient temperature
# Of the start temperature where it was measured, of the ambient temperature, of a start that was not measured.
START_SD_K, AMBIENT_SD_K, UNMEASURED_SD_K = 0.4, 1.0, 8.0
FREE_START_SD = 0.02  # sd of a record's start around the shift that all share


class Batch:
    """Batch turns values of the unknowns into whitened residuals; only this class knows the layout of the columns."""

    def __init__(self, problem: Problem, candidates: list[Candidate], *, file_errors: bool = False) -> None:
        """Lay out the columns; with `file_errors` every error of the file is estimated, each with its prior."""
        self.problem, self.candidates = problem, candidates
        evidence = problem.evidence
        self.records = len(evidence.names)
        self.columns = [(*problem.nuisances, *c.freed) for c in candidates]
        self.freed = max((len(c) for c in self.columns), default=0)
        self.knots = problem.tables.count if problem.tables is not None else 0
        self.size = self.freed + self.knots
        shape = (len(candidates), self.size)
        self.low, self.high = np.full(shape, -1e9), np.full(shape, 1e9)
        self.moves, shared = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
        unseen = problem.tables.unseen if problem.tables is not None else np.zeros(0, dtype=bool)
        self.moves[:, self.freed :] = shared[:, self.freed :] = unseen | file_errors
        for i, columns in enumerate(self.columns):
            for k, f in enumerate(columns):
                self.low[i, k], self.high[i, k] = f.bounds_u()
                self.moves[i, k] = f.estimated or file_errors
                shared[i, k] = f.nuisance and self.moves[i, k]
        self.stiffness = np.where(shared, 1.0 / self.records, 0.0)  # divided among the records: an error has one prior
        self.start_sd = np.array(
            [[max(s, FREE_START_SD) if c.free_start else s for s in evidence.start_sd] for c in candidates]
        )

    def part(self, few: Rows) -> Batch:
        """Return a batch of the candidates `few` alone, in the same columns."""
        twin = copy(self)
        twin.candidates, twin.columns = [self.candidates[i] for i in few], [self.columns[i] for i in few]
        for name in ("low", "high", "moves", "stiffness", "start_sd"):
            setattr(twin, name, getattr(self, name)[few])
        return twin

    @property
    def moving(self) -> Rows:
        """Return the columns that the refit of at least one candidate moves."""
        rows: Rows = np.flatnonzero(np.any(self.moves, axis=0))
        return rows

    def has(self, column: int) -> NDArray[np.bool_]:
        """Return True for each candidate that has this column, [C]."""
        return np.array([column < len(c) for c in self.columns])

    def fill_from(self, u: Array, fit: Refit) -> None:
        """Fill u [records, size] with the values of an earlier refit that has the same leading quantities."""
        quantities = len(fit.columns)
        u[:, :quantities] = fit.u
        if self.knots:
            u[:, self.freed :] = fit.knots

    def values_of(self, u: Array, v: Array) -> tuple[Array, OwnValues]:
        """Return quantities [variants, C, records, Q] and own values for u [variants, C, records, P], v [.., 3]."""
        evidence = self.problem.evidence
        x = np.broadcast_to(self.problem.base, (*u.shape[:3], self.problem.base.size)).copy()
        for i, columns in enumerate(self.columns):
            for k, f in sorted(enumerate(columns), key=lambda kf: kf[1].nuisance):
                if f.along:
                    continue
                value = f.value(u[:, i, :, k])
                if f.shares:
                    off = self.problem.base[f.index]
                    value = off + np.array(f.shares) * (value - off)
                x[:, i, :, f.index] = x[:, i, :, f.index] + value if f.nuisance else value
        warm = np.where([t is None for t in evidence.temps], UNMEASURED_SD_K, START_SD_K)
        believed = evidence.start_soc + x[..., INDEX["start_soc_shift"]]
        soc = np.minimum(believed + self.start_sd * v[..., 0], 1.03)
        return x, OwnValues(soc, warm * v[..., 1], AMBIENT_SD_K * v[..., 2])

    def drifts(self, u: Array) -> Array | None:
        """Return the drift of the quantities along each course, [variants, C, records, courses, Q], or None."""
        drifting = [(i, k, f) for i, columns in enumerate(self.columns) for k, f in enumerate(columns) if f.along]
        if not drifting:
            return None
        out = np.zeros((*u.shape[:3], len(COURSES), self.problem.base.size))
        for i, k, f in drifting:
            out[:, i, :, COURSES.index(f.along), f.index] = f.value(u[:, i, :, k])
        return out

    def simulated(self, u: Array, v: Array, wanted: NDArray[np.bool_]) -> Simulated:
        """Simulate the `wanted` [variants, C] combinations of variants and candidates, in that order."""
        x, own = self.values_of(u, v)
        drift = self.drifts(u)
        return simulate(
            self.problem.pack,
            self.problem.evidence,
            x[wanted],
            OwnValues(*(o[wanted] for o in own)),
            self.problem.states,
            drift[wanted] if drift is not None else None,
        )

    def residuals(self, us: Array, vs: Array, wanted: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Return the whitened residuals [variants, C, records, numbers] and the first variant's soc [rows, C, records].

        Residuals are zero where they are not `wanted` [variants, C].
        """
        simulated = self.simulated(us, vs, wanted)
        white = whitened(self.problem.evidence, simulated)
        out = np.zeros((*wanted.shape, *white.shape[1:]))
        out[wanted] = white
        return out, simulated.soc[:, : len(self.candidates)]

    def slopes_on_knots(self, soc: Array) -> Array:
        """Return the slopes of the residuals on the file's tables, [knots, C, records, numbers]."""
        tables, stack, volts = self.problem.tables, self.problem.evidence.stack, self.problem.evidence.volts
        slopes = np.zeros((self.knots, soc.shape[1], self.records, width(self.problem.evidence)))
        for j, table in enumerate(volts if tables is not None else ()):
            assert tables is not None
            amps, quick_A = (a[table.rows, j, None] for a in (stack.current_A, self.problem.evidence.quick_A))
            change = tables.voltage(self.problem.pack, soc[table.rows, :, j], amps, quick_A, stack.capacity_Ah[j])
            flat = table.inverse @ change.reshape(table.rows.size, -1)
            slopes[:, :, j, : table.rows.size] = flat.reshape(change.shape).transpose(2, 1, 0)
        return slopes


def width(evidence: Evidence) -> int:
    """Return the number of whitened numbers of the longest record."""
    pairs = zip(evidence.volts, evidence.temps, strict=True)
    return max(w.rows.size + (t.rows.size if t is not None else 0) for w, t in pairs)


def whitened(evidence: Evidence, simulated: Simulated) -> Array:
    """Return model minus measurement as independent unit numbers, [variants, records, width]."""
    stack = evidence.stack
    out = np.zeros((simulated.voltage_V.shape[1], len(evidence.names), width(evidence)))
    for j, (volts, temps) in enumerate(zip(evidence.volts, evidence.temps, strict=True)):
        misfit = simulated.voltage_V[volts.rows, :, j] - stack.voltage_V[volts.rows, j, None]
        size = volts.rows.size
        out[:, j, :size] = (volts.inverse @ misfit).T
        if temps is not None:
            warmth = simulated.temp_C[temps.rows, :, j] - stack.temp_C[temps.rows, j, None]
            out[:, j, size : size + temps.rows.size] = (temps.inverse @ warmth).T
    return out


ALL_OF_ONE = np.ones((1, 1), dtype=bool)


def at_best(problem: Problem, fit: Refit) -> Simulated:
    """Return the sensor readings that the refit's values predict (one variant)."""
    simulated = Batch(problem, [fit.candidate]).simulated(fit.u[None, None], fit.v[None, None], ALL_OF_ONE)
    if problem.tables is None:
        return simulated
    stack, soc = problem.evidence.stack, simulated.soc[:, 0]
    change = problem.tables.voltage(problem.pack, soc, stack.current_A, problem.evidence.quick_A, stack.capacity_Ah)
    of_tables_V = np.einsum("rjk,jk->rj", change, fit.knots)
    return simulated._replace(voltage_V=simulated.voltage_V + of_tables_V[:, None])


def slopes_on_file(problem: Problem, fit: Refit) -> Array:
    """Return the change of `fit.residual` for one sd of each error of the file, [records, numbers, errors]."""
    batch = Batch(problem, [fit.candidate])
    u = np.zeros((1, len(fit.u), batch.size))
    batch.fill_from(u[0], fit)
    fixed = np.flatnonzero(~fit.moves[: len(fit.columns)])
    us = np.repeat(u[None], 1 + fixed.size, axis=0)
    us[1 + np.arange(fixed.size), ..., fixed] += NUDGE
    vs = np.repeat(fit.v[None, None], 1 + fixed.size, axis=0)
    values, soc = batch.residuals(us, vs, np.repeat(ALL_OF_ONE, 1 + fixed.size, axis=0))
    shared = np.moveaxis(values[1:, 0] - values[0, 0], 0, -1) / NUDGE
    tables = np.moveaxis(batch.slopes_on_knots(soc)[:, 0], 0, -1)
    both: Array = np.concatenate([shared, tables], axis=-1)
    return both
