"""Frames of a telemetry log (.tlog): 8 bytes big-endian microseconds, then one MAVLink frame.

    v1: FE len seq sys comp id payload crc16                                     8 + len bytes
    v2: FD len incompat compat seq sys comp id[3] payload crc16 (signature[13]) 12 + len bytes

All places that could begin a frame are found at once and the chain of frames is walked over them. The checksum is
worked out for the wanted messages and wherever the chain was broken; elsewhere it is enough that the next frame
starts where this one ends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.mavlink import fields
from uavbatt.telemetry.formats.chain import Bytes, Chain, Judge, Mask, Places, Vouch, gathered, places_where, windows
from uavbatt.telemetry.formats.checksum import checksums

# The dialect's seed of each wanted message's checksum.
SEEDS = {
    fields.HEARTBEAT: 50, fields.SYS_STATUS: 124, fields.PARAM_VALUE: 220, fields.BATTERY_STATUS: 154,
    fields.BATTERY2: 174, fields.AUTOPILOT_VERSION: 178, **fields.IDENTITY_EXTRA,
    # route and place: GLOBAL_POSITION_INT, VFR_HUD, WIND, WIND_COV, HOME_POSITION, EXTENDED_SYS_STATE, MISSION_...
    33: 104, 74: 20, 168: 1, 231: 105, 242: 104, 245: 130,
    38: 9, 39: 254, 42: 28, 44: 221, 45: 232, 46: 11, 47: 153, 73: 38,
}  # fmt: skip
_V1, _V2 = 0xFE, 0xFD
_SIGNED = 0x01
_STAMP = 8
_HEAD, _HEAD_V1, _SIGNATURE = _STAMP + 10, _STAMP + 6, 13
_SHORTEST = _HEAD  # a frame of version 1 with less than two bytes of payload, which no message has, would be shorter
_LATEST_US = 4_102_444_800_000_000  # the year 2100; early times are real: a clock never set starts in 1970
_DAY_US = 86_400_000_000
_HEAD_BYTES = 65_536
_NO_SEED = -1
_WINDOW = 1 << 22  # bytes; checksums are worked out window by window, and the more frames at once the better
_BLOCK = 64  # candidates
_SEEDS = np.full(max(SEEDS) + 2, _NO_SEED, np.int64)  # by message number; the last entry is for all larger numbers
_SEEDS[list(SEEDS)] = list(SEEDS.values())
_MAY_BE_WANTED = np.isin(np.arange(256), [number & 0xFF for number in SEEDS])  # by the low byte of the number

Decode = Callable[[bytes], Any]  # whole frame -> message; None if damaged; `False` if its type is unknown


@dataclass(frozen=True, slots=True)
class FrameTable:
    """FrameTable holds the wanted frames in file order, and what the whole file says of time and damage."""

    data: Bytes
    start: Places  # place of the stamp
    payload: Places
    length: NDArray[np.int64]  # of the payload, from which the sender trims trailing zeros
    message_id: NDArray[np.int64]
    source: NDArray[np.int64]  # 256 * system + component
    first_s: float  # reception of the first and last frame of any kind; NaN without one
    last_s: float
    skipped_bytes: int

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Return the reception time of each frame [s]."""
        return stamps_us(self.data, self.start) / 1e6

    @property
    def sequence(self) -> NDArray[np.int64]:
        """Return the sender's running number of each frame, 0..255."""
        is_v1 = self.payload - self.start == _HEAD_V1
        return self.data[self.start + np.where(is_v1, _STAMP + 2, _STAMP + 4)].astype(np.int64)

    def payloads(self, width: int) -> Bytes:
        """Return the payloads, `width` bytes each: trimmed zeros put back, later extensions left out."""
        found = gathered(self.data, self.payload, width)
        found[np.arange(width) >= self.length[:, None]] = 0
        return found

    def records(self, layout: np.dtype[Any]) -> Any:
        """Return the payloads as records, one each; `layout` has at least the last field that is read."""
        return self.payloads(layout.itemsize).view(layout)[:, 0]

    def places(self, message_id: int) -> Places:
        """Return the indices of the frames of this message."""
        return np.flatnonzero(self.message_id == message_id)

    def of(self, message_id: int) -> FrameTable:
        """Return the frames of this message."""
        return self.at(self.places(message_id))

    def at(self, chosen: Any) -> FrameTable:
        """Return some of the frames, chosen by mask or index."""
        return replace(
            self,
            start=self.start[chosen],
            payload=self.payload[chosen],
            length=self.length[chosen],
            message_id=self.message_id[chosen],
            source=self.source[chosen],
        )


