"""The first row of a record: what it tells of charge and overpotentials."""

from __future__ import annotations

import numpy as np
import pytest
from factories import generic_pack

from uavbatt.battery import initial_state, model
from uavbatt.battery.scaling import Pack
from uavbatt.estimation.noise import first_state


def generic() -> Pack:
    return generic_pack()


@pytest.mark.parametrize("transfer_V", [0.0, 0.05])
@pytest.mark.parametrize("rate", [1.0, 2.0, 4.0])
def test_a_log_that_begins_in_mid_air_finds_the_charge_and_the_overpotentials(rate: float, transfer_V: float) -> None:
    """A cell flown from full to 0.7 by the model, then seen for one row: two roads to one state."""
    pack = generic()
    pack = pack._replace(cell=pack.cell._replace(transfer_V=transfer_V))
    flown = model.advance(pack.cell, model.rested(1.0, 20.0), rate, 20.0, 0.3 * 3600.0 / rate)
    shown_V = float(model.cell_voltage(pack.cell, flown, rate))
    first = first_state(pack, shown_V, float(flown.core_C), rate)
    state, sd = first.state, np.sqrt(first.covariance[0, 0])
    assert float(state.soc) == pytest.approx(0.7, abs=0.01) and sd > 0.05
    assert float(state.polarisation_V) == pytest.approx(float(flown.polarisation_V), rel=0.1)
    assert float(state.diffusion_V) == pytest.approx(float(flown.diffusion_V), rel=0.1)


def test_a_full_pack_has_no_past() -> None:
    fresh = initial_state.state_under_load(generic().cell, np.array([1.0]), np.array([20.0]), np.array([3.0]))
    assert fresh.polarisation_V == fresh.diffusion_V == 0.0
    charging = initial_state.state_under_load(generic().cell, 0.5, 20.0, -1.0)  # nobody flies on a negative current
    assert abs(float(charging.diffusion_V)) < 1e-6


def read(soc: float, bias_sd_V: float, may_be_full: bool = True) -> tuple[float, float]:
    """What a rested reading of 4 mV at the voltage of `soc` tells of the charge: mean and sd."""
    emf_V = float(model.open_circuit_voltage(generic().cell, soc))
    mean, covariance = initial_state.joint(generic().cell, emf_V, 0.004, bias_sd_V, may_be_full)
    return float(mean[0]), float(np.sqrt(covariance[0, 0]))


def test_what_could_be_full_most_likely_is() -> None:
    near, far = read(0.97, 0.03), read(0.6, 0.01)
    assert near[0] > 0.985 and near[1] < 0.02
    assert far == pytest.approx(read(0.6, 0.01, may_be_full=False), rel=1e-3)
    assert far[0] == pytest.approx(0.6, abs=1e-6)


def test_between_the_two_the_doubt_is_larger_than_of_either() -> None:
    """Near enough for a full pack and far enough for a used one: the mixture is wider than its parts."""
    torn = read(0.90, 0.03)
    assert 0.9 < torn[0] < 0.99 and torn[1] > read(0.90, 0.03, may_be_full=False)[1] * 0.9


def test_a_reading_tells_only_the_sum_of_charge_and_discrepancy() -> None:
    """Kalman's update in closed form: OCV(soc) + b is known to the reading's sd, each alone hardly better."""
    mean, P = initial_state.joint(generic().cell, 3.84, 0.002, 0.05, may_be_full=False)
    above_V, below_V = model.open_circuit_voltage(generic().cell, np.array([0.54, 0.46]))
    slope_V = float(above_V - below_V) / 0.08
    row = np.array([slope_V, 1.0])
    assert row @ P @ row == pytest.approx(0.002**2, rel=0.01)
    assert np.sqrt(P[1, 1]) == pytest.approx(0.05, rel=0.05) and P[0, 1] < 0.0
    assert mean[0] == pytest.approx(0.5, abs=1e-6)


def test_a_pack_on_its_avionics_is_idle_and_a_hover_is_not() -> None:
    """The same voltage: under 0.2 C it may be a full pack, under 3 C it is one that has flown."""
    pack = generic()
    idle_V = float(model.cell_voltage(pack.cell, model.rested(0.985, 20.0), 0.2))
    assert float(first_state(pack, idle_V, 20.0, 0.2).mean[0]) > 0.985
    assert first_state(pack, idle_V - 0.1, 20.0, 3.0).covariance[0, 0] > 0.05**2
