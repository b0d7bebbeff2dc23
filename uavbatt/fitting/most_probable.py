"""The most probable unknowns of a fit: least squares, a point and its slopes from one simulation side by side.

Of few readings one simulation costs what thirty side by side do, so that a point that is asked for has its neighbours
with it: the slopes there are nearly always asked for next.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from uavbatt.battery.model import Array

NUDGE = 1e-4  # in units of the prior's standard deviations


def most_probable(
    residuals: Callable[[Array], Array],
    start: Array,
    *,
    evaluations: int,
    xtol: float,
    ftol: float,
    is_robust: bool = False,
) -> OptimizeResult:
    """Find the unknowns u [slots] of the least sum of squares, from `start` on.

    residuals: gives [batch, numbers] for u [batch, slots], the prior's own share (u itself) among them.
    evaluations, xtol, ftol: when the search ends, as in `scipy.optimize.least_squares`, whose result is returned.
    is_robust: a residual beyond 1 counts less than its square.
    """

    asked, known = np.empty(0), np.empty((0, 0))

    def with_neighbours(u: Array) -> Array:
        nonlocal asked, known
        if not np.array_equal(u, asked):
            asked, known = u.copy(), residuals(np.vstack([u, u + NUDGE * np.eye(u.size)]))
        return known

    def objective(u: Array) -> Array:
        out: Array = with_neighbours(u)[0]
        return out

    def slopes(u: Array) -> Array:
        values = with_neighbours(u)
        return np.asarray((values[1:] - values[0]).T / NUDGE)

    loss: Literal["soft_l1", "linear"] = "soft_l1" if is_robust else "linear"
    return least_squares(objective, start, slopes, loss=loss, max_nfev=evaluations, xtol=xtol, ftol=ftol)
