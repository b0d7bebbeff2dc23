"""Sensors that fail silently: a reading that stands still although it must move, a current that falls alone."""

from __future__ import annotations

import math
from typing import NamedTuple

STUCK_S, REFUSED_STUCK_S = 30.0, 60.0
# The voltage of a cell falls by at least LEAST_FALL_V per unit of charge. A voltage is stuck if it has not moved
# although it must have fallen by three of its own smallest steps and by 10 mV.
LEAST_FALL_V, STUCK_STEPS, STUCK_V = 0.15, 3.0, 0.01
COARSEST_STEP_V = 0.1  # assumed for a voltmeter that has not shown its smallest step yet
# A voltmeter of such steps, seen so often, shows the knee of an emptying pack too late.
COARSE_CELL_V, COARSE_CHANGES = 0.1, 8
# If the voltage of a cell has gone down and up by this much several times, the current must have changed.
TURN_CELL_V, TURNS = 0.012, 6
# A current is stuck if it should have changed this many times since its last change. The expected number follows from
# the share of rows in which it usually changes (`habit`, over about a hundred rows). On the ground, below a tenth of
# 1 C, a constant current is normal.
MISSED_MOVES, STILL_C_RATE, HABIT_KEPT = 15.0, 0.1, 0.99
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
ROSE_CELL_V, ROSE_S, ROSE_LATE_S, ROSE_TAU_S, ROSE_LOADED_S, STAYED_SHARE = 0.045, 3.0, 10.0, 5.0, 30.0, 0.8


class LastChange(NamedTuple):
    """LastChange follows one reading since its last change.

    value : the reading; since_s : the time of its last change [s]; rows : since that change; step : its smallest change
    so far; habit : the share of rows in which it changed; changes : how often it changed.
    """

    value: float = math.nan
    since_s: float = math.nan
    step: float = math.inf
    rows: int = 0
    habit: float = 0.0
    changes: int = 0

    def after(self, time_s: float, value: float) -> LastChange:
        """Return the same with one more reading."""
        if value == self.value:
            return self._replace(rows=self.rows + 1)
        change = abs(value - self.value)
        step = min(self.step, change) if math.isfinite(change) else self.step
        habit = HABIT_KEPT ** (self.rows + 1) * self.habit + (1.0 - HABIT_KEPT)
        return LastChange(value, time_s, step, 0, habit, self.changes + 1)

    def age_s(self, time_s: float) -> float:
        """Return the time since its last change [s]; 0 before the first reading."""
        return time_s - self.since_s if math.isfinite(self.since_s) else 0.0


class SensorChanges(NamedTuple):
    """SensorChanges follows voltage and current since their last changes, drawn charge, and turns of the voltage."""

    time_s: float = math.nan
    voltage: LastChange = LastChange()
    current: LastChange = LastChange()
    drawn_Ah: float = 0.0  # since the voltage last moved
    turn_V: float = math.nan  # highest while it rises, lowest while it falls
    is_rising: bool = False
    turns: int = 0  # since the current last moved

    def after(self, time_s: float, voltage_V: float, current_A: float, cells: float) -> SensorChanges:
        """Return the same with one more row."""
        dt_s = max(time_s - self.time_s, 0.0) if math.isfinite(self.time_s) else 0.0
        voltage, current = self.voltage.after(time_s, voltage_V), self.current.after(time_s, current_A)
        drawn_Ah = self.drawn_Ah + max(current_A, 0.0) * dt_s / 3600.0 if voltage.rows else 0.0
        turn_V, is_rising, turns = self.turn_V, self.is_rising, self.turns if current.rows else 0
        step_V = voltage_V - turn_V if math.isfinite(turn_V) else 0.0
        if (step_V > 0.0) is is_rising:
            turn_V = voltage_V
        elif abs(step_V) > TURN_CELL_V * cells:
            turn_V, is_rising, turns = voltage_V, not is_rising, turns + 1
        return SensorChanges(time_s, voltage, current, drawn_Ah, turn_V, is_rising, turns)

    def is_coarse(self, cells: float) -> bool:
        """Return True if the voltage is read in steps that are too large to see the end of a flight."""
        return self.voltage.changes >= COARSE_CHANGES and self.voltage.step >= COARSE_CELL_V * cells

    def stuck_voltage_s(self, cells: float, capacity_Ah: float) -> float:
        """Return how long the voltage is constant although the charge drawn must have moved it [s]; 0 if sound."""
        step_V = min(self.voltage.step, COARSEST_STEP_V)
        must_V = LEAST_FALL_V * cells * self.drawn_Ah / capacity_Ah
        return self.voltage.age_s(self.time_s) if must_V > max(STUCK_STEPS * step_V, STUCK_V) else 0.0

    def stuck_current_s(self, capacity_Ah: float) -> float:
        """Return how long the current has been constant against its habit or the voltage's turns [s]; 0 if sound."""
        missed = self.current.rows * self.current.habit if self.current.value > STILL_C_RATE * capacity_Ah else 0.0
        is_stuck = self.turns >= TURNS or missed >= MISSED_MOVES
        return self.current.age_s(self.time_s) if is_stuck else 0.0


