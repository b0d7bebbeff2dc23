"""Is it worth compiling? The extra `fast` (numba) does the same arithmetic over arrays some hundred times faster.

Compiled code is kept in the user's cache folder, in one folder per state of the sources, so that neither a read-only
installation nor a new version of the package goes wrong. Loading it takes START_S with the import of numba, making it
COMPILE_S (measured, on one core): work that plain numpy does sooner is left to it. How much there will be of a work
nobody knows; when as much could have been spared as loading or making costs, as much again is likely. In flight nobody
asks.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path

START_S = {"filter": 0.4, "forecast": 0.4, "openloop": 2.0}  # the last gains two to three times only: it must wait
COMPILE_S = {"filter": 9.0, "forecast": 4.0, "openloop": 2.0}  # the kinds of work
_allowed = True
_used: set[str] = set()
_spared_s: dict[str, float] = {}


@cache
def is_installed() -> bool:
    """Whether numba is there; it is not imported to find out."""
    return find_spec("numba") is not None


@cache
def is_usable() -> bool:
    """Whether numba can indeed be imported: it refuses a numpy that is newer than it knows."""
    try:
        importlib.import_module("numba")
    except Exception:
        return False
    return True


@contextmanager
def left_out() -> Iterator[None]:
    """Plain numpy only, inside the block."""
    global _allowed
    before, _allowed = _allowed, False
    try:
        yield
    finally:
        _allowed = before


def pays(spared_s: float, work: str) -> bool:
    """Whether to do a work compiled that is then done about `spared_s` sooner; once it pays, it does so for good."""
    place = folder() if _allowed and is_installed() else None
    if place is None:
        return False
    if work not in _used:
        _spared_s[work] = _spared_s.get(work, 0.0) + spared_s
        cost_s = START_S[work] + (0.0 if (place / work).exists() else COMPILE_S[work])
        if _spared_s[work] > cost_s and is_usable():
            _used.add(work)
    return work in _used


def is_used(work: str) -> bool:
    """Whether that has been found."""
    return _allowed and work in _used


def is_made(work: str) -> None:
    """All that this work needs has been compiled, and is in the folder now."""
    place = folder()
    if place is not None and not (place / work).exists():
        with suppress(OSError):
            (place / work).touch()


@cache
def folder() -> Path | None:
    """Where compiled code of these sources is kept; None where nothing can be written."""
    package = Path(__file__).parent
    digest = hashlib.sha256(sys.version.encode())
    for part in ("battery", "estimation", "prediction"):
        for source in sorted((package / part).glob("*.py")):
            digest.update(source.read_bytes())
    try:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
        place = home / "uavbatt" / digest.hexdigest()[:16]
        place.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return None
    return place if os.access(place, os.W_OK) else None
