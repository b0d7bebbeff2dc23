"""Workers on this machine: processes connected by unnamed pipes.

No port is open, so that no other user of the machine can make a worker run code.

    queue -> the pipe of an idle worker -> its work -> the pipe -> row

A worker has one log at a time, so that the log is known if the worker dies or uses more memory than its share. That log
is tried once more in a new process; if it fails again, its row says so.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any, Generic, NamedTuple

from uavbatt.errors import UavbattError, UsageError
from uavbatt.fleet.errand import Errand, Rows

TRIES = 2  # a log that kills its process twice is at fault itself
LOOK_PERIOD_S = 1.0  # how often processes are looked after; a flight takes some seconds
MEMORY_IN_USE = 0.9  # of the machine's memory, by all workers together
LEAST_BYTES = 150e6  # memory of a worker with a small log
_SPAWN = multiprocessing.get_context("spawn")


class Task(NamedTuple):
    """A Task is an errand with the number of its log, and how often it has been tried."""

    number: int
    errand: Errand[Any]
    tries: int = 0


class Worker:
    """A Worker is one process, with the log that it is working on."""

    def __init__(self) -> None:
        self.line, theirs = _SPAWN.Pipe()
        self._process: SpawnProcess = _SPAWN.Process(target=_work, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()
        self.task: Task | None = None
        self.is_ready = False

    def give(self, task: Task) -> None:
        """Give the worker an errand."""
        self.task = task
        with suppress(OSError):  # it is dead, as its pipe will tell
            self.line.send(task.errand)

    def memory_bytes(self) -> int:
        """Return the memory that the worker uses now [bytes]; 0 if the system does not tell."""
        try:
            pages = int(Path(f"/proc/{self._process.pid}/statm").read_text("ascii").split()[1])
        except (OSError, ValueError, IndexError):
            return 0
        return pages * os.sysconf("SC_PAGE_SIZE")

    def end(self) -> int | None:
        """Kill the process, and return its exit code."""
        self.line.close()
        self._process.kill()
        self._process.join()
        return self._process.exitcode


class Processes(Generic[Rows]):
    """Processes is a crew of `size` workers on this machine; each may take `limit_bytes` [bytes] of memory."""

    def __init__(self, size: int, limit_bytes: float | None = None) -> None:
        self.size = size
        self._limit_bytes = limit_bytes or MEMORY_IN_USE * machine_bytes() / size
        self._look_s = time.monotonic() + LOOK_PERIOD_S
        self._queue: deque[Task] = deque()
        self._workers = [Worker() for _ in range(size)]

    def send(self, number: int, errand: Errand[Rows]) -> None:
        """Send an errand to the workers; `number` is that of its log."""
        self._queue.append(Task(number, errand))
        self._hand_out()

    def finished(self) -> tuple[int, Rows]:
        """Wait for the next row that comes back, and return it with the number of its log."""
        return next(row for row in self._rows() if row is not None)

    def _rows(self) -> Iterator[tuple[int, Rows] | None]:
        """Yield the rows of workers that have finished, died, or grown too big."""
        while True:
            if time.monotonic() >= self._look_s:
                self._look_s = time.monotonic() + LOOK_PERIOD_S
                busy = [worker for worker in self._workers if worker.task is not None]
                for worker in [w for w in busy if w.memory_bytes() > self._limit_bytes]:
                    yield self._replace_worker(worker, f"it took more than {self._limit_bytes / 1e6:.0f} MB of memory")
            self._hand_out()
            for line in wait([worker.line for worker in self._workers], LOOK_PERIOD_S):
                row = self._row_from(next(w for w in self._workers if w.line is line))
                self._hand_out()
                yield row

    def close(self) -> None:
        """End the workers, whatever they are working on."""
        for worker in self._workers:
            worker.end()

    def _hand_out(self) -> None:
        for worker in self._workers:
            if self._queue and worker.is_ready and worker.task is None:
                worker.give(self._queue.popleft())

    def _row_from(self, worker: Worker) -> tuple[int, Rows] | None:
        try:
            row: Rows | None = worker.line.recv()
        except (EOFError, OSError):
            return self._replace_worker(worker, "the worker ended while it read this log, perhaps for lack of memory")
        task, worker.task, worker.is_ready = worker.task, None, True
        return None if task is None or row is None else (task.number, row)

    def _replace_worker(self, worker: Worker, reason: str) -> tuple[int, Rows] | None:
        """Replace a lost worker by a new one; return the row of its log if that has been tried often enough."""
        code, task = worker.end(), worker.task
        if not worker.is_ready:
            raise UavbattError(f"expected a worker process that starts, it ended with exit code {code}")
        self._workers[self._workers.index(worker)] = Worker()
        if task is None:
            return None
        if task.tries + 1 < TRIES:
            self._queue.appendleft(task._replace(tries=task.tries + 1))
            return None
        row: Rows = task.errand.lost(task.errand.log, f"{reason} (exit code {code})")
        return task.number, row


def check_workers(count: int | None) -> None:
    """Raise UsageError for so many workers that the machine has not the memory to start them."""
    most = max(1, int(MEMORY_IN_USE * machine_bytes() / LEAST_BYTES))
    if count is not None and count > most:
        raise UsageError(f"--workers {count}: expected at most {most}, for each takes {LEAST_BYTES / 1e6:.0f} MB")


def machine_bytes() -> float:
    """Return the memory of the machine, or of the container that this runs in [bytes]."""
    size = float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    try:
        return min(size, float(Path("/sys/fs/cgroup/memory.max").read_text("ascii")))
    except (OSError, ValueError):  # no such file, or `max`
        return size


def _work(line: Connection) -> None:
    """Run the worker until the other end of its pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the run ends its workers
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    gc.set_threshold(50_000)  # as in the command: rows have no reference cycles
    import uavbatt.fleet.lesson  # noqa: F401  # all that errands need, loaded before the first

    try:
        line.send(None)
        while True:
            errand: Errand[Any] = line.recv()
            line.send(errand.done())
    except (EOFError, OSError):
        return


def _end_with_parent() -> None:
    """End this process when its parent dies."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
