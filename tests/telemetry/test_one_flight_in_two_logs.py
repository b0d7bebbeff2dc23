"""The same flight as a table and as a .tlog gives the same numbers, but for what only one of the two says.

A .tlog also knows the route, from which comes the load to come, and MAVLink rounds currents to 10 mA. That is all: with
the table's currents rounded the numbers are equal; without, they differ by a small part of their own uncertainty.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import takewhile
from pathlib import Path

import pytest

from uavbatt.battery import battery_file
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.estimator import Estimator
from uavbatt.log_replay.run import ReplayedRow, engine_for, steps
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.records import NAN, Flight
from uavbatt.telemetry import read_log

CUTOFF_V = 21.6
PACK = PackOptions(cells=6, capacity_Ah=5.7, cutoff_V=CUTOFF_V)
EVERY_30_S = ForecastSettings(forecast_period_s=30.0)


def bare(flight: Flight) -> Flight:
    """The flight with its volts, amperes and temperatures alone."""
    samples = tuple(replace(s, consumed_Ah=NAN, armed=None) for s in flight.samples)
    return replace(flight, samples=samples, navigation=(), facts=())


def replayed(flight: Flight) -> list[ReplayedRow]:
    generic = battery_file.read_battery("lipo-generic")
    return list(steps(flight, Estimator(generic, PACK, EVERY_30_S, engine_for(is_long=True))))


@pytest.fixture(params=["m100_001_752", "m100_009_794", "m100_038_752"])
def both(request: pytest.FixtureRequest, shared_data: Path) -> tuple[Flight, Flight]:
    """The table and the telemetry of one flight; the first two begin in the air."""
    table = read_log(shared_data / f"flights/m100/{request.param}.csv")
    return bare(table), bare(read_log(shared_data / f"flights/m100_routes/{request.param}.tlog"))


def test_equal_rows_give_equal_numbers(both: tuple[Flight, Flight]) -> None:
    table, telemetry = both
    pairs = list(zip(table.samples, telemetry.samples, strict=True))
    assert all(abs(one.current_A - other.current_A) < 0.0051 for one, other in pairs)
    rounded = replace(table, samples=tuple(replace(one, current_A=other.current_A) for one, other in pairs))
    for one, other in zip(replayed(rounded), replayed(telemetry), strict=True):
        assert one.estimate.soc == pytest.approx(other.estimate.soc, abs=1e-6)
        for key in ("remaining_s", "remaining_lo_s", "remaining_hi_s"):
            assert getattr(one.remaining, key) == pytest.approx(getattr(other.remaining, key), abs=0.01, nan_ok=True)


def test_what_is_rounded_is_a_small_part_of_what_is_not_known(both: tuple[Flight, Flight]) -> None:
    """Up to the end of flight: below the cut-off a battery of another make is at its wits' end, by 10 mA or without."""
    rows = zip(*map(replayed, both), strict=True)
    for one, other in takewhile(lambda pair: not pair[0].estimate.voltage_V < CUTOFF_V, rows):
        assert one.estimate.soc == pytest.approx(other.estimate.soc, abs=1e-3 + 0.1 * one.estimate.soc_sd)
        said, heard = one.remaining, other.remaining
        width_s = said.remaining_hi_s - said.remaining_lo_s
        assert math.isnan(width_s) or abs(said.remaining_s - heard.remaining_s) < 0.5 + 0.05 * width_s
