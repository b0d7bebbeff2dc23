"""The run: logs are sent to workers, and each row is on disk before the next log is sent.

    logs -> a bounded number under way -> fly (worker process, or a cluster's) -> journal -> tables

Only a few logs are under way at a time, so that memory does not grow with the number of flights. With a pack ledger the
logs are sent twice: first for the records that fill the ledger, then to be replayed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from uavbatt.errors import MissingExtra
from uavbatt.fleet import fly, journal, lesson, tables
from uavbatt.fleet.errand import Errand, Rows
from uavbatt.fleet.fly import Job, RememberedPack
from uavbatt.fleet.journal import Journal
from uavbatt.fleet.ledger import LessonsOfLog
from uavbatt.fleet.lesson import Lesson, lesson_of
from uavbatt.fleet.logs import JOURNAL, LESSONS, LogFile
from uavbatt.fleet.processes import Processes
from uavbatt.fleet.row import LOST, FlightRow, row_of

_UNDER_WAY_PER_WORKER = 3  # so that no worker waits for its next log, and few are lost with it


class Workers(Protocol[Rows]):
    """Workers is the interface of a group of workers."""

    size: int

    def send(self, number: int, errand: Errand[Rows]) -> None:
        """Send an errand to the workers; `number` is that of its log."""

    def finished(self) -> tuple[int, Rows]:
        """Wait for the next row that comes back, and return it with the number of its log."""


@dataclass(frozen=True, slots=True)
class FinishedLog:
    """FinishedLog tells how many logs are done (with earlier runs), and of how many.

    is_new : False before the first log of this run; dropped : damaged rows of earlier runs that were removed
    """

    is_new: bool
    done: int
    total: int
    dropped: int = 0


def check_extra(scheduler: str | None = None) -> None:
    """Raise MissingExtra when pyarrow, or for a scheduler Dask, is not installed."""
    try:
        import pyarrow  # noqa: F401

        if scheduler is not None:
            import distributed  # noqa: F401
    except ImportError:
        raise MissingExtra("fleet", "a fleet of flights") from None


@contextmanager
def connected(workers: int, scheduler: str | None = None) -> Iterator[Workers[Any]]:
    """Yield the crew of an existing Dask cluster, or of `workers` processes here that end with the block.

    Raises UavbattError when the cluster does not answer, has no workers, or runs another version of uavbatt.
    """
    if scheduler is None:
        with closing(Processes[Any](workers)) as crew:
            yield crew
        return
    from uavbatt.fleet.cluster import joined

    with joined(scheduler) as cluster:
        yield cluster


def learn_all(
    crew: AbstractContextManager[Workers[tuple[Lesson, ...]]], logs: Sequence[LogFile], job: Job, folder: Path
) -> Iterator[FinishedLog]:
    """Work out the record of each flight for the ledger, for all logs that `folder` does not have; yield finished ones.

    crew and errors as in `run_fleet`; `lessons` gives what was found.
    """

    def errand(number: int, _: int) -> Errand[tuple[Lesson, ...]]:
        return Errand(logs[number], partial(lesson.learn, job=job), lesson.lost_lessons)

    keys = _lesson_keys(logs, job)
    with Journal(folder / LESSONS, _numbers(keys), lesson_of) as store:
        yield from _worked_off(crew, errand, keys, store)
        store.tidy()


def lessons(folder: Path, logs: Sequence[LogFile], job: Job) -> Iterator[LessonsOfLog]:
    """Yield (number of the log, the lessons of its flights) of a finished first pass, without unreadable logs."""
    with Journal(folder / LESSONS, _numbers(_lesson_keys(logs, job)), lesson_of) as store:
        yield from ((number, lessons) for number, lessons in store.rows() if lessons[0].status != LOST)


def run_fleet(
    crew: AbstractContextManager[Workers[tuple[FlightRow, ...]]],
    logs: Sequence[LogFile],
    job: Job,
    folder: Path,
    met: Sequence[Sequence[RememberedPack]] = (),
) -> Iterator[FinishedLog]:
    """Replay every log without rows in `folder`, then write its tables; yield the finished logs.

    crew: see `connected`; not entered when there is nothing to do. The first item tells how many were done before.
    met: the packs of each log's flights, where a ledger knows them. Raises UavbattError when the cluster goes away:
    what is done stays done, and the next run goes on there.
    """

    def errand(number: int, each: int) -> Errand[tuple[FlightRow, ...]]:
        flight_job = replace(job, flights_each=each)
        work = partial(fly.fly_log, job=flight_job, met=met[number] if met else ())
        return Errand(logs[number], work, partial(fly.lost_rows, job=flight_job))

    keys = _keys(logs, job, met)
    with Journal(folder / JOURNAL, _numbers(keys), row_of) as store:
        yield from _worked_off(crew, errand, keys, store)
        tables.write_tables(folder, (row for _, rows in store.rows() for row in rows))
        store.tidy()


def rows(
    folder: Path, logs: Sequence[LogFile], job: Job, met: Sequence[Sequence[RememberedPack]] = ()
) -> Iterator[FlightRow]:
    """Yield the rows of a finished run, one at a time."""
    with Journal(folder / JOURNAL, _numbers(_keys(logs, job, met)), row_of) as store:
        yield from (row for _, rows in store.rows() for row in rows)


def _keys(logs: Sequence[LogFile], job: Job, met: Sequence[Sequence[RememberedPack]]) -> list[str]:
    job_key = journal.job_key(job)
    return [journal.key(log, job_key, packs) for log, packs in zip(logs, met or [()] * len(logs), strict=True)]


def _lesson_keys(logs: Sequence[LogFile], job: Job) -> list[str]:
    lesson_key = journal.lesson_key(job)
    return [journal.key(log, lesson_key) for log in logs]


def _numbers(keys: Sequence[str]) -> dict[str, int]:
    return {key: number for number, key in enumerate(keys)}


def _worked_off(
    crew: AbstractContextManager[Workers[tuple[journal.Row, ...]]],
    errand: Callable[[int, int], Errand[tuple[journal.Row, ...]]],
    keys: Sequence[str],
    store: Journal[journal.Row],
) -> Iterator[FinishedLog]:
    """Send out the errands of all logs without rows in the journal, and write the rows as they come.

    errand : makes the errand of the log with a number, for a worker that does about so many of them.
    """
    yield FinishedLog(False, len(store), len(keys), store.dropped)
    to_do = [number for number in range(len(keys)) if number not in store]
    if not to_do:
        return
    with crew as at_work:
        for number, rows_of_log in _sent_out(at_work, errand, to_do):
            store.add(number, keys[number], rows_of_log)
            yield FinishedLog(True, len(store), len(keys))


def _sent_out(
    crew: Workers[Rows], errand: Callable[[int, int], Errand[Rows]], to_do: Sequence[int]
) -> Iterator[tuple[int, Rows]]:
    """Send out the errands, and yield (number of the log, its row) as they come back."""
    each, sent = len(to_do) // crew.size, 0
    for count in range(len(to_do)):
        while sent < len(to_do) and sent - count < _UNDER_WAY_PER_WORKER * crew.size:
            crew.send(to_do[sent], errand(to_do[sent], each))
            sent += 1
        yield crew.finished()
