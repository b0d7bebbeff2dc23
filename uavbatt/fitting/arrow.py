"""Robust least squares in which some unknowns are shared by all records and each record has a few of its own.

The own unknowns v_r of a record change its own rows alone. So the normal equations have the shape of an arrow,

    [A    B_1  B_2 ..] [du  ]   [g  ]
    [B_1' C_1        ] [dv_1] = [h_1]        (A - sum_r B_r C_r^-1 B_r') du = g - sum_r B_r C_r^-1 h_r
    [..           .. ] [..  ]   [.. ]

and the matrix of the second equation, the Schur complement, is small (Triggs et al., Bundle Adjustment, 2000, section
6.1). Time and memory grow as the number of records; with one dense matrix of slopes they grew as its cube and square.

All unknowns are in standard deviations of their priors. A residual f counts as 2 c² (sqrt(1 + (f/c)²) - 1), nearly f²
below c and nearly 2 c |f| beyond it, so that an outlier does not decide.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from uavbatt.battery.model import Array

NUDGE = 1e-4  # finite difference in sds of the prior
CONVERGED = 1e-3  # a step that gains less of the cost, as was expected of it, is the last: far below any standard error
# The steps stay within a radius [sds] in which the equations hold (Conn, Gould & Toint, Trust-Region Methods, 2000): a
# step that gains little of what is expected (POOR share) makes it a quarter of that step, one that gains nearly all
# (GOOD) twice as large. With damping that changes by factors instead, a search crept along a bend of the OCV's shape
# and ended before its time: 250 instead of 217 in cost, and a data set that passes the gate did not.
FIRST_RADIUS, LEAST_RADIUS, SHORTER, LONGER = 1.0, 1e-3, 0.25, 2.0
GOOD, POOR = 0.75, 0.25
LEAST_DAMPING, MOST_DAMPING, WITHIN = 1e-9, 1e12, 0.1  # Levenberg's; the length of a step is met to a tenth

# (u [variants, shared], v [variants, records, own]) -> residuals [variants, rows, records], and those that no record
# has [variants, numbers]
Evaluate = Callable[[Array, Array], tuple[Array, Array]]


class Optimum(NamedTuple):
    """Optimum holds the most probable unknowns u [shared] and v [records, own], and how well they are known.

    cost : half the sum over all residuals and unknowns
    information : of u, with v free to follow, [shared, shared]; log_determinant : ln of that of all unknowns together
    """

    u: Array
    v: Array
    cost: float
    information: Array
    log_determinant: float


class _Equations(NamedTuple):
    """_Equations holds the normal equations at u and v, and the cost there."""

    a: Array  # [shared, shared]
    b: Array  # [records, shared, own]
    c: Array  # [records, own, own]
    g: Array  # [shared]: downhill
    h: Array  # [records, own]
    cost: float


class _Step(NamedTuple):
    """_Step holds a step, its length [sds], the gain expected of it, and True if the radius holds it back."""

    du: Array
    dv: Array
    length: float
    expected: float
    is_held: bool


def robust_least_squares(
    evaluate: Evaluate, start: Array, own: tuple[int, int], outlier: float, evaluations: int
) -> Optimum:
    """Find the unknowns of the least cost, from u = `start` and v = 0 on; 0 is the most probable before any record.

    start : of the shared unknowns [shared]; own : numbers of records and of own unknowns; outlier : c, the size beyond
    which a residual is one; evaluations : of the residuals, at most
    """
    u, v, radius = start, np.zeros(own), FIRST_RADIUS
    at = _equations(evaluate, u, v, outlier)
    for _ in range(evaluations):
        step = _step_within(at, radius)
        gained = at.cost - _cost_at(evaluate, u + step.du, v + step.dv, outlier)
        if gained < POOR * step.expected:
            radius = SHORTER * step.length
        elif gained > GOOD * step.expected and step.is_held:
            radius *= LONGER
        if gained > 0.0:
            u, v = u + step.du, v + step.dv
            at = _equations(evaluate, u, v, outlier)
        if radius < LEAST_RADIUS or POOR * step.expected <= gained < CONVERGED:
            break
    information = _information(at, _own_solved(at)[0])
    determinants = (np.linalg.slogdet(matrices)[1] for matrices in (at.c, information))
    return Optimum(u, v, at.cost, information, float(sum(map(np.sum, determinants))))


def _cost(residuals: Array, outlier: float) -> float:
    return float(outlier**2 * np.sum(np.sqrt(1.0 + (residuals / outlier) ** 2) - 1.0))


def _cost_at(evaluate: Evaluate, u: Array, v: Array, outlier: float) -> float:
    of_records, common = evaluate(u[None], v[None])
    cost = sum(_cost(r, outlier) for r in (of_records, common, u, v))
    return cost if np.isfinite(cost) else np.inf


def _weights(residuals: Array, outlier: float) -> tuple[Array, Array]:
    """Return the weights of residuals in the gradient and in the curvature of the cost."""
    beyond = 1.0 + (residuals / outlier) ** 2
    return beyond**-0.5, beyond**-1.5


def _equations(evaluate: Evaluate, u: Array, v: Array, outlier: float) -> _Equations:
    """Work out the normal equations by small changes of each shared unknown, and of every record's own at once."""
    shared, own = u.size, v.shape[1]
    us, vs = np.repeat(u[None], 1 + shared + own, axis=0), np.repeat(v[None], 1 + shared + own, axis=0)
    us[1 : 1 + shared] += NUDGE * np.eye(shared)
    for k in range(own):
        vs[1 + shared + k, :, k] += NUDGE
    of_records, common = evaluate(us, vs)
    slopes = np.moveaxis((of_records[1:] - of_records[0]) / NUDGE, -1, 0)  # [records, unknowns, rows]
    gentle, steep = _weights(of_records[0].T, outlier)
    curvature = slopes * steep[:, None] @ np.swapaxes(slopes, 1, 2)
    downhill = -(slopes @ (gentle * of_records[0].T)[..., None])[..., 0]
    shape = (common[1 : 1 + shared] - common[0]) / NUDGE  # [shared, numbers]
    gentle_shape, steep_shape = _weights(common[0], outlier)
    (gentle_u, steep_u), (gentle_v, steep_v) = _weights(u, outlier), _weights(v, outlier)
    return _Equations(
        a=curvature[:, :shared, :shared].sum(axis=0) + shape * steep_shape @ shape.T + np.diag(steep_u),
        b=curvature[:, :shared, shared:],
        c=curvature[:, shared:, shared:] + steep_v[..., None] * np.eye(own),
        g=downhill[:, :shared].sum(axis=0) - shape @ (gentle_shape * common[0]) - gentle_u * u,
        h=downhill[:, shared:] - gentle_v * v,
        cost=sum(_cost(r, outlier) for r in (of_records[0], common[0], u, v)),
    )


