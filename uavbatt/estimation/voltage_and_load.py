"""Voltage and current that do not move together: a current that falls alone, a voltage that falls or rises alone."""

from __future__ import annotations

import math
from typing import NamedTuple

from uavbatt.estimation.sensor_row import SensorRow
from uavbatt.limits import is_answered

LOADED_C_RATE = 0.4
# A current that falls below FALLEN_SHARE of its recent mean must let the voltage rise. A voltage that is read a moment
# later than the current, or smoothed by the autopilot, follows within half a second or at the next row.
FALLEN_SHARE, RECOVERED_SHARE, LEAST_RISE_CELL_V, RECENT_TAU_S = 0.4, 0.25, 0.02, 10.0
DOUBTED_S, DEAD_S = 0.5, 3.0
# A cell that falls by ALONE_CELL_V within seconds, while the current does not rise by ALONE_C_RATE, is no discharge: a
# cold, worn cell needs a larger rise, too. A current that is reported late rises within FELL_TAU_S.
ALONE_CELL_V, ALONE_C_RATE, ALONE_S, FELL_TAU_S, RETURNED_SHARE = 0.4, 1.0, 1.0, 3.0, 0.5
# A cell does not rise by ROSE_CELL_V for ROSE_S while the current stays: over 259 logs of flights none rose by 0.03 V.
# A current that is reported late falls within ROSE_LATE_S.
# The rise must be larger than ROSE_SCATTERS times the usual distance of a row from the mean, for a noisy voltmeter.
ROSE_CELL_V, ROSE_S, ROSE_LATE_S, ROSE_TAU_S, ROSE_LOADED_S, STAYED_SHARE = 0.045, 3.0, 10.0, 15.0, 30.0, 0.8
ROSE_SCATTERS, SCATTER_TAU_S = 5.0, 30.0


class Recent(NamedTuple):
    """Recent holds means over the last seconds of sound rows; NaN before the first.

    time_s : of the last row [s]; above_V : how far the voltage was above the expected one [V].
    """

    time_s: float = math.nan
    voltage_V: float = math.nan
    above_V: float = math.nan
    current_A: float = math.nan

    def after(self, row: SensorRow, tau_s: float) -> Recent:
        """Return the means after one more row, over about `tau_s` [s]."""
        above_V = row.voltage_V - row.predicted_V
        if not math.isfinite(self.time_s):
            return Recent(row.time_s, row.voltage_V, above_V, row.current_A)
        keep = math.exp(-max(row.time_s - self.time_s, 0.0) / tau_s)
        return Recent(
            row.time_s,
            row.voltage_V + keep * (self.voltage_V - row.voltage_V),
            above_V + keep * (self.above_V - above_V),
            row.current_A + keep * (self.current_A - row.current_A),
        )


class LoadWatch(NamedTuple):
    """LoadWatch notices a current that falls far while the voltage stays low."""

    recent: Recent = Recent()
    fell_s: float = math.nan  # time at which the current fell [s]
    expected_rise_V: float = -math.inf  # the rise of the voltage that the model expects of the smaller load, so far
    gone_since_s: float = math.nan  # NaN while the sensor is sound

    def after(self, row: SensorRow) -> LoadWatch:
        """Return the watch after one more row."""
        usual_A = self.recent.current_A
        is_far_more, more_C = row.current_A * FALLEN_SHARE > usual_A, (row.current_A - usual_A) / row.capacity_Ah
        if is_far_more and not is_answered(more_C, row.voltage_V, self.recent.voltage_V):
            return self  # what the voltage does not show is no load, and its end is no failure
        if not usual_A >= LOADED_C_RATE * row.capacity_Ah or row.current_A > FALLEN_SHARE * usual_A:
            return LoadWatch(self.recent.after(row, RECENT_TAU_S))
        # The model sees a block of rows at once, so that its rise is whole only after a second or two.
        fell_s = self.fell_s if math.isfinite(self.fell_s) else row.time_s
        expected_rise_V = max(self.expected_rise_V, row.predicted_V - self.recent.voltage_V)
        has_risen = row.voltage_V - self.recent.voltage_V > RECOVERED_SHARE * expected_rise_V
        is_gone = expected_rise_V > LEAST_RISE_CELL_V * row.cells and not has_risen
        if not is_gone and row.time_s - fell_s >= DEAD_S:
            return LoadWatch(Recent().after(row, RECENT_TAU_S))
        since_s = self.gone_since_s if math.isfinite(self.gone_since_s) else row.time_s
        return LoadWatch(self.recent, fell_s, expected_rise_V, since_s if is_gone else math.nan)


