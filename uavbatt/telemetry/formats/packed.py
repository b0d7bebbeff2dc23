"""Packed logs: a log in gzip, or the only file of a zip archive, is unpacked in memory before it is read."""

from __future__ import annotations

import gzip
import io
import zipfile
import zlib
from typing import IO

from uavbatt.errors import BadInput

GZIP, ZIP = b"\x1f\x8b", b"PK\x03\x04"
MOST_BYTES = 2**31  # a packed file of a few kB can hold any number of zeros
_CHUNK = 1 << 20

Content = bytes | memoryview  # of a file


def is_packed(head: bytes) -> bool:
    """Return True if a file begins as gzip or zip does."""
    return head.startswith((GZIP, ZIP))


def as_log(source: str, data: Content) -> tuple[str, Content]:
    """Return name and content of a log that may be packed. Raises BadInput as `unpacked`."""
    return unpacked(source, bytes(data)) if is_packed(bytes(data[: len(ZIP)])) else (source, data)


def unpacked(source: str, data: bytes) -> tuple[str, bytes]:
    """Return name and content of a packed log.

    source : name of the packed file; the log's own name is it without `.gz`, or the name in the archive
    data : the packed bytes
    Raises BadInput for damaged or encrypted files, for archives of none or several files, and beyond MOST_BYTES.
    """
    try:
        if data.startswith(GZIP):
            with gzip.GzipFile(fileobj=io.BytesIO(data)) as file:
                return source.removesuffix(".gz"), _limited(source, file)
        return _only_file(source, data)
    except (OSError, EOFError, zlib.error, zipfile.BadZipFile, RuntimeError, NotImplementedError) as error:
        raise BadInput(source, "", f"a whole gzip or zip file: {error}") from None


def _only_file(source: str, data: bytes) -> tuple[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        files = [entry for entry in archive.infolist() if not entry.is_dir()]
        if len(files) != 1:
            raise BadInput(source, "", f"an archive of one log, found {len(files)} files: unpack it first")
        with archive.open(files[0]) as file:
            return f"{source}/{files[0].filename}", _limited(source, file)


def _limited(source: str, file: IO[bytes] | gzip.GzipFile) -> bytes:
    found = io.BytesIO()
    while chunk := file.read(_CHUNK):
        found.write(chunk)
        if found.tell() > MOST_BYTES:
            raise BadInput(source, "", f"a log of {MOST_BYTES >> 30} GiB at most once unpacked")
    return found.getvalue()
