"""Rows of a failed sensor are no evidence about a battery: a fit leaves them out, and names them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import called

from uavbatt.battery import battery_file
from uavbatt.battery.scaling import pack_of
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.estimation.sensor_faults import DEAD_CURRENT, STUCK_CURRENT, STUCK_VOLTAGE, TWO_BATTERIES
from uavbatt.fitting.battery import RecordedPack, fit_battery
from uavbatt.fitting.failed_sensors import FROZEN, failed_spans, without_failed
from uavbatt.fitting.vehicle import trace
from uavbatt.records import Flight, Sample
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight

CELLS, CAPACITY_AH, CUTOFF_V = 4, 5.0, 13.2
SIZE = ("--cells", "4", "--capacity-ah", "5")
GENERIC = battery_file.read_battery("lipo-generic")
FROM_S, UNTIL_S = 300.0, 400.0


@pytest.fixture(scope="module")
def samples() -> tuple[Sample, ...]:
    pack = pack_of(GENERIC, CELLS, CAPACITY_AH, CUTOFF_V, float("nan"))
    return tuple(simulate_flight(pack, SimulatedFlight(power_W=300.0, ambient_C=20.0, rate_Hz=1.0, seed=5)))


def within(samples: tuple[Sample, ...], **values: float) -> tuple[Sample, ...]:
    return tuple(replace(s, **values) if FROM_S < s.time_s <= UNTIL_S else s for s in samples)


def spans_of(samples: tuple[Sample, ...]) -> list[tuple[float, float, str]]:
    return [tuple(span) for span in failed_spans(samples, CELLS, CAPACITY_AH)]


def test_nothing_is_left_out_of_a_sound_flight(samples) -> None:
    assert spans_of(samples) == []


def test_a_landed_aircraft_has_no_failed_sensor(samples) -> None:
    """The current is gone for good, but the voltage has risen by half of what its resistance gives back."""
    flown = [s for s in samples if s.time_s <= UNTIL_S]
    landed = [replace(s, time_s=s.time_s + UNTIL_S, current_A=0.3, voltage_V=flown[-1].voltage_V + 0.2) for s in flown]
    assert spans_of((*flown, *landed[:200])) == []


@pytest.mark.parametrize("reading_A", [0.0, -1.0, 0.3])
def test_a_current_that_dies_in_flight_is_left_out_until_it_returns(samples, reading_A: float) -> None:
    assert spans_of(within(samples, current_A=reading_A)) == [(FROM_S, UNTIL_S, DEAD_CURRENT)]


def test_a_voltage_that_stands_still_is_left_out(samples) -> None:
    held_V = next(s.voltage_V for s in samples if s.time_s == FROM_S)
    assert spans_of(within(samples, voltage_V=held_V)) == [(FROM_S, UNTIL_S, STUCK_VOLTAGE)]


def test_a_voltage_that_freezes_for_seconds_is_left_out(samples) -> None:
    """Of 12 diagnoses of healthy packs with such logs 8 found an effect that nobody declared."""
    held_V = next(s.voltage_V for s in samples if s.time_s == FROM_S)
    frozen = tuple(replace(s, voltage_V=held_V) if FROM_S < s.time_s <= FROM_S + 20.0 else s for s in samples)
    assert spans_of(frozen) == [(FROM_S, FROM_S + 20.0, FROZEN)]
    avionics_A = 0.25 * CAPACITY_AH
    landed = [
        replace(samples[-1], time_s=samples[-1].time_s + k, current_A=avionics_A + 0.01 * (k % 3))
        for k in range(1, 100)
    ]
    rested = [replace(s, voltage_V=15.2 + 0.002 * min(k, 60)) for k, s in enumerate(landed)]
    assert spans_of((*samples, *rested)) == [], "under the avionics alone a voltage that has recovered stands still"


@pytest.mark.parametrize("digit_V", [0.05, 0.1, 0.5])
def test_a_coarse_voltmeter_has_not_frozen(samples, digit_V: float) -> None:
    """It reads now one step, now the next, and then one of them for minutes."""
    assert spans_of(tuple(replace(s, voltage_V=digit_V * round(s.voltage_V / digit_V)) for s in samples)) == []


def test_a_current_that_stands_still_is_left_out(samples) -> None:
    held_A = next(s.current_A for s in samples if s.time_s == FROM_S)
    assert spans_of(within(samples, current_A=held_A)) == [(FROM_S, UNTIL_S, STUCK_CURRENT)]


def test_the_rows_of_two_batteries_are_left_out(samples) -> None:
    """A payload's battery under the same id, in every second row."""
    other = within(samples, voltage_V=11.8, current_A=0.4)
    mixed = tuple(b if k % 2 else a for k, (a, b) in enumerate(zip(samples, other, strict=True)))
    ((after_s, until_s, reason),) = spans_of(mixed)
    assert reason == TWO_BATTERIES
    assert FROM_S - 30.0 <= after_s <= FROM_S and until_s >= UNTIL_S


