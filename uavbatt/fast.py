"""Is it worth compiling? The extra `fast` (numba) does the same arithmetic over arrays some hundred times faster.

Compiled code is kept in the user's cache folder, in one folder per state of the sources, so that neither a read-only
installation nor a new version of the package goes wrong. Loading it takes START_S, making it COMPILE_S (measured, with
the import of numba, on one core): work that plain numpy does sooner is left to it. In flight nothing is compiled.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path

START_S, COMPILE_S = 0.6, 15.0
_allowed = True
_used: set[str] = set()


@cache
def is_installed() -> bool:
    """Whether numba can be imported; it is not imported to find out."""
    return find_spec("numba") is not None


@contextmanager
def left_out() -> Iterator[None]:
    """Plain numpy only, inside the block."""
    global _allowed
    before, _allowed = _allowed, False
    try:
        yield
    finally:
        _allowed = before


def pays(plain_s: float, *works: str) -> bool:
    """Whether compiled code, start included, is sooner done with what takes plain numpy about `plain_s`.

    A work is what is compiled together. Once it has paid it is used for the rest of the process.
    """
    place = folder() if _allowed and is_installed() else None
    if place is None:
        return False
    if not _used.issuperset(works):
        cost_s = START_S if all((place / work).exists() for work in works) else COMPILE_S
        if plain_s <= cost_s:
            return False
        _used.update(works)
    return True


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
