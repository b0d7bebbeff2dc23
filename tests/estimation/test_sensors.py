"""Sensors that stand still: told from a load that is steady by the sensor's own habit of moving."""

from __future__ import annotations

import numpy as np
import pytest

from uavbatt.estimation.sensors import STUCK_S, SensorChanges

CELLS, CAPACITY_AH = 4.0, 5.0


def after(current_A: list[float], row_s: float = 1.0) -> SensorChanges:
    """The readings of a voltage that falls steadily, beside these currents."""
    readings = SensorChanges()
    for k, amps in enumerate(current_A):
        readings = readings.after(k * row_s, 15.0 - 0.002 * k, amps, CELLS)
    return readings


def gusty(rows: int, digit_A: float = 0.05, seed: int = 1) -> list[float]:
    """A hover as a sensor with this last digit reads it."""
    amps = 18.0 + 0.6 * np.random.default_rng(seed).standard_normal(rows)
    return list((np.round(amps / digit_A) * digit_A).tolist())


def test_a_current_that_stops_moving_is_stuck() -> None:
    sound = gusty(120)
    assert after(sound).stuck_current_s(CAPACITY_AH) == 0.0
    stuck = after([*sound, *[2.0] * 40]).stuck_current_s(CAPACITY_AH)
    assert STUCK_S <= stuck <= 40.0


def test_it_is_forgiven_when_it_moves_again() -> None:
    assert after([*gusty(120), *[2.0] * 40, *gusty(3, seed=2)]).stuck_current_s(CAPACITY_AH) == 0.0


@pytest.mark.parametrize(
    "current_A",
    [
        [18.0] * 300,  # a load bench: it never moved
        [18.0] * 100 + [20.0] * 100 + [18.0] * 100,  # steps of a test
        [*gusty(120), *[0.3] * 120],  # landed, on its electronics
        gusty(300, digit_A=1.0),  # a coarse sensor
    ],
)
def test_what_is_steady_by_nature_is_not_stuck(current_A: list[float]) -> None:
    assert after(current_A).stuck_current_s(CAPACITY_AH) == 0.0


def test_rows_sent_more_often_than_the_sensor_is_read_are_not_stuck() -> None:
    """Ten rows a second of a sensor that is read once a second."""
    repeated = [amps for amps in gusty(60) for _ in range(10)]
    assert after(repeated, row_s=0.1).stuck_current_s(CAPACITY_AH) == 0.0
