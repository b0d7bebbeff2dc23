"""Faults of the sensors of one pack, with their words; a value that is replaced at each row."""

from __future__ import annotations

from itertools import compress
from typing import NamedTuple

from uavbatt.estimation.sensor_row import SensorRow
from uavbatt.estimation.still_sensors import REFUSED_STUCK_S, STUCK_S, SensorChanges
from uavbatt.estimation.two_batteries import TwoBatteries
from uavbatt.estimation.voltage_and_load import (
    ALONE_S,
    DEAD_S,
    DOUBTED_S,
    ROSE_LATE_S,
    ROSE_S,
    FallWatch,
    LoadWatch,
    RiseWatch,
)
from uavbatt.notice import Kind, Notice

STUCK_VOLTAGE = Notice("the voltage has not moved under load for half a minute: a stuck sensor?", Kind.STUCK_VOLTAGE)
STUCK_CURRENT = Notice(
    "the current has not moved for half a minute, as it does in flight: a stuck sensor?", Kind.STUCK_CURRENT
)
DEAD_CURRENT = Notice("the current fell and the voltage did not rise: a failed current sensor?", Kind.DEAD_CURRENT)
FELL_ALONE = Notice("the voltage fell at once and the load did not rise: a wire, or a cell?", Kind.FELL_ALONE)
ROSE_ALONE = Notice("the voltage rose at once and the load did not fall: a voltmeter that moved?", Kind.ROSE_ALONE)
TWO_BATTERIES = Notice(
    "the readings go back and forth between two levels: two batteries under one id?", Kind.TWO_BATTERIES
)
COARSE = Notice("the voltage is read in steps of 0.1 V a cell or more: too coarse to see the end", Kind.COARSE)


class SensorFaults(NamedTuple):
    """SensorFaults holds what the watches over the sensors have seen so far, and the faults that follow from it.

    doubts : words for a number that is shown with a warning; refusals : words for no number.
    """

    changes: SensorChanges = SensorChanges()
    load: LoadWatch = LoadWatch()
    fall: FallWatch = FallWatch()
    rise: RiseWatch = RiseWatch()
    two: TwoBatteries = TwoBatteries()
    doubts: tuple[Notice, ...] = ()
    refusals: tuple[Notice, ...] = ()

    def after(self, row: SensorRow) -> SensorFaults:
        """Return the same after one more row."""
        changes, two = self.changes.after(row), self.two.after(row)
        load, fall, rise = self.load.after(row), self.fall.after(row), self.rise.after(row)
        are_two = two.are_likely(row.time_s)
        voltage_s = changes.stuck_voltage_s(row.cells, row.capacity_Ah) if changes.voltage.rows else 0.0
        current_s = changes.stuck_current_s(row.capacity_Ah) if changes.current.rows else 0.0
        gone_s, risen_s = row.time_s - load.gone_since_s, row.time_s - rise.risen_since_s
        doubted = {
            TWO_BATTERIES: are_two,
            STUCK_VOLTAGE: voltage_s >= STUCK_S,
            STUCK_CURRENT: current_s >= STUCK_S,
            DEAD_CURRENT: gone_s >= DOUBTED_S,
            ROSE_ALONE: risen_s >= ROSE_S,
            FELL_ALONE: row.time_s - fall.fallen_since_s >= ALONE_S,
        }
        refused = {
            TWO_BATTERIES: are_two,
            COARSE: changes.is_coarse(row.cells),
            STUCK_VOLTAGE: voltage_s >= REFUSED_STUCK_S,
            STUCK_CURRENT: current_s >= REFUSED_STUCK_S,
            DEAD_CURRENT: gone_s >= DEAD_S,
            ROSE_ALONE: risen_s > ROSE_LATE_S,
        }
        doubts, refusals = compress(doubted, doubted.values()), compress(refused, refused.values())
        return SensorFaults(changes, load, fall, rise, two, tuple(doubts), tuple(refusals))

    def of_next_pack(self) -> SensorFaults:
        """Return what outlives a change of the pack: two batteries in turn look like one."""
        return SensorFaults(two=self.two)
