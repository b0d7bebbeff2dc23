"""Which rows of a replay are in the air: those under load, and those whose current was lost on the way.

A sensor that dies in the air ends no flight. A row without a current that can be believed goes on with the flight as
long as the vehicle says that it is armed; where it does not say, until the voltage is back above what it was under the
last load: a pack that lands recovers, one that flies on only falls.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.model import Array
from uavbatt.estimation.monitor import DEAD_CURRENT, STUCK_CURRENT
from uavbatt.log_replay.run import ReplayedRow
from uavbatt.telemetry.drawn import loaded_A

DOUBTED = {DEAD_CURRENT, STUCK_CURRENT}
LOADED_TAU_S = 10.0


class InAir(NamedTuple):
    """InAir holds the rows of a replay that are in the air, and those of them that have lost their current.

    current_A : of each row [A], infinite where it was lost in the air: any load is possible there.
    loaded_A : a row with more is under load [A].
    """

    flying: NDArray[np.bool_]
    lost: NDArray[np.bool_]
    current_A: Array
    loaded_A: float

    @property
    def lost_at_end(self) -> NDArray[np.intp]:
        """Return the rows without their current with which the flight ends; empty if it ends with a known load."""
        sound = np.flatnonzero(self.flying & ~self.lost)
        lost = np.flatnonzero(self.lost)
        return lost[lost > sound[-1]] if sound.size else lost


def in_air(run: Sequence[ReplayedRow]) -> InAir:
    """Return which rows of a replay are in the air; of a log without any current none is."""
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
        elif math.isfinite(level_s) and (math.isnan(amps[k]) or not DOUBTED.isdisjoint(row.estimate.warnings)):
            lost[k] = volts <= level_V if row.armed is None else row.armed
    return InAir(loaded | lost, lost, np.where(lost, math.inf, amps), least_A)
