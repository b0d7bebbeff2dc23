"""A battery fitted to the flights of crews that land with charge left, and flown to its end."""

from __future__ import annotations

import pytest
from scoring import wrong_cases, wrong_judged
from scoring.other_pack import FLAT


def test_nobody_has_measured_the_capacity_of_such_packs() -> None:
    """Below the last charge of the flights only what packs usually lack tells the curve: it may be far off."""
    file = wrong_cases.fitted(FLAT, wrong_cases.LANDED)
    error_V = file.parameters.standard_error
    assert any("no deep discharge: nothing below a charge of 0.2" in words for words in file.battery.remarks)
    assert error_V["ocv_0.05"] > 0.15 and error_V["ocv_0.1"] > 0.04
    assert error_V["ocv_0.4"] < 0.02


@pytest.mark.parametrize("name", ["landed-80to92-part-5", "landed-92to105-full-2"])
def test_the_lower_end_holds_where_no_flight_of_the_fit_came(name: str) -> None:
    """It was 45 and 33 s too long in the last two minutes."""
    case = next(c for c in wrong_cases.of_fleet(6, wrong_cases.LANDED) if c.name == name)
    assert wrong_judged.judged(case).lo_excess_s < 15.0
