"""The course of an effect in a sentence: since which flight, steady or growing, how large by now."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from uavbatt.battery.effects import unit_words
from uavbatt.diagnosis.follow import FollowedEffect
from uavbatt.diagnosis.words import QUANTITY


def course_words(one: FollowedEffect, flights: Sequence[str], dates: Sequence[str]) -> str:
    """Say when the effect began, as `since flight 5 of 9 (2026-05-03, f5.tlog), steady`."""
    begins, count = one.course.begins, len(flights)
    course = "growing from flight to flight" if one.course.grows else "steady"
    if begins == 0 and not one.course.grows:
        return f"in every one of the {count} flights, {course}"
    day = f"{dates[begins]}, " if dates[begins] else ""
    sentence = f"since flight {begins + 1} of {count} ({day}{Path(flights[begins]).name}), {course}"
    if one.earliest < one.latest:
        sentence += f"; it may have begun at any from flight {one.earliest + 1} to {one.latest + 1}"
    if begins == count - 1:
        sentence += "; one flight alone shows it: fly another"
    return sentence


def size_words(one: FollowedEffect) -> str:
    """Say how large the effect is at the last flight, and by how much it grows."""
    quantity, unit = QUANTITY.get(one.quantity, one.quantity), unit_words(one.values[0].unit)
    last = one.found.parameters[one.quantity]
    sentence = f"{quantity}: {one.quantity} = {last.value:.4g} [{last.lo:.4g}, {last.hi:.4g}] {unit}".rstrip()
    if one.course.grows:
        each = (last.value - one.off) / (len(one.values) - one.course.begins)
        sentence += f" at the last flight, {each:+.2g} {unit}".rstrip() + " a flight"
    return sentence
