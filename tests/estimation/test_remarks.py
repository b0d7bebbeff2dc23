"""A pack is called worn only where it surely is."""

from __future__ import annotations

import msgspec
import pytest

from uavbatt.battery import battery_file
from uavbatt.estimation.remarks import is_worn
from uavbatt.estimation.summary import BeliefSummary

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
