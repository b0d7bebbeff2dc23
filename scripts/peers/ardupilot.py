"""ArduPilot's charge counter over a filtered current: (C - drawn)/I_f.

ArduPilot itself shows remaining per cent = 100 (C - drawn)/C with drawn = 0 at boot and no voltage in it; for
ordinary monitors it gives no time. The time here is the form its DroneCAN monitor (charge left over
instantaneous current: `tau_s=0`), its plane-wind-fs script (tau about 1 s) and the unmerged generic proposal
(a filtered rate) share. The filter is y += a (x - y), a = dt/(dt + tau), from the first current.

Source: ArduPilot AP_BattMonitor_Backend.cpp, AP_BattMonitor_DroneCAN.cpp, plane-wind-fs.lua, pull request
18613; equations only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from peers.columns import FloatArray, column, integral_h
from uavbatt.records import Sample

TAU_S = 50.0
"""Default filter [s]: PX4's, and about the best of 0 to 200 s on the flights scored here: the peer's best case."""
LEAST_CURRENT_A = 0.1


def predict(
    samples: Sequence[Sample],
    capacity_Ah: float,
    cells: int,
    *,
    usable_Ah: float | None = None,
    tau_s: float = TAU_S,
) -> FloatArray:
    """Return the time left [s] at every sample; NaN without a current that flows.

    capacity_Ah : BATT_CAPACITY; usable_Ah : what a calibrated pilot writes there instead; `cells` is not used
    """
    del cells
    time_s, current_A = column(samples, "time_s"), column(samples, "current_A")
    left_Ah = (capacity_Ah if usable_Ah is None else usable_Ah) - integral_h(time_s, current_A)
    smooth_A = low_pass(time_s, current_A, tau_s)
    with np.errstate(divide="ignore", invalid="ignore"):
        remaining_s = np.maximum(left_Ah, 0.0) / smooth_A * 3600.0
    return np.where((smooth_A > LEAST_CURRENT_A) & np.isfinite(current_A), remaining_s, math.nan)


def low_pass(time_s: FloatArray, values: FloatArray, tau_s: float) -> FloatArray:
    """Return values after a first-order filter with the steps as they come; unknown values are passed over."""
    smooth = np.full_like(values, math.nan)
    state, last_s = math.nan, math.nan
    for row, (now_s, value) in enumerate(zip(time_s, values, strict=True)):
        if math.isfinite(value):
            dt_s = now_s - last_s
            gain = dt_s / (dt_s + tau_s) if dt_s + tau_s > 0.0 else 1.0
            state = value if math.isnan(state) else state + gain * (value - state)
            last_s = now_s
        smooth[row] = state
    return smooth
