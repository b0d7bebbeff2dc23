"""Refits side by side: each ends where it would end alone, and nothing in the model has a corner that holds one."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from planted_flights import CAPACITY_AH, CELLS, CUTOFF_V, FILE, fly

from uavbatt.battery.sizing.pack_size import PackOptions, pack_from
from uavbatt.diagnosis.diagnosis import options_of, problem_of
from uavbatt.diagnosis.refit import solver
from uavbatt.diagnosis.refit.late_current import SHIFTS_S, metered_current
from uavbatt.diagnosis.refit.problem import Problem
from uavbatt.diagnosis.refit.solver import refit


@cache
def problem() -> Problem:
    """Two flights whose current is read a tenth too large."""
    records = [fly(air_C, 160.0, seed, gain=1.1) for air_C, seed in ((12.0, 1), (25.0, 2))]
    return problem_of(records, FILE, pack_from(FILE, PackOptions(CELLS, CAPACITY_AH, CUTOFF_V)))


def test_a_candidate_ends_beside_others_where_it_ends_alone() -> None:
    options = [o for o in options_of(problem(), FILE, ()) if o.name in ("current_gain", "polarisation", "weak_cell")]
    for alone, beside in zip((refit(problem(), [o])[0] for o in options), refit(problem(), options), strict=True):
        assert beside.values() == pytest.approx(alone.values(), rel=1e-6)
        assert beside.total == pytest.approx(alone.total, rel=1e-9)


def test_candidates_in_groups_end_where_they_end_together(monkeypatch: pytest.MonkeyPatch) -> None:
    options = [o for o in options_of(problem(), FILE, ()) if o.name in ("current_gain", "polarisation", "weak_cell")]
    together = refit(problem(), options)
    monkeypatch.setattr(solver, "COLUMNS", 1)
    for one, grouped in zip(together, refit(problem(), options), strict=True):
        assert grouped.values() == pytest.approx(one.values(), rel=1e-6)
        assert grouped.total == pytest.approx(one.total, rel=1e-9)


def test_what_a_refit_holds_stays_at_what_the_file_says_and_counts_in_the_errors() -> None:
    gain = next(o for o in options_of(problem(), FILE, ()) if o.name == "current_gain")
    fit = refit(problem(), [gain])[0]
    held = ~fit.moves[: len(fit.columns)]
    assert held.any() and not fit.u[:, held].any() and not fit.knots.any()
    assert fit.covariance_u(considered=True) > fit.covariance_u(considered=False)


def test_a_current_read_later_is_the_shifted_one_and_has_no_corner_at_no_delay() -> None:
    evidence = problem().evidence
    column = np.array([1.0, 1.0])

    def read(delay_s: float) -> np.ndarray:
        return metered_current(evidence.stack.current_A, evidence.shifted_A, delay_s * column)

    places = np.searchsorted(SHIFTS_S, (0.0, 1.0))
    assert read(1.0) - read(0.0) == pytest.approx(evidence.shifted_A[places[1]] - evidence.shifted_A[places[0]])
    before, at, after = (read(delay_s) for delay_s in (-1e-4, 0.0, 1e-4))
    slope = np.max(np.abs(after - before))
    assert slope > 0.0 and np.max(np.abs(after - 2.0 * at + before)) < 1e-2 * slope
