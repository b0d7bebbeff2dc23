"""The curves of a battery over its charge in one array, so that a forecast's step looks all of them up at once."""

from __future__ import annotations

import numpy as np

from uavbatt.battery import equations as eq
from uavbatt.battery.model import GRID_STEP, LOWEST_SOC, Array
from uavbatt.battery.scaling import Pack


def curve_tables(pack: Pack) -> Array:
    """Return `ocv_V`, `r0_ohmAh` and `ocv_drift_sd_V` of a pack as [left end or rise, curve, segment of SOC_GRID].

    A segment is added at each end of the grid: there the open-circuit voltage goes straight on, the others are flat.
    """
    curves = np.stack([pack.cell.ocv_V, pack.cell.r0_ohmAh, pack.ocv_drift_sd_V])
    goes_on = np.array([[1.0], [0.0], [0.0]])
    below, above = goes_on * (curves[:, 1:2] - curves[:, :1]), goes_on * (curves[:, -1:] - curves[:, -2:-1])
    nodes = np.concatenate([curves[:, :1] - below, curves, curves[:, -1:] + above], axis=1)
    return np.stack([nodes[:, :-1], np.diff(nodes)])


def looked_up(tables: Array, soc: Array) -> Array:
    """Return the values of the curves in `tables` (`curve_tables`) at a charge [batch], as [curve, batch]."""
    index, share = eq.segment(soc, LOWEST_SOC - GRID_STEP, GRID_STEP, tables.shape[2])
    found = np.asarray(tables.take(index, axis=2))
    return np.asarray(found[0] + found[1] * share)
