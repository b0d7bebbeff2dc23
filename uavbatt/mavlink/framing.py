"""MAVLink frames as bytes: where they begin and end, their checksum, and one field that may be rewritten.

    v1: FE len seq sys comp id payload crc16                                     8 + len bytes
    v2: FD len incompat compat seq sys comp id[3] payload crc16 (signature[13]) 12 + len bytes

The checksum is CRC-16/MCRF4XX over everything from `len` to the payload's end plus one byte of the message's
definition (CRC_EXTRA, 154 for BATTERY_STATUS). A v2 sender cuts trailing zeros of the payload, and the reader adds them
again. No dependencies, because the small proxy process uses it.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

V1, V2 = 0xFE, 0xFD
SIGNED = 0x01
V1_OVERHEAD, V2_OVERHEAD, SIGNATURE = 8, 12, 13
V2_HEADER = 10
BATTERY_STATUS, BATTERY_CRC_EXTRA = 147, 154
ID_AT, PERCENT_AT, TIME_AT, TIME_END = 32, 35, 36, 40  # payload offsets of BATTERY_STATUS
# Messages that are sent only once and are useful even if late: parameters (PARAM_*), missions (MISSION_*), commands and
# their answers, STATUSTEXT, files and logs (FILE_TRANSFER_PROTOCOL, LOG_*), AUTOPILOT_VERSION.
_COMMANDS, _PARAMETERS, _MISSIONS = (11, 75, 76, 77), (*range(20, 24), *range(320, 325)), (*range(37, 48), 51, 73)
SENT_ONCE = frozenset((*_COMMANDS, *_PARAMETERS, *_MISSIONS, 110, *range(117, 123), 148, 253))
LONGEST = V2_OVERHEAD + 255 + SIGNATURE


def _crc_table() -> tuple[int, ...]:
    table = []
    for value in range(256):
        for _ in range(8):
            value = (value >> 1) ^ 0x8408 if value & 1 else value >> 1
        table.append(value)
    return tuple(table)


_TABLE = _crc_table()


def crc16(data: bytes, extra: int) -> int:
    """Return the CRC-16/MCRF4XX of `data` and the message's CRC_EXTRA."""
    crc = 0xFFFF
    for byte in data:
        crc = (crc >> 8) ^ _TABLE[(crc ^ byte) & 0xFF]
    return (crc >> 8) ^ _TABLE[(crc ^ extra) & 0xFF]


class Header(NamedTuple):
    """The header tells who sent a frame, and what it is."""

    system: int
    component: int
    message_id: int

    @property
    def source(self) -> tuple[int, int]:
        """Return system and component of the sender."""
        return self.system, self.component


def frame_length(data: bytes, start: int) -> int:
    """Return the length of the frame whose first byte is at `start`; 0: none starts here; -1: too few bytes to tell."""
    mark = data[start]
    if mark not in (V1, V2):
        return 0
    if len(data) - start < (2 if mark == V1 else 3):
        return -1
    if mark == V1:
        return V1_OVERHEAD + data[start + 1]
    return V2_OVERHEAD + data[start + 1] + (SIGNATURE if data[start + 2] & SIGNED else 0)


def header(frame: bytes) -> Header:
    """Return sender and message id of a whole frame."""
    if frame[0] == V1:
        return Header(frame[3], frame[4], frame[5])
    return Header(frame[5], frame[6], frame[7] | frame[8] << 8 | frame[9] << 16)


def _next_mark(data: bytes, position: int) -> int:
    """Return the place of the next byte that could begin a frame; the end of the data if there is none."""
    found = [at for mark in (b"\xfe", b"\xfd") if (at := data.find(mark, position)) >= 0]
    return min(found, default=len(data))


def pieces(data: bytes, start: int = 0) -> Iterator[tuple[int, int, bool]]:
    """Yield (from, to, is a whole frame) over all of `data`; the last piece may be a frame cut short."""
    garbage_from, position = start, start
    while position < len(data):
        length = frame_length(data, position)
        if length == 0:
            position = _next_mark(data, position + 1)
            continue
        if garbage_from < position:
            yield garbage_from, position, False
        if length < 0 or position + length > len(data):
            yield position, len(data), False
            return
        yield position, position + length, True
        position = garbage_from = position + length
    if garbage_from < position:
        yield garbage_from, position, False


def sequence(frame: bytes) -> int:
    """Return the sender's running number of a whole frame, 0..255."""
    return frame[2] if frame[0] == V1 else frame[4]


