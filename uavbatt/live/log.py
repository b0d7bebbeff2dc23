"""Lines of the companion process and its proxy for their log, the error stream."""

from __future__ import annotations

import sys
from contextlib import suppress

from uavbatt.errors import terminal_line
from uavbatt.mavlink.pipe import takes_bytes


def tell(words: str, who: str = "uavbatt") -> None:
    """Write a line to the log; a reader who has gone, or a terminal that is stopped, is neither waited nor died for."""
    with suppress(OSError, ValueError):
        if _is_read():
            print(terminal_line(f"{who}: {words}"), file=sys.stderr, flush=True)


def _is_read() -> bool:
    try:
        return takes_bytes(sys.stderr.fileno())
    except ValueError:  # a stream without a descriptor takes all
        return True
