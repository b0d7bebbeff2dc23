"""The compiled twins against numpy and filterpy: the same numbers to 1e-9, on flights that were flown and simulated."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import astuple, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from factories import generic_pack

import uavbatt
from uavbatt import fast
from uavbatt.battery import battery_file, model, openloop
from uavbatt.battery.capacity_prior import Capacities, capacities, known_capacity
from uavbatt.battery.effects import EFFECTS
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import Belief
from uavbatt.estimation import ahead
from uavbatt.estimation.ahead import Row
from uavbatt.estimation.filter import SocFilter
from uavbatt.estimation.recursion import Shown
from uavbatt.estimator import Estimator, PackOptions
from uavbatt.log_replay import steps
from uavbatt.prediction import batch as questions
from uavbatt.prediction.batch import Question
from uavbatt.records import NAN, Sample
from uavbatt.simulate import Mission, fly, with_effects

pytest.importorskip("numba", reason="the extra `fast` is not installed")
LOGS = Path(__file__).resolve().parents[2] / "logs"
CLOSE = 1e-9


def pack_4s() -> Pack:
    return generic_pack()


@cache
def flown() -> tuple[Sample, ...]:
    return tuple(fly(pack_4s(), Mission(500.0, 8.0, rate_Hz=10.0, seed=5)))


def holed(samples: tuple[Sample, ...]) -> list[Sample]:
    """Rows with what telemetry does: gaps, twins, rows back in time, without current, without temperature."""
    rows = [s for k, s in enumerate(samples) if not (900 < k < 960 or 1500 < k < 2300)]
    for k in (3, 250, 251, 252):
        rows[k] = replace(rows[k], current_A=NAN)
    rows[0] = replace(rows[0], voltage_V=NAN)
    rows[400] = replace(rows[400], time_s=rows[399].time_s)
    rows[500] = replace(rows[500], time_s=rows[500].time_s - 30.0)
    return [replace(s, temp_C=NAN) if 600 < k < 800 else s for k, s in enumerate(rows)]


def assert_same_rows(pack: Pack, samples: list[Sample]) -> None:
    """Row for row: what filterpy's filter shows and believes, and what the twin does, in two goes."""
    sure = pack._replace(resistance_scale_sd=0.2)
    for row, shown, belief in both(sure, known_capacity(sure), samples):
        np.testing.assert_allclose(row.shown, shown, rtol=0.0, atol=CLOSE)
        assert (row.moments is None) == (belief is None)
        if belief is not None and row.moments is not None:
            np.testing.assert_allclose(row.moments.x, belief.means, rtol=CLOSE, atol=CLOSE)
            sd = np.sqrt(np.diagonal(belief.covariances, axis1=1, axis2=2))
            scale = sd[:, :, None] * sd[:, None, :]
            np.testing.assert_allclose(row.moments.P / scale, belief.covariances / scale, atol=CLOSE)
            assert row.time_s == belief.time_s
    # Of a bank: members that the readings have left behind amplify the last digit, and weigh little.
    for row, shown, belief in both(pack, capacities(pack), samples):
        np.testing.assert_allclose(row.shown, shown, rtol=1e-5, atol=1e-5)
        if belief is not None and row.moments is not None:
            np.testing.assert_allclose(row.moments.weight, belief.weights, rtol=0.0, atol=1e-5)
            np.testing.assert_allclose(row.moments.weight @ row.moments.x, belief.mean, rtol=1e-5, atol=1e-5)


def both(pack: Pack, members: Capacities, samples: list[Sample]) -> Iterator[tuple[Row, Shown, Belief | None]]:
    """Each row as the twin has it, and what filterpy's filter shows and believes after it."""
    plain, twin = SocFilter(pack, capacities=members), SocFilter(pack, capacities=members)
    cut = len(samples) // 3
    found = ahead.by_twin(twin, samples[:cut]) + ahead.by_twin(twin, samples[cut:])
    for sample, row in zip(samples, found, strict=True):
        yield row, plain.take(sample), plain.belief


