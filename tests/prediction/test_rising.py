"""A power that rises for minutes: found in the scatter of a flight, and not where nothing rises."""

from __future__ import annotations

import numpy as np
import pytest
from route_rig import POWERS

from uavbatt.prediction.load.rising import (
    BLOCK_S,
    LEAST_RISING,
    LONGEST_RISE,
    NOW_BLOCKS,
    RISING_SD,
    blocks_since_rise,
    has_risen,
)
from uavbatt.prediction.route.power_level import PowerLevel


def rising(rise: float, scatter: float = 0.0, blocks: int = LONGEST_RISE, seed: int = 4) -> bool:
    """What is found in ratios that rise evenly and scatter."""
    noise = scatter * np.random.default_rng(seed).standard_normal(blocks)
    return has_risen(np.linspace(0.0, rise, blocks) + noise)


def test_ice_and_a_wind_that_freshens_are_found() -> None:
    assert rising(0.25) and rising(0.25, scatter=0.04) and rising(0.15, blocks=LEAST_RISING)
    assert not rising(0.06)
    assert not rising(-0.25)  # less power is safe to see late
    assert not rising(0.25, blocks=LEAST_RISING - 1)
    assert not has_risen(np.empty(0))


def test_a_rise_that_has_ended_is_remembered() -> None:
    """What counts is all of the time at the new power, or the last two minutes of it."""
    risen = np.concatenate([np.zeros(6), np.linspace(0.0, 0.25, 12)])
    for later in (0, 1, 5, 40, 100):
        since = blocks_since_rise(np.concatenate([risen, np.full(later, 0.25)]))
        assert max(later - 8, NOW_BLOCKS) <= since <= later + NOW_BLOCKS
    assert blocks_since_rise(np.zeros(60)) == 0


def test_a_front_and_a_payload_are_steps() -> None:
    """Twelve per cent for two minutes may pass; what lasts is found as a step, or counts by the mean of the flight."""
    for since in (2, 4, 8, 12):
        assert not has_risen(np.concatenate([np.zeros(LONGEST_RISE - since), np.full(since, 0.12)]))


def test_the_last_four_minutes_are_enough() -> None:
    """The first half of the flight was steady."""
    assert has_risen(np.concatenate([np.zeros(12), np.linspace(0.0, 0.2, 8)]))


@pytest.mark.parametrize("scatter", [0.02, 0.05, 0.1, 0.25])
def test_scatter_alone_is_hardly_ever_a_rise(scatter: float) -> None:
    """Blocks of a simulated flight scatter by 0.02, those of a real one by up to 0.25."""
    assert sum(rising(0.0, scatter, seed=seed) for seed in range(300)) <= 6


def flown(ratios: np.ndarray, noise: float = 0.0) -> PowerLevel:  # type: ignore[type-arg]
    """The level after a second at each ratio."""
    level, dice = PowerLevel(), np.random.default_rng(1)
    for ratio in ratios * np.exp(noise * dice.standard_normal(ratios.size)):
        level = level.after(float(ratio), 1.0, row_sd=noise)
    return level


def test_a_level_that_rises_is_that_of_the_last_two_minutes_and_may_rise_on() -> None:
    """The mean of ten minutes: 200 to 400 s too much were told on a mission, and the lower end 100 to 250 s."""
    level, sd = flown(np.concatenate([np.ones(240), np.linspace(1.0, 1.4, 600)]), noise=0.05).level(POWERS)
    assert level == pytest.approx(1.36, abs=0.03)
    assert RISING_SD < sd < 1.5 * RISING_SD
    steady, sd = flown(np.full(840, 1.2), noise=0.05).level(POWERS)
    assert steady == pytest.approx(1.17, abs=0.03) and sd < 0.5 * RISING_SD


def test_a_level_that_has_stopped_rising_is_known_well_again() -> None:
    stopped = flown(np.concatenate([np.ones(240), np.linspace(1.0, 1.4, 400), np.full(900, 1.4)]), noise=0.05)
    level, sd = stopped.level(POWERS)
    assert level == pytest.approx(1.36, abs=0.05) and sd < 0.5 * RISING_SD


def test_a_saved_level_that_no_flight_leaves_is_not_possible() -> None:
    good = flown(np.ones(200))
    assert good.is_possible and good.blocks and BLOCK_S * len(good.blocks) <= 200.0
    assert not good._replace(blocks=(1.0,) * (LONGEST_RISE + 1)).is_possible
    assert not good._replace(blocks=(0.0,)).is_possible
    assert not good._replace(open_sum_s=float("nan")).is_possible