class _Heads(NamedTuple):
    """_Heads holds candidates for frames, and what their heads say if they are frames."""

    start: Places
    payload: Places
    length: NDArray[np.int64]
    message_id: NDArray[np.int64]

    def at(self, chosen: Any) -> _Heads:
        """Return some of the candidates."""
        return _Heads(*(column[chosen] for column in self))


def decoder() -> Decode:
    """Return pymavlink's decoder of a frame, independent of its environment variables.

    It checks the CRC, fills trimmed payloads, and returns None for a damaged frame, False for an unknown message.
    """
    from pymavlink.dialects.v20 import ardupilotmega

    link = ardupilotmega.MAVLink(None)

    def decode(frame: bytes) -> Any:
        try:
            message = link.decode(bytearray(frame))
        except ardupilotmega.MAVError:
            return None
        return False if message.get_type().startswith("UNKNOWN") else message

    return decode


def frames(raw: bytes | memoryview) -> FrameTable:
    """Return the wanted frames of a telemetry log. Damage is passed over and counted; noise alone gives no frame."""
    data = np.frombuffer(raw, np.uint8)
    chain = Chain()
    chain.in_chain = True  # a file begins with a frame: to judge that by its checksum costs the whole dialect's import
    kept = [_heads(data, np.zeros(0, np.int64))]
    first_us, last_us = -1, -1
    for begin, end in windows(len(data), _WINDOW):
        start, stop = _candidates(data, begin, end)
        chosen, heads, is_sound = _wanted(data, start)
        wanted, sound = np.zeros(len(start), np.bool_), np.ones(len(start), np.bool_)
        wanted[chosen], sound[chosen] = True, is_sound
        vouch, judge = _vouch(data, stop, wanted, sound), _judge(data, start, stop, wanted, sound)
        taken = chain.take(start, stop, sound, vouch, judge, end)
        places = np.flatnonzero(taken)
        if len(places):
            ends_us = stamps_us(data, start[places[[0, -1]]])
            first_us, last_us = int(ends_us[0]) if first_us < 0 else first_us, int(ends_us[1])
        kept.append(heads.at(taken[chosen]))
    return _frames(data, kept, first_us, last_us, chain.skipped)


def looks_like_tlog(raw: bytes | memoryview) -> bool:
    """Return True if the head of `raw` holds at least one time-stamped frame with a good checksum."""
    data = np.frombuffer(raw[:_HEAD_BYTES], np.uint8)
    start, _ = _candidates(data, 0, len(data))
    if np.any(_wanted(data, start)[2]):
        return True
    heads = _heads(data, start)
    seeds = np.array([_seed(number) for number in heads.message_id.tolist()], np.int64)
    known = seeds != _NO_SEED
    return bool(np.any(_is_sound(data, heads.at(known), seeds[known])))


def stamps_us(data: Bytes, start: Places) -> NDArray[np.int64]:
    """Return the time stamps [us] at the given places."""
    return gathered(data, start, _STAMP).view(">i8")[:, 0].astype(np.int64)


def _candidates(data: Bytes, begin: int, end: int) -> tuple[Places, Places]:
    """Return every place from `begin` to `end` where a frame could begin that fits into the file, and where it ends."""
    size = len(data)

    def is_marked(at: int, to: int) -> Mask:
        mark = data[at + _STAMP : to + _STAMP]
        return np.asarray(mark - np.uint8(_V2) <= _V1 - _V2, np.bool_)  # unsigned: what is below wraps around

    start = places_where(is_marked, begin, min(end, size - _SHORTEST + 1))
    # a stamp before 2100 has 0 in its first byte and at most 14 in its second
    start = start[(data[start] == 0) & (data[1:][start] <= _LATEST_US >> 48)]
    is_v1, length, flags = data[_STAMP:][start] == _V1, data[_STAMP + 1 :][start], data[_STAMP + 2 :][start]
    flags[is_v1] = 0
    stop = start + length
    stop += _HEAD + 2
    stop[is_v1] -= _HEAD - _HEAD_V1
    stop[flags == _SIGNED] += _SIGNATURE
    possible = (stop <= size) & (flags <= _SIGNED)
    late = np.flatnonzero(data[1:][start] == _LATEST_US >> 48)
    possible[late] &= stamps_us(data, start[late]) <= _LATEST_US
    return (start, stop) if possible.all() else (start[possible], stop[possible])


def _heads(data: Bytes, start: Places) -> _Heads:
    """Return the heads of the candidates at these places."""
    is_v1, length = data[_STAMP:][start] == _V1, data[_STAMP + 1 :][start].astype(np.int64)
    low, middle, high = (data[_HEAD - 3 + k :][start].astype(np.int64) for k in range(3))
    message_id = np.where(is_v1, data[_HEAD_V1 - 1 :][start], low | middle << 8 | high << 16)
    return _Heads(start, start + np.where(is_v1, _HEAD_V1, _HEAD), length, message_id)


