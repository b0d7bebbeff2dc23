"""An errand: one log, and the work that makes rows of it, as sent to a worker."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from uavbatt.fleet.logs import LogFile

Rows = TypeVar("Rows")


@dataclass(frozen=True, slots=True)
class Errand(Generic[Rows]):
    """An Errand is the work on one log; both functions can be pickled.

    work : returns the log's rows, and never raises; lost : returns those of a log whose worker died, with the reason
    """

    log: LogFile
    work: Callable[[LogFile], Rows]
    lost: Callable[[LogFile, str], Rows]

    def done(self) -> Rows:
        """Return the rows of the log."""
        return self.work(self.log)