class LoadWatch(NamedTuple):
    """LoadWatch notices a current that falls far while the voltage stays low.

    voltage_V and current_A are means over the last seconds of sound rows.
    """

    time_s: float = math.nan
    voltage_V: float = math.nan
    current_A: float = math.nan
    fell_s: float = math.nan  # time at which the current fell [s]
    expected_rise_V: float = -math.inf  # the rise of the voltage that the model expects of the smaller load, so far
    gone_since_s: float = math.nan  # NaN while the sensor is sound

    def after(
        self, time_s: float, voltage_V: float, current_A: float, predicted_V: float, cells: float, capacity_Ah: float
    ) -> LoadWatch:
        """Return the watch after one more row, whose voltage the model predicts as `predicted_V` [V]."""
        if not math.isfinite(self.current_A):
            return LoadWatch(time_s, voltage_V, current_A)
        if self.current_A < LOADED_C_RATE * capacity_Ah or current_A > FALLEN_SHARE * self.current_A:
            keep = math.exp(-max(time_s - self.time_s, 0.0) / RECENT_TAU_S)
            return LoadWatch(
                time_s,
                voltage_V + keep * (self.voltage_V - voltage_V),
                current_A + keep * (self.current_A - current_A),
            )
        # The model sees a block of rows at once, so that its rise is whole only after a second or two.
        fell_s = self.fell_s if math.isfinite(self.fell_s) else time_s
        expected_rise_V = max(self.expected_rise_V, predicted_V - self.voltage_V)
        has_risen = voltage_V - self.voltage_V > RECOVERED_SHARE * expected_rise_V
        is_gone = expected_rise_V > LEAST_RISE_CELL_V * cells and not has_risen
        if not is_gone and time_s - fell_s >= DEAD_S:
            return LoadWatch(time_s, voltage_V, current_A)
        since_s = self.gone_since_s if math.isfinite(self.gone_since_s) else time_s
        return self._replace(
            fell_s=fell_s, expected_rise_V=expected_rise_V, gone_since_s=since_s if is_gone else math.nan
        )


class FallWatch(NamedTuple):
    """FallWatch notices a voltage that falls at once under a load that stays: the wire of the voltmeter, or a cell.

    voltage_V and current_A are means over the last seconds of sound rows.
    """

    time_s: float = math.nan
    voltage_V: float = math.nan
    current_A: float = math.nan
    fallen_since_s: float = math.nan  # NaN while the voltage fits the load

    def after(
        self, time_s: float, voltage_V: float, current_A: float, predicted_V: float, cells: float, capacity_Ah: float
    ) -> FallWatch:
        """Return the watch after one more row, whose voltage the model predicts as `predicted_V` [V]."""
        least_V, fell_V = ALONE_CELL_V * cells, self.voltage_V - voltage_V
        has_fallen, is_loaded = math.isfinite(self.fallen_since_s), current_A > LOADED_C_RATE * capacity_Ah
        is_settled = time_s - self.fallen_since_s > FELL_TAU_S
        is_alone = is_loaded and (is_settled or current_A - self.current_A < ALONE_C_RATE * capacity_Ah)
        if has_fallen and is_alone and fell_V > RETURNED_SHARE * least_V:
            return self
        if is_alone and min(fell_V, predicted_V - voltage_V) > least_V and not has_fallen:
            return self._replace(fallen_since_s=time_s)
        if has_fallen or not math.isfinite(fell_V):
            return FallWatch(time_s, voltage_V, current_A)
        keep = math.exp(-max(time_s - self.time_s, 0.0) / FELL_TAU_S)
        return FallWatch(
            time_s, voltage_V + keep * (self.voltage_V - voltage_V), current_A + keep * (self.current_A - current_A)
        )


class RiseWatch(NamedTuple):
    """RiseWatch notices a voltage that rises at once under a load that stays: its meter has moved, not the pack.

    voltage_V, above_V and current_A are means over the last seconds of sound rows: the voltage, how far it was above
    the model's, and the current. What has risen for ROSE_S remains so for this pack, unless the current follows.
    """

    time_s: float = math.nan
    voltage_V: float = math.nan
    above_V: float = math.nan
    current_A: float = math.nan
    loaded_s: float = 0.0
    risen_since_s: float = math.nan  # NaN while the voltage fits the load

    def after(
        self, time_s: float, voltage_V: float, current_A: float, predicted_V: float, cells: float, capacity_Ah: float
    ) -> RiseWatch:
        """Return the watch after one more row, whose voltage the model predicts as `predicted_V` [V]."""
        above_V, passed_s, risen_s = voltage_V - predicted_V, time_s - self.time_s, time_s - self.risen_since_s
        if risen_s > ROSE_LATE_S:
            return self
        rise_V = min(voltage_V - self.voltage_V, above_V - self.above_V)
        is_loaded = current_A > LOADED_C_RATE * capacity_Ah
        stays = is_loaded and current_A > STAYED_SHARE * self.current_A
        least_V = ROSE_CELL_V * cells * (RETURNED_SHARE if math.isfinite(risen_s) else 1.0)
        if stays and (risen_s >= ROSE_S or (rise_V > least_V and self.loaded_s > ROSE_LOADED_S)):
            return self if math.isfinite(risen_s) else self._replace(risen_since_s=time_s)
        if not passed_s < ROSE_S:
            return RiseWatch(time_s, voltage_V, above_V, current_A)
        keep, loaded_s = math.exp(-max(passed_s, 0.0) / ROSE_TAU_S), self.loaded_s + passed_s if is_loaded else 0.0
        return RiseWatch(
            time_s,
            voltage_V + keep * (self.voltage_V - voltage_V),
            above_V + keep * (self.above_V - above_V),
            current_A + keep * (self.current_A - current_A),
            loaded_s,
        )
