"""Frames of a telemetry log (.tlog): 8 bytes big-endian microseconds, then one MAVLink frame.

    v1: FE len seq sys comp id payload crc16                                     8 + len bytes
    v2: FD len incompat compat seq sys comp id[3] payload crc16 (signature[13]) 12 + len bytes
The CRC is checked on the wanted messages and wherever the chain of frames was broken; elsewhere it
is enough that the next frame starts where this one ends (checking all would take 20 times longer).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

_V1, _V2 = 0xFE, 0xFD
_SIGNED = 0x01
_STAMP = 8
_LATEST_US = 4_102_444_800_000_000  # the year 2100; early times are real: a clock never set starts in 1970
_HEAD_BYTES = 65_536

Decode = Callable[[bytes], Any]  # whole frame -> message; None if damaged; `False` if its type is unknown


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame: reception time [s], who sent it, and the message if it was wanted."""

    time_s: float
    system: int
    component: int
    message_id: int
    message: Any = None


def decoder() -> Decode:
    """pymavlink's decoder, independent of its environment variables, CRC checked, trimmed payloads filled."""
    from pymavlink.dialects.v20 import ardupilotmega

    link = ardupilotmega.MAVLink(None)

    def decode(frame: bytes) -> Any:
        try:
            message = link.decode(bytearray(frame))
        except ardupilotmega.MAVError:
            return None
        return False if message.get_type().startswith("UNKNOWN") else message

    return decode


def frames(data: bytes, wanted: frozenset[int], decode: Decode) -> Iterator[tuple[int, Frame | None]]:
    """(bytes skipped before it, frame) in file order; the last item is (bytes skipped, None)."""
    position, skipped, in_chain = 0, 0, False
    while position + _STAMP < len(data):
        end = _frame_end(data, position)
        frame = _checked(data, position, end, wanted, decode, in_chain) if end else None
        if frame is None:
            following = _next_candidate(data, position + 1)
            skipped += following - position
            position, in_chain = following, False
            continue
        yield skipped, frame
        position, skipped, in_chain = end, 0, True
    yield skipped + max(len(data) - position, 0), None


def looks_like_tlog(data: bytes) -> bool:
    """True if the head of `data` holds at least one time-stamped frame with a good CRC."""
    if len(data) <= _STAMP or not any(mark in data[:_HEAD_BYTES] for mark in (b"\xfe", b"\xfd")):
        return False
    decode = decoder()
    every_id = frozenset(range(1 << 16))  # "wanted" means that the CRC is checked
    return any(f is not None and f.message for _, f in frames(data[:_HEAD_BYTES], every_id, decode))


def _frame_end(data: bytes, position: int) -> int:
    """Where the frame after the stamp at `position` would end; 0 if there cannot be one."""
    start = position + _STAMP
    if start + 3 > len(data):
        return 0
    stamp_us = int.from_bytes(data[position:start], "big")
    if stamp_us > _LATEST_US:
        return 0
    if data[start] == _V1:
        end = start + 8 + data[start + 1]
    elif data[start] == _V2 and data[start + 2] in (0, _SIGNED):
        end = start + 12 + data[start + 1] + 13 * data[start + 2]
    else:
        return 0
    return end if end <= len(data) else 0


def _checked(
    data: bytes, position: int, end: int, wanted: frozenset[int], decode: Decode, in_chain: bool
) -> Frame | None:
    """The frame between the stamp at `position` and `end`, or None if it is damaged."""
    start = position + _STAMP
    time_s = int.from_bytes(data[position:start], "big") / 1e6
    if data[start] == _V1:
        system, component, message_id = data[start + 3], data[start + 4], data[start + 5]
    else:
        system, component = data[start + 5], data[start + 6]
        message_id = int.from_bytes(data[start + 7 : start + 10], "little")
    follows = end + _STAMP >= len(data) or data[end + _STAMP] in (_V1, _V2)
    if in_chain and follows and message_id not in wanted:
        return Frame(time_s, system, component, message_id)
    message = decode(data[start:end])
    if message is None or (message is False and not follows):
        return None
    return Frame(time_s, system, component, message_id, message or None)


def _next_candidate(data: bytes, position: int) -> int:
    """The next place whose ninth byte could start a frame; the end of the data if there is none."""
    hits = [hit for mark in (b"\xfe", b"\xfd") if (hit := data.find(mark, position + _STAMP)) >= 0]
    return min(hits) - _STAMP if hits else len(data)
