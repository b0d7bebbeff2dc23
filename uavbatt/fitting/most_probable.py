"""The most probable unknowns of fits: least squares, with slopes from one simulation of all finite differences.

Twenty simulations side by side cost the same as one. So every simulation gives the residuals and their slopes together,
and fits that use the same simulation (from several starts, or to parts of the data) run side by side too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from queue import SimpleQueue
from typing import Literal

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from uavbatt.battery.model import Array

NUDGE = 1e-4  # in units of the prior's standard deviations

Residuals = Callable[[Array, Array], Array]


def most_probable(
    simulate: Callable[[Array], Array],
    residuals: Sequence[Residuals],
    starts: Sequence[Array],
    *,
    evaluations: int,
    xtol: float,
    ftol: float,
    is_robust: bool = False,
) -> list[OptimizeResult]:
    """Find the unknowns u [slots] of the least sum of squares of each of `residuals`, from its own start on.

    simulate: gives what the residuals compare, [batch, ...], for u [batch, slots]; each row by itself.
    residuals: each gives [batch, numbers] for u and what was simulated, the prior's own share (u itself) among them.
    evaluations, xtol, ftol: when a search ends, as in `scipy.optimize.least_squares`, whose results are returned.
    is_robust: a residual beyond 1 counts less than its square.

    Each search is a thread. It waits until all other running searches have also asked for a simulation.
    """
    loss: Literal["soft_l1", "linear"] = "soft_l1" if is_robust else "linear"
    questions = SimpleQueue[tuple[int, Array | None]]()
    answers = [SimpleQueue[Array | None]() for _ in starts]

    def search(k: int) -> OptimizeResult:
        def misfit(u: Array) -> Array:
            questions.put((k, u))
            if (simulated := answers[k].get()) is None:
                raise CancelledError
            return residuals[k](u, simulated)

        try:
            objective, slopes = _with_slopes(misfit)
            return least_squares(objective, starts[k], slopes, loss=loss, max_nfev=evaluations, xtol=xtol, ftol=ftol)
        finally:
            questions.put((k, None))

    with ThreadPoolExecutor(max(len(starts), 1)) as threads:
        searches = [threads.submit(search, k) for k in range(len(starts))]
        try:
            _answer(simulate, questions, answers)
        finally:
            for answer in answers:
                answer.put(None)
    return [s.result() for s in searches]


def _answer(
    simulate: Callable[[Array], Array],
    questions: SimpleQueue[tuple[int, Array | None]],
    answers: list[SimpleQueue[Array | None]],
) -> None:
    """Simulate together what all running searches ask for, until none is left."""
    searching, waiting = len(answers), dict[int, Array]()
    while searching:
        k, u = questions.get()
        if u is None:
            searching -= 1
        else:
            waiting[k] = u
        if waiting and len(waiting) == searching:
            order = sorted(waiting)
            ends = np.cumsum([len(waiting[k]) for k in order])
            simulated = np.split(simulate(np.vstack([waiting[k] for k in order])), ends[:-1])
            waiting.clear()
            for k, part in zip(order, simulated, strict=True):
                answers[k].put(part)


def _with_slopes(residuals: Callable[[Array], Array]) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
    """Return the residuals [numbers] of one u [slots], and their slopes [numbers, slots]."""
    last_u, last_residuals = np.empty(0), np.empty((0, 0))

    def around(u: Array) -> Array:
        """Return the residuals at u and at each of its finite differences; kept, as the search asks twice for one u."""
        nonlocal last_u, last_residuals
        if not np.array_equal(u, last_u):
            last_u, last_residuals = u.copy(), residuals(np.vstack([u, u + NUDGE * np.eye(u.size)]))
        return last_residuals

    def objective(u: Array) -> Array:
        return np.asarray(around(u)[0])

    def slopes(u: Array) -> Array:
        values = around(u)
        return np.asarray((values[1:] - values[0]).T / NUDGE)

    return objective, slopes
