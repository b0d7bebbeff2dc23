"""Fitting: what was planted comes back, and what is known of the records is used as it should be."""

from __future__ import annotations

import math
from functools import cache
from unittest.mock import patch

import numpy as np
import pytest
from factories import generic_pack

from uavbatt import dataset
from uavbatt.battery import battery_file, model
from uavbatt.battery.model import LONGEST_STEP_S, SOC_GRID, Array, Parameters, open_circuit_voltage
from uavbatt.battery.openloop import Trajectory, simulate
from uavbatt.battery.scaling import pack_of
from uavbatt.errors import NotEnoughData, UsageError
from uavbatt.fitting import assemble, observed, prior, solve, unmetered
from uavbatt.fitting.battery import RecordedPack, fit_battery, size_of
from uavbatt.fitting.generic import generic_lipo
from uavbatt.fitting.limiter import limited_discharge
from uavbatt.fitting.observed import ObservedRecord, binned, from_flight, held_load, stack
from uavbatt.records import NAN, Flight, PackFacts, Sample
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight

PLANTED = {"polarisation_ratio": 0.9, "diffusion_ratio": 0.5, "heat_capacity_JpKAh": 30.0, "resistance_gain": 1.5}


def planted_cell() -> Parameters:
    """The generic cell with other ohms, lags and heat, and an OCV that bulges by 20 mV in the middle."""
    cell = pack_of(generic_lipo(), 1, 1.0, 3.3, 3.5).cell
    bulge_V = 0.02 * np.exp(-(((SOC_GRID - 0.5) / 0.15) ** 2))
    return cell._replace(ocv_V=cell.ocv_V + bulge_V, **PLANTED)


