"""Bench tests with a row every 10 s: their noise at rest, their delays, and packs that rest below the file's full."""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from cases import first_quick
from planted_flights import CAPACITY_AH, CELLS, FILE, PACK, fly

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.diagnosis.diagnosis import options_of, problem_of
from uavbatt.diagnosis.refit.meter_noise import noise_K, noise_V, resting_noise_V
from uavbatt.fitting import observed, solve, wander
from uavbatt.fitting.observed import ObservedRecord

NOISE_V = 0.007
ROWS_OF_A_BIN = {0.25: 20, 1.0: 5, 2.0: 2, 5.0: 1, 10.0: 1}  # at least
READING_V = np.hypot(0.02, 0.15 * 0.04)  # of both sensors of a flight: volts, and amperes over 40 mohm


def bench_test(seed: int, apart_s: float = 10.0, rested_V: float = 16.74) -> ObservedRecord:
    """Three minutes of rest, read with noise, then a flight's discharge; one row every `apart_s` [s]."""
    flown, noise = fly(25.0, 160.0, seed), np.random.default_rng(seed)
    rest_s, rows = np.arange(0.0, 180.0, apart_s), np.arange(20, flown.time_s.size, int(apart_s))
    resting = np.zeros(rest_s.size)
    return ObservedRecord(
        f"test {seed}",
        np.concatenate([rest_s, 160.0 + flown.time_s[rows]]),
        np.concatenate([rested_V + NOISE_V * noise.standard_normal(rest_s.size), flown.voltage_V[rows]]),
        np.concatenate([resting, flown.current_A[rows]]),
        np.concatenate([resting + 25.0, flown.temp_C[rows]]),
        25.0,
        CELLS,
        CAPACITY_AH,
    )


@pytest.fixture(scope="module")
def slow() -> list[ObservedRecord]:
    return [bench_test(seed) for seed in range(1, 9)]


def test_rows_at_rest_show_the_noise_of_the_voltmeter_at_any_spacing(slow: list[ObservedRecord]) -> None:
    assert resting_noise_V(slow) == pytest.approx(NOISE_V, rel=0.25)
    loaded_at_once = [replace(r, current_A=np.maximum(r.current_A, 10.0)) for r in slow]
    assert resting_noise_V(loaded_at_once) == 0.0


def test_the_noise_at_rest_is_no_evidence(slow: list[ObservedRecord]) -> None:
    problem = problem_of(slow, FILE, PACK)
    squares = []
    for j, volts in enumerate(problem.evidence.volts):
        measured_V = problem.evidence.stack.voltage_V[volts.rows, j]
        noise_V = np.where(volts.rest, measured_V - np.mean(measured_V[volts.rest]), 0.0)
        squares += list((volts.inverse @ noise_V)[volts.rest] ** 2)
    assert 0.5 < np.mean(squares) < 1.5


def held_bench(apart_s: float) -> ObservedRecord:
    """Twenty minutes of a held load, every row a single reading of a noisy voltmeter and a noisy thermometer."""
    time_s, noise = np.arange(0.0, 1200.0, apart_s), np.random.default_rng(5)
    volts = 16.0 - 0.001 * time_s - 0.3 * (time_s % 240.0 < 120.0)
    seen = (volts + NOISE_V * noise.standard_normal(time_s.size), 25.0 + 0.003 * time_s)
    current_A = np.where(time_s % 240.0 < 120.0, 20.0, 12.0)
    felt = seen[1] + 0.1 * noise.standard_normal(time_s.size)
    return ObservedRecord("bench", time_s, seen[0], current_A, felt, 25.0, CELLS, CAPACITY_AH)


@pytest.mark.parametrize("apart_s", [2.0, 5.0, 10.0])
def test_slow_rows_of_a_held_load_carry_the_noise_of_few_readings(apart_s: float) -> None:
    """The noise that a file states is of means over 5 s: single readings of a sound bench looked like an effect."""
    share = 1.0 / np.sqrt(ROWS_OF_A_BIN[apart_s])
    assert noise_V(held_bench(apart_s), ohm=0.0375) == pytest.approx(share * NOISE_V, rel=0.3)
    assert noise_K(held_bench(apart_s), 0.02) == pytest.approx(share * 0.1, rel=0.3)


