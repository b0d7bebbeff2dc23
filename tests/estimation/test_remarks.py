"""A pack is called worn only where it surely is."""

from __future__ import annotations

import math

import msgspec
import pytest

from uavbatt.battery import battery_file
from uavbatt.estimation.remarks import acts_soon, is_worn
from uavbatt.estimation.summary import BeliefSummary
from uavbatt.records import PackFacts, Sample

BATTERY = battery_file.read_battery("lipo-generic")
FILE = msgspec.structs.replace(
    BATTERY, parameters=msgspec.structs.replace(BATTERY.parameters, resistance_scale_sd=0.20)
)


@pytest.mark.parametrize(
    ("wear", "sd", "is_said"),
    [
        (0.40, 0.10, True),
        (0.40, 0.18, False),  # beyond what packs of its type differ by, and not sure
        (0.20, 0.01, False),  # sure, and within what packs of its type differ by (0.25)
    ],
)
def test_more_resistance_than_its_type_has_must_be_large_and_sure(wear: float, sd: float, is_said: bool) -> None:
    assert is_worn(BeliefSummary(wear=wear, wear_sd=sd), FILE) is is_said


@pytest.mark.parametrize(
    ("counted", "reported", "armed", "is_said"),
    [
        (3.0, math.nan, True, False),
        (3.85, math.nan, True, True),  # 1.15 of 5 Ah left, and it lands at 0.75
        (3.0, 0.24, True, True),
        (3.85, 0.30, None, False),  # what the autopilot itself says goes before our arithmetic
        (3.85, math.nan, False, False),  # on the ground it does nothing
        (math.nan, math.nan, True, False),
    ],
)
def test_an_autopilot_that_will_soon_act_by_its_own_count(
    counted: float, reported: float, armed: bool | None, is_said: bool
) -> None:
    facts = PackFacts(capacity_Ah=5.0, acts_below_soc=0.15)
    row = Sample(600.0, 15.0, 15.0, consumed_Ah=counted, reported_soc=reported, armed=armed)
    assert acts_soon(facts, row) is is_said
    assert not acts_soon(PackFacts(capacity_Ah=5.0), row)
