"""A replay as forecast lines: columns over the rows of a flight, NaN where refused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from peers.columns import FloatArray

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.estimator import Estimator
from uavbatt.log_replay.run import ReplayedRow, steps
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.load.scenarios import LoggedLoad
from uavbatt.records import Flight
from uavbatt.scoring.scores import FlightScore, score_flight


@dataclass(frozen=True, slots=True)
class Lines:
    """Lines holds the time left [s] by row; `lo_s` and `hi_s` are None for a method without an interval."""

    time_s: FloatArray
    remaining_s: FloatArray
    lo_s: FloatArray | None = None
    hi_s: FloatArray | None = None
    alarm_s: FloatArray | None = None

    def scored(self, name: str, group: str, start_s: float, end_s: float) -> FlightScore:
        """Return the scores of these lines against the end."""
        return score_flight(
            name,
            self.time_s,
            self.remaining_s,
            self.lo_s,
            self.hi_s,
            end_s=end_s,
            start_s=start_s,
            group=group,
            alarm_remaining_s=self.alarm_s,
        )


def replayed(
    flight: Flight, battery: BatteryFile, options: PackOptions, settings: ForecastSettings | None = None
) -> list[ReplayedRow]:
    """Replay every row of the flight through a fresh estimator."""
    return list(steps(flight, Estimator(battery, options, settings)))


def ours(run: Sequence[ReplayedRow]) -> Lines:
    """Return the forecast lines of a replay; the alarm looks at the time that is undercut at its stated risk."""
    said = [s.remaining for s in run]
    return Lines(
        time_s=np.array([r.time_s for r in said]),
        remaining_s=np.array([r.remaining_s for r in said]),
        lo_s=np.array([r.remaining_lo_s for r in said]),
        hi_s=np.array([r.remaining_hi_s for r in said]),
        alarm_s=np.array([r.remaining_alarm_s for r in said]),
    )


def logged(flight: Flight) -> LoggedLoad:
    """Return the flight's own later power (`--load log`): it tests the battery alone."""
    rows = [s for s in flight.samples if np.isfinite(s.voltage_V) and np.isfinite(s.current_A)]
    return LoggedLoad(np.array([s.time_s for s in rows]), np.array([max(s.voltage_V * s.current_A, 0.0) for s in rows]))
