"""Lines of the companion process for its log, the error stream."""

from __future__ import annotations

import sys
from contextlib import suppress


def tell(words: str) -> None:
    """Write a line to the log; the process goes on if nobody reads the log any more."""
    with suppress(OSError, ValueError):
        print(f"uavbatt: {words}", file=sys.stderr, flush=True)
