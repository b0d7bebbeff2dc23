"""The regression model V(t, T): its shape, what it recovers, and that a held-out run is really held out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from uavbatt import dataset
from uavbatt.dataset import DataSet, Run
from uavbatt.validation.gating import gate, regression
from uavbatt.validation.gating.gate import Limits
from uavbatt.validation.gating.heldout import HeldOut
from uavbatt.validation.judging.crossing import crossing_time
from uavbatt.validation.judging.readings import read_once

MINUTES = 60.0 * np.arange(10)
TRUE = np.array([10.9, 0.15, -0.05, 0.2, np.log(60.0), 0.5, 0.0, np.log(380.0), 0.12, -0.02, 6.0, np.log(0.05), 9.35,
                 12.5])  # fmt: skip


@pytest.fixture(scope="module")
def study() -> DataSet:
    return dataset.load()


@pytest.fixture(scope="module")
def held(study: DataSet) -> HeldOut:
    return regression.held_out(read_once(study))


def planted(sd_V: float, seed: int = 1) -> list[Run]:
    rng = np.random.default_rng(seed)
    nan = np.full(MINUTES.size, np.nan)
    runs = []
    for k, T in enumerate((-5.0, 0.0, 5.0, 15.0, 25.0, 25.0, 25.0, 35.0, 45.0)):
        volts = regression.curve(TRUE, MINUTES - 1e-6, np.full(MINUTES.size, T), np.zeros(10), np.zeros(10), 3)
        runs.append(Run("1", k, T, MINUTES, volts + rng.normal(0.0, sd_V, MINUTES.size), nan, nan))
    return runs


def test_before_the_load_it_is_the_rested_voltage_and_long_after_the_knee_the_floor() -> None:
    one, none = np.array([25.0]), np.zeros(1)
    assert regression.curve(TRUE, np.array([-1.0]), one, none, none, 3)[0] == 12.5
    assert regression.curve(TRUE, np.array([900.0]), one, none, none, 3)[0] == pytest.approx(9.35, abs=0.01)


def test_it_falls_all_the_way_under_load_and_the_knee_comes_later_when_warm() -> None:
    t = np.linspace(0.0, 600.0, 301)
    knees = []
    for T in (-5.0, 10.0, 25.0, 45.0):
        volts = regression.curve(TRUE, t, np.full(t.size, T), np.zeros(t.size), np.zeros(t.size), 3)
        assert (np.diff(volts) < 1e-9).all()
        knees.append(crossing_time(t, volts, 10.0))
    assert knees == sorted(knees)
    assert knees[-1] - knees[0] > 30.0


def test_a_planted_law_is_recovered() -> None:
    runs = planted(0.005)
    found = regression.fit_regression(regression.rows_of(runs, [1e-6] * len(runs), [0] * len(runs)), 3)
    t = np.linspace(60.0, 520.0, 47)
    for T in (0.0, 25.0, 40.0):
        truth = regression.curve(TRUE, t, np.full(t.size, T), np.zeros(t.size), np.zeros(t.size), 3)
        assert crossing_time(t, found.voltage(t, np.full(t.size, T)), 10.0) == pytest.approx(
            crossing_time(t, truth, 10.0), abs=4.0
        )
        assert np.sqrt(np.mean((found.voltage(t, np.full(t.size, T)) - truth) ** 2)) < 0.03


def test_a_step_between_series_does_not_pass_for_temperature() -> None:
    runs = [replace(r, voltage_V=r.voltage_V - 0.2) if r.ambient_C > 30.0 else r for r in planted(0.005)]
    series = [int(r.ambient_C > 30.0) for r in runs]
    t, T = np.array([120.0]), np.array([35.0])
    truth = regression.curve(TRUE, t, T, np.zeros(1), np.zeros(1), 3)[0]

    def predicted(numbers: list[int]) -> float:
        return float(
            regression.fit_regression(regression.rows_of(runs, [1e-6] * len(runs), numbers), 3).voltage(t, T)[0]
        )

    assert abs(predicted(series) - truth) < 0.5 * abs(predicted([0] * len(runs)) - truth)


def test_it_is_gated_on_occasions_it_has_not_seen(study: DataSet, held: HeldOut) -> None:
    claim = gate.voltage_claim(held, Limits(), study.cutoff_V, study.uncertainty)
    assert claim.verdict != "fail"
    assert np.abs(claim.bias).max() < 0.05
    shifted = replace(held, model_V=held.model_V + 0.2)
    assert gate.voltage_claim(shifted, Limits(), study.cutoff_V, study.uncertainty).verdict == "fail"


def test_the_knee_time_of_the_study_is_met_within_the_limit(study: DataSet, held: HeldOut) -> None:
    limits = Limits()
    claim = gate.crossing_claim(held, limits, study.uncertainty)
    assert abs(claim.bias[0]) < limits.time_s
    assert claim.verdict != "fail"


def test_a_regression_that_is_late_by_twice_the_limit_fails_in_time(study: DataSet, held: HeldOut) -> None:
    limits = Limits()
    late = np.apply_along_axis(lambda v: np.interp(held.time_s - 2 * limits.time_s, held.time_s, v), 2, held.model_V)
    claim = gate.crossing_claim(replace(held, model_V=late), limits, study.uncertainty)
    assert claim.verdict == "fail"
    assert claim.bias[0] > limits.time_s


def test_changing_an_occasion_does_not_change_its_own_prediction(study: DataSet, held: HeldOut) -> None:
    spoilt = tuple(
        replace(r, voltage_V=r.voltage_V - 0.3) if r.run == 4 and r.sample != "T1" and r.ambient_C == 25.0 else r
        for r in study.runs
    )
    again = regression.held_out(read_once(replace(study, runs=spoilt)))
    assert again.model_V[3] == pytest.approx(held.model_V[3], abs=1e-9)
    assert np.abs(again.model_V[0] - held.model_V[0]).max() > 0.005


def test_one_time_runs_are_predicted_by_fits_without_them(study: DataSet, held: HeldOut) -> None:
    assert sorted(s.ambient_C for s in held.singles) == [t for t in study.ambients_C if t != 25.0]
    spoilt = tuple(replace(r, voltage_V=r.voltage_V - 0.01) if r.ambient_C == 10.0 else r for r in study.runs)
    again = regression.held_out(read_once(replace(study, runs=spoilt)))
    a, b = (next(s.model_V for s in h.singles if s.ambient_C == 10.0) for h in (held, again))
    assert b == pytest.approx(a, abs=1e-9)
    others = [np.abs(x.model_V - y.model_V).max() for x, y in zip(held.singles, again.singles, strict=True)]
    assert max(others) > 1e-4
