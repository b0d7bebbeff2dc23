"""Opening of the ledger's SQLite file, and its errors in words."""

from __future__ import annotations

import os
import sqlite3
from pathlib import Path

from uavbatt.errors import BadInput
from uavbatt.files import no_file

PATIENCE_S = 10.0  # longest wait for another writer
BROKEN = (sqlite3.DatabaseError, UnicodeDecodeError)  # the second for a text, in a row or an error, that is damaged


def open_file(path: Path, only_read: bool) -> sqlite3.Connection:
    """Return a connection to the file; only_read : it must exist. Raises BadInput for what is no ledger."""
    if only_read and not path.exists():
        raise BadInput(path, "", "a pack ledger, found no such file")
    if found := no_file(path):
        raise BadInput(path, "", f"a pack ledger, found {found}")
    if not path.parent.is_dir():
        raise BadInput(path, "", "an existing folder to keep the pack ledger in")
    try:
        mode = ("ro&immutable=1" if _is_on_read_only(path) else "ro") if only_read else "rwc"
        connection = sqlite3.connect(
            f"{path.resolve().as_uri()}?mode={mode}", uri=True, timeout=PATIENCE_S, isolation_level=None,
            check_same_thread=False,
        )  # fmt: skip
        connection.row_factory = sqlite3.Row
        if not only_read:
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = FULL")  # a commit is on the disk
        connection.execute("PRAGMA foreign_keys = ON")
    except BROKEN as error:
        raise BadInput(path, "", words_of(error)) from None
    return connection


def file_identity(path: Path) -> tuple[int, int] | None:
    """Return what tells this file from another one at the same path; None if there is no file."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _is_on_read_only(path: Path) -> bool:
    """Return True for a ledger that nobody can be writing: SQLite must not look for a lock that it cannot make."""
    whole = path.resolve()
    wal = whole.with_name(f"{whole.name}-wal")
    return not os.access(whole.parent, os.W_OK) and not (wal.exists() and wal.stat().st_size > 0)


def words_of(error: Exception) -> str:
    """Return what was expected of the ledger, and what SQLite found."""
    text = "text that is no text" if isinstance(error, UnicodeDecodeError) else str(error)
    if "locked" in text:
        return f"a pack ledger that nobody else writes for {PATIENCE_S:.0f} s, found it locked"
    if "full" in text:
        return "room on the disk for the pack ledger, found it full: nothing was changed"
    if "not a database" in text:
        return "a pack ledger, found a file of another kind"
    return f"a pack ledger that can be read and written, SQLite says: {text}"
