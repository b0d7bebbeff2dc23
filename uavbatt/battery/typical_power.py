"""The power that a typical multirotor draws from a pack, by its size alone.

Hovers of 12 to 30 minutes draw 2 to 4 C.
"""

from __future__ import annotations

TYPICAL_C_RATE, TYPICAL_CELL_V = 2.5, 3.8  # a hover of 24 minutes; mean voltage of a cell on the way


def typical_power_W(cells: int, capacity_Ah: float) -> float:
    """Return the power [W] that a typical multirotor draws from a pack of `cells` in series and `capacity_Ah` [Ah]."""
    return TYPICAL_C_RATE * capacity_Ah * cells * TYPICAL_CELL_V
