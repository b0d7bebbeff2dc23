"""Running numbers of frames: two senders behind one address are two, and a bad link of one sender is one."""

from __future__ import annotations

import random
from collections.abc import Iterable

import pytest

from uavbatt.telemetry.link.sequence_numbers import SequenceNumbers, Stream

FRAME_S = 0.05
ADDRESS = ("10.0.0.1", 14550)


def told(numbers: Iterable[int]) -> list[object]:
    """The senders that the frames are given to, twenty a second."""
    counts = SequenceNumbers(ADDRESS)
    return [counts.stream(number % 256, k * FRAME_S) for k, number in enumerate(numbers)]


def lossy(dice: random.Random) -> list[int]:
    return [k for k in range(20_000) if dice.random() > 0.5]


def late(dice: random.Random) -> list[int]:
    return [k for _, k in sorted((k + dice.uniform(0.0, 6.0), k) for k in range(20_000))]


def twice(dice: random.Random) -> list[int]:
    return [k for _, k in sorted((k + extra, k) for k in range(10_000) for extra in (0.0, dice.uniform(0.0, 5.0)))]


def silent(dice: random.Random) -> list[int]:
    """Gaps of any length, as a radio behind a hill makes them."""
    found, number = [], 0
    for _ in range(400):
        number += dice.randrange(300)
        found += range(number, number + 40)
        number += 40
    return found


def few(dice: random.Random) -> list[int]:
    """A router that passes two kinds of frames of sixty in a second."""
    return [k for k in range(100_000) if k % 60 in (7, 8) or (k % 60 == 31 and dice.random() < 0.9)]


def fading(dice: random.Random) -> list[int]:
    """Twelve frames in a row are lost, now and then."""
    return [k for k in range(20_000) if k // 12 % 5 or dice.random() < 0.1]


def poor(dice: random.Random) -> list[int]:
    return [k for k in range(60_000) if dice.random() > 0.85]


@pytest.mark.parametrize("link", [lossy, late, twice, silent, few, fading, poor])
def test_one_sender_on_a_bad_link_is_one(link) -> None:  # type: ignore[no-untyped-def]
    assert set(told(link(random.Random(1)))) == {ADDRESS}


def test_a_sender_that_does_not_count_is_one() -> None:
    assert set(told([0] * 1000)) == {ADDRESS}


@pytest.mark.parametrize("loss", [0.0, 0.2])
def test_two_senders_are_two_from_the_first_second_on(loss: float) -> None:
    dice, next_of, numbers, whose = random.Random(2), [0, 120], [], []
    for _ in range(2000):
        who = dice.randrange(2)
        next_of[who] += 1
        if dice.random() >= loss:
            numbers.append(next_of[who])
            whose.append(who)
    senders = told(numbers)[40:]
    right = sum(isinstance(sender, Stream) is bool(who) for sender, who in zip(senders, whose[40:], strict=True))
    assert max(right, len(senders) - right) >= 0.97 * len(senders)


def test_when_one_of_two_falls_silent_the_other_is_the_sender() -> None:
    both = [number for k in range(200) for number in (k, k + 100)]
    assert told([*both, *range(300, 900)])[-1] == ADDRESS
