"""Rows of a flight that a failed sensor wrote: a fit leaves them out and says so, as a forecast refuses them.

The rules are those of a flight (`estimation.sensors`), but no battery file is known yet: the rise of the voltage that a
smaller load must bring is that of half a new cell's resistance.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from uavbatt.estimation.monitor import DEAD_CURRENT, STUCK_CURRENT, STUCK_VOLTAGE, TWO_BATTERIES
from uavbatt.estimation.sensors import DEAD_S, REFUSED_STUCK_S, STILL_C_RATE, LoadWatch, SensorChanges
from uavbatt.estimation.two_batteries import TwoBatteries
from uavbatt.fitting.prior import RESISTANCE_OHMAH
from uavbatt.records import Flight, Sample

LEAST_OHMAH = RESISTANCE_OHMAH / 2.0


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
    changes, load, two = SensorChanges(), LoadWatch(), TwoBatteries()
    found: dict[tuple[float, str], FailedSpan] = {}
    for row in samples:
        if not (math.isfinite(row.voltage_V) and math.isfinite(row.current_A)) or row.time_s < changes.time_s:
            continue
        changes = changes.after(row.time_s, row.voltage_V, row.current_A, cells)
        risen_V = load.voltage_V + cells * LEAST_OHMAH * (load.current_A - row.current_A) / capacity_Ah
        load = load.after(row.time_s, row.voltage_V, row.current_A, risen_V, cells, capacity_Ah)
        two = two.after(row.time_s, row.voltage_V, row.current_A, cells, capacity_Ah)
        is_idle = row.current_A < STILL_C_RATE * capacity_Ah
        for after_s, is_failing, reason in (
            (changes.voltage.since_s, changes.stuck_voltage_s(cells, capacity_Ah) >= REFUSED_STUCK_S, STUCK_VOLTAGE),
            (changes.current.since_s, changes.stuck_current_s(capacity_Ah) >= REFUSED_STUCK_S, STUCK_CURRENT),
            (load.time_s, is_idle and row.time_s - load.gone_since_s >= DEAD_S, DEAD_CURRENT),
            (two.since_s, two.are_likely(row.time_s), TWO_BATTERIES),
        ):
            if is_failing:
                found[after_s, reason] = FailedSpan(after_s, row.time_s, reason)
    spans = sorted(found.values(), key=lambda span: (span.after_s, -span.until_s))
    return tuple(s for i, s in enumerate(spans) if all(s.until_s > other.until_s for other in spans[:i]))
