"""The time to the end under a steady power, which places a surge of power within the rest of a flight."""

from __future__ import annotations

import numpy as np
import pytest
from factories import generic_pack

from uavbatt.battery.model import advance, rested
from uavbatt.battery.state_space import SIZE, Belief, X
from uavbatt.prediction.forecaster import Forecaster, ForecastSettings
from uavbatt.prediction.load.scenarios import ConstantLoad
from uavbatt.prediction.typical_end import longest_s, steady_s

POWER_W = 300.0


def belief(soc: float) -> Belief:
    mean = np.zeros(SIZE)
    mean[X.SOC], mean[X.CORE], mean[X.SENSOR] = soc, 25.0, 25.0
    return Belief.gaussian(mean, 1e-12 * np.eye(SIZE), 25.0)


@pytest.mark.parametrize("cutoff_V", [12.4, 13.2, 14.0])
def test_the_time_to_the_cut_off_is_about_that_of_the_simulation(cutoff_V: float) -> None:
    """A pack that has flown for ten minutes: its lags are those of the load."""
    pack = generic_pack(cutoff_V=cutoff_V)
    c_rate = POWER_W / (4 * 3.7) / pack.installation.present_capacity_Ah
    flown = advance(pack.cell, rested(0.95, 25.0), c_rate, 25.0, 600.0)
    now = belief(0.6)
    now.means[0, X.POLARISATION], now.means[0, X.DIFFUSION] = flown.polarisation_V, flown.diffusion_V
    simulated = Forecaster(pack, ForecastSettings(ConstantLoad(POWER_W, 1e-6))).forecast(now, 0.0)
    assert simulated is not None
    assert steady_s(pack, now, POWER_W) == pytest.approx(simulated.median_s, rel=0.1)


def test_a_higher_cut_off_ends_the_flight_earlier_and_not_the_simulation() -> None:
    low, high = (generic_pack(cutoff_V=volts) for volts in (12.4, 14.4))
    assert steady_s(high, belief(0.8), POWER_W) < 0.9 * steady_s(low, belief(0.8), POWER_W)
    assert longest_s(high, belief(0.8), POWER_W) == longest_s(low, belief(0.8), POWER_W)


def test_a_pack_at_its_cut_off_has_some_time_left() -> None:
    assert all(0.0 < steady_s(generic_pack(cutoff_V=15.5), belief(soc), POWER_W) < 60.0 for soc in (-0.02, 0.0, 0.5))
