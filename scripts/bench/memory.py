"""Memory of a process, as Linux counts it."""

from __future__ import annotations

import os
from pathlib import Path


def resident_MB(pid: int) -> float:
    """Return the resident memory of a process [MB]."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
