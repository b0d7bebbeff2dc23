"""Cells that charge to 4.35 V ("LiHV"): modelled as an ordinary cell with more charge above its full voltage."""

from __future__ import annotations

import numpy as np

from uavbatt.battery.model import Array

ORDINARY_FULL_V = 4.25  # an ordinary cell never rests above this
SLOPE_AT_FULL_V = 1.0  # of the open-circuit voltage per unit of charge


def fullest_cell_V(rested_V: float, cells: int) -> float:
    """Return the voltage at which a full cell of a pack rests [V], to 10 mV; ORDINARY_FULL_V for ordinary cells.

    rested_V : the highest voltage of the pack before its first load [V], NaN if none was seen.
    """
    cell_V = rested_V / cells
    return round(cell_V, 2) if cell_V > ORDINARY_FULL_V else ORDINARY_FULL_V


def ocv_of_fuller(soc: Array, ordinary_V: Array, fullest_V: float) -> Array:
    """Return the open-circuit voltage [V] at `soc` of cells that have rested at `fullest_V` [V] and no higher.

    Above ORDINARY_FULL_V the ordinary curve is stretched, OCV(soc · (1 + more)), so that a full cell rests there.

    soc, ordinary_V : the knots of the ordinary curve, from empty to full; fullest_V : NaN is an ordinary cell's.
    """
    if not fullest_V > ORDINARY_FULL_V:
        return ordinary_V
    stretched = soc * (1.0 + (fullest_V - ordinary_V[-1]) / SLOPE_AT_FULL_V)
    beyond = np.maximum(stretched - 1.0, 0.0)
    return np.asarray(np.interp(stretched, soc, ordinary_V) + SLOPE_AT_FULL_V * beyond)
