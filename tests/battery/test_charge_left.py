"""A test under a large load leaves charge in the cells: below the 0 of such a curve a pack still flies."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from uavbatt.battery import battery_file
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing.pack_size import PackOptions, pack_from
from uavbatt.battery.spreads import spread_of
from uavbatt.estimator import Estimator
from uavbatt.log_replay.run import engine_for
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.scoring.end_of_flight import end_of_flight
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight

STUDY = battery_file.read_battery("lpab-3s")


def ends_at(empty_V: float) -> BatteryFile:
    """The study's file with another open-circuit voltage at a charge of 0."""
    table = STUDY.parameters
    return msgspec.structs.replace(STUDY, parameters=msgspec.structs.replace(table, ocv_V=[empty_V, *table.ocv_V[1:]]))


def test_the_study_s_tests_leave_what_lies_between_their_end_and_an_emptied_cell() -> None:
    assert spread_of(STUDY).empty_soc_sd == pytest.approx((STUDY.parameters.ocv_V[0] - 3.3) / 4.0)  # it falls with 4 V


def test_the_open_circuit_voltage_of_the_study_s_pack_has_no_steps() -> None:
    """Nine mean readings once gave a curve that was flat, steep and flat again, which no cell has."""
    soc, ocv_V = np.array(STUDY.parameters.ocv_soc), np.array(STUDY.parameters.ocv_V)
    slope_V = np.diff(ocv_V) / np.diff(soc)
    assert (slope_V[soc[:-1] >= 0.05] > 0.25).all()


@pytest.mark.parametrize("empty_V", [2.9, 3.3])
def test_tests_that_emptied_the_cells_leave_nothing(empty_V: float) -> None:
    assert spread_of(ends_at(empty_V)).empty_soc_sd == 0.0


def test_a_mild_flight_of_the_study_s_pack_goes_on_below_the_end_of_its_tests() -> None:
    """At 120 W instead of the 300 W of the tests: a minute before its end "2 s, at most 3 s" was said, for a minute."""
    options = PackOptions(cells=3, capacity_Ah=5.0, cutoff_V=9.9)
    samples = list(simulate_flight(pack_from(STUDY, options), SimulatedFlight(120.0, 25.0, rate_Hz=1.0, seed=12)))
    time_s, voltage_V = np.array([(s.time_s, s.voltage_V) for s in samples]).T
    end_s = end_of_flight(time_s, voltage_V, cutoff_V=9.9)
    estimator = Estimator(STUDY, options, ForecastSettings(forecast_period_s=10.0), engine_for(is_long=True))
    said = {round(now.time_s): left for now, left in estimator.run(samples)}
    for before_s in (60.0, 30.0):
        left = said[round(end_s - before_s)]
        assert left.remaining_lo_s < before_s < left.remaining_hi_s