def is_sent_once(data: bytes) -> bool:
    """Return True if bytes begin with a frame that is worth something late (SENT_ONCE)."""
    return len(data) >= V2_HEADER and data[0] in (V1, V2) and header(data).message_id in SENT_ONCE


def is_signed(frame: bytes) -> bool:
    """Return True if a whole frame carries a signature."""
    return frame[0] == V2 and bool(frame[2] & SIGNED)


class BatteryStatusParts(NamedTuple):
    """BatteryStatusParts holds the parts of a BATTERY_STATUS that a rewriter needs."""

    id: int
    percent: int
    time_remaining_s: int  # 0: not provided


def battery_of(frame: bytes) -> BatteryStatusParts | None:
    """Return the battery of an unsigned v2 BATTERY_STATUS with a good checksum; None for any other frame."""
    if len(frame) < V2_OVERHEAD or frame[0] != V2 or frame[2] != 0 or frame[7:10] != b"\x93\x00\x00":
        return None
    end = V2_HEADER + frame[1]
    if len(frame) != end + 2 or crc16(frame[1:end], BATTERY_CRC_EXTRA) != frame[end] | frame[end + 1] << 8:
        return None
    payload = frame[V2_HEADER:end].ljust(TIME_END, b"\0")
    percent, left_s = struct.unpack_from("<bi", payload, PERCENT_AT)
    return BatteryStatusParts(payload[ID_AT], percent, left_s)


def with_battery(frame: bytes, time_remaining_s: int, percent: int | None) -> bytes:
    """Return the same BATTERY_STATUS frame (see `battery_of`) with another time [s] and, if given, percent."""
    payload = bytearray(frame[V2_HEADER : V2_HEADER + frame[1]].ljust(TIME_END, b"\0"))
    struct.pack_into("<i", payload, TIME_AT, time_remaining_s)
    if percent is not None:
        struct.pack_into("<b", payload, PERCENT_AT, percent)
    trimmed = bytes(payload).rstrip(b"\0") or b"\0"
    body = bytes([len(trimmed)]) + frame[2:V2_HEADER] + trimmed
    return bytes([V2]) + body + struct.pack("<H", crc16(body, BATTERY_CRC_EXTRA))


class Splitter:
    """Splitter cuts a byte stream into whole frames and garbage; what is not yet whole waits for the next bytes."""

    def __init__(self) -> None:
        self._rest = b""
        self._owed = 0  # bytes of a frame whose beginning was handed out before it was whole

    @property
    def waiting(self) -> bool:
        """Return True if the beginning of a frame is held."""
        return bool(self._rest)

    def feed(self, data: bytes) -> list[tuple[bytes, bool]]:
        """Return (bytes, is a whole frame) in order; together they are all bytes fed but those still waiting."""
        made: list[tuple[bytes, bool]] = []
        if self._owed:
            owed, data = data[: self._owed], data[self._owed :]
            self._owed -= len(owed)
            made.append((owed, False))
        data, self._rest = self._rest + data, b""
        for begin, end, whole in pieces(data):
            if not whole and end == len(data) and frame_length(data, begin) != 0:
                self._rest = data[begin:end]
            else:
                made.append((data[begin:end], whole))
        return made

    def flush(self) -> bytes:
        """Return the bytes that wait; the rest of their frame is passed on as it comes."""
        held, self._rest = self._rest, b""
        length = frame_length(held, 0) if held else 0
        self._owed = max(length - len(held), 0)
        return held


class Frames:
    """Frames finds complete frames in a byte stream or in datagrams, and finds the next one again after damage.

    A damaged length would hide the frames behind it. So the caller checks each frame and calls `reject` if it is
    broken: then the search goes on one byte after the start of that frame.
    """

    def __init__(self) -> None:
        self._data = b""
        self._last = (0, 0)

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Yield whole frames, one after the other; `reject()` may be called before the next is taken."""
        self._data += data
        position = 0
        while position < len(self._data):
            length = frame_length(self._data, position)
            if length == 0:
                position = _next_mark(self._data, position + 1)
                continue
            if length < 0 or position + length > len(self._data):
                break
            self._last = (position + 1, position + length)
            yield self._data[position : position + length]
            position = self._last[1]
        self._data = self._data[position:]

    def reject(self) -> None:
        """Reject the last frame: go on with the search one byte after its start."""
        self._last = (self._last[0], self._last[0])
