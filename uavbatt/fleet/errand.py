"""An errand: one log, and the work that makes a row of it, as sent to a worker."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from uavbatt.fleet.logs import LogFile

Row = TypeVar("Row")


@dataclass(frozen=True, slots=True)
class Errand(Generic[Row]):
    """An Errand is the work on one log; both functions can be pickled.

    work : returns the log's row, and never raises; lost : returns the row of a log whose worker died, with the reason
    """

    log: LogFile
    work: Callable[[LogFile], Row]
    lost: Callable[[LogFile, str], Row]

    def done(self) -> Row:
        """Return the row of the log."""
        return self.work(self.log)
