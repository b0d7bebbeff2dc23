"""Bounds of every value in a flight's record: an edited file that breaks them is refused.

They are wide: every value that a ledger wrote lies within them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from uavbatt.battery.high_voltage import ORDINARY_FULL_V
from uavbatt.battery.sections import HIGHEST_CELL_V
from uavbatt.limits import CAPACITY_AH, MOST_CELLS
from uavbatt.packs.records import FlightRecord

LATEST_UTC_S = 2.5e11  # the calendar ends with the year 9999
OHM, AH, VARIANCE = (1e-5, 10.0), (0.01, 1e4), (1e-12, 1e6)
BOUNDS: Mapping[str, tuple[float, float]] = {
    "cells": (1, MOST_CELLS),
    "rated_Ah": CAPACITY_AH,
    "type_ohm": OHM,
    "start_utc_s": (0.0, LATEST_UTC_S),
    "duration_s": (0.0, 3.2e7),
    "soc_start": (0.0, 1.0),
    "soc_end": (0.0, 1.0),
    "charge_Ah": (0.0, 1e4),
    "energy_Wh": (0.0, 1e6),
    "temp_mean_C": (-500.0, 1000.0),  # of a sensor in any unit
    "temp_max_C": (-500.0, 1000.0),
    "weak_cell": (0, MOST_CELLS),
    "weak_cell_V": (0.0, 10.0),
    "cycles": (0, 1_000_000),
    "fullest_cell_V": (ORDINARY_FULL_V, HIGHEST_CELL_V),
}
"""Key -> least and greatest value; NaN and None are unknown, but for NEEDED."""
NEEDED = ("rated_Ah", "type_ohm")


def doubt_of(flight: FlightRecord) -> tuple[str, str] | None:
    """Return the key of an impossible value of a flight, and the expected range; None if all values are possible."""
    for key, (low, high) in BOUNDS.items():
        value = getattr(flight, key)
        is_unknown = value is None or (math.isnan(value) and key not in NEEDED)
        if not is_unknown and not low <= value <= high:
            return key, f"{low:g} to {high:g}, found {value:g}"
    words = _evidence_doubt(flight)
    return ("told", words) if words else None


def _evidence_doubt(flight: FlightRecord) -> str:
    """Return what was expected of the evidence of a flight; empty if the evidence is possible."""
    told = flight.told
    for log, (low, high) in ((told.log_ohm, OHM), (told.log_Ah, AH)):
        if not math.log(low) < log < math.log(high):
            return "ohms and ampere-hours of a pack"
    least, most = VARIANCE
    is_spread = least < told.variance_ohm < most and least < told.variance_Ah < most
    if not (is_spread and told.variance_Ah * told.variance_ohm > told.covariance**2):
        return "variances above zero, and a covariance that they allow"
    return ""
