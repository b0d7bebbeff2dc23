"""Recordings of the companion process describe themselves, so that a replay of one gives the same forecasts.

A recording begins with a PARAM_VALUE that never travelled: of the companion's component, PERIOD_NAME, the seconds
between two forecasts. Other logs have none.
"""

from __future__ import annotations

from uavbatt.mavlink import fields
from uavbatt.records import NAN
from uavbatt.telemetry.formats.tlog_frames import frames
from uavbatt.telemetry.formats.tlog_payloads import parameters

PERIOD_NAME = "UAVB_FORECAST_S"
HEAD_BYTES = 16_384


def is_recording(data: bytes | memoryview) -> bool:
    """Return True if a log is a recording of the companion process: its stamps come from a monotonic clock."""
    return PERIOD_NAME.encode() in bytes(data[:HEAD_BYTES])


def forecast_period_s(data: bytes | memoryview) -> float:
    """Return the time between forecasts [s] in the process that wrote a recording; NaN when it does not say."""
    if not is_recording(data):
        return NAN
    said = frames(bytes(data[:HEAD_BYTES])).of(fields.PARAM_VALUE)
    found = (value for name, value in parameters(said, [False] * len(said.start)) if name == PERIOD_NAME)
    return next((value for value in found if value > 0.0), NAN)
