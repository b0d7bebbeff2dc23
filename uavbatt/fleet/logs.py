"""Search for logs: paths, folders and patterns on this disk, or addresses of any file system that fsspec knows.

/data/**/*.tlog                     a pattern
/data/summer                        a folder: every log in it, by suffix, at any depth; packed ones as well
s3://bucket/logs/*.BIN              a pattern behind an address
zip://*.tlog::https://host/a.zip    files inside an archive
"""

from __future__ import annotations

import glob
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path, PurePath
from typing import Any

from uavbatt.errors import BadInput, UsageError
from uavbatt.telemetry.read import MOST_BYTES

SUFFIXES = (".bin", ".log", ".tlog", ".ulg", ".csv", ".zip")
JOURNAL, TABLE = "flights.jsonl", "flights.csv"  # files of a fleet's output folder, which are no logs
LESSONS = "lessons.jsonl"
_CHANGED = ("mtime", "last_modified", "LastModified", "updated", "ETag", "etag", "created", "CRC")


class Unreadable(BadInput):
    """Unreadable is raised for a log whose bytes cannot be read now; the next run tries again."""


@dataclass(frozen=True, slots=True)
class LogFile:
    """A LogFile is a log to be replayed: path or address, size [bytes], and time of change in any form."""

    name: str
    size: int
    changed: str

    def read(self) -> bytes:
        """Return the bytes. Raises Unreadable when they cannot be read, BadInput for more than any log has."""
        if self.size > MOST_BYTES:
            raise BadInput(self.name, "", f"a log, found a file of more than {MOST_BYTES >> 30} GiB")
        try:
            return _read_bytes(self.name) if "://" in self.name else Path(self.name).read_bytes()
        except Exception as error:  # a remote file system raises whatever its library raises
            raise Unreadable(self.name, "", f"a log that can be read: {_words(error)}") from None


def find_logs(patterns: Iterable[str], without: Iterable[str] = ()) -> list[LogFile]:
    """Return every log that the patterns name, each once, by name.

    without : patterns of what is left out, of a log's whole path or address, or of its file name alone
    Raises UsageError for a pattern that names nothing, and when nothing is left.
    """
    by_path: dict[str, LogFile] = {}
    for pattern in patterns:
        logs = list(_remote(pattern) if "://" in pattern else _local(pattern))
        if not logs:
            raise UsageError(f"{pattern}: expected the name of a log, a folder or a pattern of logs, found none")
        by_path |= {log.name: log for log in logs}
    for pattern in without:
        left_out = [name for name in by_path if _fits(name, pattern)]
        if not left_out:
            raise UsageError(f"--exclude {pattern}: expected a pattern of a log's name or whole path, it fits none")
        for name in left_out:
            del by_path[name]
    if not by_path:
        raise UsageError("--exclude: expected that some logs are left, all are left out")
    return sorted(by_path.values(), key=lambda log: log.name)


def _fits(name: str, pattern: str) -> bool:
    return fnmatchcase(name, pattern) or fnmatchcase(PurePath(name).name, pattern)


def _local(pattern: str) -> Iterator[LogFile]:
    names = [pattern] if Path(pattern).exists() else glob.glob(pattern, recursive=True)
    for name in names:
        path = Path(name)
        files = (p for p in path.rglob("*") if _is_log(p)) if path.is_dir() else (path,)
        for file in files:
            if file.is_file() and not _is_own_table(file):
                stat = file.stat()
                yield LogFile(str(file.resolve()), stat.st_size, str(stat.st_mtime_ns))


def _is_log(file: Path) -> bool:
    """Return True if the name ends as that of a log, packed by gzip or not."""
    name = PurePath(file.name.lower().removesuffix(".gz"))
    return name.suffix in SUFFIXES


def _is_own_table(file: Path) -> bool:
    """Return True for a table of an earlier run, which a pattern may include."""
    return file.name == TABLE and (file.parent / JOURNAL).exists()


def _remote(pattern: str) -> Iterator[LogFile]:
    from fsspec.core import open_files

    try:
        files = open_files(pattern, "rb")
        for file in files:
            info: dict[str, Any] = file.fs.info(file.path)
            if info.get("type") != "directory":
                changed = next((str(info[key]) for key in _CHANGED if info.get(key) is not None), "")
                yield LogFile(_address(pattern, file), int(info.get("size") or 0), changed)
    except Exception as error:
        raise UsageError(f"{pattern}: expected an address that can be listed: {_words(error)}") from None


def _address(pattern: str, file: Any) -> str:
    """Return the whole address of one file of a pattern; in an archive the archive's address stays behind it."""
    outer = pattern.partition("::")[2]
    if outer:
        return f"{pattern.partition('://')[0]}://{file.path}::{outer}"
    return str(file.full_name)


def _read_bytes(name: str) -> bytes:
    from fsspec.core import open as open_address

    with open_address(name, "rb") as stream:
        data: bytes = stream.read()
        return data


def _words(error: Exception) -> str:
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return " ".join(text.split())
