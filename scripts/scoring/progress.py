"""Progress of a long score, on stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable


def progress(began_s: float) -> Callable[[str], None]:
    """Return a teller that writes each step to stderr, with the seconds since `began_s` (`time.monotonic`)."""

    def say(text: str) -> None:
        print(f"[{time.monotonic() - began_s:5.0f} s] {text}", file=sys.stderr, flush=True)

    return say
