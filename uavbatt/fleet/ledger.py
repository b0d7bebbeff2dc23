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

LessonsOfLog = tuple[int, Sequence[Lesson]]  # number of the log, the lessons of its flights
Place = tuple[int, int]  # number of the log, and of the flight in it, from 0
Placed = tuple[Place, Lesson]


@dataclass(frozen=True, slots=True)
class LedgerUpdate:
    """LedgerUpdate counts the flights that the ledger holds of these logs; `left_out` says why it lacks others."""

    saved: int
    left_out: dict[Place, str]


def fill(ledger: Ledger, lessons: Iterable[LessonsOfLog]) -> LedgerUpdate:
    """Save the records of the flights; return how many flights they are, and which were left out.

    Logs of one flight are one: the ledger keeps the longest.
    """
    saved, left_out = 0, dict[Place, str]()
    for name, flights in sorted(_by_pack(lessons).items()):
        teaching = [(place, lesson) for place, lesson in flights if lesson.taught is not None]
        while teaching:
            try:
                stand = ledger.save_all(name, [lesson.taught for _, lesson in teaching if lesson.taught])
                saved += len({one.flight.key for one in stand})
                break
            except AnotherSize as error:
                place, _ = teaching.pop(error.index)
                left_out[place] = str(error)
            except UavbattError as error:
                left_out |= {place: str(error) for place, _ in teaching}
                break
    return LedgerUpdate(saved, left_out)


def packs_met(
    ledger: Ledger, lessons: Sequence[LessonsOfLog], filled: LedgerUpdate, logs: int, battery_sha256: str
) -> list[list[RememberedPack]]:
    """Return for each log the packs of its flights, with their health before the log; the ledger must be filled."""
    met: list[list[RememberedPack]] = [[] for _ in range(logs)]
    begun_utc_s = dict[int, float]()
    for log, flights in lessons:
        met[log], begun_utc_s[log] = [NOT_MET] * len(flights), flights[0].start_utc_s
    for name, flights_of_pack in _by_pack(lessons).items():
        every = ledger.flights(name)
        for (log, index), lesson in flights_of_pack:
            last = ledger.before(name, begun_utc_s[log], lesson.key)
            health = prior(last, lesson.start_utc_s, battery_sha256) if last is not None else None
            own = (after for after in every if after.flight.is_of(lesson.key, lesson.start_utc_s))
            words = [finding.words for after in own for finding in after.findings]
            words += [filled.left_out[log, index]] if (log, index) in filled.left_out else []
            met[log][index] = RememberedPack(health, tuple(f"pack {name}: {one}" for one in words))
    return met


def _by_pack(lessons: Iterable[LessonsOfLog]) -> dict[str, Sequence[Placed]]:
    """Return the flights of each named pack in order of time; flights without a clock come last."""
    packs: dict[str, list[Placed]] = defaultdict(list)
    for log, flights in lessons:
        for index, lesson in enumerate(flights):
            if lesson.pack:
                packs[lesson.pack].append(((log, index), lesson))
    return {name: sorted(flights, key=_moment) for name, flights in packs.items()}


def _moment(placed: Placed) -> tuple[float, Place]:
    place, lesson = placed
    return (lesson.start_utc_s if math.isfinite(lesson.start_utc_s) else math.inf, place)
