"""A flight recorded by aircraft and by ground station is one flight, whatever the clocks, rates and digits."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from factories import generic_pack

from uavbatt.records import NAN, Flight, Sample
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight
from uavbatt.telemetry import read_log
from uavbatt.telemetry.recorded_twice import without_second_recordings


@cache
def flown(seed: int) -> Flight:
    """A flight with the noise of its seed, ten rows a second for two minutes after the rest."""
    rows = simulate_flight(generic_pack(), SimulatedFlight(300.0, rate_Hz=10.0, seed=seed), lands_s=150.0)
    return Flight(source=f"aircraft{seed}.BIN", kind="dataflash", samples=tuple(rows))


def as_station(flight: Flight, rate_Hz: float, source: str = "station.tlog", late_s: float = 0.7) -> Flight:
    """The rows that a link brings down: a part of them, late by a changing time, with digits cut off, another clock."""
    random, rows = np.random.default_rng(7), list[Sample]()
    for sample in flight.samples[:: round(10.0 / rate_Hz)]:
        time_s = 5000.0 + sample.time_s + late_s + 0.3 * random.random()
        voltage_V, current_A = (
            math.floor(1000.0 * sample.voltage_V) / 1000.0,
            math.floor(100.0 * sample.current_A) / 100.0,
        )
        rows.append(replace(sample, time_s=time_s, voltage_V=voltage_V, current_A=current_A))
    return replace(flight, source=source, kind="tlog", samples=tuple(sorted(rows, key=lambda row: row.time_s)))


def left_out(*flights: Flight) -> list[tuple[str, str]]:
    return [(second.source, first.source) for second, first in without_second_recordings(flights)[1]]


@pytest.mark.parametrize("rate_Hz", [10.0, 2.0, 1.0, 0.5])
def test_the_record_of_the_link_is_found_at_every_rate(rate_Hz: float) -> None:
    aircraft = flown(1)
    assert left_out(aircraft, as_station(aircraft, rate_Hz)) == [("station.tlog", "aircraft1.BIN")]


def test_a_clock_that_is_set_in_flight_hides_no_second_recording() -> None:
    """The station learns the date after a quarter of the flight: its clock leaps by half a century."""
    aircraft, station = flown(1), as_station(flown(1), 2.0)
    rows = station.samples
    leapt = [replace(row, time_s=row.time_s + 1.7e9) for row in rows[len(rows) // 4 :]]
    station = replace(station, samples=(*rows[: len(rows) // 4], *leapt))
    assert left_out(station, aircraft) == [("station.tlog", "aircraft1.BIN")]


def test_two_flights_of_one_power_are_two() -> None:
    assert left_out(flown(1), flown(2), as_station(flown(3), 2.0)) == []


def test_each_of_several_recordings_is_known_and_the_order_stays() -> None:
    one, two = flown(1), flown(2)
    files = [as_station(two, 2.0, "b.tlog"), one, as_station(one, 1.0, "a.tlog"), two, as_station(two, 1.0, "c.tlog")]
    kept, second = without_second_recordings(files)
    assert [flight.source for flight in kept] == ["aircraft1.BIN", "aircraft2.BIN"]
    assert {(a.source, b.source) for a, b in second} == {
        ("b.tlog", "aircraft2.BIN"), ("a.tlog", "aircraft1.BIN"), ("c.tlog", "aircraft2.BIN")
    }  # fmt: skip


def test_the_recording_that_covers_more_of_the_flight_is_kept() -> None:
    """The aircraft's own log began when it was armed: the station has seen the pack at rest before."""
    whole = flown(1)
    armed = replace(whole, samples=whole.samples[450:])
    assert left_out(armed, as_station(whole, 2.0)) == [("aircraft1.BIN", "station.tlog")]


def test_one_decimal_is_enough_for_a_copy_and_no_reason_to_confuse_two_flights() -> None:
    def coarse(flight: Flight, source: str) -> Flight:
        rows = [replace(s, voltage_V=round(s.voltage_V, 1), current_A=round(s.current_A, 1)) for s in flight.samples]
        return replace(flight, source=source, samples=tuple(rows))

    one, two = flown(1), flown(2)
    assert left_out(coarse(one, "x.csv"), coarse(two, "y.csv")) == []
    assert left_out(coarse(one, "x.csv"), coarse(one, "copy.csv")) == [("copy.csv", "x.csv")]


def test_flights_without_a_current_or_without_rows_are_left_alone() -> None:
    bare = replace(flown(1), samples=tuple(replace(s, current_A=NAN) for s in flown(1).samples))
    empty = replace(flown(1), samples=())
    assert left_out(bare, bare, empty, empty) == []


def test_the_real_flights_in_two_formats_are_found_and_no_other_pair(shared_data: Path) -> None:
    names = [log.stem for log in sorted((shared_data / "flights/m100").glob("m100_*.csv"))]
    paths = [shared_data / f"flights/{place}{name}.{kind}" for name in names
             for place, kind in (("m100/", "csv"), ("m100_routes/", "tlog"))]  # fmt: skip
    flights = [read_log(path) for path in paths]
    kept, second = without_second_recordings(flights)
    assert len(kept) == len(names)
    assert all(Path(a.source).stem == Path(b.source).stem for a, b in second)
    assert all(flight.navigation for flight in kept)  # of a table and a .tlog the one that tells the route


def test_flights_of_one_aircraft_over_one_route_are_different_flights(shared_data: Path) -> None:
    flights = [read_log(path) for path in sorted((shared_data / "missions/learn").glob("*.tlog"))]
    assert len(list(combinations(flights, 2))) > 10
    assert left_out(*flights) == []
