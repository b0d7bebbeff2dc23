"""The rows of a flight that a fit compares with a model: a lost voltmeter or a spike of the current is no evidence."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from uavbatt.battery.initial_state import IDLE_C_RATE
from uavbatt.records import Sample
from uavbatt.telemetry.cleaning.cleaner import Cleaner
from uavbatt.telemetry.cleaning.readings import HIGHEST_READING_V
from uavbatt.telemetry.quality.drawn import loaded_A

# A current that the voltage does not answer is a spike if it is twice the high current of the flight, which is thrice
# the least one under load. A smaller one may be early or late, which a diagnosis is to see.
SPIKE = 6.0
# The first minute after a landing shows the resistance and the fast polarisation. What recovers in the minutes after it
# is no part of a flight, and slower than the model: a fit that holds it bends the curve where the aircraft landed, and
# a diagnosis with that file raises alarms (half of 20 healthy sets, a quarter without it).
RECOVERED_S = 60.0


def used_rows(
    samples: Sequence[Sample], cleaner: Cleaner, cells: int, capacity_Ah: float
) -> tuple[list[Sample], list[float]]:
    """Return the rows with voltage and current that may be compared, and their temperatures [°C; NaN: not to be used].

    A voltage that a replay would not use, or that no cell can have, counts as not measured; so does a spike of the
    current (SPIKE). The rest after the last load is left out but for its start (RECOVERED_S).

    cells : in series; capacity_Ah : of the pack [Ah]
    """
    metered = [s for s in samples if math.isfinite(s.voltage_V) and math.isfinite(s.current_A)]
    most_A = SPIKE * loaded_A(np.array([sample.current_A for sample in metered]))
    rows, temps_C = [], []
    for row in metered:
        cleaner, cleaned = cleaner.clean(row, capacity_Ah=capacity_Ah, cells=cells)
        is_spike = cleaned.current_A != row.current_A and abs(row.current_A) > most_A
        if cleaned.voltage_V < cells * HIGHEST_READING_V and not is_spike:
            rows.append(row)
            temps_C.append(cleaned.temp_C)
    landed_s = max((r.time_s for r in rows if r.current_A >= IDLE_C_RATE * capacity_Ah), default=math.inf)
    flown = sum(row.time_s <= landed_s + RECOVERED_S for row in rows)
    return rows[:flown], temps_C[:flown]
