"""What a filter learns shortly after a load: nothing of the capacity, also if a small load remains."""

from __future__ import annotations

import numpy as np
import pytest
from factories import generic_pack
from scoring.other_pack import LIPO, Pack, drawn

from uavbatt.battery.capacity_prior import capacities
from uavbatt.estimation.filter import SocFilter

POWER_OF_1C_W = 75.0


def weights_after(*phases: tuple[float, int]) -> list[np.ndarray]:
    """The weights of the capacities after each phase: a C-rate and for how many seconds."""
    pack, ours, from_s, found = (
        Pack(make=LIPO),
        SocFilter(generic_pack(), capacities=capacities(generic_pack())),
        0.0,
        [],
    )
    for rate_c, seconds in phases:
        rows = drawn(pack, [rate_c * POWER_OF_1C_W] * seconds, from_s).rows
        ours.run(list(rows))
        from_s += seconds
        assert ours.belief is not None
        found.append(ours.belief.weights)
    return found


@pytest.mark.parametrize(("high_c", "low_c"), [(8.0, 0.4), (12.0, 0.45)])
def test_the_recovery_after_a_climb_tells_nothing_of_the_capacity(high_c: float, low_c: float) -> None:
    """A glider that draws 0.4 C was no pack at rest: the filter of the largest capacity won by the recovery."""
    *_, begun, glided, long = weights_after((0.1, 20), (high_c, 60), (low_c, 4), (low_c, 40), (low_c, 200))
    assert glided == pytest.approx(begun, abs=1e-9)
    assert np.abs(long - glided).max() > 1e-4  # after a minute it tells again


def test_a_descent_of_a_multirotor_tells_of_the_capacity() -> None:
    *_, begun, descended = weights_after((0.1, 20), (3.0, 120), (1.5, 4), (1.5, 40))
    assert np.abs(descended - begun).max() > 1e-4
