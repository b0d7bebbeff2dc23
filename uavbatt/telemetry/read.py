"""`read_log`: recognise a flight log by its content and read it into a `Flight`."""

from __future__ import annotations

import gc
import math
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, SupportsIndex

from uavbatt.errors import BadInput, UsageError, check_path, printable
from uavbatt.records import Flight
from uavbatt.telemetry.builder import LogBuilder, default_instance
from uavbatt.telemetry.formats.logger_table import kind_of_table
from uavbatt.telemetry.formats.packed import Content as Content
from uavbatt.telemetry.formats.packed import as_log, is_packed, unpacked
from uavbatt.telemetry.identity import completed, stated_serials
from uavbatt.telemetry.parameters import capacity_notes, facts_timeline

if TYPE_CHECKING:
    from uavbatt.telemetry.columns import Columns

KNOWN_KINDS = "a flight log (DataFlash .BIN or .log, .tlog, PX4 .ulg, or a CSV of telemetry, DJI, radio or blackbox)"
STANDARD_INPUT = "-"
MOST_BYTES = 2**32  # the largest file on the FAT32 card of an autopilot
_HEAD_BYTES = 65_536
_FMT_LINE = re.compile(rb"^FMT\s*,", re.MULTILINE)
_ADDRESS = re.compile(r"[a-z]{3,6}:/", re.IGNORECASE)
_WORD = re.compile(r"[A-Za-z_]{2,}")
_ULOG = b"ULog\x01\x12\x35"
_UTF16 = (b"\xff\xfe", b"\xfe\xff")  # byte order marks, as spreadsheets write them with "Unicode text"
_BLACKBOX, _DJI_RECORD = b"H Product:Blackbox", "DJIFlightRecord"  # how the file begins, and its name
_DATAFLASH = b"\xa3\x95\x80"  # the head of a FMT record, which begins a DataFlash log
_ODD_IN_TEXT = bytes(byte for byte in range(32) if not 9 <= byte <= 13)


def read_log(path: str | Path, instance: int | None = None, system: int | None = None) -> Flight:
    """Read a flight log of any supported kind.

    instance: the battery to read (ArduPilot's instances, MAVLink's ids: from 0). By default the
    one that carries the flight (`default_instance`).
    system: MAVLink's number of the vehicle in a `.tlog` that holds several. By default the first that speaks of a
    battery.
    path: `-` reads standard input; a log in gzip, or alone in a zip archive, is unpacked.
    Raises BadInput for a file that is no readable flight log, UsageError for an absent instance or system.
    """
    check_path("path", path, "the path of a flight log")
    with _uncollected():
        return read_bytes(*content_of(Path(path)), instance, system)


