"""How a simulated aircraft moves along its legs: two roads to the place, and the times of uniform acceleration."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uavbatt.prediction.route.legs import Leg, Phase, Point
from uavbatt.simulate.route import motion_of

ACCELERATION_MS2 = 2.5


def leg(length_m: float, speed_ms: float) -> Leg:
    return Leg(1, Phase.ROUTE, Point(0.0, 0.0, 20.0), Point(length_m, 0.0, 20.0), length_m, speed_ms, 2.5, 1.5)


@pytest.mark.parametrize(
    ("length_m", "speed_ms", "lasts_s"),
    [
        (100.0, 5.0, 20.0 + 5.0 / 2.5),  # 2 s to gain the speed, 2 s to lose it, in which half of the way is flown
        (10.0, 5.0, 2.0 * 5.0 / 2.5),  # the speed is gained in half of the way
        (4.0, 5.0, 2.0 * math.sqrt(4.0 / 2.5)),  # and here it is not reached
        (0.0, 5.0, 0.0),
    ],
)
def test_a_leg_lasts_as_long_as_uniform_acceleration_says(length_m: float, speed_ms: float, lasts_s: float) -> None:
    assert motion_of(leg(length_m, speed_ms), ACCELERATION_MS2).lasts_s == pytest.approx(lasts_s)


@pytest.mark.parametrize("length_m", [3.0, 10.0, 11.0, 200.0])
def test_the_speed_adds_up_to_the_place(length_m: float) -> None:
    motion = motion_of(leg(length_m, 5.0), ACCELERATION_MS2)
    time_s = np.linspace(-1.0, motion.lasts_s + 1.0, 20_001)
    share, rate = np.array([motion.at(t) for t in time_s]).T
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time_s))])
    assert share == pytest.approx(summed, abs=1e-4)
    assert share[0] == 0.0 and share[-1] == 1.0
    assert np.max(np.abs(np.diff(rate))) * length_m <= 1.01 * ACCELERATION_MS2 * (time_s[1] - time_s[0])
