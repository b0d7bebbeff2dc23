"""The battery model against closed forms: circuit, charge, heat, power, and what scaling a pack must do."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from factories import generic_pack
from hypothesis import given, settings
from hypothesis import strategies as st

from uavbatt.battery import battery_file, model
from uavbatt.battery import equations as eq
from uavbatt.battery.model import SOC_GRID, Parameters, State
from uavbatt.battery.openloop import simulate
from uavbatt.battery.pack import (
    Installation,
    grown,
    metered_voltage,
    terminal_voltage,
    true_current,
    weak_soc,
    weak_voltage,
)
from uavbatt.battery.scaling import Pack
from uavbatt.battery.tables import dense, dense_resistance, monotone_cubic

STEPS_S = (0.05, 0.2, 1.0, 2.5, 5.0, 12.0, 30.0, 60.0)


def cell(**changes: float) -> Parameters:
    """A cell with OCV 3.4 + 0.8 soc V and 0.03 ohm·Ah, all effects off but those in `changes`."""
    return Parameters(ocv_V=3.4 + 0.8 * SOC_GRID, r0_ohmAh=np.full(SOC_GRID.size, 0.03))._replace(**changes)


def generic() -> Parameters:
    """The packaged generic cell: tables and every base effect."""
    return generic_pack(1, 1.0, 3.3, 3.5).cell


def end_state(p: Parameters, start: State, c_rate: float, ambient_C: float, step_s: float, total_s: float) -> State:
    state = start
    for _ in range(round(total_s / step_s)):
        state = model.advance(p, state, c_rate, ambient_C, step_s)
    return state


@pytest.mark.parametrize("step_s", STEPS_S)
def test_the_length_of_a_step_does_not_matter(step_s: float) -> None:
    """Two minutes at 4 C in any steps from 0.05 s to 60 s end in one state, with every base effect on."""
    p, start = generic(), model.rested(0.9, 12.0)
    fine = end_state(p, start, 4.0, 12.0, 0.05, 120.0)
    state = end_state(p, start, 4.0, 12.0, step_s, 120.0)
    assert float(state.soc) == pytest.approx(float(fine.soc), abs=1e-9)
    assert float(state.polarisation_V) == pytest.approx(float(fine.polarisation_V), abs=3e-4)
    assert float(state.diffusion_V) == pytest.approx(float(fine.diffusion_V), abs=3e-4)
    assert float(state.core_C) == pytest.approx(float(fine.core_C), abs=0.03)
    assert float(state.sensor_C) == pytest.approx(float(fine.sensor_C), abs=0.15)
    volts = [float(model.cell_voltage(p, s, 4.0)) for s in (state, fine)]
    assert volts[0] == pytest.approx(volts[1], abs=1e-3)


def test_an_empty_surface_costs_the_slope_of_the_ocv() -> None:
    """0.02 h at 3 C lack 0.06 of the charge; at 0.8 V per unit that is 48 mV once the lag has passed."""
    p = cell(polarisation_tau_s=20.0, surface_h=0.02)
    at_once = float(model.cell_voltage(p, model.rested(0.9, 25.0), 3.0))
    assert at_once == pytest.approx(float(model.cell_voltage(cell(), model.rested(0.9, 25.0), 3.0)))
    late = end_state(p, model.rested(0.9, 25.0), 3.0, 25.0, 1.0, 200.0)
    assert float(late.polarisation_V) == pytest.approx(0.8 * 0.06, rel=1e-3)
    assert float(model.depletion(p, 0.02, 1e6)) == pytest.approx(0.8 * 0.07)  # no more than there is in the table
    assert float(model.depletion(p, -0.4, 1e6)) == 0.0


@pytest.mark.parametrize("step_s", STEPS_S)
def test_one_rc_pair_under_constant_current(step_s: float) -> None:
    """v(t) = I R k (1 - exp(-t/tau)), exactly, however it is stepped, when nothing makes R change."""
    p = cell(polarisation_ratio=0.7, polarisation_tau_s=20.0)
    state = end_state(p, model.rested(1.0, 25.0), 3.0, 25.0, step_s, 60.0)
    expected_V = 3.0 * 0.03 * 0.7 * -math.expm1(-60.0 / 20.0)
    assert float(state.polarisation_V) == pytest.approx(expected_V, rel=1e-12)


def test_an_rc_pair_relaxes_at_rest() -> None:
    p = cell(polarisation_ratio=0.7, polarisation_tau_s=20.0)
    start = model.rested(0.5, 25.0)._replace(polarisation_V=0.05)
    assert float(model.advance(p, start, 0.0, 25.0, 40.0).polarisation_V) == pytest.approx(0.05 * math.exp(-2.0))


@pytest.mark.parametrize("step_s", STEPS_S)
def test_charge_is_counted(step_s: float) -> None:
    """An hour at 0.5 C takes half the charge."""
    assert float(end_state(cell(), model.rested(1.0, 25.0), 0.5, 25.0, step_s, 3600.0).soc) == pytest.approx(0.5)


def test_a_silence_of_thirty_hours_is_thirty_silences_of_one() -> None:
    """A pack at rest forgets its load, in as many steps as an hour has, however long it lay."""
    p = generic()
    once = warm = model.rested(0.6, 40.0)._replace(polarisation_V=0.05, diffusion_V=0.02)
    for _ in range(30):
        once = model.advance(p, once, 0.001, 10.0, 3600.0)
    assert model.stride(p, 30 * 3600.0).steps == model.stride(p, 3600.0).steps
    assert model.advance(p, warm, 0.001, 10.0, 30 * 3600.0) == pytest.approx(once, abs=1e-4)


def test_charge_that_comes_back() -> None:
    p, start = generic(), model.rested(0.6, 25.0)
    there = model.advance(p, start, 2.0, 25.0, 60.0)
    assert float(model.advance(p, there, -2.0, 25.0, 60.0).soc) == pytest.approx(0.6, abs=1e-12)


def test_rate_capacity_takes_more_charge_at_a_high_rate() -> None:
    p = cell(rate_gain_h=0.02)
    slow = 1.0 - float(model.advance(p, model.rested(1.0, 25.0), 1.0, 25.0, 36.0).soc)
    fast = 1.0 - float(model.advance(p, model.rested(1.0, 25.0), 6.0, 25.0, 6.0).soc)
    assert slow == pytest.approx(0.01 * 1.02) and fast == pytest.approx(0.01 * 1.12)


def test_heat_settles_where_losses_equal_cooling() -> None:
    """At constant heat q the core ends at ambient + q/h and comes there with C/h."""
    p = cell(heat_gain=1.0, heat_capacity_JpKAh=20.0, cooling_WpKAh=0.5)
    heat_W = 4.0**2 * 0.03
    for time_s in (10.0, 40.0, 400.0):
        core_C = float(model.advance(p, model.rested(0.9, 10.0), 4.0, 10.0, time_s).core_C)
        assert core_C == pytest.approx(10.0 + heat_W / 0.5 * -math.expm1(-time_s * 0.5 / 20.0), rel=1e-9)


def test_the_air_of_the_propellers_cools_a_pack_sooner_and_further() -> None:
    """With airflow the cooling is h (1 + g |c|): the core ends at q/h' and comes there with C/h'."""
    p = cell(heat_gain=1.0, heat_capacity_JpKAh=20.0, cooling_WpKAh=0.5, airflow_gain_h=0.5)
    heat_W, cooling_WpK = 4.0**2 * 0.03, 0.5 * (1.0 + 0.5 * 4.0)
    for time_s in (10.0, 40.0, 400.0):
        core_C = float(model.advance(p, model.rested(0.9, 10.0), 4.0, 10.0, time_s).core_C)
        assert core_C == pytest.approx(
            10.0 + heat_W / cooling_WpK * -math.expm1(-time_s * cooling_WpK / 20.0), rel=1e-9
        )


def test_energy_balance_of_a_cell_without_cooling() -> None:
    """With next to no cooling, the heat kept equals the charge's energy less what went out of the terminals."""
    p = generic()._replace(cooling_WpKAh=1e-9, airflow_gain_h=0.0)
    state, loss_J, dt_s = model.rested(0.9, 25.0), 0.0, 0.1
    for _ in range(3000):
        after = model.step(p, state, 3.0, 25.0, dt_s, model.lags(p, dt_s))
        loss_J += 3.0 * float(model.open_circuit_voltage(p, state.soc) - model.cell_voltage(p, state, 3.0)) * dt_s
        state = after
    assert (float(state.core_C) - 25.0) * p.heat_capacity_JpKAh == pytest.approx(loss_J, rel=1e-6)


