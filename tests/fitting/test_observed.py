"""Records of flights as the fit takes them: what a log may hold of time, voltage and temperature."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from factories import generic_pack

from uavbatt.battery.model import Array
from uavbatt.cli.diagnose_records import observed_of
from uavbatt.errors import NotEnoughData
from uavbatt.fitting.observed import HELD_WINDOW_S, ObservedRecord, after_step, from_flight, held_load, stack
from uavbatt.records import Flight, Sample
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight
from uavbatt.telemetry import read_log

ROWS = 60


def written(folder: Path, temp_C: Array) -> ObservedRecord:
    """A flight of ROWS rows a second apart with such temperatures, read from its table."""
    rows = [f"{k},{16.4 - 0.01 * k:.2f},15,{temp_C[k]}" for k in range(ROWS)]
    path = folder / "flight.csv"
    path.write_text("\n".join(["time_s,voltage_V,current_A,temp_C", *rows, ""]))
    return from_flight(read_log(path), 4, 5.0)


@pytest.mark.parametrize("everywhere_C", [298.15, 1e9, 0.0, 55.0], ids=["kelvin", "damaged", "not set", "of a board"])
def test_a_temperature_that_no_cell_has_is_not_measured(tmp_path: Path, everywhere_C: float) -> None:
    assert np.isnan(written(tmp_path, np.full(ROWS, everywhere_C)).temp_C).all()


def test_a_diagnosis_takes_a_sensor_that_begins_hot_as_it_is(tmp_path: Path) -> None:
    """A pack at 36 °C under a sensor that reads 8 K too much was taken for a board: its offset had no name."""
    written(tmp_path, np.linspace(44.0, 55.0, ROWS))
    flown = read_log(tmp_path / "flight.csv")
    assert np.isfinite(observed_of(flown, 4, 5.0).temp_C).all()
    assert np.isnan(from_flight(flown, 4, 5.0).temp_C).all()


@pytest.mark.parametrize("once_C", [1e9, 655.35, -273.0, 60.0])
def test_a_row_with_an_impossible_temperature_costs_that_row_alone(tmp_path: Path, once_C: float) -> None:
    temp_C = np.linspace(25.0, 31.0, ROWS)
    read = written(tmp_path, np.where(np.arange(ROWS) == 30, once_C, temp_C)).temp_C
    assert np.isnan(read[30]) and np.allclose(np.delete(read, 30), np.delete(temp_C, 30))


@pytest.mark.parametrize(("volts", "lost_s"), [(0.05, 5.0), (2.0, 3.0), (60.0, 2.0), (4.0, 1.0)])
def test_the_rows_of_a_lost_voltmeter_are_not_compared(volts: float, lost_s: float) -> None:
    """A dropout of five seconds was an effect without a name to a diagnosis."""
    flown = tuple(simulate_flight(generic_pack(), SimulatedFlight(300.0, rate_Hz=2.0)))
    is_lost = [300.0 < sample.time_s <= 300.0 + lost_s for sample in flown]
    samples = tuple(replace(s, voltage_V=volts) if lost else s for s, lost in zip(flown, is_lost, strict=True))
    found = from_flight(Flight("a.csv", "csv", samples), 4, 5.0)
    kept = [sample.time_s for sample, lost in zip(flown, is_lost, strict=True) if not lost]
    assert set(found.time_s) <= set(kept)
    assert len(kept) - found.time_s.size <= 1  # the first row after it may be doubted


def test_a_spike_of_the_current_is_not_compared_and_a_late_climb_is() -> None:
    flown = tuple(simulate_flight(generic_pack(), SimulatedFlight(300.0, rate_Hz=2.0)))
    size = (4, 5.0)

    def compared(amps: float) -> int:
        samples = tuple(replace(s, current_A=amps) if 300.0 < s.time_s <= 303.0 else s for s in flown)
        return from_flight(Flight("a.csv", "csv", samples), *size).time_s.size

    assert [compared(amps) for amps in (400.0, 100.0, 40.0)] == [len(flown) - 6, len(flown) - 6, len(flown)]


def test_of_the_rest_after_the_landing_only_the_first_minute_is_compared() -> None:
    """Ten minutes of recovery bent the curve of a fit: half of 20 healthy packs were told to have an effect."""
    loads_A = [0.5] * 100 + [20.0] * 300 + [0.5] * 90 + [20.0] * 60 + [0.5] * 600  # a wait, a flight, a hop, a rest
    samples = tuple(Sample(float(t), 16.0 - 0.001 * t, amps, 25.0) for t, amps in enumerate(loads_A))
    assert from_flight(Flight("a.csv", "csv", samples), 4, 5.0).time_s[[0, -1]].tolist() == [0.0, 549.0 + 60.0]
    on_the_bench = tuple(replace(sample, current_A=0.5) for sample in samples)
    assert from_flight(Flight("a.csv", "csv", on_the_bench), 4, 5.0).time_s.size == len(samples)


@pytest.mark.parametrize(("step_s", "found"), [(0.1, 1), (0.8, 2)])
def test_rows_within_too_few_steps_are_said_to_be_too_few(tmp_path: Path, step_s: float, found: int) -> None:
    rows = [f"{step_s * k:.1f},{16.4 - 0.01 * k:.2f},20" for k in range(12)]
    (tmp_path / "short.csv").write_text("\n".join(["time_s,voltage_V,current_A", *rows, ""]))
    record = from_flight(read_log(tmp_path / "short.csv"), 4, 5.0)
    with pytest.raises(NotEnoughData, match=f"rows within {found} x 5 s: expected at least 3 x 5 s"):
        stack([record])


def test_slow_rows_of_one_time_are_their_mean(tmp_path: Path) -> None:
    rows = [f"{6 * k},{16.4 - 0.01 * k:.2f},15" for k in range(20)]
    doubled = [*rows[:10], "54,16.51,17", *rows[10:]]
    (tmp_path / "doubled.csv").write_text("\n".join(["time_s,voltage_V,current_A", *doubled, ""]))
    record = from_flight(read_log(tmp_path / "doubled.csv"), 4, 5.0)
    assert record.time_s.size == 20
    assert (record.voltage_V[9], record.current_A[9]) == (pytest.approx(16.41), pytest.approx(16.0))
    assert np.isfinite(stack([record]).slope_Vps).all()


def test_a_held_load_is_the_mean_of_what_is_near_in_time_and_value() -> None:
    """Two roads: the rule as it stands in the docstring, row against row."""
    dice = np.random.default_rng(1)
    time_s = np.cumsum(dice.uniform(0.1, 4.0, 300))
    current_A = np.round(5.0 + 3.0 * (time_s % 100.0 > 50.0) + 0.05 * dice.standard_normal(300), 2)
    scatter = 1.4826 * np.median(np.abs(np.diff(current_A))) / np.sqrt(2.0)
    near = np.abs(time_s[:, None] - time_s) <= HELD_WINDOW_S
    alike = np.abs(current_A[:, None] - current_A) <= 5.0 * scatter
    expected_A = [np.mean(current_A[those]) for those in near & alike]
    assert held_load(time_s, current_A) == pytest.approx(expected_A, abs=1e-12)


def stepped_bench(apart_s: float, ambient_C: float = 25.0) -> ObservedRecord:
    """A bench that loads the pack after 60 s and steps the load every two minutes, read every `apart_s` [s]."""
    time_s = np.arange(0.0, 900.0, apart_s)
    current_A = np.where(time_s < 60.0, 0.0, np.where((time_s // 120.0) % 2 == 0, 20.0, 12.0))
    flat = np.full(time_s.size, 15.0)
    return ObservedRecord("bench", time_s, flat, current_A, flat, ambient_C, 4, 5.0)


def test_slow_rows_that_follow_a_step_of_the_bench_are_not_compared() -> None:
    """At a step a voltage shows R0 alone or with the polarisation: a fit to such rows found R0 a fifth too small."""
    record = stepped_bench(10.0)
    bench = stack([record])
    left_out = sorted(set(record.time_s) - set(bench.time_s[bench.compare[:, 0], 0]))
    assert left_out == [60.0, 120.0, 240.0, 360.0, 480.0, 600.0, 720.0, 840.0]


@pytest.mark.parametrize(
    "record",
    [stepped_bench(5.0), stepped_bench(10.0, ambient_C=float("nan")), stepped_bench(60.0)],
    ids=["every 5 s", "a flight", "half of the rows follow a step"],
)
def test_all_other_rows_are_compared(record: ObservedRecord) -> None:
    bench = stack([record])
    assert np.array_equal(bench.time_s[bench.compare[:, 0], 0], record.time_s)


def bench(current_A: Array, temp_C: Array) -> ObservedRecord:
    """A test with a row each minute."""
    time_s = 60.0 * np.arange(current_A.size)
    return ObservedRecord("test", time_s, 16.0 - time_s / 1000.0, current_A, temp_C, 25.0, 4, 5.0)


def test_the_scatter_of_an_ammeter_in_slow_rows_is_no_step_of_the_load() -> None:
    """Noise of 5 % took rows out of every run, each at another minute, and no run of four was left whole."""
    noise = np.random.default_rng(3).standard_normal(22)
    load_A = np.concatenate([[0.0], 13.0 + 0.65 * noise])
    assert np.flatnonzero(after_step(bench(load_A, np.full(23, 25.0)))).tolist() == [1]


def test_the_start_of_a_test_in_slow_rows_is_as_cold_as_its_first_row() -> None:
    """The median of eight rows a minute apart was 4 K warmer than the pack that had just been loaded."""
    warming_C = 25.0 + 1.2 * np.arange(23.0)
    assert stack([bench(np.full(23, 13.0), warming_C)]).start_temp_C[0] == pytest.approx(25.0, abs=0.1)
