"""A battery fitted to flights that end at a few C, and flown where they did not come: the knee is the prior's there."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from scoring.other_pack import LIHV, Pack, Power, flight

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.estimator import Estimator
from uavbatt.fitting.battery import RecordedPack, fit_battery
from uavbatt.log_replay.run import engine_for
from uavbatt.prediction.forecaster import ForecastSettings

CUTOFF_V = 13.6


@cache
def fitted() -> BatteryFile:
    """Four flights of healthy LiHV packs at 2.8 to 5 C, to 3.4 V a cell."""
    healthy = ((1.0, 1.0, 22.0, 260.0), (0.99, 1.04, 28.0, 310.0), (1.01, 0.96, 15.0, 360.0), (0.98, 1.05, 25.0, 210.0))
    flown = [
        flight(Pack(5.0 * share, resistance=ohms, make=LIHV, air_C=air_C), Power(watts), seed=100, cutoff_V=CUTOFF_V)
        for share, ohms, air_C, watts in healthy
    ]
    logs = [made.flight(f"{number}") for number, made in enumerate(flown)]
    return fit_battery(RecordedPack("LiHV", 4, 5.0, CUTOFF_V), [], logs).file


def test_the_open_circuit_voltage_falls_at_the_knee_as_that_of_other_cells() -> None:
    """It was flat between 2 and 5 % of the charge, 0.15 V a cell too high at 2 %."""
    table = fitted().parameters
    at_V = dict(zip(table.ocv_soc, table.ocv_V, strict=True))
    assert at_V[0.05] - at_V[0.02] > 0.08
    assert abs(at_V[0.02] - np.interp(0.02, (0.01, 0.03), (3.30, 3.50))) < 0.06


def test_a_slow_flight_that_empties_the_pack_deeper_is_not_said_too_long() -> None:
    """At 1 C the same cut-off leaves less charge: the lower end was up to 112 s too long over the last five minutes."""
    flown = flight(Pack(4.85, make=LIHV, resistance=1.05), Power(75.0), seed=7, seconds=7200, cutoff_V=CUTOFF_V)
    options = PackOptions(cells=4, capacity_Ah=5.0, cutoff_V=CUTOFF_V)
    estimator = Estimator(fitted(), options, ForecastSettings(forecast_period_s=20.0), engine_for(is_long=True))
    last = [(r, flown.end_s - r.time_s) for _, r in estimator.run(flown.rows) if flown.end_s - r.time_s < 300.0]
    shown = [(r, left_s) for r, left_s in last if math.isfinite(r.remaining_lo_s)]
    assert len(shown) > 200
    assert max(r.remaining_lo_s - left_s for r, left_s in shown) < 20.0