def test_the_sensor_lags_the_core() -> None:
    p = cell(sensor_lag_s=30.0)
    start = model.rested(0.5, 20.0)._replace(core_C=40.0)
    held = p._replace(heat_capacity_JpKAh=1e9)  # the core stays where it is
    after = model.advance(held, start, 0.0, 20.0, 30.0)
    assert float(after.sensor_C) == pytest.approx(40.0 - 20.0 * math.exp(-1.0), abs=1e-6)


def test_arrhenius() -> None:
    assert eq.arrhenius(25.0, 2345.0) == 1.0
    assert eq.arrhenius(0.0, 0.0) == 1.0
    assert eq.arrhenius(0.0, 2000.0) == pytest.approx(math.exp(2000.0 * (1 / 273.15 - 1 / 298.15)))
    temps = np.linspace(-20.0, 60.0, 81)
    assert (np.diff(eq.arrhenius(temps, 1500.0)) < 0.0).all()


@given(
    emf_V=st.floats(3.0, 60.0), resistance=st.floats(1e-4, 0.5), share=st.floats(0.0, 0.999)
)  # share of the largest power
def test_current_at_power_solves_its_equation(emf_V: float, resistance: float, share: float) -> None:
    largest_W = emf_V**2 / (4.0 * resistance)
    current = float(eq.current_at_power(emf_V, resistance, share * largest_W))
    assert (emf_V - resistance * current) * current == pytest.approx(share * largest_W, rel=1e-9, abs=1e-9)
    assert 0.0 <= current <= emf_V / (2.0 * resistance) * (1 + 1e-12)  # the smaller root


