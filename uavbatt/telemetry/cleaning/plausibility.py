"""Plausibility of temperature and current readings: pure functions, used by `info` and by the cleaning.

A cell in a flying pack has a thermal time constant of minutes, so a reading that moves by more than 1 K/s is that of
a chip, or noise. A reading that never changes does not come from a working sensor. One that starts above 40 °C comes
from a sensor on a circuit board (42 to 54 °C were seen in a flight controller).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from uavbatt.limits import KELVIN
from uavbatt.records import NAN, Sample

MIN_CELL_C, MAX_CELL_C = -40.0, 85.0
MAX_SLOPE_K_PER_S = 1.0
SLACK_K = 1.0  # sensors with 1 K resolution step by 1 K
BOARD_START_C = 40.0
_LIVE_AFTER_S = 120.0  # in a shorter record a sound sensor may be constant
_MIN_STEPS = 20
_MIN_STEP_A = 1.0
_MAX_STEP_S = 5.0


def plausible_temperature_C(temp_C: float, previous_C: float = NAN, elapsed_s: float = NAN) -> float:
    """Return `temp_C` [°C] if a cell may have it, else NaN.

    previous_C : the last plausible reading [°C]; elapsed_s : its age [s]; NaN where there was none. Fields that are
    not set read exactly 0.0, which is not used; a real 0.00 °C costs one row.
    """
    if not MIN_CELL_C <= temp_C <= MAX_CELL_C or temp_C == 0.0:
        return NAN
    if abs(temp_C - previous_C) > SLACK_K + MAX_SLOPE_K_PER_S * max(elapsed_s, 0.0):
        return NAN
    return temp_C


def temperature_verdict(samples: Sequence[Sample]) -> str:
    """Judge the temperature of a log: `absent`, `plausible`, or the reason why it is doubtful."""
    rows = [(s.time_s, s.temp_C) for s in samples if math.isfinite(s.temp_C)]
    if not rows:
        return "absent"
    if all(KELVIN[0] <= temp_C <= KELVIN[1] for _, temp_C in rows):
        return "impossible values (kelvin?)"
    if any(not MIN_CELL_C <= temp_C <= MAX_CELL_C for _, temp_C in rows):
        return "impossible values (unit?)"
    if len({temp_C for _, temp_C in rows}) == 1 and rows[-1][0] - rows[0][0] >= _LIVE_AFTER_S:
        return "constant (no live sensor?)"
    if rows[0][1] > BOARD_START_C:
        return "hot from the start (board sensor?)"
    jumps = sum(
        abs(c1 - c0) > SLACK_K + MAX_SLOPE_K_PER_S * (t1 - t0) for (t0, c0), (t1, c1) in itertools.pairwise(rows)
    )
    return "jumps (not a cell's temperature?)" if jumps > len(rows) // 100 else "plausible"


def sag_correlation(samples: Sequence[Sample]) -> float:
    """Return the correlation of voltage steps with current steps; NaN with fewer than 20 steps above 1 A.

    Near -1 both were measured at the same instant. Near 0 they were not (smart packs), or the autopilot has removed the
    sag from the voltage.
    """
    steps = [
        (b.voltage_V - a.voltage_V, b.current_A - a.current_A)
        for a, b in itertools.pairwise(samples)
        if 0 < b.time_s - a.time_s <= _MAX_STEP_S
    ]
    steps = [(dv, di) for dv, di in steps if math.isfinite(dv) and abs(di) > _MIN_STEP_A]
    if len(steps) < _MIN_STEPS:
        return NAN
    cross = sum(dv * di for dv, di in steps)
    scale = math.sqrt(sum(dv * dv for dv, _ in steps) * sum(di * di for _, di in steps))
    return cross / scale if scale > 0 else 0.0
