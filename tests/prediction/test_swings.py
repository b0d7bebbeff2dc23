"""Swings of the power: of mean 1, as large and as long as stated, whatever the steps are."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uavbatt.prediction.load.swings import GUST_MEMORY_S, MANOEUVRE_MEMORY_S, Swings, swung

COUNT = 2000


@pytest.mark.parametrize("swings", [Swings(0.2, 0.0), Swings(0.0, 0.3), Swings(0.15, 0.25)])
def test_the_power_keeps_its_mean_and_has_the_stated_spread(swings: Swings) -> None:
    factors = swung(np.full(100, 4.0), COUNT, swings)
    assert factors.mean() == pytest.approx(1.0, abs=0.01)
    spread = math.sqrt((1.0 + swings.manoeuvres**2) * (1.0 + swings.gusts**2) - 1.0)  # of a product
    assert factors.std() == pytest.approx(spread, rel=0.05)
    assert (factors > 0.0).all()


@pytest.mark.parametrize(
    ("swings", "memory_s"), [(Swings(0.2, 0.0), MANOEUVRE_MEMORY_S), (Swings(0.0, 0.2), GUST_MEMORY_S)]
)
def test_a_swing_is_forgotten_with_its_memory(swings: Swings, memory_s: float) -> None:
    logs = np.log(swung(np.full(200, 2.0), COUNT, swings))
    logs -= logs.mean(axis=1, keepdims=True)
    for lag in (1, 4, 10):
        correlation = float(np.mean(logs[lag:] * logs[:-lag]) / np.mean(logs**2))
        assert correlation == pytest.approx(math.exp(-2.0 * lag / memory_s), abs=0.05)


def test_equal_steps_and_steps_that_hardly_differ_give_the_same_swings() -> None:
    """Equal steps are worked out in blocks, others one by one."""
    steps_s = np.full(90, 3.0)
    hardly_s = steps_s + 1e-9 * np.arange(90)
    swings = Swings(0.2, 0.25)
    assert swung(steps_s, 24, swings) == pytest.approx(swung(hardly_s, 24, swings), rel=1e-6)


def test_no_swings_leave_the_power_as_it_is() -> None:
    assert (swung(np.full(50, 2.0), 8, Swings(0.0, 0.0)) == 1.0).all()
