"""Words of a planned mission: every kind of leg by its own verb, and the wind by where it comes from."""

from __future__ import annotations

from typing import Any

import pytest

from uavbatt.navigation import Wind
from uavbatt.plan.words import leg_words, wind_words
from uavbatt.prediction.route.legs import Leg, Phase, Point

LOW, HIGH = Point(0.0, 0.0, 20.0), Point(0.0, 0.0, 60.0)


def leg(phase: Phase, begin: Point, end: Point, run_m: float = 0.0, **other: Any) -> Leg:
    return Leg(1, phase, begin, end, run_m, 5.0, 2.5, 1.5)._replace(**other)


@pytest.mark.parametrize(
    ("flown", "words"),
    [
        (leg(Phase.TAKE_OFF, Point(0.0, 0.0, 0.0), LOW), "takes off"),
        (leg(Phase.ROUTE, LOW, HIGH), "climbs"),
        (leg(Phase.ROUTE, HIGH, LOW), "descends"),
        (leg(Phase.ROUTE, LOW, LOW, hold_s=30.0), "stays, waits 30 s"),
        (leg(Phase.ROUTE, LOW, HIGH, 100.0), "flies"),
        (leg(Phase.HOME, LOW, HIGH), "climbs"),
        (leg(Phase.HOME, HIGH, HIGH, 100.0, hold_s=5.0), "flies home, waits 5 s"),
        (leg(Phase.LANDING, HIGH, LOW), "descends"),
        (leg(Phase.LANDING, LOW, Point(0.0, 0.0, 0.0)), "lands"),
        (leg(Phase.ROUTE, LOW, Point(0.0, 0.0, 0.0), moves_load=True), "sets its payload down"),
        (leg(Phase.ROUTE, LOW, HIGH, moves_load=True), "climbs"),
        (leg(Phase.ROUTE, LOW, LOW, 188.5, circle_m=10.0), "3 turns of 10 m radius"),
    ],
)
def test_every_leg_has_its_verb(flown: Leg, words: str) -> None:
    assert leg_words(flown) == words


@pytest.mark.parametrize(
    ("wind", "words"),
    [
        (Wind(-5.0, 0.0), "5.0 m/s from 0°"),  # the air moves south
        (Wind(0.0, -5.0), "5.0 m/s from 90°"),
        (Wind(3.0, 0.0), "3.0 m/s from 180°"),
        (Wind(0.0, 4.0), "4.0 m/s from 270°"),
        (Wind(0.0, 0.0), "none stated: still air"),
    ],
)
def test_a_wind_is_told_by_where_it_comes_from(wind: Wind, words: str) -> None:
    assert wind_words(wind) == words
