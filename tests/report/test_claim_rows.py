"""A row of the claims table speaks of one instant, whatever the reason in the certificate names."""

from __future__ import annotations

import numpy as np
import pytest

from uavbatt.report.validation.tables import claims_table
from uavbatt.validation.gating.ambient_claims import _shown
from uavbatt.validation.gating.gate import Claim, decide

BIAS, HALF = np.array([0.216, -0.408, 0.05]), np.array([1.019, 0.16, 0.01])


@pytest.mark.parametrize("judge", [decide, _shown])
def test_no_figure_of_another_instant_stands_in_the_row(judge) -> None:  # type: ignore[no-untyped-def]
    verdict, reason = judge(BIAS, HALF, 0.15)
    claim = Claim("voltage", -5.0, verdict, reason, False, np.arange(3) * 60.0, BIAS, HALF, HALF, 0.15, "V")
    row = claims_table([claim])
    assert verdict == "fail" and "-0.408" in reason
    assert "408 mV" in row and "216" not in row and "-0.408" not in row
    assert "beyond ±0.15" in row
