"""A pack that is flown three times without being charged: what a forecast says does not count the waits in between."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from cases import first_quick
from factories import generic_pack

from uavbatt.battery import battery_file
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.diagnosis.close import remaining
from uavbatt.estimator import Estimator
from uavbatt.log_replay.load_options import stated_load
from uavbatt.log_replay.outcome import outcome
from uavbatt.log_replay.run import steps
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.load.power_history import RecentLoad
from uavbatt.prediction.load.scenarios import FlightPoint, LoggedLoad
from uavbatt.prediction.load.waits import in_air_s, waits_of
from uavbatt.records import Flight, Sample
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight

FILE = battery_file.read_battery("lipo-generic")
OPTIONS = PackOptions(cells=4, capacity_Ah=5.0, cutoff_V=13.2)
WAITS_S = ((300.0, 900.0), (1100.0, 1300.0))


def on_the_ground(time_s: float) -> bool:
    return any(begin_s <= time_s < end_s for begin_s, end_s in WAITS_S)


@cache
def three_hops() -> Flight:
    """A flight of 300 W with two waits on the ground, disarmed, at 6 W."""
    rows = simulate_flight(
        generic_pack(), SimulatedFlight(300.0, rate_Hz=1.0), lambda time_s: 6.0 if on_the_ground(time_s) else 300.0
    )
    armed = (replace(row, armed=row.time_s >= 20.0 and not on_the_ground(row.time_s)) for row in rows)
    return Flight("hops", "tlog", tuple(armed))


def test_waits_are_the_stretches_that_wait_and_time_in_the_air_leaves_them_out() -> None:
    time_s = np.arange(10.0)
    is_waiting = np.isin(time_s, (0.0, 1.0, 4.0, 5.0, 9.0))
    waits = waits_of(time_s, is_waiting, ~is_waiting)
    assert waits == ((0.0, 2.0), (4.0, 6.0), (9.0, np.inf))
    assert in_air_s([0.0, 2.0, 3.0, 5.0, 8.0], 9.0, waits).tolist() == [5.0, 5.0, 4.0, 3.0, 1.0]
    assert in_air_s([1.0, 7.0], 9.0, ()).tolist() == [8.0, 2.0]


@pytest.mark.parametrize("row_s", [1.0, 10.0])
def test_a_logged_load_is_that_of_the_flights_without_the_waits(row_s: float) -> None:
    time_s = np.arange(0.0, 900.0, row_s)
    watts = np.where(time_s < 300.0, 200.0, 400.0)
    apart_s = np.where(time_s < 300.0, time_s, time_s + 600.0)
    rests_s = np.arange(300.0, 900.0, row_s)
    order = np.argsort(np.concatenate([apart_s, rests_s]))
    with_wait = LoggedLoad(
        np.concatenate([apart_s, rests_s])[order],
        np.concatenate([watts, np.full_like(rests_s, 5.0)])[order],
        waits=((300.0, 900.0),),
    )
    for flown_s, now_s in ((100.0, 100.0), (500.0, 1100.0)):
        found, expected = (
            load.scenarios(FlightPoint(at_s, at_s, 0.5, 200.0, RecentLoad()), 5.0, 200)
            for load, at_s in ((with_wait, now_s), (LoggedLoad(time_s, watts), flown_s))
        )
        assert found.power_W == pytest.approx(expected.power_W) and found.dt_s == pytest.approx(expected.dt_s)


@pytest.mark.parametrize("until_s", [600, 6000])
@pytest.mark.parametrize("armed", [True, False, None])
def test_a_logged_load_goes_on_as_the_flight_and_not_as_the_ground_after_it(armed: bool | None, until_s: int) -> None:
    """Five minutes of idling after the landing made 15 minutes of 8, whatever the vehicle says of its arming then."""
    rows = [Sample(float(k), 15.0, 20.0 if k < 300 else 0.5, armed=True if k < 300 else armed) for k in range(until_s)]
    load = stated_load("log", Flight("landed", "tlog", tuple(rows)), None)
    found = load.scenarios(FlightPoint(250.0, 250.0, 0.5, 300.0, RecentLoad()), 5.0, 200)
    assert found.power_W == pytest.approx(np.full((200, 1), 300.0))


@pytest.mark.parametrize("word", first_quick(1, ["recent", "log"]))
def test_the_forecasts_of_each_flight_are_right_by_the_time_in_the_air(word: str) -> None:
    flight = three_hops()
    load = stated_load(word, flight, None, FILE)
    run = list(steps(flight, Estimator(FILE, OPTIONS, ForecastSettings(load))))
    found = outcome(run, 13.2)
    truth = [c.before_end_s for c in found.checkpoints]
    assert truth == pytest.approx([found.left_s(20.0) / 2.0, 360.0, 240.0, 120.0, 60.0], abs=1.0)
    assert found.left_s(20.0) == pytest.approx(found.end_of_flight_s - 20.0 - 800.0, abs=2.0)
    assert found.air_s == pytest.approx(found.duration_s - 20.0 - 800.0, abs=2.0)
    assert all(c.inside and abs(c.error_s) < 0.25 * c.before_end_s + 30.0 for c in found.checkpoints)


def test_a_diagnosis_judges_the_flights_and_not_the_waits() -> None:
    errors, hits = remaining(three_hops(), FILE, OPTIONS)
    assert len(errors) > 8 and all(hits) and np.mean(errors) < 60.0
