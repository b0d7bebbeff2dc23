"""When "turn back now" is said: at a risk of 5 %, later where the interval is that of an untested make."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from factories import generic_pack
from route_rig import HOME, SETTINGS, mission, to

from uavbatt.battery import battery_file
from uavbatt.battery.remembered import PackHealth
from uavbatt.battery.sizing import PackOptions
from uavbatt.estimator import Estimator
from uavbatt.navigation import Mode, Navigation, Position
from uavbatt.notice import Kind, kind_of
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.route_path import METRES_PER_DEGREE
from uavbatt.records import Estimate, Remaining, Sample
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight

FAR_M = 1000.0
HEALTH = PackHealth(math.log(0.004), math.log(5.0), np.diag([0.1**2, 0.03**2]), cells=4)


def waiting(time_s: float) -> Navigation:
    """An aircraft that waits FAR_M north of home for longer than its pack lasts."""
    place = Position(time_s, HOME.lat_deg + FAR_M / METRES_PER_DEGREE, HOME.lon_deg, 60.0, 0.0, 0.0, 0.0)
    return Navigation(
        time_s=time_s,
        mode=Mode.MISSION,
        mission=mission(to(1, FAR_M, 0.0, 60.0, hold_s=5000.0)),
        current=1,
        current_since_s=0.0,
        current_heard_s=time_s,
        home=HOME,
        settings=SETTINGS,
        position=place,
    )


@cache
def rows() -> tuple[Sample, ...]:
    """A flight under 350 W until the pack is empty."""
    return tuple(simulate_flight(generic_pack(), SimulatedFlight(350.0, rate_Hz=0.2)))


@cache
def flown(battery: str, is_remembered: bool = False) -> tuple[tuple[Estimate, Remaining], ...]:
    """What is said along the flight, with the pack's type by this file."""
    pack, settings = PackOptions(cells=4, capacity_Ah=5.0, cutoff_V=13.2), ForecastSettings(forecast_period_s=15.0)
    health = HEALTH if is_remembered else None
    estimator = Estimator(battery_file.read_battery(battery), pack, settings, remembered=health)
    return tuple(estimator.run(rows(), waiting))


@pytest.mark.parametrize(
    ("battery", "is_remembered", "is_later"),
    [("lipo-generic", False, True), ("lipo-generic", True, False), ("lpab-3s", False, False)],
)
def test_a_make_that_nobody_tested_is_called_home_later_than_its_worst_case(
    battery: str, is_remembered: bool, is_later: bool
) -> None:
    routes = [said.route for _, said in flown(battery, is_remembered) if said.route is not None]
    known = [route for route in routes if 0.0 < route.turn_back_lo_s < route.turn_back_s]
    assert known
    for route in known:
        assert route.turn_back_lo_s <= route.turn_back_alarm_s <= route.turn_back_s
        assert (route.turn_back_alarm_s > route.turn_back_lo_s) is is_later


def test_the_warning_names_its_risk() -> None:
    told = [e.warnings for e, _ in flown("lipo-generic")] + [e.warnings for e, _ in flown("lpab-3s")]
    words = {str(warning) for row in told for warning in row if kind_of(warning) is Kind.TURN_BACK}
    assert {word.rsplit(" ", 2)[1] for word in words} == {"17.5", "5"}


def test_the_alarm_counts_down_with_the_turn_back() -> None:
    route = next(s.route for _, s in flown("lipo-generic") if s.route is not None and s.route.turn_back_lo_s > 10.0)
    later = route.later(4.0)
    assert later.turn_back_alarm_s == pytest.approx(route.turn_back_alarm_s - 4.0)
    assert replace(route, turn_back_lo_s=0.0).must_turn_back_now is False
    assert route.later(1e4).must_turn_back_now