# --- the filter --------------------------------------------------------------------------------------------------


def test_the_filter_on_a_simulated_flight_with_holes() -> None:
    assert_same_rows(pack_4s(), holed(flown())[:3500])


@pytest.mark.parametrize("name", ["quad_4s.tlog", "quad_3s.BIN", "hexa_6s_cold.csv"])
def test_the_filter_on_the_sample_logs(name: str) -> None:
    cells = int(name.split("_")[1][0])
    pack = generic_pack(cells, 5.0, 3.3 * cells, 3.5 * cells)
    assert_same_rows(pack, list(uavbatt.read_log(LOGS / name).samples[:1200]))


def test_the_filter_on_flown_flights(shared_data: Path) -> None:
    logs = sorted((shared_data / "flights" / "m100").glob("m100_0*.csv"))[:3]
    assert logs
    for log in logs:
        assert_same_rows(generic_pack(6, 5.7, 20.4, 21.0), list(uavbatt.read_log(log).samples))


@pytest.mark.parametrize("name", sorted(set(EFFECTS) - {"current_delay"}))  # which the filter undoes before the twin
def test_the_filter_under_every_effect(name: str) -> None:
    assert_same_rows(affected(name), list(flown()[:400]))


def affected(name: str) -> Pack:
    """The pack with an effect on, at a size that shows."""
    quantity = EFFECTS[name].quantities[0]
    return with_effects(pack_4s(), {name: quantity.prior + 0.1 * (quantity.high - quantity.prior)})


# --- the forecast ------------------------------------------------------------------------------------------------


def asked(samples: tuple[Sample, ...], options: PackOptions) -> Iterator[Question]:
    """The questions of a flight."""
    estimator = Estimator(battery_file.read("lipo-generic"), options)
    estimator.look_ahead(samples)
    for sample in samples:
        question = estimator.ask(sample).question
        if question is not None:
            yield question


def assert_same_ends(found: list[Question]) -> None:
    from uavbatt.prediction import compiled

    with fast.left_out():
        together = questions.answers(found)
    for question, beside in zip(found, together, strict=True):
        alone, twin = questions.answer(question), compiled.answer(question)
        for plain, side_by_side, quick in zip(alone, beside, twin, strict=True):
            np.testing.assert_array_equal(side_by_side, plain)
            np.testing.assert_allclose(quick, plain, rtol=CLOSE, atol=CLOSE)


OPTIONS = PackOptions(cells=4, capacity_Ah=5.0, cutoff_V=13.2, low_V=14.0, forecast_period_s=40.0)


@pytest.mark.parametrize("reserve_soc", [0.0, 0.3])
def test_the_forecasts_of_a_simulated_flight(reserve_soc: float) -> None:
    assert_same_ends(list(asked(flown()[::5], replace(OPTIONS, reserve_soc=reserve_soc))))


def test_forecasts_by_slow_rows() -> None:
    found = list(asked(flown()[::120], OPTIONS))
    assert any(question.by_rows for question in found)
    assert_same_ends(found)


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_a_forecast_under_every_effect(name: str) -> None:
    question = next(asked(flown()[::10], OPTIONS))
    pack = affected(name)._replace(cutoff_V=question.pack.cutoff_V, low_V=question.pack.low_V)
    assert_same_ends([question._replace(pack=pack)])


