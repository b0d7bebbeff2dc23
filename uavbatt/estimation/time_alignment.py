"""Alignment of voltage and current in telemetry that reports one of them later than the other.

With the effect `current_delay` a row holds the voltage of now and the current of `delay_s` ago (negative: the other
way round). The late quantity cannot be known earlier, so the early one is held back until the late one comes. So no row
depends on a later one.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import replace

from uavbatt.records import NAN, Sample


class Skew:
    """Skew gives each sample voltage and current of one instant, from a memory of the rows before.

    delay_s : that of the effect `current_delay` [s], not 0.
    """

    def __init__(self, delay_s: float) -> None:
        self.delay_s = delay_s
        self._time_s: list[float] = []
        self._held: list[float] = []

    def paired(self, sample: Sample) -> Sample:
        """Return the sample with its earlier quantity `delay_s` old, interpolated between the rows.

        A row that is not later than the last has no partner: without voltage it is left out by the filter.
        """
        if self._time_s and sample.time_s <= self._time_s[-1]:
            return replace(sample, voltage_V=NAN)
        current_is_late = self.delay_s > 0.0
        self._time_s.append(sample.time_s)
        self._held.append(sample.voltage_V if current_is_late else sample.current_A)
        at_s = sample.time_s - abs(self.delay_s)
        right = bisect_right(self._time_s, at_s)
        held = self._held[0]
        if right > 0:
            self._time_s, self._held = self._time_s[right - 1 :], self._held[right - 1 :]
            share = (at_s - self._time_s[0]) / (self._time_s[1] - self._time_s[0])
            held = self._held[0] + share * (self._held[1] - self._held[0])
        return replace(sample, voltage_V=held) if current_is_late else replace(sample, current_A=held)
