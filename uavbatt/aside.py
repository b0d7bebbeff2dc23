"""Output files that appear whole or not at all.

What is written goes to a temporary name beside the target (same file system, so that the renaming is atomic) and
takes the target's place when the block ends. An exception in the block leaves the old file, or none.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import IO, Any, BinaryIO, Literal, TextIO, overload

from uavbatt.errors import BadInput

STDOUT = "-"


@overload
def written_aside(path: str | Path, mode: Literal["w"] = "w") -> AbstractContextManager[TextIO]: ...
@overload
def written_aside(path: str | Path, mode: Literal["wb"]) -> AbstractContextManager[BinaryIO]: ...
def written_aside(path: str | Path, mode: Literal["w", "wb"] = "w") -> AbstractContextManager[Any]:
    """A file that appears under `path` only when the block ends without an exception.

    mode : "w" text in UTF-8 with its line ends as written, where `-` is standard output; "wb" bytes
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
        file = aside.open(mode) if "b" in mode else aside.open(mode, encoding="utf-8", newline="")
    except OSError as error:
        raise BadInput(target, "", f"a place that can be written: {error.strerror}") from None
    try:
        with file:
            yield file
        os.replace(aside, target)
    finally:
        aside.unlink(missing_ok=True)
