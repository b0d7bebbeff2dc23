"""Readings that stand still although they must move, and readings in steps that are too coarse."""

from __future__ import annotations

import math
from typing import NamedTuple

from uavbatt.estimation.sensor_row import SensorRow
from uavbatt.limits import GROUNDED_C_RATE

STUCK_S, REFUSED_STUCK_S = 30.0, 60.0
# The voltage of a cell falls by at least LEAST_FALL_V per unit of charge. A voltage is stuck if it has not moved
# although it must have fallen by three of its own smallest steps and by 10 mV.
LEAST_FALL_V, STUCK_STEPS, STUCK_V = 0.15, 3.0, 0.01
COARSEST_STEP_V = 0.1  # assumed for a voltmeter that has not shown its smallest step yet
# A voltmeter of such steps, seen so often, shows the knee of an emptying pack too late.
COARSE_CELL_V, COARSE_CHANGES = 0.1, 5
# If the voltage of a cell has gone down and up by this much several times, the current must have changed. A voltmeter
# that reads between two of its steps shows now one, now the other: that is no turn.
TURN_CELL_V, TURN_STEPS, TURNS = 0.012, 1.5, 6
# A current is stuck if it should have changed this many times since its last change. The expected number follows from
# the share of rows in which it usually changes (`habit`, over about a hundred rows). Below a tenth of 1 C a constant
# current is normal, and so is that of the avionics which began after the motors were disarmed. In the air it is normal,
# too, if the steps are more than COARSE_SHARE of the current: now the load lies between two of them, now it does not.
MISSED_MOVES, STILL_C_RATE, HABIT_KEPT, COARSE_SHARE = 15.0, 0.1, 0.99, 0.1


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

    @property
    def missed(self) -> float:
        """Return how many changes should have come since its last one."""
        return self.rows * self.habit

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
    moved_armed: bool | None = None  # whether the motors were armed when the current last moved

    def after(self, row: SensorRow) -> SensorChanges:
        """Return the same with one more row."""
        time_s, voltage_V, current_A = row[:3]
        dt_s = max(time_s - self.time_s, 0.0) if math.isfinite(self.time_s) else 0.0
        voltage, current = self.voltage.after(time_s, voltage_V), self.current.after(time_s, current_A)
        drawn_Ah = self.drawn_Ah + max(current_A, 0.0) * dt_s / 3600.0 if voltage.rows else 0.0
        turn_V, is_rising, turns = self.turn_V, self.is_rising, self.turns if current.rows else 0
        step_V = voltage_V - turn_V if math.isfinite(turn_V) else 0.0
        if (step_V > 0.0) is is_rising:
            turn_V = voltage_V
        elif abs(step_V) > max(TURN_CELL_V * row.cells, TURN_STEPS * voltage.step):
            turn_V, is_rising, turns = voltage_V, not is_rising, turns + 1
        moved_armed = self.moved_armed if current.rows else row.armed
        return SensorChanges(time_s, voltage, current, drawn_Ah, turn_V, is_rising, turns, moved_armed)

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
        least_C = GROUNDED_C_RATE if self.moved_armed is False else STILL_C_RATE
        least_A = max(least_C * capacity_Ah, self.current.step / COARSE_SHARE)
        missed = self.current.missed if self.current.value > least_A else 0.0
        is_stuck = self.turns >= TURNS or missed >= MISSED_MOVES
        return self.current.age_s(self.time_s) if is_stuck else 0.0
