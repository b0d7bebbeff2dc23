"""What a recording of the companion process says of itself, so that a replay of it gives the same forecasts.

A recording begins with a PARAM_VALUE that never travelled: of the companion's component, PERIOD_NAME, the seconds
between two forecasts. Other logs have none.
"""

from __future__ import annotations

from pathlib import Path

from uavbatt.mavlink import fields
from uavbatt.records import NAN
from uavbatt.telemetry.tlog_frames import decoder, frames

PERIOD_NAME = "UAVB_FORECAST_S"
HEAD_BYTES = 16_384


def forecast_period_s(path: str | Path) -> float:
    """Seconds between forecasts in the process that wrote the recording `path`; NaN when it does not say."""
    with Path(path).open("rb") as file:
        head = file.read(HEAD_BYTES)
    if PERIOD_NAME.encode() not in head:
        return NAN
    for _, frame in frames(head, frozenset((fields.PARAM_VALUE,)), decoder()):
        if frame is not None and frame.message and frame.message_id == fields.PARAM_VALUE:
            name, value = fields.parameter(frame.message, is_px4=False)
            if name == PERIOD_NAME and value > 0.0:
                return value
    return NAN
