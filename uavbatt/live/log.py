"""Lines of the companion process and its proxy for their log, the error stream."""

from __future__ import annotations

import sys
from contextlib import suppress

from uavbatt.errors import terminal_line
from uavbatt.mavlink.pipe import takes_bytes


def tell(words: str, who: str = "uavbatt") -> None:
    """Write a line to the log; drop it if nobody reads the log any more, or if the terminal is stopped.

    The process neither waits nor ends because of its log.
    """
    with suppress(OSError, ValueError):
        if _is_read():
            print(terminal_line(f"{who}: {words}"), file=sys.stderr, flush=True)


def _is_read() -> bool:
    try:
        return takes_bytes(sys.stderr.fileno())
    except ValueError:  # a stream without a descriptor takes all
        return True
