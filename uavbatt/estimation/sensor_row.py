"""One row of the sensors of a pack, as the watches over them take it in."""

from __future__ import annotations

from typing import NamedTuple


class SensorRow(NamedTuple):
    """SensorRow holds a row with voltage and current, the voltage that is expected of it, and the size of the pack.

    time_s [s]; voltage_V, predicted_V [V]; current_A [A]; cells in series; capacity_Ah [Ah]; armed: None if unknown
    """

    time_s: float
    voltage_V: float
    current_A: float
    predicted_V: float
    cells: float
    capacity_Ah: float
    armed: bool | None = None
