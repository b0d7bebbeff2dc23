"""Flights in order of time: since when an effect is there, and whether it grows."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from planted_flights import FILE, PACK, fly

from uavbatt.diagnosis.course import Course, FlightValues, courses
from uavbatt.diagnosis.follow import CAN_BEGIN, Follow, follow
from uavbatt.diagnosis.follow_words import course_words, size_words
from uavbatt.errors import NotEnoughData
from uavbatt.fitting.observed import ObservedRecord
from uavbatt.log_replay.run import engine_for

FLIGHTS = 5
# A few effects, so that the tests are quick; all of them are tried by scripts/diagnose_cases_healthy.py --follow.
TRIED = ("current_gain", "capacity_fade", "voltage_offset", "temperature_offset", "harness_resistance")
WITHOUT = tuple(name for name in CAN_BEGIN if name not in TRIED)


@cache
def flight(k: int, **effect: float) -> ObservedRecord:
    """The k-th of a row of flights with weather and loads of their own."""
    random = np.random.default_rng(200 + k)
    flown = fly(float(random.uniform(8.0, 32.0)), float(random.uniform(130.0, 180.0)), 200 + k, **effect)
    return replace(flown, name=f"flight_{k + 1}")


def followed(records: list[ObservedRecord]) -> Follow:
    return follow(records, FILE, PACK, WITHOUT, engine=engine_for(is_long=True))


@pytest.fixture(scope="module")
def begins_late() -> Follow:
    return followed([flight(k, gain=1.1) if k >= 2 else flight(k) for k in range(FLIGHTS)])


def test_a_course_is_in_no_flight_before_it_begins_and_whole_in_the_last() -> None:
    for course in courses(6):
        shares = course.shares(6)
        assert np.all(shares[: course.begins] == 0.0) and np.all(np.diff(shares) >= 0.0)
        assert shares[course.begins] > 0.0 and shares[-1] == 1.0


def test_a_course_saves_what_least_squares_by_hand_save() -> None:
    own = FlightValues(np.array([0.0, 0.1, 2.0, 2.2]), np.full(4, 0.5))
    assert own.saved(Course(2, grows=False)) == pytest.approx(2.0 * 2.1**2 / 0.5**2)
    assert max(courses(4), key=own.saved) == Course(2, grows=False)


def test_nothing_begins_in_healthy_flights() -> None:
    found = followed([flight(k) for k in range(FLIGHTS)])
    assert found.verdict == "no_missing_effect" and found.effects == ()
    assert found.flights == tuple(f"flight_{k + 1}" for k in range(FLIGHTS))


def test_an_effect_that_begins_is_told_with_its_flight(begins_late: Follow) -> None:
    one = begins_late.effects[0]
    assert begins_late.verdict == "effect_found" and "current_gain" in one.found.members
    assert one.course == Course(2, grows=False)
    assert one.earliest <= 2 <= one.latest
    told = one.found.parameters["gain_I"]
    assert told.lo <= 1.1 <= told.hi
    assert len(one.values) == FLIGHTS and one.values[0].value < 1.05 < one.values[-1].value


def test_its_words_name_flight_day_and_log(begins_late: Follow) -> None:
    days = ("2026-05-01", "2026-05-02", "2026-05-03", "2026-05-04", "2026-05-05")
    one = begins_late.effects[0]
    assert course_words(one, begins_late.flights, days).startswith("since flight 3 of 5 (2026-05-03, flight_3), steady")
    assert "gain_I = 1.099 [" in size_words(one)


def test_an_effect_that_grows_is_said_to_grow() -> None:
    found = followed([flight(k, offset_V=-0.12 * max(k - 1, 0)) for k in range(FLIGHTS)])
    one = found.effects[0]
    assert "voltage_offset" in one.found.members
    assert one.course == Course(2, grows=True)
    assert "a flight" in size_words(one) and "growing" in course_words(one, found.flights, ("",) * FLIGHTS)


def test_an_effect_of_every_flight_began_before_them() -> None:
    found = followed([flight(k, offset_V=-0.4) for k in range(3)])
    assert found.effects[0].course == Course(0, grows=False)
    assert course_words(found.effects[0], found.flights, ("",) * 3) == "in every one of the 3 flights, steady"


def test_one_flight_has_no_course() -> None:
    with pytest.raises(NotEnoughData):
        followed([flight(0)])
