"""Steady flight: of which rows the power is learned."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uavbatt.battery.model import Array
from uavbatt.navigation import METRES_PER_DEGREE, Position
from uavbatt.prediction.route.steadiness import Steadiness

SPEED_MS, LEG_S, TURN_S = 5.0, 40, 3


def flown(noise_ms: float, seconds: int = 400) -> tuple[list[bool], Array]:
    """Return if each second of a flight there and back in legs of LEG_S was steady, and which were turns."""
    rng, value = np.random.default_rng(7), Steadiness()
    north_m, steady, turning = 0.0, [], []
    for second in range(seconds):
        leg, into_s = divmod(second, LEG_S)
        share = min(into_s / TURN_S, 1.0) if leg else 1.0
        north_ms = SPEED_MS * (-1.0) ** leg * (2.0 * share - 1.0)
        north_m += north_ms
        told = np.array([north_ms, 0.0, 0.0]) + rng.normal(0.0, noise_ms, 3)
        value = value.after(Position(float(second), north_m / METRES_PER_DEGREE, 0.0, 30.0, *map(float, told)))
        steady.append(value.is_steady)
        turning.append(0.0 < share < 1.0 or (into_s == TURN_S and leg > 0))
    return steady, np.array(turning)


@pytest.mark.parametrize("noise_ms", [0.0, 0.1, 0.3])
def test_the_noise_of_a_receiver_is_no_turn_and_turns_are_found_in_it(noise_ms: float) -> None:
    """With 0.3 m/s on each axis nothing was steady: no power was learned, and "turn back now" came 564 s early."""
    steady, turning = flown(noise_ms)
    settled = np.arange(len(steady)) > 120
    assert np.mean(np.array(steady)[settled & ~turning]) > 0.8
    assert not np.array(steady)[turning].any()


def test_without_noise_a_gentle_turn_counts_as_one() -> None:
    value, steady = Steadiness(), []
    for second in range(60):
        heading = 0.1 * second  # 0.5 m/s in each second
        velocity = SPEED_MS * math.cos(heading), SPEED_MS * math.sin(heading), 0.0
        place = (
            SPEED_MS / 0.1 / METRES_PER_DEGREE * math.sin(heading),
            -SPEED_MS / 0.1 / METRES_PER_DEGREE * math.cos(heading),
        )
        value = value.after(Position(float(second), *place, 30.0, *velocity))
        steady.append(value.is_steady)
    assert not any(steady[1:25])


def test_an_unknown_velocity_is_not_steady_and_changes_nothing() -> None:
    value = Steadiness().after(Position(0.0, 0.0, 0.0, 30.0, 1.0, 0.0, 0.0))
    blind = value.after(Position(1.0, 0.0, 0.0, 30.0))
    assert not blind.is_steady and blind.usual_ms == value.usual_ms
    assert Steadiness().after(None).is_steady
