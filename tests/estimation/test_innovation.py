"""Rows within a block: the tangent of the model against the model itself, at every row."""

from __future__ import annotations

import math

import numpy as np
import pytest
from factories import generic_pack

from uavbatt.battery import state_space as b
from uavbatt.battery.capacity_prior import capacities
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import Belief, X
from uavbatt.estimation.filter import SocFilter
from uavbatt.records import Sample


def in_flight(temp_C: float, *, compensated: bool = False) -> SocFilter:
    """A filter with several members after five minutes under 2 C."""
    made = generic_pack()._replace(sag_compensated=compensated)
    ours = SocFilter(made, capacities=capacities(made))
    for k in range(151):
        ours.step(Sample(2.0 * k, 15.8 - 0.003 * k, 10.0, temp_C))
    return ours


def by_the_model(made: Pack, belief: Belief, current_A: float, drawn_As: float) -> tuple[float, float]:
    """Expected voltage [V] and charge of a row `drawn_As` after the belief, member by member."""
    volts = soc = 0.0
    for weight, mean in zip(belief.weights, belief.means, strict=True):
        x = mean.copy()
        x[X.SOC] -= drawn_As / (3600.0 * made.installation.capacity_Ah * math.exp(x[X.LOG_CAPACITY]))
        volts, soc = volts + weight * float(b.voltage(made, x, current_A)), soc + weight * x[X.SOC]
    return volts, soc


@pytest.mark.parametrize(("temp_C", "close_V"), [(25.0, 0.002), (-15.0, 0.012)])
@pytest.mark.parametrize("current_A", [7.0, 9.5, 10.0, 10.5, 14.0])
def test_a_row_within_a_block_is_held_against_the_model(temp_C: float, close_V: float, current_A: float) -> None:
    """Gusts of 40 %: to 0.5 mV a cell, and to 3 mV in the cold, where the drop of the reaction bends."""
    ours = in_flight(temp_C)
    belief, at_s = ours.belief, ours.time_s
    assert belief is not None
    shown = ours.step(Sample(at_s + 1.0, 15.2, current_A, temp_C))
    volts, soc = by_the_model(ours.pack, belief, current_A, 0.5 * (10.0 + current_A))
    assert shown.predicted_voltage_V == pytest.approx(volts, abs=close_V)
    assert shown.innovation_V == pytest.approx(15.2 - volts, abs=close_V)
    assert shown.soc == pytest.approx(soc, abs=1e-9)
    assert math.isnan(shown.nis)


def test_a_voltage_that_the_autopilot_compensates_asks_for_no_drop_of_the_current() -> None:
    ours = in_flight(25.0, compensated=True)
    shown = [
        ours.step(Sample(ours.time_s + 0.2, 15.2, current_A, 25.0)).predicted_voltage_V for current_A in (9.0, 11.0)
    ]
    assert np.ptp(shown) < 0.005
