"""Innovations of rows: how far a measured voltage is from the one that the belief expects.

A block of rows is held against the model itself when it closes. The rows within a block change neither belief nor
charge by much, so that they are held against the tangent of the model at the row that closed the last block.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uavbatt.battery import state_space as b
from uavbatt.battery.model import Array
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import Belief, X

# Steps of the slopes, of the pack's capacity: 0.5 C, about what a load in flight varies by, and the charge of a block
# at 2 C.
STEP_C_RATE, STEP_CHARGE = 0.5, 0.001


class Innovation(NamedTuple):
    """Innovation holds a row against the model: innovation [V], NIS (NaN within a block), expected voltage [V], soc."""

    innovation_V: float
    nis: float
    expected_V: float
    soc: float


class Tangent(NamedTuple):
    """Tangent holds what a belief expects at a current, and how that changes with the current and the charge drawn.

    current_A [A]; voltage_V [V]; soc; V_per_A [V/A]; V_per_As [V/(A s)]; soc_per_As [1/(A s)]
    """

    current_A: float
    voltage_V: float
    soc: float
    V_per_A: float
    V_per_As: float
    soc_per_As: float


NOTHING = Innovation(math.nan, math.nan, math.nan, math.nan)


def tangent(pack: Pack, belief: Belief, current_A: float) -> Tangent:
    """Return the tangent of the model at a belief under the true pack current `current_A` [A]: means of the members."""
    points_A, drawn_As = tangent_points(pack, current_A)
    x = np.repeat(belief.means.T[:, None], points_A.size, axis=1)
    x[X.SOC] -= drawn_As[:, None] / (3600.0 * pack.installation.present_capacity_Ah * np.exp(x[X.LOG_CAPACITY]))
    return tangent_through(
        points_A, drawn_As, b.voltage(pack, x, points_A[:, None]) @ belief.weights, x[X.SOC] @ belief.weights
    )


def tangent_points(pack: Pack, current_A: float) -> tuple[Array, Array]:
    """Return the three points of a tangent: as it is now, under more current, with charge drawn; in [A] and [A s]."""
    capacity_Ah = pack.installation.present_capacity_Ah
    points_A, drawn_As = np.full(3, current_A), np.zeros(3)
    points_A[1] += STEP_C_RATE * capacity_Ah
    drawn_As[2] = STEP_CHARGE * 3600.0 * capacity_Ah
    return points_A, drawn_As


def tangent_through(points_A: Array, drawn_As: Array, volts: Array, soc: Array) -> Tangent:
    """Return the tangent through the voltages [V] and the charges that are expected at the three `tangent_points`."""
    return Tangent(
        float(points_A[0]),
        float(volts[0]),
        float(soc[0]),
        float((volts[1] - volts[0]) / (points_A[1] - points_A[0])),
        float((volts[2] - volts[0]) / drawn_As[2]),
        float((soc[2] - soc[0]) / drawn_As[2]),
    )


def within_block(at: Tangent, voltage_V: float, current_A: float, drawn_As: float) -> Innovation:
    """Return the innovation of a row within a block, `drawn_As` [A s] after the last block."""
    expected_V = at.voltage_V + at.V_per_A * (current_A - at.current_A) + at.V_per_As * drawn_As
    return Innovation(voltage_V - expected_V, math.nan, expected_V, at.soc + at.soc_per_As * drawn_As)