def bench(c_rate: float, ambient_C: float, seed: int) -> ObservedRecord:
    """A discharge of a 3S 4 Ah pack to 3.3 V a cell: a minute of rest, pulses, sensors with noise."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, 60.0 + 3600.0 / c_rate * 0.97, 5.0)
    rate = np.where(time_s < 60.0, 0.0, c_rate * (1.0 + 0.3 * np.sign(np.sin(time_s / 47.0))))
    run = simulate(
        planted_cell(), model.rested(np.array([1.0]), np.array([ambient_C])), rate[:, None],
        np.diff(time_s, prepend=0.0)[:, None], np.array([ambient_C]),
    )  # fmt: skip
    volts = run.voltage_V[:, 0]
    keep = np.cumsum(volts < 3.3) == 0
    noise = rng.standard_normal((2, time_s.size)) * np.array([[0.004], [0.1]])
    return ObservedRecord(
        name=f"{c_rate} C at {ambient_C} °C",
        time_s=time_s[keep],
        voltage_V=(3 * volts + noise[0])[keep],
        current_A=(4.0 * rate)[keep],
        temp_C=(run.sensor_C[:, 0] + noise[1])[keep],
        ambient_C=ambient_C,
        cells=3,
        capacity_Ah=4.0,
    )


@cache
def records() -> tuple[ObservedRecord, ...]:
    return tuple(bench(c, t, k) for k, (c, t) in enumerate([(2.0, 25.0), (5.0, 25.0), (4.0, 5.0), (4.0, 38.0)]))


@cache
def found() -> tuple[solve.CellFit, observed.Stack]:
    stacked = stack(list(records()))
    return solve.fit_cell(stacked), stacked


def test_what_was_planted_comes_back() -> None:
    fit, _ = found()
    cell = prior.cell(fit.slots, fit.x[None])
    middle = np.linspace(0.1, 0.95, 30)
    truth_V = np.asarray(open_circuit_voltage(planted_cell(), middle))
    fitted = Parameters(ocv_V=cell.ocv_V[0], r0_ohmAh=cell.r0_ohmAh[0])
    assert np.asarray(open_circuit_voltage(fitted, middle)) == pytest.approx(truth_V, abs=0.01)
    lag = fit.value("polarisation_ratio") + fit.value("diffusion_ratio")
    total = model.resistance(fitted, middle, 25.0) * (1.0 + lag)
    planted = 1.5 * prior.RESISTANCE_OHMAH * (1 + 0.9 + 0.5)
    assert float(np.mean(total)) == pytest.approx(planted, rel=0.1)
    assert fit.value("heat_capacity_JpKAh") == pytest.approx(30.0, rel=0.2)


def test_planted_values_lie_within_their_errors() -> None:
    fit, _ = found()
    for name in ("activation_K", "heat_capacity_JpKAh", "polarisation_ratio", "diffusion_ratio"):
        truth = {"activation_K": 1500.0, **PLANTED}[name]
        assert abs(fit.value(name) - truth) < 4.0 * fit.standard_error(name), name


def test_the_data_narrow_the_prior() -> None:
    fit, _ = found()
    assert (np.diag(fit.covariance_u) <= 1.0 + 1e-9).all()
    for name in ("r0_ohmAh", "activation_K", "ocv_0.5"):
        slot = next(s for s in fit.slots if s.name == name)
        assert fit.standard_error(name) < 0.6 * slot.sd * (fit.value(name) if slot.log else 1.0), name


def test_simulations_in_parts_give_the_same_fit() -> None:
    """What differs is the rounding of sums, in the last digits."""
    fit, stacked = found()
    with patch.object(solve, "COLUMNS", 1):
        again = solve.fit_cell(stacked)
    assert again.u == pytest.approx(fit.u, abs=1e-6)
    assert again.own == pytest.approx(fit.own, abs=1e-6)


def test_the_fit_explains_its_records() -> None:
    fit, stacked = found()
    run = solve.replay_fit(stacked, fit)
    gap_V = (run.voltage_V * stacked.cells - stacked.voltage_V)[stacked.compare]
    assert float(np.sqrt(np.mean(gap_V**2))) < 0.02
    left = assemble.discrepancy(stacked, run, 3, held_out=False, source="itself")
    assert abs(left.voltage_bias_V) < 0.005 and left.voltage_rmse_V < 0.012 and left.temperature_rmse_K < 0.4


def test_discrepancy_of_a_known_error() -> None:
    """A model 30 mV too high everywhere has that bias and that RMSE, and noise of the sensor does not count."""
    _, stacked = found()
    noise_V = np.random.default_rng(3).normal(0.0, 0.01, stacked.voltage_V.shape)
    shifted = (stacked.voltage_V + 0.03 + noise_V) / stacked.cells
    run = Trajectory(shifted, stacked.temp_C + 1.0, stacked.temp_C, stacked.temp_C)
    left = assemble.discrepancy(stacked, run, 3, held_out=True, source="x")
    flat = np.concatenate(
        [np.min(stacked.sigma_V[r, j]) / stacked.sigma_V[r, j] for j, r in enumerate(stacked.compare.T)]
    )
    assert left.voltage_bias_V == pytest.approx(0.03 * float(np.mean(flat)), rel=0.1)
    assert left.voltage_rmse_V == pytest.approx(0.03 * float(np.sqrt(np.mean(flat**2))), rel=0.1)
    assert left.temperature_rmse_K == pytest.approx(1.0, rel=1e-3) and left.held_out


@pytest.mark.parametrize("memory_s", [10.0, 40.0])
def test_the_memory_of_the_model_error_is_that_of_its_lasting_part(memory_s: float) -> None:
    """An Ornstein-Uhlenbeck error of this memory, read every 2 s with white noise of three tenths of its size."""
    dice, rows = np.random.default_rng(1), 20000
    keeps, error = math.exp(-2.0 / memory_s), np.zeros(rows)
    for k in range(1, rows):
        error[k] = keeps * error[k - 1] + math.sqrt(1.0 - keeps**2) * dice.standard_normal()
    error += 0.3 * dice.standard_normal(rows)
    assert assemble._correlation_time(error, 2.0 * np.arange(rows)) == pytest.approx(memory_s, rel=0.25)


def test_the_misfit_is_told_for_the_pack_that_the_file_is_of() -> None:
    """Tests of a 3S pack in a file of a 6S one: twice the volts."""
    fit, _ = found()
    tests = patch.object(observed, "from_dataset", return_value=list(records()))
    with tests, patch.object(solve, "fit_cell", return_value=fit):
        fits = [fit_battery(RecordedPack("x", n, 4.0, 3.3 * n), [dataset.load()], []).file.discrepancy for n in (3, 6)]
    wanders = [left.wander for left in fits if left.wander is not None]
    three, six = ([f.voltage_bias_V, *w.voltage_sd_V, w.voltage_noise_V, w.rest_sd_V]
                  for f, w in zip(fits, wanders, strict=True))  # fmt: skip
    assert six == pytest.approx([2.0 * v for v in three], rel=1e-3)


# --- the prior ---------------------------------------------------------------------------------------------------


def test_the_prior_is_physical() -> None:
    slots = prior.cell_slots()
    x = prior.values(slots, np.zeros((1, len(slots))))
    ocv_V, r0 = prior.knots(slots, x)
    assert (np.diff(ocv_V) > 0.0).all() and (r0 > 0.0).all()
    assert ocv_V[0] == pytest.approx(prior.OCV_V) and r0[0] == pytest.approx(prior.RESISTANCE_OHMAH)
    wild = prior.values(slots, np.random.default_rng(1).normal(0.0, 5.0, (200, len(slots))))
    positive = [i for i, s in enumerate(slots) if s.log]
    assert (wild[:, positive] > 0.0).all()


@pytest.mark.parametrize("rested_V", [np.nan, 4.10, 4.20, 4.24])
def test_ordinary_cells_have_the_ordinary_prior(rested_V: float) -> None:
    assert prior.ocv_knots(rested_V) is prior.OCV_V


@pytest.mark.parametrize("rested_V", [4.30, 4.35])
def test_cells_that_charge_higher_go_on_where_the_others_stop(rested_V: float) -> None:
    """Full they rest where they were seen to; a charge below is the ordinary cell's at a higher one."""
    ocv_V = prior.ocv_knots(rested_V)
    assert ocv_V[-1] == pytest.approx(rested_V) and ocv_V[0] == prior.OCV_V[0]
    assert (np.diff(ocv_V) > 0.0).all() and (ocv_V >= prior.OCV_V).all()
    assert np.interp(0.5, prior.OCV_SOC, ocv_V) - np.interp(0.5, prior.OCV_SOC, prior.OCV_V) < 0.04