# --- a whole replay ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["quad_4s.tlog", "hexa_6s_cold.csv"])
def test_a_replay_says_the_same_compiled(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    whole = uavbatt.read_log(LOGS / name)
    flight = replace(whole, samples=whole.samples[: len(whole.samples) // 2])

    def numbers() -> list[list[float]]:
        estimator = Estimator(battery_file.read("lipo-generic"), PackOptions(capacity_Ah=5.0, forecast_period_s=10.0))
        run = list(steps(flight, estimator))
        values = [(*astuple(step.estimate), *astuple(step.remaining)) for step in run]
        return [[value for value in row if isinstance(value, float)] for row in values]

    with fast.left_out():
        plain = numbers()
    monkeypatch.setattr(fast, "pays", lambda spared_s, work: True)
    monkeypatch.setattr(fast, "is_used", lambda work: True)
    for row, quick in zip(plain, numbers(), strict=True):
        np.testing.assert_allclose(quick, row, rtol=CLOSE, atol=CLOSE)


# --- the open loop -----------------------------------------------------------------------------------------------


def test_the_open_loop_of_many_columns() -> None:
    from uavbatt.battery import compiled_openloop

    random = np.random.default_rng(3)
    batch, rows = 6, 300
    rate, dt_s = random.uniform(-1.0, 6.0, (rows, batch)), random.uniform(0.1, 5.0, (rows, batch))
    ambient_C = random.uniform(-10.0, 35.0, batch)
    cell = pack_4s().cell._replace(
        ocv_V=pack_4s().cell.ocv_V + random.uniform(0.0, 0.05, (batch, 1)),
        resistance_gain=random.uniform(0.7, 1.6, batch),
        airflow_gain_h=random.uniform(0.0, 0.5, batch),
        hysteresis_V=random.uniform(0.0, 0.03, batch),
        rate_gain_h=0.01,
    )
    start = model.rested(np.full(batch, 0.97), 20.0)
    with fast.left_out():
        plain = openloop.states(cell, start, rate, dt_s, ambient_C)
    for quick, column in zip(compiled_openloop.states(cell, start, rate, dt_s, ambient_C), plain, strict=True):
        np.testing.assert_allclose(quick, column, rtol=CLOSE, atol=CLOSE)


# --- when it is used ---------------------------------------------------------------------------------------------


def test_work_pays_when_as_much_was_asked_as_it_costs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(fast, "folder", lambda: tmp_path)
    monkeypatch.setattr(fast, "_used", set())
    monkeypatch.setattr(fast, "_spared_s", {})
    tenth_s = 0.1 * (fast.START_S["forecast"] + fast.COMPILE_S["forecast"])
    assert [fast.pays(tenth_s, "forecast") for _ in range(11)] == [False] * 10 + [True]
    with fast.left_out():
        assert not fast.pays(math.inf, "forecast")
        assert not fast.is_used("forecast")
    fast.is_made("filter")
    assert fast.pays(fast.START_S["filter"] + 0.01, "filter")


def test_without_a_folder_to_write_to_nothing_is_compiled(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "taken"))
    fast.folder.cache_clear()
    try:
        assert fast.folder() is None
        assert not fast.pays(math.inf, "forecast")
    finally:
        monkeypatch.undo()
        fast.folder.cache_clear()


def test_a_numba_that_cannot_be_imported_is_left_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(fast, "folder", lambda: tmp_path)
    monkeypatch.setattr(fast, "_used", set())
    monkeypatch.setitem(sys.modules, "numba", None)  # makes its import fail
    fast.is_usable.cache_clear()
    try:
        assert fast.is_installed()
        assert not fast.pays(math.inf, "forecast")
    finally:
        fast.is_usable.cache_clear()


def test_in_flight_numba_is_never_imported() -> None:
    code = (
        "import sys, uavbatt.live.daemon, uavbatt.cli.live_process, uavbatt.live.tracked_battery\n"
        "from uavbatt.battery import battery_file\n"
        "from uavbatt.estimator import Estimator, PackOptions\n"
        "from uavbatt.records import Sample\n"
        "options = PackOptions(cells=4, capacity_Ah=5.0, forecast_period_s=0.0)\n"
        "e = Estimator(battery_file.read('lipo-generic'), options)\n"
        "out = [e.step(Sample(float(k), 15.6 - 0.002 * k, 20.0, 25.0))[1] for k in range(60)]\n"
        "assert out[-1].remaining_s > 0.0\n"
        "assert not {'numba', 'llvmlite', 'uavbatt.battery.compiled'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