@given(emf_V=st.floats(3.0, 60.0), resistance=st.floats(1e-4, 0.5), times=st.floats(1.0, 1e3))
def test_current_at_power_saturates(emf_V: float, resistance: float, times: float) -> None:
    asked_W = times * emf_V**2 / (4.0 * resistance)
    assert float(eq.current_at_power(emf_V, resistance, asked_W)) == pytest.approx(emf_V / (2.0 * resistance), rel=1e-6)


@settings(deadline=None, max_examples=40)
@given(soc=st.floats(0.02, 0.98), temp_C=st.floats(-15.0, 45.0), rate=st.floats(0.1, 8.0))
def test_monotonicities(soc: float, temp_C: float, rate: float) -> None:
    """More load sags more; a warmer, a fuller and a lower-ohmic cell shows more volts."""
    p = generic()
    state = model.rested(soc, temp_C)
    volts = float(model.cell_voltage(p, state, rate))
    assert float(model.cell_voltage(p, state, rate + 0.5)) < volts
    assert float(model.cell_voltage(p, model.rested(soc, temp_C + 5.0), rate)) > volts
    assert float(model.cell_voltage(p, model.rested(soc + 0.02, temp_C), rate)) > volts
    assert float(model.cell_voltage(p._replace(resistance_gain=1.3), state, rate)) < volts
    after = model.advance(p, state, rate, temp_C, 20.0)
    assert float(after.soc) < soc and float(after.polarisation_V) > 0.0 and float(after.core_C) > temp_C


def test_a_batch_equals_its_members() -> None:
    p = generic()
    socs, temps, rates = np.array([0.2, 0.6, 0.95]), np.array([-5.0, 20.0, 40.0]), np.array([1.0, 4.0, 7.0])
    together = model.advance(p, model.rested(socs, temps), rates, 15.0, 23.0)
    volts = model.cell_voltage(p, together, rates)
    for k in range(3):
        alone = model.advance(p, model.rested(socs[k], temps[k]), rates[k], 15.0, 23.0)
        for ours, theirs in zip(together, alone, strict=True):
            assert ours[k] == pytest.approx(float(theirs), rel=1e-14)
        assert volts[k] == pytest.approx(float(model.cell_voltage(p, alone, rates[k])), rel=1e-14)