def test_the_generic_file_is_the_prior() -> None:
    made = generic_lipo()
    assert made.parameters.ocv_V == pytest.approx(list(prior.OCV_V)) and made.status == "generic"
    assert {e.name for e in made.effects} == set(prior.BASE_EFFECTS)


# --- records -----------------------------------------------------------------------------------------------------


def test_bins_keep_the_charge_and_the_means() -> None:
    time_s = np.arange(0.0, 600.0, 0.5)
    current_A = 10.0 + 3.0 * np.sin(time_s / 5.0)
    fine = ObservedRecord("x", time_s, 16.0 - 0.02 * current_A, current_A, np.full(time_s.size, 20.0), 20.0, 4, 5.0)
    coarse = binned(fine)
    assert np.diff(coarse.time_s) == pytest.approx(observed.BIN_S)
    assert float(np.mean(coarse.current_A)) == pytest.approx(float(np.mean(current_A)))
    assert coarse.voltage_V == pytest.approx(16.0 - 0.02 * coarse.current_A)
    assert binned(coarse) is coarse


def test_coarse_rows_are_split_and_only_real_rows_are_compared() -> None:
    rows = np.arange(0.0, 240.0, 12.0)
    coarse = ObservedRecord(
        "x", rows, 16.0 - rows / 500.0, np.full(rows.size, 10.0), np.full(rows.size, 20.0), 20.0, 4, 5.0
    )
    stacked = stack([coarse, bench(5.0, 25.0, 1)])
    assert (stacked.dt_s <= LONGEST_STEP_S + 1e-9).all() and (stacked.dt_s >= 0.0).all()
    assert int(stacked.compare[:, 0].sum()) == rows.size
    assert stacked.time_s[stacked.compare[:, 0], 0] == pytest.approx(rows)
    assert list(stacked.rested) == [False, True]


def test_a_held_load_loses_its_noise_and_keeps_its_steps() -> None:
    rng = np.random.default_rng(2)
    time_s = np.arange(0.0, 600.0, 2.0)
    true_A: Array = np.where(time_s < 20.0, 0.0, np.where(time_s < 300.0, 10.0, 16.0))
    held_A = held_load(time_s, true_A + rng.normal(0.0, 0.2, time_s.size))
    assert float(np.sqrt(np.mean((held_A - true_A) ** 2))) < 0.08
    assert np.abs(held_A - true_A).max() < 0.25  # no smearing over the steps


@cache
def flight() -> Flight:
    pack = generic_pack()
    facts = ((0.0, PackFacts(4, 5.0, critical_voltage_V=13.2)),)
    return Flight(
        "f", "csv", tuple(simulate_flight(pack, SimulatedFlight(300.0, 20.0, rate_Hz=0.5, seed=6))), facts=facts
    )


