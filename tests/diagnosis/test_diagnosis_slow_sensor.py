"""A reading behind a filter is none of the named effects, although it looks like a delay between the two readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cases import first_quick
from planted_flights import MISSIONS, fly, found

from uavbatt.battery.model import Array
from uavbatt.diagnosis.refit import late_current
from uavbatt.fitting import observed
from uavbatt.fitting.observed import ObservedRecord


def behind(readings: Array, tau_s: float) -> Array:
    """Readings of every second behind a first-order filter, step by step."""
    out, held = [], float(readings[0])
    for reading in readings:
        held += (float(reading) - held) * (1.0 - np.exp(-1.0 / tau_s))
        out.append(held)
    return np.array(out)


@pytest.fixture(scope="module")
def flights() -> list[ObservedRecord]:
    return [fly(*mission) for mission in MISSIONS[:3]]


def test_a_filtered_voltage_is_no_declared_effect(flights: list[ObservedRecord]) -> None:
    diagnosis = found([replace(r, voltage_V=behind(r.voltage_V, 4.0)) for r in flights])
    assert diagnosis.verdict == "undeclared_effect"
    assert any("current_delay is no delay: the voltage read follows the truth" in r for r in diagnosis.reasons)
    assert all(c.probability <= 0.4 for c in diagnosis.classes)
    assert not diagnosis.after.candidate.names  # nothing of it enters the battery file


@pytest.mark.slow  # the filtered voltage, above, is its witness
def test_a_filtered_current_is_no_declared_effect(flights: list[ObservedRecord]) -> None:
    diagnosis = found([replace(r, current_A=behind(r.current_A, 4.0)) for r in flights])
    assert diagnosis.verdict == "undeclared_effect"
    assert any("current_delay is no delay: the current read follows the truth" in r for r in diagnosis.reasons)


@pytest.mark.parametrize("seconds", first_quick(1, [3, -3]))
def test_a_delay_stays_a_delay(flights: list[ObservedRecord], seconds: int) -> None:
    ahead, behind_rows = max(-seconds, 0), max(seconds, 0)
    cut = [
        replace(
            r,
            time_s=r.time_s[abs(seconds) :] - abs(seconds),
            voltage_V=r.voltage_V[behind_rows : r.time_s.size - ahead],
            temp_C=r.temp_C[behind_rows : r.time_s.size - ahead],
            current_A=r.current_A[ahead : r.time_s.size - behind_rows],
        )
        for r in flights
    ]
    diagnosis = found(cut)
    assert diagnosis.verdict == "effect_found" and diagnosis.classes[0].members == ("current_delay",)
    assert np.sign(diagnosis.classes[0].parameters["delay_s"].value) == np.sign(seconds)


def test_the_current_that_goes_with_a_filtered_voltage_is_the_filtered_one(flights: list[ObservedRecord]) -> None:
    stack = observed.stack(flights)
    followed_A = late_current.followed(flights, stack)
    for j, record in enumerate(flights):
        by_hand = observed.binned(replace(record, current_A=behind(record.current_A, 4.0))).current_A
        at_4_s = followed_A[np.searchsorted(late_current.SHIFTS_S, -4.0), :, j]
        inside = slice(2, by_hand.size - 1)
        assert np.std((at_4_s[: by_hand.size] - by_hand)[inside]) < 0.1 * np.std(by_hand)


def test_a_filter_of_nothing_changes_nothing_and_the_two_ways_undo_each_other(flights: list[ObservedRecord]) -> None:
    record = flights[0]
    smooth = replace(record, current_A=20.0 + 5.0 * np.sin(record.time_s / 40.0))
    filtered = replace(smooth, current_A=behind(smooth.current_A, 4.0))
    stack = observed.stack([smooth])
    shift = np.searchsorted(late_current.SHIFTS_S, [0.0, 4.0])
    alike, before = late_current.followed([smooth], stack)[shift[0], 2:-2, 0], late_current.followed([filtered], stack)
    assert alike == pytest.approx(stack.current_A[2:-2, 0], abs=0.05)
    assert before[shift[1], 8:-2, 0] == pytest.approx(stack.current_A[8:-2, 0], abs=0.1)
