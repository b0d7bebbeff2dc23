"""Diagnosis of logs that go on after the landing: how a voltage recovers is no effect of the pack."""

from __future__ import annotations

import math

import diagnose_own_logs
import numpy as np
import pytest

from uavbatt.diagnosis.refit.whitening import recovery_error_V
from uavbatt.fitting.observed import ObservedRecord, stack


def test_a_recovery_is_doubted_by_the_drop_that_ended_and_less_a_minute_later() -> None:
    """Closed form: R0 times a load of ten minutes that ends, faded by exp(-t/45 s); before it nothing is doubted."""
    time_s = np.arange(0.0, 900.0, 5.0)
    current_A = np.where((time_s >= 60.0) & (time_s < 660.0), 20.0, 0.0)
    rows = np.full(time_s.size, 15.0), current_A, np.full(time_s.size, math.nan)
    error_V = recovery_error_V(stack([ObservedRecord("a", time_s, *rows, 25.0, 4, 5.0)]), ohm=0.02)[:, 0]
    assert not error_V[time_s < 660.0].any()
    since_s = time_s[time_s >= 660.0] - 660.0
    faded = np.abs(error_V[time_s >= 660.0]) / (0.3 * 0.02 * 20.0)
    assert faded == pytest.approx(np.exp(-since_s / 45.0), rel=0.06)  # the current falls between two rows


@pytest.mark.slow
@pytest.mark.parametrize("number", [2, 9, 10, 14])
def test_healthy_packs_whose_logs_rest_after_the_landing_have_no_effect(number: int) -> None:
    """With a file of their own logs they were told `harness_resistance`, at 0.3 to 0.6."""
    assert diagnose_own_logs.diagnosed("rest", number).verdict == "no_missing_effect"