class FallWatch(NamedTuple):
    """FallWatch notices a voltage that falls at once under a load that stays: the wire of the voltmeter, or a cell."""

    recent: Recent = Recent()
    fallen_since_s: float = math.nan  # NaN while the voltage fits the load

    def after(self, row: SensorRow) -> FallWatch:
        """Return the watch after one more row."""
        least_V, fell_V = ALONE_CELL_V * row.cells, self.recent.voltage_V - row.voltage_V
        has_fallen, is_settled = math.isfinite(self.fallen_since_s), row.time_s - self.fallen_since_s > FELL_TAU_S
        stays = is_settled or row.current_A - self.recent.current_A < ALONE_C_RATE * row.capacity_Ah
        is_alone = row.current_A > LOADED_C_RATE * row.capacity_Ah and stays
        if has_fallen and is_alone and fell_V > RETURNED_SHARE * least_V:
            return self
        if is_alone and min(fell_V, row.predicted_V - row.voltage_V) > least_V and not has_fallen:
            return FallWatch(self.recent, row.time_s)
        return FallWatch((Recent() if has_fallen else self.recent).after(row, FELL_TAU_S))


class RiseWatch(NamedTuple):
    """RiseWatch notices a voltage that rises at once under a load that stays: its meter has moved, not the pack.

    What has risen for ROSE_LATE_S remains so for this pack: by then the current has not followed, as it would have in a
    load that eases, and the voltage has not gone back.
    """

    recent: Recent = Recent()
    scatter_V: float = 0.0  # mean distance of a row from the mean of those before it
    loaded_s: float = 0.0  # how long the load of a flight has lasted [s]
    risen_since_s: float = math.nan  # NaN while the voltage fits the load

    def after(self, row: SensorRow) -> RiseWatch:
        """Return the watch after one more row."""
        recent, risen_s, passed_s = self.recent, row.time_s - self.risen_since_s, row.time_s - self.recent.time_s
        if risen_s > ROSE_LATE_S:
            return self
        off_V = row.voltage_V - row.predicted_V - recent.above_V
        rise_V = min(row.voltage_V - recent.voltage_V, off_V)
        least_V, has_risen = max(ROSE_CELL_V * row.cells, ROSE_SCATTERS * self.scatter_V), math.isfinite(risen_s)
        is_loaded = row.current_A > LOADED_C_RATE * row.capacity_Ah
        if risen_s >= ROSE_S and self._has_gone_back(row, RETURNED_SHARE * least_V):  # it may move again at once
            return RiseWatch(Recent().after(row, ROSE_TAU_S), self.scatter_V, self.loaded_s)
        stays = is_loaded and (row.current_A > STAYED_SHARE * recent.current_A or (has_risen and off_V > least_V))
        least_V *= RETURNED_SHARE if has_risen else 1.0
        if stays and (risen_s >= ROSE_S or (rise_V > least_V and self.loaded_s > ROSE_LOADED_S)):
            return self if has_risen else self._replace(risen_since_s=row.time_s)
        if not passed_s < ROSE_S:  # rows that are far apart tell no sudden rise
            return RiseWatch(Recent().after(row, ROSE_TAU_S))
        if off_V < -least_V:  # a row far below the others must not make those after it look risen
            return self._replace(risen_since_s=math.nan)
        scatter_V = self.scatter_V + (abs(off_V) - self.scatter_V) * min(max(passed_s, 0.0) / SCATTER_TAU_S, 1.0)
        loaded_s = self.loaded_s + passed_s if is_loaded else 0.0
        return RiseWatch(recent.after(row, ROSE_TAU_S), scatter_V, loaded_s)

    def _has_gone_back(self, row: SensorRow, within_V: float) -> bool:
        """Return True if the voltage is again within `within_V` [V] of that before the rise, at no larger current."""
        is_low = row.voltage_V - self.recent.voltage_V < within_V
        return is_low and row.current_A < self.recent.current_A / STAYED_SHARE
