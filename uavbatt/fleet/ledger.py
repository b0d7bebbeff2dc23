"""The pack ledger of a fleet: the same as if the logs were replayed one by one in order of time."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from uavbatt.errors import UavbattError
from uavbatt.fleet.fly import NOT_MET, RememberedPack
from uavbatt.fleet.lesson import Lesson
from uavbatt.packs.ledger import AnotherSize, Ledger, prior

Numbered = tuple[int, Lesson]


@dataclass(frozen=True, slots=True)
class LedgerUpdate:
    """LedgerUpdate counts the flights that the ledger holds of these logs; `left_out` says why it lacks others."""

    saved: int
    left_out: dict[int, str]


def fill(ledger: Ledger, lessons: Iterable[Numbered]) -> LedgerUpdate:
    """Save the records of the flights; return how many flights they are, and which logs were left out.

    Logs of one flight are one: the ledger keeps the longest.
    """
    saved, left_out = 0, dict[int, str]()
    for name, flights in sorted(_by_pack(lessons).items()):
        teaching = [(number, lesson) for number, lesson in flights if lesson.taught is not None]
        while teaching:
            try:
                stand = ledger.save_all(name, [lesson.taught for _, lesson in teaching if lesson.taught])
                saved += len({one.flight.key for one in stand})
                break
            except AnotherSize as error:
                number, _ = teaching.pop(error.index)
                left_out[number] = str(error)
            except UavbattError as error:
                left_out |= {number: str(error) for number, _ in teaching}
                break
    return LedgerUpdate(saved, left_out)


def packs_met(
    ledger: Ledger, lessons: Iterable[Numbered], filled: LedgerUpdate, logs: int, battery_sha256: str
) -> list[RememberedPack]:
    """Return the pack of each log with its health before that log; the ledger must be filled."""
    met = [NOT_MET] * logs
    for name, flights in _by_pack(lessons).items():
        every = ledger.flights(name)
        for number, lesson in flights:
            last = ledger.before(name, lesson.start_utc_s, lesson.key)
            health = prior(last, lesson.start_utc_s, battery_sha256) if last is not None else None
            own = (after for after in every if after.flight.is_of(lesson.key, lesson.start_utc_s))
            words = [finding.words for after in own for finding in after.findings]
            words += [filled.left_out[number]] if number in filled.left_out else []
            met[number] = RememberedPack(health, tuple(f"pack {name}: {one}" for one in words))
    return met


def _by_pack(lessons: Iterable[Numbered]) -> dict[str, Sequence[Numbered]]:
    """Return the flights of each named pack in order of time; flights without a clock come last."""
    packs: dict[str, list[Numbered]] = defaultdict(list)
    for number, lesson in lessons:
        if lesson.pack:
            packs[lesson.pack].append((number, lesson))
    return {name: sorted(flights, key=_moment) for name, flights in packs.items()}


def _moment(numbered: Numbered) -> tuple[float, int]:
    number, lesson = numbered
    return (lesson.start_utc_s if math.isfinite(lesson.start_utc_s) else math.inf, number)
