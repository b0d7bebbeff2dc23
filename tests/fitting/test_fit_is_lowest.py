"""A fit of a cell to flights ends as low as a dense search from elsewhere, although the curve of the cell has bends."""

from __future__ import annotations

import math
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from scipy.optimize import least_squares
from scoring.other_pack import FLAT, IDLE_W, LIHV, LIPO, ORDINARY, Make, Pack, Power, drawn, flight

from uavbatt.battery.model import Array
from uavbatt.fitting import observed, prior, solve
from uavbatt.fitting.arrow import Evaluate, Optimum, robust_least_squares
from uavbatt.fitting.observed import Stack
from uavbatt.records import Flight

# Share of 5 Ah, ohms against a new one's, power [W]
PACKS = ((1.0, 1.0, 260.0), (0.80, 1.9, 330.0), (0.92, 1.3, 400.0))
NUDGE, LITTLE = 1e-4, 0.5  # LITTLE: of the cost, half a chi-square of one; a search may stop at a bend


def flown(make: Make) -> Stack:
    flights = [
        flight(Pack(5.0 * share, resistance=ohms, make=make), Power(watts, climb=0.2), seed=k).flight()
        for k, (share, ohms, watts) in enumerate(PACKS)
    ]
    return observed.stack([observed.from_flight(f, 4, 5.0) for f in flights])


def dense_cost(evaluate: Evaluate, shared: int, own: tuple[int, int], outlier: float) -> float:
    """The cost at which scipy's search ends, with one dense matrix of slopes of all unknowns."""

    def residuals(xs: Array) -> Array:
        of_records, common = evaluate(xs[:, :shared], xs[:, shared:].reshape(-1, *own))
        return np.concatenate([of_records.reshape(len(xs), -1), common, xs], axis=1)

    def slopes(x: Array) -> Array:
        values = residuals(np.vstack([x, x + NUDGE * np.eye(x.size)]))
        return np.asarray((values[1:] - values[0]).T / NUDGE)

    start = np.zeros(shared + own[0] * own[1])
    ends = least_squares(
        lambda x: residuals(x[None])[0],
        start,
        slopes,
        loss="soft_l1",
        f_scale=outlier,
        xtol=1e-4,
        ftol=1e-4,
        max_nfev=60,
    )
    return float(ends.cost)


@pytest.mark.parametrize("make", [LIPO, LIHV], ids=["LiPo", "LiHV"])
def test_a_fit_ends_as_low_as_a_dense_search(make: Make) -> None:
    dense: list[float] = []

    def both(evaluate: Evaluate, start: Array, own: tuple[int, int], outlier: float, evaluations: int) -> Optimum:
        dense.append(dense_cost(evaluate, start.size, own, outlier))
        return robust_least_squares(evaluate, start, own, outlier, evaluations)

    with patch.object(solve, "robust_least_squares", both):
        found = solve.fit_cell(flown(make), own_prior=solve.IN_SERVICE, evaluations=60)
    assert found.cost < dense[0] + LITTLE


def test_a_search_that_meets_a_flat_curve_near_empty_goes_round_it() -> None:
    """A pack flown empty that rests before its motors are tried once more shows one voltage for minutes.

    No cell is flat there. With the curve at which the search ended first, a later flight was told 101 s too many.
    """
    pack = Pack(10.0, size_Ah=10.0, make=FLAT, air_C=17.0)
    air = flight(pack, Power(497.0), replace(ORDINARY, voltage_sd_V=0.012, current_sd_A=0.67), seed=93).rows
    ground = drawn(pack, [IDLE_W] * 234 + [200.0] * 2, air[-1].time_s + 1.0, air[-1].consumed_Ah, armed=False).rows
    stack = observed.stack([observed.from_flight(Flight("emptied", "csv", (*air, *ground)), 4, 10.0)])
    with patch.object(solve, "FLAT_V", -math.inf):
        first = solve.fit_cell(stack, own_prior=solve.ALIKE, evaluations=60)
    found = solve.fit_cell(stack, own_prior=solve.ALIKE, evaluations=60)
    assert prior.lowest_fall_V(first.slots, first.u) < 0.01
    assert prior.lowest_fall_V(found.slots, found.u) > 0.05
    assert found.cost < first.cost - LITTLE
