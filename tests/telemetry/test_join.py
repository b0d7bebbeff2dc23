"""Two batteries of one aircraft as one pack: what the wires do to currents, voltages, charge and facts."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from factories import generic_pack

from uavbatt.battery import battery_file
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.errors import UsageError
from uavbatt.estimator import Estimator
from uavbatt.log_replay.run import engine_for, steps
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.records import NAN, Flight, Identity, PackFacts, Sample
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight
from uavbatt.telemetry.join import Wiring, joined, read_joined

EVERY_30_S = ForecastSettings(forecast_period_s=30.0)
HALF = PackFacts(cells_series=4, capacity_Ah=5.0, low_voltage_V=14.0, critical_voltage_V=13.2)


def battery(instance: int, *rows: Sample, facts: PackFacts = HALF) -> Flight:
    return Flight("two.csv", "csv", rows, instance, (0, 1), ((0.0, facts),))


def test_in_parallel_currents_add_and_the_voltage_is_one() -> None:
    one = battery(0, Sample(1.0, 16.0, 10.0, 20.0, 0.1, 0.9, True, (4.0, 4.0, 4.0, 4.0)))
    two = battery(1, Sample(0.5, 16.2, 8.0, 30.0, 0.2, 0.8, True, (4.1, 4.1, 3.9, 4.1)))
    pack = joined([one, two], Wiring.PARALLEL)
    row = pack.samples[0]
    assert (row.voltage_V, row.current_A, row.temp_C) == (pytest.approx(16.1), 18.0, 25.0)
    assert (row.consumed_Ah, row.reported_soc, row.armed) == (pytest.approx(0.3), pytest.approx(0.85), True)
    assert row.cell_voltages_V == (4.1, 4.1, 3.9, 4.1)  # of the pack with the weakest cell
    assert pack.facts_at(1.0) == replace(HALF, capacity_Ah=10.0)
    assert "batteries 0, 1 joined in parallel" in pack.notes


def test_the_joined_pack_has_the_name_of_all_its_packs() -> None:
    """Two packs in parallel were remembered under the serial of the first, which then held twice as much."""
    rows = [Sample(float(t), 16.0, 10.0) for t in (0, 100)]
    one, two = (
        replace(battery(k, *rows), identity=Identity(battery_serial=first), discharges=((100.0 + k, later),))
        for k, (first, later) in enumerate((("9", "7"), ("8", "")))
    )
    pack = joined([one, two], Wiring.PARALLEL)
    assert pack.identity.battery_serial == joined([two, one], Wiring.PARALLEL).identity.battery_serial == "8+9"
    assert pack.discharges == ((100.0, ""),)  # nothing tells the second of the later two


def test_in_series_voltages_add_and_the_current_is_one() -> None:
    one, two = battery(0, Sample(1.0, 16.0, 10.0)), battery(1, Sample(1.0, 15.5, 10.4))
    pack = joined([one, two], Wiring.SERIES)
    assert (pack.samples[0].voltage_V, pack.samples[0].current_A) == (31.5, pytest.approx(10.2))
    assert pack.facts_at(1.0) == PackFacts(8, 5.0, 28.0, 26.4)


@pytest.mark.parametrize("wiring", Wiring)
def test_a_battery_that_fell_silent_is_not_counted_on(wiring: Wiring) -> None:
    """Its last reading is not carried on: the pack's current (parallel) or voltage (series) is unknown."""
    one = battery(0, *(Sample(float(t), 16.0, 10.0) for t in range(20)))
    two = battery(1, *(Sample(float(t), 16.0, 8.0) for t in range(5)))
    late = joined([one, two], wiring).samples[-1]
    assert math.isnan(late.current_A if wiring is Wiring.PARALLEL else late.voltage_V)


def test_a_row_hangs_on_nothing_that_comes_later() -> None:
    one = battery(0, *(Sample(float(t), 16.0 - 0.01 * t, 10.0) for t in range(20)))
    two = battery(1, *(Sample(0.3 + t, 16.1, 8.0 + 0.1 * t) for t in range(20)))
    cut = [replace(f, samples=tuple(s for s in f.samples if s.time_s <= 11.5)) for f in (one, two)]
    whole = joined([one, two], Wiring.PARALLEL).samples
    assert repr(joined(cut, Wiring.PARALLEL).samples) == repr(whole[: len(cut[0].samples)])


def test_two_packs_last_as_long_as_one_of_their_size() -> None:
    """A flight on one 10 Ah pack, and the same flight told as two 5 Ah packs that share its current unevenly."""
    rows = simulate_flight(generic_pack(4, 10.0, 13.2, 14.0), SimulatedFlight(450.0, rate_Hz=0.5))
    shares = (0.55, 0.45)
    halves = [
        battery(i, *(replace(s, current_A=share * s.current_A, consumed_Ah=NAN) for s in rows))
        for i, share in enumerate(shares)
    ]
    generic, options = battery_file.read_battery("lipo-generic"), PackOptions(capacity_Ah=10.0, cells=4, cutoff_V=13.2)
    engine = engine_for(is_long=True)
    said = [
        [s.remaining.remaining_s for s in steps(flight, Estimator(generic, options, EVERY_30_S, engine))]
        for flight in (Flight("one", "csv", tuple(rows)), joined(halves, Wiring.PARALLEL))
    ]
    assert np.allclose(said[0], said[1], atol=2.0, rtol=0.0, equal_nan=True) and np.isfinite(said[0]).any()


def test_packs_of_different_voltage_are_not_in_parallel() -> None:
    with pytest.raises(UsageError, match=r"16\.0 V and 24\.0 V are not in parallel"):
        joined([battery(0, Sample(0.0, 16.0, 1.0)), battery(1, Sample(0.0, 24.0, 1.0))], Wiring.PARALLEL)


def test_one_battery_is_nothing_to_join(tmp_path: Path) -> None:
    log = tmp_path / "one.csv"
    log.write_text("time_s,voltage_V,current_A\n0,16,1\n1,16,9\n2,16,9\n")
    with pytest.raises(UsageError, match="nothing to join in parallel"):
        read_joined(log, Wiring.PARALLEL)
