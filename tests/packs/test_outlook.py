"""When a pack will be retired: the quantiles of many drawn packs, and the numbers in the crew's units."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uavbatt.packs.outlook import outlook, retirement
from uavbatt.packs.records import PackBelief

RATED_AH = 5.0
MEAN = np.array([math.log(0.012), math.log(4.6), 0.004, -0.008])


def belief(capacity_sd: float = 0.03, trend_sd: float = 0.002, correlation: float = 0.0) -> PackBelief:
    sd = np.array([0.05, capacity_sd, 0.001, trend_sd])
    shared = np.eye(4)
    shared[1, 3] = shared[3, 1] = correlation
    return PackBelief(MEAN, shared * np.outer(sd, sd))


@pytest.mark.parametrize("correlation", [-0.6, 0.0, 0.6])
def test_the_flights_left_are_the_quantiles_of_drawn_packs(correlation: float) -> None:
    known, file_sd = belief(correlation=correlation), 0.02
    dice = np.random.default_rng(1)
    drawn = dice.multivariate_normal(known.mean, known.covariance, 200_000)
    left = drawn[:, 1] + file_sd * dice.standard_normal(len(drawn)) - math.log(0.8 * RATED_AH)
    flights = np.maximum(left, 0.0) / np.maximum(-drawn[:, 3], 1e-9)
    expected = np.quantile(flights, [0.5, 0.05, 0.95])
    found = retirement(known, RATED_AH, file_sd)
    assert found[0] == pytest.approx(expected[0], rel=0.05)
    assert found[1:] == pytest.approx(expected[1:], rel=0.2, abs=2.0)  # of a hundred draws


def test_a_pack_below_its_limit_is_due_now_and_one_that_does_not_fade_never() -> None:
    worn = PackBelief(MEAN - np.array([0.0, 0.5, 0.0, 0.0]), belief().covariance)
    assert retirement(worn, RATED_AH, 0.02) == (0.0, 0.0, 0.0)
    steady = PackBelief(MEAN * np.array([1.0, 1.0, 1.0, 0.0]) + np.array([0.0, 0.0, 0.0, 0.02]), belief().covariance)
    assert retirement(steady, RATED_AH, 0.02) == (math.inf, math.inf, math.inf)


def test_the_outlook_is_in_ohms_and_ampere_hours_with_the_error_of_the_file() -> None:
    found = outlook(belief(), RATED_AH, 7, "a-make")
    assert found.flights == 7
    assert (found.resistance_ohm, found.capacity_Ah) == pytest.approx((0.012, 4.6))
    assert found.resistance_hi_ohm / found.resistance_ohm == pytest.approx(
        found.resistance_ohm / found.resistance_lo_ohm
    )
    assert math.log(found.resistance_hi_ohm / 0.012) / 1.645 == pytest.approx(math.hypot(0.05, 0.04), rel=0.01)
    sd = math.log(found.capacity_hi_Ah / found.capacity_Ah) / 1.645
    assert sd == pytest.approx(math.hypot(0.03, 0.02), rel=0.01)
    assert (found.capacity_trend, found.resistance_trend) == (-0.008, 0.004)
    generic = outlook(belief(), RATED_AH, 7, "lipo-generic")
    assert generic.capacity_lo_Ah < found.capacity_lo_Ah and generic.capacity_Ah == found.capacity_Ah
