"""The run: logs go out to workers, rows come back and are on disk before the next log goes out.

    logs -> a bounded number under way -> fly (worker process, or a cluster's) -> journal -> tables

Few logs are under way at a time, so that memory does not grow with the number of flights.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from uavbatt.errors import MissingExtra
from uavbatt.fleet import journal, tables
from uavbatt.fleet.fly import Job
from uavbatt.fleet.logs import LogFile
from uavbatt.fleet.processes import Processes
from uavbatt.fleet.row import FlightRow

_UNDER_WAY_PER_WORKER = 3


class Crew(Protocol):
    """The workers that replay the logs."""

    size: int

    def fly(self, number: int, log: LogFile, job: Job) -> None:
        """Have a log flown."""

    def finished(self) -> tuple[int, FlightRow]:
        """The next row that comes back, with the number of its log."""


@dataclass(frozen=True, slots=True)
class Finished:
    """One log done: its row, how many are done by now (those of earlier runs included), and of how many.

    dropped: damaged rows of earlier runs that were taken out of the journal.
    """

    row: FlightRow | None
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
def connected(workers: int, scheduler: str | None = None) -> Iterator[Crew]:
    """The crew of an existing Dask cluster, or of `workers` processes on this machine that end with the block.

    Raises UavbattError when the cluster does not answer, has no workers, or runs another version of uavbatt.
    """
    if scheduler is None:
        with closing(Processes(workers)) as crew:
            yield crew
        return
    from uavbatt.fleet.cluster import joined

    with joined(scheduler) as cluster:
        yield cluster


def run_fleet(
    crew: AbstractContextManager[Crew], logs: Sequence[LogFile], job: Job, folder: Path
) -> Iterator[Finished]:
    """Fly every log that `folder` has no row of yet, then write its tables; yields as logs are done.

    crew: see `connected`; not entered when there is nothing to do. The first item tells how many were done before.
    Raises UavbattError when the cluster goes away: what is done stays done, and the next run goes on there.
    """
    job_key = journal.job_key(job)
    keys = [journal.key(log, job_key) for log in logs]
    with journal.Journal(folder, {key: number for number, key in enumerate(keys)}) as done:
        yield Finished(None, len(done), len(logs), done.dropped)
        if len(done) < len(logs):
            to_do = [number for number in range(len(logs)) if number not in done]
            with crew as at_work:
                for number, row in _flown(at_work, logs, job, to_do):
                    done.add(number, keys[number], row)
                    yield Finished(row, len(done), len(logs))
        tables.write_tables(folder, done.rows())
        done.tidy()


def rows(folder: Path, logs: Sequence[LogFile], job: Job) -> Iterator[FlightRow]:
    """The rows of a finished run, one at a time."""
    job_key = journal.job_key(job)
    keys = {journal.key(log, job_key): number for number, log in enumerate(logs)}
    with journal.Journal(folder, keys) as done:
        yield from done.rows()


def _flown(crew: Crew, logs: Sequence[LogFile], job: Job, to_do: Sequence[int]) -> Iterator[tuple[int, FlightRow]]:
    """(number of the log, its row) as they come back."""
    job = replace(job, flights_each=len(to_do) // crew.size)
    sent = 0
    for done in range(len(to_do)):
        while sent < len(to_do) and sent - done < _UNDER_WAY_PER_WORKER * crew.size:
            crew.fly(to_do[sent], logs[to_do[sent]], job)
            sent += 1
        yield crew.finished()
