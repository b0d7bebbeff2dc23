"""Lines of the companion process for its log, which is the error stream."""

from __future__ import annotations

import sys
from contextlib import suppress


def tell(words: str) -> None:
    """Write a line to the log; a log that nobody reads any more is no error."""
    with suppress(OSError, ValueError):
        print(f"uavbatt: {words}", file=sys.stderr, flush=True)
