"""A voltmeter of coarse steps: what its reading tells while it stands still."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from scoring import wrong_cases, wrong_judged
from scoring.wrong_judged import Judged

from uavbatt.estimation.meter import Meter, meter_after, meter_variance
from uavbatt.log_replay.run import steps

CELLS, BLOCK_S = 4.0, 2.0


def read(readings: list[float]) -> Meter:
    meter = Meter()
    for voltage_V in readings:
        meter = meter_after(meter, voltage_V, 1.0)
    return meter


def falling(step_V: float, rows: int = 200) -> list[float]:
    return [step_V * round((16.0 - 0.02 * k) / step_V) for k in range(rows)]


def test_a_meter_of_fine_steps_adds_nothing() -> None:
    assert meter_variance(read(falling(0.01)), CELLS, BLOCK_S) == 0.0


def test_the_error_of_a_new_reading_is_uniform_within_a_step() -> None:
    meter = read([*falling(0.2), 11.0])
    assert meter.step_V == pytest.approx(0.2)
    assert math.sqrt(meter_variance(meter, CELLS, BLOCK_S)) == pytest.approx(0.2 / math.sqrt(12.0))


def test_readings_that_stand_still_are_one_reading() -> None:
    """Blocks of 2 s in a minute, each with the error of the first: the last has 31 times its variance."""
    readings = [*falling(0.2), 11.0]
    fresh, held = (meter_variance(read(r), CELLS, BLOCK_S) for r in (readings, readings + [11.0] * 60))
    assert held == pytest.approx(31.0 * fresh)


def test_a_large_fall_at_take_off_is_no_step_of_the_meter() -> None:
    assert meter_variance(read([16.8, 15.2]), CELLS, BLOCK_S) == 0.0


def judged(step_V: float, number: int) -> Judged:
    """A worn pack of the make of a fitted file, through a voltmeter of these steps."""
    case = next(c for c in wrong_cases.sampled(6) if c.name == f"fitted-65to80-full-{number}")
    flown = case.flown()
    rows = tuple(replace(s, voltage_V=round(s.voltage_V / step_V) * step_V) for s in flown.rows)
    flight = replace(flown.flight(case.name), samples=rows)
    return wrong_judged.judge(case, flown, list(steps(flight, wrong_judged.estimator(case))))


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 3])
def test_a_worn_pack_is_told_in_time_through_steps_of_50_mV_a_cell(number: int) -> None:
    """The lower end was 57 and 64 s too long, the alarm 7 minutes early, the NEES 24 and 32."""
    found = judged(0.2, number)
    assert found.lo_excess_s < 15.0
    assert 60.0 < found.alarm_s < 240.0
    assert found.nees < 3.0
