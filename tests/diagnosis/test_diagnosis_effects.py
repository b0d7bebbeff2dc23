"""Effects that act outside the cell's state: the filter honours what the simulated flight was given."""

from __future__ import annotations

import numpy as np
import pytest
from cases import first_quick
from factories import generic_pack

from uavbatt.battery.model import Array, open_circuit_voltage, transfer_drop, under_power
from uavbatt.battery.pack import true_power
from uavbatt.battery.scaling import Pack
from uavbatt.estimation.filter import SocFilter
from uavbatt.records import Sample
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, with_effects


def pack(**effects: float) -> Pack:
    return with_effects(generic_pack(), effects)


def innovations(made: Pack, samples: list[Sample]) -> Array:
    """Innovations at the closed blocks; the rows between carry no NIS."""
    ours = SocFilter(made)
    estimates = [ours.step(s) for s in samples]
    assert [e.voltage_V for e in estimates] == [s.voltage_V for s in samples]  # the output is what was reported
    return np.array([e.innovation_V for e in estimates if np.isfinite(e.nis)])


@pytest.mark.parametrize("delay_s", first_quick(1, [3.0, -3.0]))
def test_a_known_delay_between_voltage_and_current_costs_nothing(delay_s: float) -> None:
    mission = SimulatedFlight(250.0, rate_Hz=1.0, seed=4)
    straight = np.std(innovations(pack(), simulate_flight(pack(), mission)))
    skewed = simulate_flight(pack(current_delay=delay_s), mission)
    assert np.std(innovations(pack(), skewed)) > 1.3 * straight
    assert np.std(innovations(pack(current_delay=delay_s), skewed)) < 1.1 * straight


def test_a_known_compensation_of_sag_costs_nothing() -> None:
    """An autopilot that adds I·R to the voltage it reports: the filter takes it off, the power is that of the pack."""
    mission = SimulatedFlight(250.0, rate_Hz=1.0, seed=4)
    straight = np.std(innovations(pack(), simulate_flight(pack(), mission)))
    lifted = simulate_flight(pack(sag_compensation=0.03), mission)
    assert np.std(innovations(pack(), lifted)) > 1.3 * straight
    assert np.std(innovations(pack(sag_compensation=0.03), lifted)) < 1.1 * straight
    sample = lifted[len(lifted) // 2]
    believed_W = true_power(pack(sag_compensation=0.03).installation, sample.voltage_V, sample.current_A)
    assert believed_W == pytest.approx((sample.voltage_V - 0.03 * sample.current_A) * sample.current_A)


def test_hysteresis_is_away_at_full_and_whole_on_the_way_down() -> None:
    plain, turned = pack().cell, pack(hysteresis=0.02).cell
    soc = np.array([1.0, 0.97, 0.5, 0.1])
    lower_V = open_circuit_voltage(plain, soc) - open_circuit_voltage(turned, soc)
    assert lower_V == pytest.approx([0.0, 0.02 * (1.0 - np.exp(-1.0)), 0.02, 0.02], abs=1e-6)


def test_a_known_start_below_what_the_rested_voltage_says() -> None:
    sample = simulate_flight(pack(), SimulatedFlight(250.0, rate_Hz=1.0))[0]
    believed, known = SocFilter(pack()).step(sample).soc, SocFilter(pack(initial_charge=-0.1)).step(sample).soc
    assert believed - known == pytest.approx(0.1, abs=0.02)


def test_a_sluggish_reaction_shows_at_a_small_load_and_saturates_at_a_large_one() -> None:
    made = pack(charge_transfer=0.08)
    small, half, large = (float(transfer_drop(made.cell, rate)) for rate in (0.05, 0.3, 8.0))
    assert half == pytest.approx(0.04)
    assert small / 0.05 > 10.0 * large / 8.0 and large == pytest.approx(0.08, rel=0.05)


def test_power_is_met_through_a_sluggish_reaction() -> None:
    cell, emf_V, ohmAh, power_WpAh = pack(charge_transfer=0.08).cell, 3.9, 0.06, 12.0
    rate = under_power(cell, emf_V, ohmAh, power_WpAh).c_rate
    assert rate * (emf_V - rate * ohmAh - transfer_drop(cell, rate)) == pytest.approx(power_WpAh, rel=1e-3)
