"""The compiled twins against numpy and filterpy: the same numbers to 1e-9, on flights that were flown and simulated."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import astuple, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from factories import generic_pack, with_spread

import uavbatt
from uavbatt import compiled
from uavbatt.battery import battery_file, model, openloop
from uavbatt.battery.capacity_prior import Capacities, capacities, known_capacity
from uavbatt.battery.effects import EFFECTS
from uavbatt.battery.scaling import Pack
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.battery.state_space import SIZE, X
from uavbatt.compiled import cache as compiled_cache
from uavbatt.compiled.fallback import plain_where_it_fails
from uavbatt.engine import PLAIN, Engine
from uavbatt.estimation.filter import SocFilter
from uavbatt.estimation.kalman import filterpy_condition
from uavbatt.estimation.recursion import FilteredRow, filter_window
from uavbatt.estimator import Estimator
from uavbatt.log_replay.run import engine_for, steps
from uavbatt.prediction import batch as questions
from uavbatt.prediction.batch import Question
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.simulation.time_to_end import EndTimes
from uavbatt.records import NAN, Sample
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, with_effects

numba = pytest.importorskip("numba", reason="the extra `fast` is not installed")
LOGS = Path(__file__).resolve().parents[2] / "logs"
CLOSE = 1e-9
# Quotients of small differences: of millivolts that are told apart in 21 V, and of what is left of large variances.
QUOTIENT_CLOSE = 1e-8


def pack_4s() -> Pack:
    return generic_pack()


@cache
def flown() -> tuple[Sample, ...]:
    return tuple(simulate_flight(pack_4s(), SimulatedFlight(500.0, 8.0, rate_Hz=10.0, seed=5)))


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
    sure = with_spread(pack, resistance_scale_sd=0.2)
    for quick, plain in both(sure, known_capacity(sure), samples):
        np.testing.assert_allclose(quick.innovation, plain.innovation, rtol=0.0, atol=QUOTIENT_CLOSE)
        assert (quick.belief is None) == (plain.belief is None)
        if quick.belief is not None and plain.belief is not None:
            np.testing.assert_allclose(quick.belief.means, plain.belief.means, rtol=CLOSE, atol=CLOSE)
            sd = np.sqrt(np.diagonal(plain.belief.covariances, axis1=1, axis2=2))
            scale = sd[:, :, None] * sd[:, None, :]
            quick_share, plain_share = quick.belief.covariances / scale, plain.belief.covariances / scale
            np.testing.assert_allclose(quick_share, plain_share, rtol=0.0, atol=QUOTIENT_CLOSE)
            assert quick.belief.ambient_C == pytest.approx(plain.belief.ambient_C, abs=1e-9)
    # Of a bank: members that the readings have left behind amplify the last digit, and weigh little.
    for quick, plain in both(pack, capacities(pack), samples):
        np.testing.assert_allclose(quick.innovation, plain.innovation, rtol=1e-5, atol=1e-5)
        if quick.belief is not None and plain.belief is not None:
            np.testing.assert_allclose(quick.belief.weights, plain.belief.weights, rtol=0.0, atol=1e-5)
            np.testing.assert_allclose(quick.belief.mean, plain.belief.mean, rtol=1e-5, atol=1e-5)


def both(pack: Pack, members: Capacities, samples: list[Sample]) -> Iterator[tuple[FilteredRow, FilteredRow]]:
    """The filter after each row as the twin has it, in two windows, and as filterpy has it."""
    plain, twin = SocFilter(pack, capacities=members), SocFilter(pack, capacities=members)
    cut, window = len(samples) // 3, compiled.engine().filter_window
    found = twin.run(samples[:cut], window) + twin.run(samples[cut:], window)
    by_filterpy = partial(filter_window, condition=filterpy_condition())
    for sample, quick in zip(samples, found, strict=True):
        yield quick, plain.run([sample], by_filterpy)[0]


# --- the filter --------------------------------------------------------------------------------------------------


def test_the_state_is_indexed_by_plain_integers() -> None:
    """Numba before 0.68 compiles no IntEnum as an index: a long log, a fleet and a diagnosis ended in its error."""
    assert [type(index) for index in X] == [int] * SIZE and list(X) == list(range(SIZE))


@pytest.mark.slow
def test_the_filter_on_a_simulated_flight_with_holes() -> None:
    assert_same_rows(pack_4s(), holed(flown())[:2600])


@pytest.mark.parametrize(
    "name", ["quad_3s.BIN", *(pytest.param(n, marks=pytest.mark.slow) for n in ("quad_4s.tlog", "hexa_6s_cold.csv"))]
)
def test_the_filter_on_the_sample_logs(name: str) -> None:
    cells = int(name.split("_")[1][0])
    pack = generic_pack(cells, 5.0, 3.3 * cells, 3.5 * cells)
    assert_same_rows(pack, list(uavbatt.read_log(LOGS / name).samples[:600]))


def test_the_filter_after_a_landing() -> None:
    """A minute at rest is not weighed, the next is; then the load comes back."""
    before = list(flown()[150:500])
    rest = [Sample(before[-1].time_s + 1.0 + k, 15.6 + 0.002 * k, 0.3, 25.0) for k in range(90)]
    shift_s = rest[-1].time_s + 1.0 - flown()[500].time_s
    assert_same_rows(pack_4s(), [*before, *rest, *(replace(s, time_s=s.time_s + shift_s) for s in flown()[500:560])])


def test_the_filter_through_a_voltmeter_of_coarse_steps() -> None:
    assert_same_rows(pack_4s(), [replace(s, voltage_V=0.2 * round(s.voltage_V / 0.2)) for s in flown()[:600]])


def test_the_filter_on_flown_flights(shared_data: Path) -> None:
    # Not the first: one generic capacity explains it so badly that the discrepancy runs to 0.4 V a cell, where the last
    # digit grows to 1e-8.
    logs = sorted((shared_data / "flights" / "m100").glob("m100_0*.csv"))[1:4]
    assert logs
    for log in logs:
        assert_same_rows(generic_pack(6, 5.7, 20.4, 21.0), list(uavbatt.read_log(log).samples))


@pytest.mark.parametrize("name", sorted(set(EFFECTS) - {"current_delay"}))  # which the filter undoes before the twin
def test_the_filter_under_every_effect(name: str) -> None:
    assert_same_rows(affected(name), list(flown()[150:290]))  # take-off in it, after 20 s on the ground


def affected(name: str) -> Pack:
    """The pack with an effect on, at a size that shows."""
    quantity = EFFECTS[name].quantities[0]
    return with_effects(pack_4s(), {name: quantity.prior + 0.1 * (quantity.high - quantity.prior)})


# --- the forecast ------------------------------------------------------------------------------------------------


def asked(samples: tuple[Sample, ...], reserve_soc: float = 0.0) -> Iterator[Question]:
    """The questions of a flight."""
    found: list[Question] = []

    def noted(questions_asked: Sequence[Question]) -> list[EndTimes]:
        found.extend(questions_asked)
        return questions.answers(questions_asked)

    settings = ForecastSettings(reserve_soc=reserve_soc, forecast_period_s=40.0)
    for _ in Estimator(battery_file.read_battery("lipo-generic"), OPTIONS, settings, Engine(answers=noted)).run(
        samples
    ):
        yield from found
        found.clear()


def assert_same_ends(found: list[Question]) -> None:
    for question, beside in zip(found, questions.answers(found), strict=True):
        alone, (twin,) = questions.end_times(question.flying), compiled.engine().answers([question])
        for plain, side_by_side, quick in zip(alone, beside, twin, strict=True):
            np.testing.assert_array_equal(side_by_side, plain)
            np.testing.assert_allclose(quick, plain, rtol=CLOSE, atol=CLOSE)


OPTIONS = PackOptions(cells=4, capacity_Ah=5.0, cutoff_V=13.2, low_V=14.0)


@pytest.mark.parametrize("reserve_soc", [0.0, 0.3])
def test_the_forecasts_of_a_simulated_flight(reserve_soc: float) -> None:
    assert_same_ends(list(asked(flown()[::5], reserve_soc)))


def test_forecasts_by_slow_rows() -> None:
    found = list(asked(flown()[::120]))
    assert any(question.flying.by_rows for question in found)
    assert_same_ends(found)


@cache
def first_question() -> Question:
    return next(asked(flown()[::10]))


def test_the_slow_rows_of_a_long_log() -> None:
    """Three hours of rows 6 s apart are more steps than there are normals: these come again."""
    rows = 1800
    first = first_question().flying
    power_W, dt_s = np.full((rows, first.x.shape[1]), 30.0), np.full(rows, 6.0)
    long = first._replace(power_W=power_W, dt_s=dt_s, by_rows=True, reserve_soc=0.02)
    assert_same_ends([first_question()._replace(flying=long)])
    assert np.median(questions.end_times(long).end_s) > 1024 * 6.0


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_a_forecast_under_every_effect(name: str) -> None:
    question = first_question()
    flying = question.flying
    pack = affected(name)._replace(cutoff_V=flying.pack.cutoff_V, low_V=flying.pack.low_V)
    assert_same_ends([question._replace(flying=flying._replace(pack=pack))])


# --- a whole replay ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["quad_4s.tlog", "hexa_6s_cold.csv"])
def test_a_replay_says_the_same_compiled(name: str) -> None:
    whole = uavbatt.read_log(LOGS / name)
    flight = replace(whole, samples=whole.samples[: len(whole.samples) // 2])

    def numbers(engine: Engine) -> list[list[float]]:
        options, settings = PackOptions(capacity_Ah=5.0), ForecastSettings(forecast_period_s=10.0)
        estimator = Estimator(battery_file.read_battery("lipo-generic"), options, settings, engine)
        run = list(steps(flight, estimator))
        values = [(*astuple(step.estimate), *astuple(step.remaining)) for step in run]
        return [[value for value in row if isinstance(value, float)] for row in values]

    for row, quick in zip(numbers(PLAIN), numbers(compiled.engine()), strict=True):
        np.testing.assert_allclose(quick, row, rtol=CLOSE, atol=QUOTIENT_CLOSE)


# --- the open loop -----------------------------------------------------------------------------------------------


def test_the_open_loop_of_many_columns() -> None:
    random = np.random.default_rng(3)
    batch, rows = 6, 300
    rate, dt_s = random.uniform(-1.0, 6.0, (rows, batch)), random.uniform(0.1, 5.0, (rows, batch))
    ambient_C = random.uniform(-10.0, 35.0, batch)
    cell = pack_4s().cell._replace(
        ocv_V=pack_4s().cell.ocv_V + random.uniform(0.0, 0.05, (batch, 1)),
        resistance_gain=random.uniform(0.7, 1.6, batch),
        airflow_gain_h=random.uniform(0.0, 0.5, batch),
        hysteresis_V=random.uniform(0.0, 0.03, batch),
        surface_h=random.uniform(0.0, 0.04, batch),
        rate_gain_h=0.01,
    )
    start = model.rested(np.full(batch, 0.97), 20.0)
    plain = openloop.states(cell, start, rate, dt_s, ambient_C)
    for quick, column in zip(compiled.engine().states(cell, start, rate, dt_s, ambient_C), plain, strict=True):
        np.testing.assert_allclose(quick, column, rtol=CLOSE, atol=CLOSE)


# --- when it is used ---------------------------------------------------------------------------------------------


@pytest.fixture
def unknown_machine() -> Iterator[None]:
    """Nothing is known of the machine yet, before and after."""
    for known in (compiled_cache.cache_dir, compiled_cache.is_available):
        known.cache_clear()
    yield
    for known in (compiled_cache.cache_dir, compiled_cache.is_available):
        known.cache_clear()


def test_only_long_work_is_compiled() -> None:
    assert engine_for(is_long=False) is PLAIN
    assert engine_for(is_long=True) == compiled.engine() != PLAIN


@pytest.mark.usefixtures("unknown_machine")
def test_without_a_folder_to_write_to_nothing_is_compiled(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "taken"))
    assert compiled_cache.cache_dir() is None
    assert engine_for(is_long=True) is PLAIN


@pytest.mark.usefixtures("unknown_machine")
def test_a_numba_that_cannot_be_imported_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numba", None)  # makes its import fail
    assert engine_for(is_long=True) is PLAIN


def test_what_numba_cannot_compile_is_worked_out_by_numpy() -> None:
    """Versions of numba before 0.68 did not compile the filter: the command ended in an error of the compiler."""
    tried = []

    @numba.njit
    def unknown_to_numba(value: float) -> str:
        return f"{value!r:>{value}}"

    def fast(value: float) -> str:
        tried.append(value)
        return unknown_to_numba(value)

    run = plain_where_it_fails(fast, lambda value: f"plain {value}")
    assert [run(1.0), run(2.0)] == ["plain 1.0", "plain 2.0"]
    assert tried == [1.0]  # what failed once is not compiled again


def test_an_installation_without_the_package_is_plain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(uavbatt, "compiled")
    monkeypatch.setitem(sys.modules, "uavbatt.compiled", None)
    assert engine_for(is_long=True) is PLAIN


def test_in_flight_numba_is_never_imported() -> None:
    code = (
        "import sys, uavbatt.live.daemon, uavbatt.cli.live_process, uavbatt.live.tracked_battery\n"
        "from uavbatt.battery import battery_file\n"
        "from uavbatt.battery.sizing.pack_size import PackOptions\n"
        "from uavbatt.estimator import Estimator\n"
        "from uavbatt.prediction.forecaster import ForecastSettings\n"
        "from uavbatt.records import Sample\n"
        "options, settings = PackOptions(cells=4, capacity_Ah=5.0), ForecastSettings(forecast_period_s=20.0)\n"
        "e = Estimator(battery_file.read_battery('lipo-generic'), options, settings)\n"
        "out = [e.step(Sample(float(k), 15.6 - 0.002 * k, 20.0, 25.0))[1] for k in range(60)]\n"
        "assert out[-1].remaining_s > 0.0\n"
        "assert not {'numba', 'llvmlite', 'uavbatt.compiled'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