def _wanted(data: Bytes, start: Places) -> tuple[Places, _Heads, Mask]:
    """Return which candidates are wanted messages, their heads, and if their checksums are right."""
    # the low byte of the number excludes most candidates; in version 1 the number stands elsewhere
    chosen = np.flatnonzero(_MAY_BE_WANTED[data[_HEAD - 3 :][start]] | (data[_STAMP:][start] == _V1))
    heads = _heads(data, start[chosen])
    seeds = _SEEDS[np.minimum(heads.message_id, len(_SEEDS) - 1)]
    wanted = seeds != _NO_SEED
    heads = heads.at(wanted)
    return chosen[wanted], heads, _is_sound(data, heads, seeds[wanted])


def _is_sound(data: Bytes, heads: _Heads, seed: NDArray[np.int64]) -> Mask:
    """Return True if the checksums are right."""
    after = heads.payload + heads.length
    sent = data[after].astype(np.int64) | data[after + 1].astype(np.int64) << 8
    found = checksums(data, heads.start + _STAMP + 1, after - heads.start - _STAMP - 1, seed)
    return np.asarray(found == sent, np.bool_)


def _vouch(data: Bytes, stop: Places, wanted: Mask, sound: Mask) -> Vouch:
    """Return the check within a chain: a wanted frame needs its checksum, any other one a mark behind it."""

    def vouch(chosen: Places) -> Mask:
        mark = stop[chosen] + _STAMP
        following = data[np.minimum(mark, len(data) - 1)]
        follows = (mark >= len(data)) | (following == _V1) | (following == _V2)
        return np.where(wanted[chosen], sound[chosen], follows)

    return vouch


def _judge(data: Bytes, start: Places, stop: Places, wanted: Mask, sound: Mask) -> Judge:
    """Return the check of one candidate: its checksum decides; an unknown type counts if a frame may follow it."""

    @cache
    def block(number: int) -> list[bool | None]:
        """Return the verdicts of a block of checksums, None for unknown types: one by one is far slower."""
        heads = _heads(data, start[number * _BLOCK : (number + 1) * _BLOCK])
        seeds = np.array([_seed(message_id) for message_id in heads.message_id.tolist()])
        is_sound = _is_sound(data, heads, seeds).tolist()
        return [None if seed == _NO_SEED else good for seed, good in zip(seeds.tolist(), is_sound, strict=True)]

    def judge(index: int, in_chain: bool) -> bool:
        mark = int(stop[index]) + _STAMP
        follows = mark >= len(data) or int(data[mark]) in (_V1, _V2)
        if not in_chain and follows and _is_stamp_torn(data, int(start[index]), mark):
            return False
        if wanted[index]:
            return bool(sound[index])
        verdict = block(index // _BLOCK)[index % _BLOCK]
        return follows if verdict is None else verdict

    return judge


def _is_stamp_torn(data: Bytes, start: int, next_mark: int) -> bool:
    """Return True if the stamp before a whole frame is damaged: it is days from the next one's."""
    if start == 0 or next_mark >= len(data):
        return False
    this_us, next_us = (int.from_bytes(data[at : at + _STAMP].tobytes(), "big") for at in (start, next_mark - _STAMP))
    return abs(next_us - this_us) > _DAY_US


def _frames(data: Bytes, kept: list[_Heads], first_us: int, last_us: int, skipped_bytes: int) -> FrameTable:
    start, payload, length, message_id = (np.concatenate(columns) for columns in zip(*kept, strict=True))
    system = payload - np.where(payload - start == _HEAD, 5, 3)
    return FrameTable(
        data=data,
        start=start,
        payload=payload,
        length=length,
        message_id=message_id,
        source=data[system].astype(np.int64) << 8 | data[system + 1],
        first_s=first_us / 1e6 if first_us >= 0 else float("nan"),
        last_s=last_us / 1e6 if last_us >= 0 else float("nan"),
        skipped_bytes=skipped_bytes,
    )


def _seed(message_id: int) -> int:
    """Return the checksum's seed of a message; _NO_SEED if the dialect does not know it."""
    if message_id in SEEDS:
        return SEEDS[message_id]
    return _dialect().get(message_id, _NO_SEED)


@cache
def _dialect() -> dict[int, int]:
    """Return the seeds of all messages. They are big, and are loaded only if a chain is broken."""
    from pymavlink.dialects.v20 import ardupilotmega

    return {number: int(kind.crc_extra) for number, kind in ardupilotmega.mavlink_map.items()}
