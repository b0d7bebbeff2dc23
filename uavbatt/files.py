"""Output files that are written completely or not at all, and values as JSON: unknown (NaN, infinity) is null.

The content goes to a temporary file beside the target (on the same file system, so that the renaming is atomic), which
replaces the target when the block ends. After an exception in the block the old file is unchanged.
"""

from __future__ import annotations

import codecs
import dataclasses
import json
import math
import os
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import IO, Any, BinaryIO, Literal, TextIO, overload

import msgspec

from uavbatt.errors import BadInput, printable

STDOUT = "-"
_FOREIGN = re.compile("[\x7f-\U0010ffff]")  # characters that JSON does not escape by itself


@overload
def atomic_write(path: str | Path, mode: Literal["w"] = "w") -> AbstractContextManager[TextIO]: ...
@overload
def atomic_write(path: str | Path, mode: Literal["wb"]) -> AbstractContextManager[BinaryIO]: ...
def atomic_write(path: str | Path, mode: Literal["w", "wb"] = "w") -> AbstractContextManager[Any]:
    """Open a file that appears under `path` only when the block ends without an exception.

    mode : "w" text in UTF-8 with its line ends as written, where `-` is standard output; "wb" bytes.

    Raises BadInput when nothing can be written there.
    """
    return _standard_output() if mode == "w" and str(path) == STDOUT else _aside(Path(path), mode)


@contextmanager
def _standard_output() -> Iterator[TextIO]:
    yield sys.stdout


@contextmanager
def _aside(target: Path, mode: str) -> Iterator[IO[Any]]:
    if target.is_dir():
        raise BadInput(target, "", "a file to write, found a directory")
    aside = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        with _opened(aside, mode, target) as file:
            yield file
        os.replace(aside, target)
    finally:  # begins before the file is made: a signal may end the process in any line
        with suppress(OSError):
            aside.unlink()


def _opened(aside: Path, mode: str, target: Path) -> IO[Any]:
    """Open the temporary file. Raises BadInput, with the name of the target, if that is not possible."""
    try:
        return aside.open(mode) if "b" in mode else aside.open(mode, encoding="utf-8", newline="")
    except OSError as error:
        raise BadInput(target, "", f"a place that can be written: {error.strerror}") from None


def no_file(path: Path) -> str:
    """Return "a directory" or "a device or a pipe" for a path that names one; empty otherwise."""
    if not path.exists() or path.is_file():
        return ""
    return "a directory" if path.is_dir() else "a device or a pipe"


def read_bounded(path: Path, most_bytes: int, expected: str) -> bytes:
    """Read a whole text file. Raises BadInput, with what was `expected`, for a file that cannot be read.

    The mark of byte order, which editors of Windows put before the text, is left out.
    most_bytes : a larger file is refused. A device or a pipe is refused before it is opened: it may have no end, or
    nobody who writes to it.
    """
    try:
        if str(path) != os.devnull and (found := no_file(path)):
            raise BadInput(path, "", f"{expected}, found {found}")
        with path.open("rb") as stream:
            content = stream.read(most_bytes + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise BadInput(path, "", f"{expected}, cannot be read: {reason}") from None
    if len(content) > most_bytes:
        raise BadInput(path, "", f"{expected} of at most {most_bytes // 1_000_000} MB")
    return content.removeprefix(codecs.BOM_UTF8)


def plain(value: Any) -> Any:
    """Return dataclasses, arrays and mappings as dicts, lists and numbers; NaN and infinity become None.

    Keys that are numbers (ambient temperatures) become their shortest text.
    """
    if isinstance(value, msgspec.Struct):
        return plain(msgspec.to_builtins(value))
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {key if isinstance(key, str) else f"{key:g}": plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # an array or number of numpy, which is not loaded only to ask for its types
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def without_none(value: Any) -> Any:
    """Return plain values without their Nones, at any depth, because TOML has no null."""
    if isinstance(value, dict):
        return {k: without_none(v) for k, v in value.items() if v is not None}
    return [without_none(v) for v in value] if isinstance(value, list) else value


def write_json(path: Path, content: Any, indent: int = 2) -> None:
    """Write `content`, made `plain`, to `path`."""
    with atomic_write(path, "w") as stream:
        stream.write(json_for(stream, json.dumps(plain(content), indent=indent, ensure_ascii=False)) + "\n")


def json_for(stream: TextIO, text: str) -> str:
    """Return JSON with escapes for characters that could control a terminal, or that `stream` cannot encode.

    stream : what it is written to; a character that its encoding does not have is escaped, as JSON allows
    """
    if text.isascii() and "\x7f" not in text:
        return text
    encoding = stream.encoding or "utf-8"
    return _FOREIGN.sub(lambda found: found[0] if _fits(found[0], encoding) else json.dumps(found[0])[1:-1], text)


def _fits(character: str, encoding: str) -> bool:
    """Return True for a character that may be printed and that the encoding has."""
    return printable(character) == character and bool(character.encode(encoding, "ignore"))
