"""Errors in one line, with their exit codes, and foreign text made safe to print.

Every error that a user can cause is a `UavbattError`. Its text names the file, the place in it and
what was expected, so that the command line prints it as it is and never a traceback.
"""

from __future__ import annotations

import unicodedata
from os import PathLike
from pathlib import Path


class UavbattError(Exception):
    """UavbattError is an error with a one-line message for the user; exit code 1 (failed or bad data)."""

    exit_code = 1


class BadInput(UavbattError):
    """BadInput says that a file, or a place in it, is not what was expected."""

    def __init__(self, file: str | Path, place: str, expected: str) -> None:
        where = f"{file}: {place}" if place else f"{file}"
        super().__init__(f"{where}: expected {expected}")


def misread(file: str | Path, error: Exception, kind: str) -> BadInput:
    """Return the error for a file that msgspec could not decode as `kind`.

    The key that msgspec names becomes the place.
    """
    said = "too deeply nested" if isinstance(error, RecursionError) else " ".join(str(error).split())
    what, _, key = said.partition(" - at `$.")
    if key and what.startswith("Expected "):
        return BadInput(file, f"key {key.rstrip('`')}", f"{what.removeprefix('Expected ')}, in {kind}")
    return BadInput(file, f"key {key.rstrip('`')}" if key else "", f"{kind}: {what}")


class Uncertified(UavbattError):
    """Uncertified says that a battery file's hash is broken, a verdict in it is `fail`, or its status is `edited`."""


class UsageError(UavbattError):
    """UsageError says that a call cannot be carried out as it was written."""

    exit_code = 2


class CapacityNotStated(UsageError):
    """CapacityNotStated says that neither caller nor vehicle nor battery file states the capacity of the pack."""


def check_path(argument: str, value: object, expected: str) -> None:
    """Raise UsageError, with the argument's name, for a value that names no file."""
    if not isinstance(value, str | PathLike):
        raise UsageError(f"{argument}={value!r}: expected {expected}")


class MissingExtra(UavbattError):
    """MissingExtra says that an optional dependency is missing, with the pip line that adds it."""

    exit_code = 3

    def __init__(self, extra: str, purpose: str) -> None:
        super().__init__(f"{purpose} needs the extra `{extra}`: pip install 'uavbatt[{extra}]'")


class NotEnoughData(UavbattError):
    """NotEnoughData says that the data are sound, but too few for the question."""

    exit_code = 4


# Control bytes in a file name can clear a screen, escape sequences can overwrite it, direction marks can reverse a
# name. So all foreign text (file names, cells, logs, battery files) goes through these two functions.
def printable(text: str) -> str:
    """Return `text` with control, surrogate and direction-changing characters, which would break a page, as U+FFFD."""
    return "".join("\ufffd" if unicodedata.category(c) in ("Cc", "Cf", "Cs") and c not in "\n\t" else c for c in text)


def terminal_line(text: object) -> str:
    """Return `text` as one line of a terminal."""
    return printable(str(text).replace("\n", " ").replace("\t", " "))
