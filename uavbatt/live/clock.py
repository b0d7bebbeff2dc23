"""The clock of the companion process and its proxy, from which the age of each value is worked out.

A laptop that listens as a ground station sleeps when its lid is closed. Python's monotonic clock stands still then: a
time left, or a saved state, of an hour ago would look a second old. The clock of the boot goes on.
"""

from __future__ import annotations

import time

_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)  # macOS has the first under the second's name


def now_s() -> float:
    """Return the time since the computer's boot [s]: it never falls, and goes on while the computer sleeps."""
    return time.clock_gettime(_CLOCK)
