"""Checks of whole discharge runs, for a reversed sign and for wrong units that each single row allows.

A cycler writes its tables in its own way. The rows alone do not show that the current is negative in discharge, that
the time is in minutes or that the surface is in degrees Fahrenheit; the sums over a run do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from uavbatt.dataset.records import Run
from uavbatt.errors import BadInput
from uavbatt.limits import C_RATE

MOST_DRAWN, LEAST_DRAWN = 1.5, 0.05  # shares of the rated capacity: in any run, and in the longest of all
WHOLE_DISCHARGE = (0.3, 1.3)  # shares of the rated capacity that a run down to its cut-off gives
HOTTEST_START_C = 60.0  # no test of a lithium pack begins with a hotter surface
SAME_TEMP_K = 3.0


def check_runs(runs: Sequence[Run], capacity_Ah: float, cutoff_V: float, shown: str) -> None:
    """Raise BadInput, in which `shown` names the file, for runs that no pack can have given.

    capacity_Ah : rated capacity [Ah], NaN if not stated; cutoff_V : where a discharge ends [V of the pack]
    """
    drawn_Ah = [charge_Ah(run) for run in runs]
    for run, charge in zip(runs, drawn_Ah, strict=True):
        if charge < 0.0:
            said = f"positive numbers in discharge, the run gives {charge:.3g} Ah in all: reverse the sign"
            raise BadInput(shown, f"{run.place}, current_a", said)
        if charge > MOST_DRAWN * capacity_Ah:
            said = f"current_a in A and time_s in s, the run draws {charge:.3g} Ah of {capacity_Ah:g} Ah"
            raise BadInput(shown, run.place, said + _thousandth(run, capacity_Ah))
    most_Ah = max((q for q in drawn_Ah if not math.isnan(q)), default=math.nan)
    is_emptied = any(run.voltage_V[-1] <= cutoff_V for run in runs)
    if is_emptied and most_Ah < LEAST_DRAWN * capacity_Ah:
        said = f"current_a in A and time_s in s, no run draws more than {most_Ah:.2g} Ah of {capacity_Ah:g} Ah"
        raise BadInput(shown, "", said + _slower(most_Ah / capacity_Ah))
    if _is_in_fahrenheit(runs):
        said = f"°C, {runs[0].place} begins with {_first_surface_C(runs[0]):g} (degrees Fahrenheit?)"
        raise BadInput(shown, "column surface_c", said)


def charge_Ah(run: Run) -> float:
    """Return the charge that a run draws [Ah], by the trapezoidal rule; NaN if a current was not measured."""
    mean_A = (run.current_A[1:] + run.current_A[:-1]) / 2.0
    return float(np.sum(mean_A * np.diff(run.time_s))) / 3600.0


def _thousandth(run: Run, capacity_Ah: float) -> str:
    """Return which of the two is a thousand times too large, if one is."""
    if not WHOLE_DISCHARGE[0] / 10.0 <= charge_Ah(run) / capacity_Ah / 1000.0 <= WHOLE_DISCHARGE[1]:
        return ""
    return " (milliamperes?)" if float(np.max(run.current_A)) > C_RATE[1] * capacity_Ah else " (milliseconds?)"


def _slower(share: float) -> str:
    """Return the unit of time in which the charge would be that of a whole discharge."""
    for name, seconds in (("minutes", 60.0), ("hours", 3600.0)):
        if WHOLE_DISCHARGE[0] <= share * seconds <= WHOLE_DISCHARGE[1]:
            return f" ({name}?)"
    return ""


def _first_surface_C(run: Run) -> float:
    known = run.surface_C[~np.isnan(run.surface_C)]
    return float(known[0]) if len(known) else math.nan


def _is_in_fahrenheit(runs: Sequence[Run]) -> bool:
    """Return True if all runs begin at their ambient temperatures when the surfaces are read as °F, one above 60."""
    first = np.array([_first_surface_C(run) for run in runs])
    ambient = np.array([run.ambient_C for run in runs])[~np.isnan(first)]
    first = first[~np.isnan(first)]
    if not len(first) or float(np.max(first)) <= HOTTEST_START_C:
        return False
    return bool(np.all(np.abs((first - 32.0) / 1.8 - ambient) < SAME_TEMP_K))
