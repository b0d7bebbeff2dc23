"""The first row of a record: what it tells of charge and overpotentials."""

from __future__ import annotations

import numpy as np
import pytest

from uavbatt.battery import file, model, start
from uavbatt.battery.build import Pack, pack_of
from uavbatt.battery.start import Charge
from uavbatt.estimation.noise import first_state


def generic() -> Pack:
    return pack_of(file.read("lipo-generic"), 4, 5.0, 13.2, 14.0)


@pytest.mark.parametrize("rate", [1.0, 2.0, 4.0])
def test_a_log_that_begins_in_mid_air_finds_the_charge_and_the_overpotentials(rate: float) -> None:
    """A cell flown from full to 0.7 by the model, then seen for one row: two roads to one state."""
    pack = generic()
    flown = model.advance(pack.cell, model.rested(1.0, 20.0), rate, 20.0, 0.3 * 3600.0 / rate)
    shown_V = float(model.cell_voltage(pack.cell, flown, rate))
    state, sd = first_state(pack, shown_V, float(flown.core_C), rate)
    assert float(state.soc) == pytest.approx(0.7, abs=0.01) and sd > 0.05
    assert float(state.polarisation_V) == pytest.approx(float(flown.polarisation_V), rel=0.1)
    assert float(state.diffusion_V) == pytest.approx(float(flown.diffusion_V), rel=0.1)


def test_a_full_pack_has_no_past() -> None:
    fresh = start.underway(generic().cell, np.array([1.0]), np.array([20.0]), np.array([3.0]))
    assert fresh.polarisation_V == fresh.diffusion_V == 0.0
    charging = start.underway(generic().cell, 0.5, 20.0, -1.0)  # nobody flies on a negative current
    assert abs(float(charging.diffusion_V)) < 1e-6


def test_what_could_be_full_most_likely_is() -> None:
    near, far = start.perhaps_full(Charge(0.97, 0.03)), start.perhaps_full(Charge(0.6, 0.03))
    assert near.soc > 0.985 and near.sd < 0.02
    assert far == Charge(pytest.approx(0.6, abs=1e-6), pytest.approx(0.03, rel=1e-3))


def test_between_the_two_the_doubt_is_larger_than_of_either() -> None:
    """Near enough for a full pack and far enough for a used one: the mixture is wider than its parts."""
    torn = start.perhaps_full(Charge(0.90, 0.03))
    assert 0.9 < torn.soc < 0.99 and torn.sd > 0.03


def test_a_pack_on_its_avionics_is_idle_and_a_hover_is_not() -> None:
    """The same voltage: under 0.2 C it may be a full pack, under 3 C it is one that has flown."""
    pack = generic()
    idle_V = float(model.cell_voltage(pack.cell, model.rested(0.985, 20.0), 0.2))
    assert float(first_state(pack, idle_V, 20.0, 0.2)[0].soc) > 0.985
    assert first_state(pack, idle_V - 0.1, 20.0, 3.0)[1] > 0.05
