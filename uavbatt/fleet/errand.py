"""An errand goes out to a worker: a log, and the work that makes a row of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from uavbatt.fleet.logs import LogFile

Row = TypeVar("Row")


@dataclass(frozen=True, slots=True)
class Errand(Generic[Row]):
    """An Errand is one log to be worked on by any worker; both functions can be pickled.

    work : makes the log's row, and never raises; lost : makes the row of a log whose worker died, from the reason.
    """

    log: LogFile
    work: Callable[[LogFile], Row]
    lost: Callable[[LogFile, str], Row]

    def done(self) -> Row:
        """Return the row of the log."""
        return self.work(self.log)