@pytest.mark.parametrize("apart_s", [0.25, 1.0, 2.0])
def test_means_over_the_bins_have_the_noise_of_the_temperature_that_the_file_states(apart_s: float) -> None:
    """The scatter of one flight, up to a third above that of the file, hid a cooling by the air that had no name."""
    stated_K = 0.1 / np.sqrt(ROWS_OF_A_BIN[apart_s]) / 1.2
    assert noise_K(held_bench(apart_s), stated_K) == stated_K


def test_a_record_with_fewer_rows_than_those_of_the_file_has_more_noise_of_the_temperature() -> None:
    """A sound pack in a log at 1 Hz was said to lack an effect, by a file whose flights were logged at 2 Hz."""
    of_many_rows_K = 0.1 / np.sqrt(ROWS_OF_A_BIN[0.25])
    assert noise_K(held_bench(1.0), of_many_rows_K) == pytest.approx(0.1 / np.sqrt(ROWS_OF_A_BIN[1.0]), rel=0.1)


@pytest.mark.parametrize("apart_s", [2.0, 5.0, 10.0])
def test_slow_rows_of_a_changing_load_carry_the_whole_noise_of_a_reading(apart_s: float) -> None:
    """It counted as none, and a sound pack whose log has a row every 5 s was said to lack an effect without a name."""
    flights = [noise_V(bench_test(seed, apart_s), ohm=0.04) for seed in range(1, 9)]
    assert np.mean(flights) == pytest.approx(READING_V / np.sqrt(ROWS_OF_A_BIN[apart_s]), rel=0.2)


def test_rows_ten_seconds_apart_show_no_delay_of_the_current(slow: list[ObservedRecord]) -> None:
    names = {c.name for c in options_of(problem_of(slow, FILE, PACK), FILE, ())}
    assert "current_delay" not in names and "current_offset" in names
    quick = [bench_test(seed, apart_s=1.0) for seed in (1, 2)]
    assert "current_delay" in {c.name for c in options_of(problem_of(quick, FILE, PACK), FILE, ())}


def with_start(soc: float | None) -> BatteryFile:
    told = msgspec.structs.replace(FILE.discrepancy.wander, start_soc=soc)
    return msgspec.structs.replace(FILE, discrepancy=msgspec.structs.replace(FILE.discrepancy, wander=told))


def test_full_packs_begin_as_the_full_packs_of_the_file_did(slow: list[ObservedRecord]) -> None:
    assert problem_of(slow, with_start(0.97), PACK).evidence.start_soc == pytest.approx(0.97)
    assert problem_of(slow, with_start(None), PACK).evidence.start_soc == pytest.approx(1.0)


def test_a_test_that_begins_under_load_begins_no_fuller_than_the_full_packs_of_the_file(
    slow: list[ObservedRecord],
) -> None:
    loaded = [replace(r, current_A=np.maximum(r.current_A, 10.0)) for r in slow]
    assert np.max(problem_of(loaded, with_start(0.97), PACK).evidence.start_soc) == pytest.approx(0.97)


@pytest.mark.parametrize(("started", "told"), first_quick(2, [(0.96, 0.96), (0.995, None), (0.6, None)]))
def test_a_fit_tells_the_start_of_packs_that_charge_to_less_than_full(
    slow: list[ObservedRecord], started: float, told: float | None
) -> None:
    stack = observed.stack(slow)
    fit = solve.fit_cell(stack, ("polarisation",))
    trajectory = solve.replay_fit(stack, fit)
    trajectory = trajectory._replace(soc=trajectory.soc - trajectory.soc[0] + started)
    found = wander.learn(stack, trajectory, list(range(len(slow))), CELLS).start_soc
    assert found == (None if told is None else pytest.approx(told))


@pytest.mark.parametrize("digit_V", [0.05, 0.1, 0.2])
def test_the_rounding_of_a_coarse_voltmeter_is_noise_of_a_row(digit_V: float) -> None:
    """The noise does not reach from one reading to the next: most of them are the same, and none was seen."""
    bench = held_bench(1.0)
    rounded = replace(bench, voltage_V=np.round(bench.voltage_V / digit_V) * digit_V)
    assert noise_V(rounded, ohm=0.0375) == pytest.approx(digit_V / math.sqrt(12.0), rel=0.01)
    assert noise_V(bench, ohm=0.0375) < 0.02
