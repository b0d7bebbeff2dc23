"""What ArduPilot's parameters say of a battery whose monitor sums others."""

from __future__ import annotations

import math

import pytest

from uavbatt.telemetry.parameters import facts_timeline

PARTS = {"BATT_MONITOR": 4.0, "BATT_CAPACITY": 5000.0, "BATT2_MONITOR": 4.0, "BATT2_CAPACITY": 6000.0}


@pytest.mark.parametrize(
    ("more", "capacity_Ah"),
    [
        ({"BATT3_MONITOR": 10.0, "BATT3_CAPACITY": 3300.0, "BATT3_SUM_MASK": 0.0}, 11.0),  # nobody has touched it
        ({"BATT3_MONITOR": 10.0, "BATT3_SUM_MASK": 0.0}, 11.0),
        ({"BATT3_MONITOR": 10.0, "BATT3_SUM_MASK": 2.0}, 6.0),
        ({"BATT3_MONITOR": 10.0, "BATT3_CAPACITY": 3300.0}, math.nan),  # of which parts, nobody has said yet
        ({"BATT3_MONITOR": 10.0, "BATT3_SUM_MASK": math.inf}, math.nan),
        ({"BATT3_MONITOR": 10.0, "BATT3_CAPACITY": 10500.0}, 10.5),  # its own word goes before
        ({"BATT3_MONITOR": 4.0, "BATT3_CAPACITY": 3300.0}, 3.3),  # a pack may hold as much
        ({"BATT3_MONITOR": 10.0, "BATT3_SUM_MASK": 0.0, "BATT4_MONITOR": 4.0}, math.nan),  # a part's is not known
    ],
)
def test_a_sum_of_monitors_holds_what_its_parts_hold(more: dict[str, float], capacity_Ah: float) -> None:
    said = ((0.0, name, value) for name, value in (PARTS | more).items())
    facts = facts_timeline(said, 2, is_telemetry=True)
    assert (facts[-1][1].capacity_Ah if facts else math.nan) == pytest.approx(capacity_Ah, nan_ok=True)
