"""Rows of a flight that a failed sensor wrote: a fit leaves them out and says so, as a forecast refuses them.

The rules are those of a flight (`estimation.sensor_faults`), but no battery file is known yet: the rise of the voltage
that a smaller load must bring is that of half a new cell's resistance.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from uavbatt.battery.initial_state import IDLE_C_RATE
from uavbatt.estimation.sensor_faults import DEAD_CURRENT, STUCK_CURRENT, STUCK_VOLTAGE, TWO_BATTERIES, SensorFaults
from uavbatt.estimation.sensor_row import SensorRow
from uavbatt.estimation.still_sensors import STILL_C_RATE
from uavbatt.fitting.prior import RESISTANCE_OHMAH
from uavbatt.notice import Kind, Notice
from uavbatt.records import Flight, Sample

LEAST_OHMAH = RESISTANCE_OHMAH / 2.0
# A voltage has frozen once it should have changed so many times since its last change. In flight that is too few to
# refuse a number. A coarse voltmeter, too, changes in up to half of the rows, and then not for a minute.
MISSED_CHANGES, OFTEN = 8.0, 0.55
FROZEN = Notice("the voltage stood still under load: a frozen sensor?", Kind.STUCK_VOLTAGE)


class FailedSpan(NamedTuple):
    """FailedSpan holds the times [s] after and up to which a sensor wrote no true readings, and why it is doubted."""

    after_s: float
    until_s: float
    reason: str

    def holds(self, sample: Sample) -> bool:
        """Return True if the row lies in the span."""
        return self.after_s < sample.time_s <= self.until_s


def without_failed(flight: Flight, cells: int, capacity_Ah: float) -> tuple[Flight, tuple[FailedSpan, ...]]:
    """Return the flight without the rows of a failed voltage or current sensor, and the spans that are left out.

    cells : in series; capacity_Ah : of the pack [Ah]
    """
    spans = failed_spans(flight.samples, cells, capacity_Ah)
    sound = tuple(s for s in flight.samples if not any(span.holds(s) for span in spans))
    return replace(flight, samples=sound), spans


def failed_spans(samples: tuple[Sample, ...], cells: int, capacity_Ah: float) -> tuple[FailedSpan, ...]:
    """Return the spans, in order of time, in which a reading stood still, the current was gone, or two batteries sent.

    A span within another one is not named again.
    """
    faults, found = SensorFaults(), dict[tuple[float, str], FailedSpan]()
    for row in samples:
        if not (math.isfinite(row.voltage_V) and math.isfinite(row.current_A)) or row.time_s < faults.changes.time_s:
            continue
        recent = faults.load.recent
        risen_V = recent.voltage_V + cells * LEAST_OHMAH * (recent.current_A - row.current_A) / capacity_Ah
        faults = faults.after(
            SensorRow(row.time_s, row.voltage_V, row.current_A, risen_V, cells, capacity_Ah, row.armed)
        )
        begins_s = {
            FROZEN: faults.changes.voltage.since_s,
            STUCK_VOLTAGE: faults.changes.voltage.since_s,
            STUCK_CURRENT: faults.changes.current.since_s,
            TWO_BATTERIES: faults.two.since_s,
        }
        if row.current_A < STILL_C_RATE * capacity_Ah:
            begins_s[DEAD_CURRENT] = faults.load.recent.time_s
        reasons = set(faults.refusals)
        if STUCK_VOLTAGE not in reasons and _is_frozen(faults, row.current_A / capacity_Ah):
            reasons.add(FROZEN)
        for reason in begins_s.keys() & reasons:
            found[begins_s[reason], reason] = FailedSpan(begins_s[reason], row.time_s, reason)
    spans = sorted(found.values(), key=lambda span: (span.after_s, -span.until_s))
    return tuple(s for i, s in enumerate(spans) if all(s.until_s > other.until_s for other in spans[:i]))


def _is_frozen(faults: SensorFaults, rate_c: float) -> bool:
    """Return True if the voltage has not changed for many rows under a load [1/h] although it does so often."""
    voltage = faults.changes.voltage
    return rate_c >= IDLE_C_RATE and voltage.habit >= OFTEN and voltage.missed >= MISSED_CHANGES
