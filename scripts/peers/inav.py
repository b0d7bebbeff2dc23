"""INAV's energy estimate: what is left of the watt hours over the mean power of the whole flight.

    P = V I + Z I^2;  drawn = integral of P;  t = (E - drawn) (time flown)/drawn

The heat in the pack (Z I^2) is counted as drawn. Z comes from steps of at least 2 A and 0.04 V within 0.5 s,
dV/dI, filtered at 0.5 s and then 1.2 s; slower telemetry shows no such step and leaves Z = 0.

INAV gives the time **before one must turn home**. A score of endurance has no home, so the return energy, the
critical level and the margin are 0 here, which is the most favourable reading of its number.

Source: inav src/main/flight/rth_estimator.c, src/main/sensors/battery.c, pull request 2863; equations only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from peers.columns import FloatArray, armed, column, integral_h
from uavbatt.records import Sample

NOMINAL_CELL_V = 3.7
"""Nameplate energy = nameplate charge x this x cells, as printed on packs."""
STEP_A, STEP_V, STEP_S = 2.0, 0.04, 0.5
LP_STEP_S, LP_OUTPUT_S = 0.5, 1.2


def predict(
    samples: Sequence[Sample],
    capacity_Ah: float,
    cells: int,
    *,
    usable_Wh: float | None = None,
) -> FloatArray:
    """Return the time left [s] at every sample; NaN until something was drawn, and where the current is unknown.

    capacity_Ah : rated, turned into energy at 3.7 V a cell; usable_Wh : energy drawn to the end of earlier flights
    """
    time_s, voltage_V, current_A = (column(samples, name) for name in ("time_s", "voltage_V", "current_A"))
    flying = armed(samples)
    power_W = voltage_V * current_A + impedance(time_s, voltage_V, current_A) * current_A**2
    drawn_Wh = integral_h(time_s, power_W)
    flown_s = integral_h(time_s, flying.astype(float)) * 3600.0
    flown_Wh = integral_h(time_s, np.where(flying, power_W, 0.0))
    energy_Wh = capacity_Ah * NOMINAL_CELL_V * cells if usable_Wh is None else usable_Wh
    with np.errstate(divide="ignore", invalid="ignore"):
        remaining_s = np.maximum(energy_Wh - drawn_Wh, 0.0) * flown_s / flown_Wh
    return np.where((flown_Wh > 0.0) & np.isfinite(power_W), remaining_s, math.nan)


def impedance(time_s: FloatArray, voltage_V: FloatArray, current_A: FloatArray) -> FloatArray:
    """Return the pack impedance [ohm] from load steps, as known at every row; 0 before the first step."""
    known = np.zeros_like(time_s)
    inner = outer = 0.0
    last_s = math.nan
    for row in range(1, time_s.size):
        dt_s = time_s[row] - time_s[row - 1]
        d_A, d_V = current_A[row] - current_A[row - 1], voltage_V[row] - voltage_V[row - 1]
        step = dt_s <= STEP_S and abs(d_A) >= STEP_A and abs(d_V) >= STEP_V and d_A * d_V < 0.0
        if step and math.isnan(last_s):
            inner = outer = -d_V / d_A
        elif step:
            since_s = time_s[row] - last_s
            inner += since_s / (since_s + LP_STEP_S) * (-d_V / d_A - inner)
            outer += since_s / (since_s + LP_OUTPUT_S) * (inner - outer)
        last_s = time_s[row] if step else last_s
        known[row] = outer
    return known