def test_a_batch_of_tables_equals_its_members() -> None:
    p = generic()
    tables = p._replace(ocv_V=np.stack([p.ocv_V, p.ocv_V + 0.01]), r0_ohmAh=np.stack([p.r0_ohmAh, 2.0 * p.r0_ohmAh]))
    state = model.rested(np.array([0.5, 0.5]), np.array([25.0, 25.0]))
    volts = model.cell_voltage(tables, state, np.array([2.0, 2.0]))
    one = p._replace(ocv_V=p.ocv_V + 0.01, r0_ohmAh=2.0 * p.r0_ohmAh)
    assert volts[1] == pytest.approx(float(model.cell_voltage(one, model.rested(0.5, 25.0), 2.0)))


def test_open_loop_simulation_equals_stepping() -> None:
    p = generic()
    rng = np.random.default_rng(3)
    rate, dt_s = rng.uniform(0.5, 5.0, (50, 1)), np.full((50, 1), 2.0)
    run = simulate(p, model.rested(np.array([0.95]), np.array([20.0])), rate, dt_s, np.array([20.0]))
    state = model.rested(0.95, 20.0)
    for k in range(50):
        state = model.step(p, state, float(rate[k, 0]), 20.0, 2.0, model.lags(p, 2.0)) if k else state
        assert run.voltage_V[k, 0] == pytest.approx(float(model.cell_voltage(p, state, float(rate[k, 0]))))
    assert run.soc[-1, 0] == pytest.approx(0.95 - float(rate[1:].sum()) * 2.0 / 3600.0)


def test_tables_pass_through_their_knots_and_stay_monotone() -> None:
    parameters = battery_file.read_battery("lipo-generic").parameters
    soc, volts = np.array(parameters.ocv_soc), np.array(parameters.ocv_V)
    table = dense(soc, volts)
    assert (np.diff(table) >= 0.0).all()
    p = cell()._replace(ocv_V=table)
    on_grid = np.isclose(np.round(soc / model.GRID_STEP) * model.GRID_STEP, soc)
    assert model.open_circuit_voltage(p, soc[on_grid]) == pytest.approx(volts[on_grid], abs=1e-9)
    resistance = dense_resistance(np.array([0.0, 0.1, 0.5, 1.0]), np.array([0.09, 0.03, 0.02, 0.025]))
    assert (resistance > 0.0).all() and resistance.max() == pytest.approx(0.09)