def test_a_fit_without_the_rows_of_a_dead_sensor_is_that_of_a_sound_flight(samples) -> None:
    """With them the pack of a LiPo was taken for one of lithium-ion cells, 0.6 V lower when empty."""
    dead = Flight("dead.csv", "csv", within(samples, current_A=0.0))
    size = RecordedPack("quad", CELLS, CAPACITY_AH, CUTOFF_V)

    def curve_V(flight: Flight) -> np.ndarray:
        return np.array(fit_battery(size, [], [flight]).file.parameters.ocv_V)

    sound_V = curve_V(replace(dead, samples=samples))
    kept, _ = without_failed(dead, CELLS, CAPACITY_AH)
    assert np.max(np.abs(curve_V(kept) - sound_V)) < 0.02
    assert np.max(np.abs(curve_V(dead) - sound_V)) > 0.1


def test_the_load_of_an_aircraft_is_not_that_of_a_dead_sensor(samples) -> None:
    dead = Flight("dead.csv", "csv", within(samples, current_A=0.0))
    options = PackOptions(CELLS, CAPACITY_AH)
    kept, _ = without_failed(dead, CELLS, CAPACITY_AH)
    sound_W, kept_W, dead_W = (
        np.mean(trace(flight, GENERIC, options).power_W) for flight in (replace(dead, samples=samples), kept, dead)
    )
    assert kept_W == pytest.approx(sound_W, rel=0.02)
    assert dead_W < 0.9 * sound_W


def written(folder: Path, name: str, samples: tuple[Sample, ...]) -> None:
    rows = [f"{s.time_s},{s.voltage_V:.3f},{s.current_A:.2f}" for s in samples]
    (folder / name).write_text("\n".join(["time_s,voltage_V,current_A", *rows]))


def test_the_command_names_what_it_leaves_out(samples, tmp_path) -> None:
    written(tmp_path, "dead.csv", within(samples, current_A=0.0))
    call = ("fit", "dead.csv", "--battery", "lipo-generic", "--vehicle", "quad.vehicle.toml", *SIZE)
    done = called(*call, folder=tmp_path)
    assert done.stderr == f"warning: dead.csv: 300 to 400 s left out: {DEAD_CURRENT}\n"
    assert (tmp_path / "quad.vehicle.toml").exists()


def test_a_log_of_a_dead_sensor_alone_is_refused_by_name(samples, tmp_path) -> None:
    written(tmp_path, "stuck.csv", tuple(replace(s, voltage_V=15.4) for s in samples))
    done = called("fit", "stuck.csv", "-o", "quad.battery.toml", *SIZE, folder=tmp_path)
    assert done.returncode == 4
    assert str(STUCK_VOLTAGE) in done.stderr
    assert "stuck.csv: 1 row with voltage and current" in done.stderr
    assert not (tmp_path / "quad.battery.toml").exists()


def test_both_files_are_written_or_none(samples, tmp_path) -> None:
    """A minute of flight makes a battery file of few words, but no vehicle file."""
    written(tmp_path, "short.csv", samples[:80])
    done = called("fit", "short.csv", "-o", "q.battery.toml", "--vehicle", "q.vehicle.toml", *SIZE, folder=tmp_path)
    assert done.returncode == 4
    assert [p.name for p in tmp_path.iterdir()] == ["short.csv"]
