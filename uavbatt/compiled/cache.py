"""Folder of the compiled code: in the user's cache folder, in one folder per state of the sources, so that neither a
read-only installation nor a new version of the package goes wrong.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import sys
from functools import cache
from pathlib import Path

SOURCES = ("battery", "compiled", "estimation", "prediction")


@cache
def is_available() -> bool:
    """Return True if numba can be imported and has a folder to write to.

    numba cannot be imported with a numpy that is too new for it.
    """
    if cache_dir() is None:
        return False
    try:
        importlib.import_module("numba")
    except Exception:
        return False
    return True


@cache
def cache_dir() -> Path | None:
    """Return the folder for compiled code of these sources; None where nothing can be written."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256(sys.version.encode())
    for part in SOURCES:
        for source in sorted((package / part).rglob("*.py")):
            digest.update(source.read_bytes())
    try:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
        place = home / "uavbatt" / digest.hexdigest()[:16]
        place.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return None
    return place if os.access(place, os.W_OK) else None