@pytest.mark.parametrize("knots", [2, 3, 9, 20])
def test_the_monotone_cubic_is_scipys(knots: int) -> None:
    from scipy.interpolate import PchipInterpolator

    random = np.random.default_rng(knots)
    soc = np.cumsum(random.uniform(0.01, 0.2, knots))
    values = random.normal(size=(4, knots))
    values[1].sort()
    values[2, : knots // 2] = values[2, 0]  # a plateau
    at = np.linspace(soc[0], soc[-1], 101)
    np.testing.assert_allclose(monotone_cubic(at, soc, values), PchipInterpolator(soc, values, axis=-1)(at), atol=1e-12)


def pack(cells: int = 4, capacity_Ah: float = 5.0, **installed: float) -> Pack:
    made = generic_pack(cells, capacity_Ah, 3.3 * cells, 3.5 * cells)
    return made._replace(installation=made.installation._replace(**installed))


def volts(made: Pack, current_A: float, soc: float = 0.5) -> float:
    state = model.rested(soc, 25.0)
    return float(terminal_voltage(made.installation, grown(made.cell, made.installation), state, current_A))


def test_pack_scaling() -> None:
    """Twice the cells: twice the volts at one current. Twice the capacity: half the sag."""
    assert volts(pack(cells=8), 20.0) == pytest.approx(2.0 * volts(pack(cells=4), 20.0))
    assert volts(pack(capacity_Ah=10.0), 40.0) == pytest.approx(volts(pack(capacity_Ah=5.0), 20.0))
    rest_V = volts(pack(), 0.0)
    small_V, large_V = rest_V - volts(pack(), 20.0), rest_V - volts(pack(capacity_Ah=10.0), 20.0)
    assert small_V == pytest.approx(2.0 * large_V)


@pytest.mark.parametrize(
    ("effect", "sag_at_20_A"),
    [({"harness_ohm": 0.01}, 0.2), ({"growth": 0.5}, 0.5 * 4 * 20.0 * 0.028 / 5.0), ({"fade": 0.2}, None)],
)
def test_what_adds_ohms(effect: dict[str, float], sag_at_20_A: float | None) -> None:
    """Harness: R·I. Growth: its share of n·R0·I. Fade: the ohm·Ah stay, so 20 % less charge is 25 % more ohms."""
    expected_V = sag_at_20_A if sag_at_20_A is not None else 0.25 * 4 * 20.0 * 0.028 / 5.0
    assert volts(pack(), 20.0) - volts(pack(**effect), 20.0) == pytest.approx(expected_V, rel=1e-6)


def test_a_weak_cell_lowers_the_voltage_more_the_emptier_it_is() -> None:
    drops = [volts(pack(), 20.0, z) - volts(pack(deficit=0.1), 20.0, z) for z in (0.9, 0.5, 0.15)]
    assert drops[0] > 0.0 and drops[2] > drops[0]
    assert volts(pack(), 0.0, 1.0) == pytest.approx(volts(pack(deficit=0.1), 0.0, 1.0))  # all are full
    assert volts(pack(), 20.0, 1.0) > volts(pack(deficit=0.1), 20.0, 1.0)  # a smaller cell has more ohms
    assert float(weak_soc(Installation(4, 5.0, deficit=0.1), 0.1)) == pytest.approx(0.0)


def test_a_weak_cell_is_a_smaller_one_under_the_same_current() -> None:
    """Three cells of 5 Ah and one of 4.5 Ah in series: its lags are those of its own, higher C-rate."""
    p = cell(polarisation_ratio=0.5, polarisation_tau_s=12.0, diffusion_ratio=0.8, diffusion_tau_s=400.0)
    strong, weak = (end_state(p, model.rested(1.0, 25.0), 20.0 / Ah, 25.0, 2.0, 240.0) for Ah in (5.0, 4.5))
    by_hand_V = float(model.cell_voltage(p, weak, 20.0 / 4.5))
    assert float(weak_voltage(Installation(4, 5.0, deficit=0.1), p, strong, 20.0 / 5.0)) == pytest.approx(by_hand_V)


@given(gain=st.floats(0.5, 1.5), offset_A=st.floats(-5, 5), extra_W=st.floats(0, 200), amps=st.floats(0, 100))
def test_current_seen_and_true(gain: float, offset_A: float, extra_W: float, amps: float) -> None:
    installed = Installation(4, 5.0, gain_I=gain, offset_A=offset_A, unmetered_W=extra_W)
    metered_A = (amps - extra_W / 15.0) * gain + offset_A
    assert true_current(installed, metered_A, 15.0) == pytest.approx(amps, abs=1e-9)
    assert metered_voltage(Installation(4, 5.0, gain_V=1.02, offset_V=-0.1), 15.0) == pytest.approx(15.2)


def test_effects_reach_the_model() -> None:
    """Each quantity of each effect is a field of the record that it acts on, neutral where the record's default is."""
    from uavbatt.battery.effects import CELL_EFFECTS, INSTALLATION_EFFECTS

    defaults: dict[str, Any] = {**Parameters._field_defaults, **Installation._field_defaults}
    for effect in CELL_EFFECTS + INSTALLATION_EFFECTS:
        assert all(defaults[q.name] == q.neutral for q in effect.quantities), effect.name
        assert all(q.low <= q.prior <= q.high and q.low <= q.neutral <= q.high for q in effect.quantities), effect.name
