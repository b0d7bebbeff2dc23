"""The run: logs go out to workers, rows come back and are on disk before the next log goes out.

    logs -> a bounded number under way -> fly (worker process) -> journal -> tables

Few logs are under way at a time, so that memory does not grow with the number of flights.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from uavbatt import __version__
from uavbatt.errors import MissingExtra, UavbattError, UsageError
from uavbatt.fleet import journal, tables
from uavbatt.fleet.fly import Job, bad, fly
from uavbatt.fleet.logs import LogFile
from uavbatt.fleet.row import LOST, Row

WAIT_FOR_WORKERS_S = 30
_UNDER_WAY_PER_WORKER = 3
# Dask lets its workers give every freed page back at once; a flight takes and frees the same few megabytes thousands
# of times, which made the kernel work as long as half the flight.
_MALLOC = {"MALLOC_TRIM_THRESHOLD_": 1 << 25, "MALLOC_MMAP_THRESHOLD_": 1 << 25}
_DASK = {f"distributed.nanny.pre-spawn-environ.{name}": value for name, value in _MALLOC.items()} | {
    "distributed.worker.profile.enabled": False,  # nobody reads it
    "distributed.admin.tick.interval": "1s",  # every process looks 50 times a second how busy it is: half of its idling
}


@dataclass(frozen=True, slots=True)
class Finished:
    """One log done: its row, how many are done by now (those of earlier runs included), and of how many.

    dropped: damaged rows of earlier runs that were taken out of the journal.
    """

    row: Row | None
    done: int
    total: int
    dropped: int = 0


def check_extra() -> None:
    """Raise MissingExtra when Dask or pyarrow is not installed."""
    try:
        import distributed  # noqa: F401
        import pyarrow  # noqa: F401
    except ImportError:
        raise MissingExtra("fleet", "a fleet of flights") from None


@contextmanager
def connected(workers: int, scheduler: str | None = None) -> Iterator[Any]:
    """A Dask client: of an existing cluster, or of `workers` processes on this machine that end with the block.

    Raises UavbattError when the cluster does not answer, has no workers, or runs another version of uavbatt.
    """
    import dask
    from distributed import Client, LocalCluster

    if scheduler is None:
        with (
            dask.config.set(_DASK),
            LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None,
                silence_logs=logging.CRITICAL,
            ) as cluster,
            Client(cluster, set_as_default=False) as client,
        ):  # fmt: skip
            yield client
        return
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with _client_of(scheduler) as client:
        _check_workers(client, scheduler)
        yield client


def run(connection: AbstractContextManager[Any], logs: Sequence[LogFile], job: Job, folder: Path) -> Iterator[Finished]:
    """Fly every log that `folder` has no row of yet, then write its tables; yields as logs are done.

    connection: see `connected`; not entered when there is nothing to do. The first item tells how many were done
    before. Raises UavbattError when the cluster goes away: what is done stays done, and the next run goes on there.
    """
    job_key = journal.job_key(job)
    keys = [journal.key(log, job_key) for log in logs]
    with journal.Journal(folder, {key: number for number, key in enumerate(keys)}) as done:
        yield Finished(None, len(done), len(logs), done.dropped)
        if len(done) < len(logs):
            to_do = [number for number in range(len(logs)) if number not in done]
            with connection as client:
                for number, row in _flown(client, logs, job, to_do):
                    done.add(number, keys[number], row)
                    yield Finished(row, len(done), len(logs))
        tables.write(folder, done.rows())
        done.tidy()


def rows(folder: Path, logs: Sequence[LogFile], job: Job) -> Iterator[Row]:
    """The rows of a finished run, one at a time."""
    job_key = journal.job_key(job)
    keys = {journal.key(log, job_key): number for number, log in enumerate(logs)}
    with journal.Journal(folder, keys) as done:
        yield from done.rows()


def _flown(client: Any, logs: Sequence[LogFile], job: Job, to_do: Sequence[int]) -> Iterator[tuple[int, Row]]:
    """(number of the log, its row) as they come back."""
    from distributed import as_completed

    threads = max(sum(client.nthreads().values()), 1)
    limit, numbers = _UNDER_WAY_PER_WORKER * threads, iter(to_do)
    job = replace(job, flights_each=len(to_do) // threads)
    under_way: dict[Any, int] = {}
    coming = as_completed(loop=client.loop)

    def send() -> None:
        while len(under_way) < limit and (number := next(numbers, None)) is not None:
            future = client.submit(fly, logs[number], job, pure=False, retries=1)
            under_way[future] = number
            coming.add(future)

    send()
    for future in coming:
        number = under_way.pop(future)
        yield number, _row(client, future, logs[number], job)
        future.release()
        send()


def _row(client: Any, future: Any, log: LogFile, job: Job) -> Row:
    """The row of a future. `fly` raises nothing, so an error here is the cluster's."""
    try:
        row: Row = future.result()
    except Exception as error:
        if client.status != "running":
            raise UavbattError("the cluster went away: run again, what is done stays done") from None
        return bad(log, job, f"the worker died on it, of too little memory perhaps ({type(error).__name__})", LOST)
    return row


@contextmanager
def _client_of(scheduler: str) -> Iterator[Any]:
    from distributed import Client

    try:
        client = Client(scheduler, timeout=10, set_as_default=False)
    except Exception as error:  # an address can be wrong in as many ways as there are transports
        raise UsageError(f"--scheduler {scheduler}: expected a Dask scheduler that answers: {error}") from None
    with client:
        yield client


def _check_workers(client: Any, scheduler: str) -> None:
    try:
        client.wait_for_workers(1, timeout=WAIT_FOR_WORKERS_S)
    except TimeoutError:
        raise UavbattError(f"{scheduler}: expected a worker within {WAIT_FOR_WORKERS_S} s, there is none") from None
    try:
        versions = client.run(_version)
    except Exception as error:
        raise UavbattError(f"{scheduler}: expected uavbatt {__version__} on every worker: {error}") from None
    for worker, version in versions.items():
        if version != __version__:
            raise UavbattError(f"{scheduler}: expected uavbatt {__version__} on worker {worker}, found {version}")


def _version() -> str:
    from uavbatt import __version__

    return __version__
