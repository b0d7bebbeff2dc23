"""The rows of a replay that are in the air: rows under load, and rows after the current sensor failed in flight.

A sensor that fails in the air does not end the flight. Rows without a usable current belong to the flight while the
vehicle says that it is armed. If it does not say so, they belong to it until the voltage rises above its value under
the last load: the voltage of a landed pack recovers, and that of a flying pack falls.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.model import Array
from uavbatt.log_replay.run import ReplayedRow
from uavbatt.notice import Kind, kind_of
from uavbatt.scoring.end_of_flight import end_of_flight
from uavbatt.telemetry.quality.drawn import loaded_A

DOUBTED = {Kind.DEAD_CURRENT, Kind.STUCK_CURRENT}
LOADED_TAU_S = 10.0


class InAir(NamedTuple):
    """InAir holds the rows of a replay that are in the air, and those of them without a usable current.

    current_A : of each row [A], infinite if it was lost in the air, where any load is possible
    loaded_A : current above which a row is under load [A]
    """

    flying: NDArray[np.bool_]
    lost: NDArray[np.bool_]
    current_A: Array
    loaded_A: float

    @property
    def lost_at_end(self) -> NDArray[np.intp]:
        """Return the rows without current at the end of the flight; empty if it ends with a known load."""
        sound = np.flatnonzero(self.flying & ~self.lost)
        lost = np.flatnonzero(self.lost)
        return lost[lost > sound[-1]] if sound.size else lost


def in_air(run: Sequence[ReplayedRow]) -> InAir:
    """Return which rows of a replay are in the air; none of them if the log has no current."""
    amps = np.array([s.estimate.current_A for s in run])
    least_A = loaded_A(amps)
    loaded = np.nan_to_num(amps) > least_A
    lost = np.zeros(len(run), bool)
    level_V, level_s = math.nan, math.nan  # of the voltage under the last load
    for k, row in enumerate(run):
        time_s, volts = row.estimate.time_s, row.estimate.voltage_V
        if loaded[k]:
            keep = math.exp(-(time_s - level_s) / LOADED_TAU_S) if math.isfinite(level_V) else 0.0
            level_V = volts + keep * (level_V - volts) if keep and math.isfinite(volts) else volts
            level_s = time_s
        elif math.isfinite(level_s) and (math.isnan(amps[k]) or _is_current_doubted(row)):
            lost[k] = volts <= level_V if row.armed is None else row.armed
    return InAir(loaded | lost, lost, np.where(lost, math.inf, amps), least_A)


def first_below_s(time_s: Array, voltage_V: Array, air: InAir, limit_V: float) -> float:
    """Return when the voltage under load first falls below a limit [s], by the rule for the end of a flight; else NaN.

    time_s, voltage_V : of each row; limit_V : of the pack [V]. Without a current every row may be under load.
    """
    if not math.isfinite(air.loaded_A):
        return end_of_flight(time_s, voltage_V, cutoff_V=limit_V)
    return end_of_flight(time_s, voltage_V, air.current_A, cutoff_V=limit_V, min_current_A=air.loaded_A)


def _is_current_doubted(row: ReplayedRow) -> bool:
    """Return True if the monitor doubts the current of this row (stuck or dead sensor)."""
    return any(kind_of(warning) in DOUBTED for warning in row.estimate.warnings)