@contextmanager
def _uncollected() -> Iterator[None]:
    """Pause the garbage collector: rows have no reference cycles, and the search for some takes a quarter of the
    reading of a long log."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def read_bytes(source: str, data: Content, instance: int | None = None, system: int | None = None) -> Flight:
    """Read a flight log that is in memory; `source` is its name, an address perhaps. Otherwise as `read_log`."""
    from uavbatt.telemetry.columns import rows_of
    from uavbatt.telemetry.discharges import discharge_notes, last_row_s, later_discharges

    kind, log = _kind_and_rows(source, data, system)
    chosen = _chosen(source, log, instance)
    rows = log.columns[chosen] if log.columns else rows_of(log.rows[chosen])
    serials, stated = log.serials.get(chosen, []), stated_serials(log.parameters, chosen)
    known = {name: value for _, name, value in log.parameters}
    discharges = later_discharges(rows, serials, stated)
    until_s = last_row_s(rows, discharges[0][0]) if discharges else math.inf
    of_first = [one for one in log.parameters if one[0] <= until_s]  # not of a later pack
    return Flight(
        source=printable(source),
        kind=kind,
        samples=tuple(rows.samples() if log.columns else log.rows[chosen]),
        instance=chosen,
        instances=tuple(sorted(log.columns or log.rows)),
        facts=facts_timeline(log.parameters, chosen, is_telemetry=kind == "tlog"),
        duration_s=log.now_s,
        skipped_bytes=log.skipped_bytes,
        notes=(*log.all_notes(), *capacity_notes(known, chosen), *discharge_notes(discharges)),
        identity=completed(log.identity, of_first, chosen, log.packs.get(chosen)),
        navigation=log.navigation,
        forecast_period_s=log.forecast_period_s,
        discharges=discharges,
    )


def read_columns(path: str | Path) -> Columns:
    """Read the rows of the battery that carries the flight as numpy columns instead of objects."""
    from uavbatt.telemetry.columns import rows_of

    _, log = _kind_and_rows(*content_of(Path(path)), has_route=False)
    chosen = _chosen(str(path), log, None)
    return log.columns[chosen] if log.columns else rows_of(log.rows[chosen])


def content_of(path: Path) -> tuple[str, Content]:
    """Return the name and the bytes of a log, read once: standard input and pipes cannot be read twice.

    Raises BadInput for a file that cannot be read.
    """
    if str(path) == STANDARD_INPUT:
        return as_log("standard input", sys.stdin.buffer.read())
    try:
        _check_has_end(path)
        with path.open("rb") as file:
            head = file.peek()
            if is_packed(head):
                return unpacked(str(path), file.read())
            return str(path), file.read() if _is_text(head) else _binary(file)
    except FileNotFoundError:
        found = "an address: download the log first" if _ADDRESS.match(str(path)) else "no such file"
        raise BadInput(path, "", f"{KNOWN_KINDS}, found {found}") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise BadInput(path, "", f"{KNOWN_KINDS}, cannot be read: {reason}") from None


def _check_has_end(path: Path) -> None:
    """Raise BadInput for a directory, a device or a file that is too large for the memory."""
    found = ""
    if path.is_dir():
        found = "a directory"
    elif path.is_char_device() or path.is_block_device():
        found = "a device"
    elif path.is_file() and path.stat().st_size > MOST_BYTES:
        found = f"a file of more than {MOST_BYTES >> 30} GiB"
    if found:
        raise BadInput(path, "", f"{KNOWN_KINDS}, found {found}")


def _binary(file: BufferedReader) -> Content:
    """Return a whole binary file in numpy's memory, whose large pages are faster than Python's own."""
    import numpy as np

    found = np.empty(os.fstat(file.fileno()).st_size, np.uint8).data
    size = file.readinto(found)
    rest = file.read()  # more bytes, of a pipe or of a file that still grows
    return bytes(found[:size]) + rest if rest else found[:size]


def _kind(source: str, data: Content) -> str:
    """Return the kind of log by its content; by its suffix only if the head is damaged."""
    head = bytes(data[:_HEAD_BYTES])
    if head.startswith(_ULOG):
        return "ulog"
    if head.startswith(_DATAFLASH):
        return "dataflash-binary"
    if _is_text(head):
        if _FMT_LINE.search(head):
            return "dataflash-text"
        table = kind_of_table(head)
        if table != "csv" or PurePath(source).suffix.lower() == ".csv" or _is_table(head):
            return table
        raise BadInput(source, "", f"{KNOWN_KINDS}, found text of another kind")
    if head.startswith(_BLACKBOX):
        raise BadInput(source, "", f"{KNOWN_KINDS}, found an encoded blackbox log: decode it with blackbox_decode")
    if PurePath(source).name.startswith(_DJI_RECORD):
        raise BadInput(source, "", f"{KNOWN_KINDS}, found an encoded DJI flight record: convert it to CSV first")
    # a damaged head: try tlog first, because a tlog may contain a downloaded DataFlash log
    from uavbatt.telemetry.formats.tlog_frames import looks_like_tlog

    if looks_like_tlog(data):
        return "tlog"
    if _DATAFLASH in head:
        return "dataflash-binary"
    if _FMT_LINE.search(head):
        return "dataflash-text"
    if head.startswith(_UTF16):
        raise BadInput(source, "", f"{KNOWN_KINDS}, found text in UTF-16: save it as UTF-8")
    raise BadInput(source, "", f"{KNOWN_KINDS}, found a file of another kind")


def _is_text(head: bytes) -> bool:
    """Return True if there is no NUL and hardly any byte that text does not have."""
    odd = len(head) - len(head.translate(None, _ODD_IN_TEXT))
    return b"\0" not in head and odd <= len(head) // 1000 and b"%PDF" not in head[:8]


def _is_table(head: bytes) -> bool:
    """Return True if the first line could be the header of a telemetry table, well or badly spelt."""
    first = head.lstrip().split(b"\n")[0].decode("utf-8", errors="replace")
    names = {name.lower() for name in _WORD.findall(first)}
    return bool(re.search("[,;\t]", first)) and any(n.startswith(("time", "volt")) for n in names)


def _kind_and_rows(
    source: str, data: Content, system: int | None = None, has_route: bool = True
) -> tuple[str, LogBuilder]:
    """Return the kind of a log and its rows, of a tlog with route and place if `has_route`.

    Raises BadInput if it is no log or has no rows.
    """
    if not data or (bytes(data[:_HEAD_BYTES]).isspace() and bytes(data).isspace()):
        raise BadInput(source, "", f"{KNOWN_KINDS}, found an empty file")
    kind = _kind(source, data)
    if system is not None and kind != "tlog":
        raise UsageError(f"{source}: system {system}: only a .tlog holds several vehicles, this is a log of one")
    log = _rows(kind, source, data, system, has_route)
    if not (log.rows or log.columns):
        dropped = "; ".join(log.all_notes())
        raise BadInput(source, "", "battery messages with a voltage, found none" + (f" ({dropped})" if dropped else ""))
    return kind, log


def _rows(kind: str, source: str, data: Content, system: int | None, has_route: bool) -> LogBuilder:
    """Return what a log of a kind holds; only the reader of that kind is imported."""
    if kind == "dataflash-binary":
        from uavbatt.telemetry.formats.dataflash_binary import read_dataflash

        return read_dataflash(data)
    if kind == "tlog":
        from uavbatt.telemetry.formats.tlog import read_tlog

        return read_tlog(source, data, system, has_route)
    whole = bytes(data)
    if kind == "dataflash-text":
        from uavbatt.telemetry.formats.dataflash_text import read_dataflash_text

        return read_dataflash_text(whole)
    if kind == "ulog":
        from uavbatt.telemetry.formats.ulog import read_ulog

        return read_ulog(source, whole)
    if kind == "airdata":
        from uavbatt.telemetry.formats.airdata_csv import read_airdata

        return read_airdata(source, whole)
    if kind == "dji-record":
        from uavbatt.telemetry.formats.dji_record_csv import read_dji_record

        return read_dji_record(source, whole)
    if kind == "edgetx":
        from uavbatt.telemetry.formats.edgetx_csv import read_edgetx

        return read_edgetx(source, whole)
    if kind == "blackbox":
        from uavbatt.telemetry.formats.blackbox_csv import read_blackbox

        return read_blackbox(source, whole)
    from uavbatt.telemetry.formats.csv_table import read_csv

    return read_csv(source, whole)


def _chosen(source: str, log: LogBuilder, instance: int | None) -> int:
    """Return the wanted instance, or the default one. Raises UsageError if the log does not have it."""
    if not isinstance(instance, SupportsIndex | None):
        raise UsageError(f"instance={instance!r}: expected the number of a battery, or None")
    chosen = default_instance(log) if instance is None else instance
    there = log.columns or log.rows
    if chosen not in there:
        named = ", ".join(str(i) for i in sorted(there))
        raise UsageError(f"{source}: no battery instance {chosen}; the log has: {named}")
    return chosen
