"""The search of shared and own unknowns ends where scipy's dense search ends, and knows them as well."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from uavbatt.battery.model import Array
from uavbatt.fitting.arrow import CONVERGED, NUDGE, Evaluate, robust_least_squares

OUTLIER, SHARED, RECORDS, OWN, ROWS = 4.0, 3, 5, 2, 12
AT = np.linspace(0.0, 1.0, ROWS)
TRUE_U, NOISE = np.array([0.8, -0.5, 1.2]), 0.05


def measured(outlier: float = 0.0) -> Array:
    """Return readings [rows, records] of records that differ; the last reading of the first is wrong by `outlier`."""
    dice = np.random.default_rng(7)
    readings = of_model(TRUE_U[None], dice.standard_normal((1, RECORDS, OWN)))[0]
    readings += NOISE * dice.standard_normal(readings.shape)
    readings[-1, 0] += outlier
    return readings


def of_model(u: Array, v: Array) -> Array:
    """Return the readings of the model [variants, rows, records]: a bent curve, own offset and own slope."""
    curve = np.exp(0.3 * u[:, :1]) * AT + u[:, 1:2] * AT**2 + np.sin(u[:, 2:] * AT)
    return np.asarray(curve[:, :, None] + 0.2 * v[:, None, :, 0] + 0.1 * np.sinh(v[:, None, :, 1]) * AT[:, None])


def against(readings: Array) -> Evaluate:
    return lambda u, v: ((of_model(u, v) - readings) / NOISE, 2.0 * (u[:, :1] - u[:, 1:2]))


def dense(readings: Array) -> tuple[Array, float, Array]:
    """Return unknowns, cost and curvature of all unknowns together by scipy's search and a dense Jacobian."""
    evaluate = against(readings)

    def residuals(x: Array) -> Array:
        of_records, common = evaluate(x[None, :SHARED], x[SHARED:].reshape(1, RECORDS, OWN))
        return np.concatenate([of_records.ravel(), common.ravel(), x])

    ends = least_squares(residuals, np.zeros(SHARED + RECORDS * OWN), loss="soft_l1", f_scale=OUTLIER, xtol=1e-12)
    slopes = np.asarray(ends.jac, dtype=float)
    return ends.x, float(ends.cost), slopes.T @ slopes


@pytest.mark.parametrize("outlier", [0.0, 2.0])
def test_it_ends_where_a_dense_search_ends(outlier: float) -> None:
    readings = measured(outlier)
    found = robust_least_squares(against(readings), np.zeros(SHARED), (RECORDS, OWN), OUTLIER, 60)
    x, cost, curvature = dense(readings)
    sd = np.sqrt(np.diagonal(np.linalg.inv(curvature)))
    assert np.abs((np.concatenate([found.u, found.v.ravel()]) - x) / sd).max() < 0.06
    assert found.cost == pytest.approx(cost, abs=2.0 * CONVERGED)
    assert found.log_determinant == pytest.approx(np.linalg.slogdet(curvature)[1], abs=0.01)
    marginal = np.linalg.inv(curvature)[:SHARED, :SHARED]
    assert np.linalg.inv(found.information) == pytest.approx(marginal, rel=0.01, abs=1e-5)


def test_a_wrong_reading_does_not_decide() -> None:
    """Forty standard deviations off, it moves the unknowns by less than two of theirs."""
    right, wrong = (
        robust_least_squares(against(measured(outlier)), np.zeros(SHARED), (RECORDS, OWN), OUTLIER, 60)
        for outlier in (0.0, 2.0)
    )
    sd = np.sqrt(np.diagonal(np.linalg.inv(right.information)))
    assert np.abs((wrong.u - right.u) / sd).max() < 2.0


def test_a_trial_that_cannot_be_simulated_is_no_step() -> None:
    """Far from the prior a pack diverges; the search goes on with shorter steps."""
    readings = measured()

    def diverges(u: Array, v: Array) -> tuple[Array, Array]:
        residuals, common = against(readings)(u, v)
        return np.where(np.abs(u[:, :1, None]) > 1.0 + NUDGE, np.nan, residuals), common

    found = robust_least_squares(diverges, np.zeros(SHARED), (RECORDS, OWN), OUTLIER, 60)
    assert np.isfinite(found.cost) and np.abs(found.u[0]) <= 1.0