def test_a_fit_to_a_flight_is_a_fitted_file() -> None:
    size = size_of("mine", [], [flight()], None, NAN, NAN)
    assert size == RecordedPack("mine", 4, 5.0, 13.2)
    made = fit_battery(size, [], [flight()])
    assert made.file.status == "fitted" and made.file.battery.cells_series == 4
    assert any("cold" in line for line in made.unknown) and any("capacity" in line for line in made.unknown)
    assert len(made.known) == len(prior.cell_slots())
    assert made.file.discrepancy.voltage_rmse_V < 0.1
    assert (np.diff(made.file.parameters.ocv_V) > 0.0).all()


def test_too_little_is_said() -> None:
    with pytest.raises(NotEnoughData, match="9 rows") as caught:
        from_flight(Flight("f", "csv", tuple(Sample(float(t), 16.0, 5.0) for t in range(9))), 4, 5.0)
    assert caught.value.exit_code == 4
    with pytest.raises(NotEnoughData, match="nothing to fit"):
        fit_battery(RecordedPack("x", 4, 5.0, 13.2), [], [])
    with pytest.raises(UsageError, match="--cells"):
        size_of("x", [], [], None, 5.0, NAN)
    with pytest.raises(UsageError, match="--capacity-ah"):
        size_of("x", [], [], 4, NAN, NAN)


# --- tests whose current was not measured ------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [2.0, 5.0])
def test_an_unmetered_test_of_a_smaller_load_is_explained_too(rate: float) -> None:
    """With the study's 8 C as the only prior, a test of half an hour at 2 C was missed by 1.3 V."""
    cell = planted_cell()
    time_s, start = np.arange(0.0, 3600.0 / rate, 60.0), model.rested(np.array([0.98]), np.array([23.0]))
    out = limited_discharge(lambda _: cell, start, np.array([rate]), np.array([3.1]), 25.0, time_s, 5.0)
    test = unmetered.MeanTest(time_s, 4 * out[0, :, 0], np.full(time_s.size, 0.02), out[1, :, 0], 4, 25.0)
    fit = unmetered.fit_unmetered(test)
    again = unmetered.predict_unmetered(fit.slots, fit.effects, fit.x[None], test, time_s)
    assert again[0, :, 0] == pytest.approx(test.voltage_V, abs=0.04)
    assert fit.value("c_rate") == pytest.approx(rate, rel=0.1)


def test_a_limiter_holds_the_voltage() -> None:
    """Before the limiter: constant current. After it: the voltage at the limit and the load given up."""
    cell = planted_cell()
    start, time_s = model.rested(np.array([1.0]), np.array([25.0])), np.arange(0.0, 541.0, 60.0)
    out = limited_discharge(lambda _: cell, start, np.array([7.0]), np.array([3.2]), 25.0, time_s, 5.0)
    volts = out[0, :, 0]
    assert (volts >= 3.2 - 1e-6).all() and volts[-1] == pytest.approx(3.2, abs=1e-6)
    state = model.advance(cell, model.rested(1.0, 25.0), 7.0, 25.0, 120.0)
    assert volts[2] == pytest.approx(float(model.cell_voltage(cell, state, 7.0)), abs=1e-3)


def test_an_unmetered_test_is_explained_and_its_rate_stays_open() -> None:
    """Voltage is met; the file that ships carries the C-rate with the prior's sd, since the tables cannot tell it."""
    cell = planted_cell()
    time_s = np.arange(0.0, 421.0, 60.0)
    start = model.rested(np.array([0.98]), np.array([23.0]))
    out = limited_discharge(lambda _: cell, start, np.array([8.0]), np.array([3.1]), 25.0, time_s, 5.0)
    test = unmetered.MeanTest(time_s, 3 * out[0, :, 0], np.full(time_s.size, 0.02), out[1, :, 0], 3, 25.0)
    fit = unmetered.fit_unmetered(test)
    slots = unmetered.slots_of(fit.effects, test)
    again = unmetered.predict_unmetered(slots, fit.effects, fit.x[None], test, time_s)
    assert again[0, :, 0] == pytest.approx(test.voltage_V, abs=0.04)
    assert fit.value("c_rate") == pytest.approx(8.0, abs=1.5)
    assert fit.standard_error("c_rate") > 0.2
    shipped = battery_file.read_battery("lpab-3s").parameters
    assert shipped.c_rate_sd == 1.5 and shipped.resistance_scale_sd > 1.5 / 8.0
