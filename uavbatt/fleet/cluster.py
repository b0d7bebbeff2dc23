"""Workers of an existing Dask cluster (`--scheduler tcp://host:8786`); its owner must protect the access to it."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Generic

from uavbatt import __version__
from uavbatt.errors import UavbattError, UsageError
from uavbatt.fleet.errand import Errand, Rows

WAIT_FOR_WORKERS_S = 30  # a worker that starts with the cluster is there by then


class Cluster(Generic[Rows]):
    """A Cluster is a crew with as many workers as a Dask cluster has threads."""

    def __init__(self, client: Any) -> None:
        from distributed import as_completed

        self.size = max(sum(client.nthreads().values()), 1)
        self._client = client
        self._under_way: dict[Any, tuple[int, Errand[Rows]]] = {}
        self._coming = as_completed(loop=client.loop)

    def send(self, number: int, errand: Errand[Rows]) -> None:
        """Send an errand to the workers; `number` is that of its log."""
        future = self._client.submit(errand.done, pure=False, retries=1)
        self._under_way[future] = (number, errand)
        self._coming.add(future)

    def finished(self) -> tuple[int, Rows]:
        """Wait for the next row that comes back, and return it with the number of its log."""
        future = next(self._coming)
        number, errand = self._under_way.pop(future)
        row = self._row(future, errand)
        future.release()
        return number, row

    def _row(self, future: Any, errand: Errand[Rows]) -> Rows:
        """Return the rows of a future; an errand never raises, so that an error here is one of the cluster."""
        try:
            row: Rows = future.result()
        except Exception as error:
            if self._client.status != "running":
                raise UavbattError("lost the cluster: run again, the rows that are done are kept") from None
            reason = f"the worker ended while it read this log, perhaps for lack of memory ({type(error).__name__})"
            return errand.lost(errand.log, reason)
        return row


@contextmanager
def joined(scheduler: str) -> Iterator[Cluster[Any]]:
    """Yield the crew of a cluster.

    Raises UavbattError if the cluster does not answer, has no workers, or runs another version of uavbatt.
    """
    from distributed import Client

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        client = Client(scheduler, timeout=10, set_as_default=False)
    except Exception as error:  # every transport has its own errors for a wrong address
        raise UsageError(f"--scheduler {scheduler}: expected a Dask scheduler that answers: {error}") from None
    with client:
        _check_workers(client, scheduler)
        yield Cluster(client)


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