def _own_solved(at: _Equations) -> tuple[Array, Array]:
    """Return C_r^-1 B_r' [records, own, shared] and C_r^-1 h_r [records, own], by which v is eliminated."""
    both = np.concatenate([np.swapaxes(at.b, 1, 2), at.h[..., None]], axis=-1)
    solved: Array = np.linalg.solve(at.c, both)
    return solved[..., :-1], solved[..., -1]


def _information(at: _Equations, of_b: Array) -> Array:
    """Return the information about u while v follows it, the Schur complement [shared, shared]."""
    return np.asarray(at.a - np.sum(at.b @ of_b, axis=0))


def _step_within(at: _Equations, radius: float) -> _Step:
    """Return the step of the least expected cost within a radius [sds] (Levenberg's damping, found by bisection)."""
    step = _damped_step(at, 0.0)
    low, high = math.log(LEAST_DAMPING), math.log(MOST_DAMPING)
    while step.length > (1.0 + WITHIN) * radius or (step.is_held and step.length < (1.0 - WITHIN) * radius):
        middle = 0.5 * (low + high)
        step = _damped_step(at, math.exp(middle))
        low, high = (middle, high) if step.length > radius else (low, middle)
    return step


def _damped_step(at: _Equations, damping: float) -> _Step:
    """Return the step with each unknown held by `damping` beside its prior."""
    held = at._replace(a=at.a + damping * np.eye(at.g.size), c=at.c + damping * np.eye(at.h.shape[1]))
    of_b, of_h = _own_solved(held)
    du = np.asarray(np.linalg.solve(_information(held, of_b), at.g - np.einsum("rso,ro->s", at.b, of_h)))
    dv = of_h - of_b @ du
    squared = float(np.sum(du**2) + np.sum(dv**2))
    downhill = float(np.sum(at.g * du) + np.sum(at.h * dv))
    return _Step(du, dv, math.sqrt(squared), 0.5 * (downhill + damping * squared), damping > 0.0)
