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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbatt.mavlink import fields
from uavbatt.telemetry.chain import Bytes, Chain, Judge, Mask, Places, Vouch, gathered, windows
from uavbatt.telemetry.checksum import checksums

AUTOPILOT_VERSION = 148
# The dialect's seed of each wanted message's checksum.
SEEDS = {
    fields.HEARTBEAT: 50, fields.SYS_STATUS: 124, fields.PARAM_VALUE: 220, fields.BATTERY_STATUS: 154,
    fields.BATTERY2: 174, AUTOPILOT_VERSION: 178,
}  # fmt: skip
_V1, _V2 = 0xFE, 0xFD
_SIGNED = 0x01
_STAMP = 8
_HEAD, _HEAD_V1, _SIGNATURE = _STAMP + 10, _STAMP + 6, 13
_LATEST_US = 4_102_444_800_000_000  # the year 2100; early times are real: a clock never set starts in 1970
_DAY_US = 86_400_000_000
_HEAD_BYTES = 65_536
_NO_SEED = -1
_BLOCK = 64  # candidates
_SEEDS = np.full(257, _NO_SEED, np.int64)  # by message; the last stands for all beyond
_SEEDS[list(SEEDS)] = list(SEEDS.values())

Decode = Callable[[bytes], Any]  # whole frame -> message; None if damaged; `False` if its type is unknown


@dataclass(frozen=True, slots=True)
class Frames:
    """The frames of the wanted messages in file order, and what the whole file says of time and damage."""

    data: Bytes
    start: Places  # of the stamp
    payload: Places
    length: NDArray[np.int64]  # of the payload, trailing zeros trimmed away by the sender
    message_id: NDArray[np.int64]
    source: NDArray[np.int64]  # 256 * system + component
    first_s: float  # reception of the first and last frame of any kind; NaN without one
    last_s: float
    skipped_bytes: int

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Reception time of each frame [s]."""
        return stamps_us(self.data, self.start) / 1e6

    def payloads(self, width: int) -> Bytes:
        """Payloads, `width` bytes each: trimmed zeros put back, later extensions left out."""
        found = gathered(self.data, self.payload, width)
        found[np.arange(width) >= self.length[:, None]] = 0
        return found

    def places(self, message_id: int) -> Places:
        """Which of the frames are of this message."""
        return np.flatnonzero(self.message_id == message_id)

    def of(self, message_id: int) -> Frames:
        """The frames of this message."""
        return self.at(self.places(message_id))

    def at(self, chosen: Any) -> Frames:
        """Some of the frames."""
        return replace(
            self,
            start=self.start[chosen],
            payload=self.payload[chosen],
            length=self.length[chosen],
            message_id=self.message_id[chosen],
            source=self.source[chosen],
        )


@dataclass(frozen=True, slots=True)
class _Candidates:
    """Places of one window where a frame could begin, whatever stands there."""

    start: Places
    end: Places
    payload: Places
    length: NDArray[np.int64]
    message_id: NDArray[np.int64]

    def at(self, chosen: Any) -> _Candidates:
        """Some of the candidates."""
        return _Candidates(
            self.start[chosen], self.end[chosen], self.payload[chosen], self.length[chosen], self.message_id[chosen]
        )

    def is_sound(self, data: Bytes, seed: NDArray[np.int64]) -> Mask:
        """Whether the checksum is right."""
        after = self.payload + self.length
        sent = data[after].astype(np.int64) | data[after + 1].astype(np.int64) << 8
        found = checksums(data, self.start + _STAMP + 1, after - self.start - _STAMP - 1, seed)
        return np.asarray(found == sent, np.bool_)


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


def frames(raw: bytes) -> Frames:
    """The wanted frames of a telemetry log. Damage is passed over and counted; noise alone gives no frame."""
    data = np.frombuffer(raw, np.uint8)
    chain = Chain()
    kept: list[_Candidates] = []
    first_us, last_us = -1, -1
    for begin, end in windows(len(data)):
        found = _candidates(data, begin, end)
        wanted = _is_wanted(found.message_id)
        sound = np.ones(len(wanted), np.bool_)
        chosen = found.at(wanted)
        sound[wanted] = chosen.is_sound(data, _SEEDS[chosen.message_id])
        vouch, judge = _vouch(data, found, wanted, sound), _judge(data, found, wanted, sound)
        taken = chain.take(found.start, found.end, sound, vouch, judge, end)
        places = np.flatnonzero(taken)
        if len(places):
            ends_us = stamps_us(data, found.start[places[[0, -1]]])
            first_us, last_us = int(ends_us[0]) if first_us < 0 else first_us, int(ends_us[1])
        kept.append(found.at(taken & wanted))
    return _frames(data, kept, first_us, last_us, chain.skipped)


def looks_like_tlog(raw: bytes) -> bool:
    """True if the head of `raw` holds at least one time-stamped frame with a good checksum."""
    data = np.frombuffer(raw[:_HEAD_BYTES], np.uint8)
    found = _candidates(data, 0, len(data))
    chosen = found.at(_is_wanted(found.message_id))
    if np.any(chosen.is_sound(data, _SEEDS[chosen.message_id])):
        return True
    seeds = np.array([_seed(number) for number in found.message_id.tolist()], np.int64)
    known = seeds != _NO_SEED
    return bool(np.any(found.at(known).is_sound(data, seeds[known])))


def stamps_us(data: Bytes, start: Places) -> NDArray[np.int64]:
    """The stamps [us] at the given places."""
    return gathered(data, start, _STAMP).view(">i8")[:, 0].astype(np.int64)


def _candidates(data: Bytes, begin: int, end: int) -> _Candidates:
    """Every place from `begin` to `end` where a frame could begin that ends inside the file."""
    size = len(data)
    mark = data[begin + _STAMP : end + _STAMP]
    start = np.flatnonzero(mark - np.uint8(_V2) <= _V1 - _V2) + begin  # unsigned: what is below wraps around
    # a stamp before 2100 has 0 in its first byte and at most 14 in its second
    start = start[(data[start] == 0) & (data[start + 1] <= _LATEST_US >> 48)]
    head = gathered(data, start, _HEAD)
    v1 = np.flatnonzero(head[:, _STAMP] == _V1)
    length, flags = head[:, _STAMP + 1].astype(np.int64), head[:, _STAMP + 2].copy()
    flags[v1] = 0
    payload = start + _HEAD
    payload[v1] -= _HEAD - _HEAD_V1
    stop = payload + length + 2
    stop[flags == _SIGNED] += _SIGNATURE
    possible = (stop <= size) & (flags <= _SIGNED)
    late = np.flatnonzero(head[:, 1] == _LATEST_US >> 48)
    possible[late] &= stamps_us(data, start[late]) <= _LATEST_US
    found = _Candidates(start, stop, payload, length, _message_ids(head, v1))
    return found if possible.all() else found.at(possible)


def _message_ids(head: Bytes, v1: Places) -> NDArray[np.int64]:
    """Three bytes, of which mostly only the first is used; in version 1 it is one, and stands elsewhere."""
    found = head[:, _HEAD - 3].astype(np.int64)
    wide = np.flatnonzero(head[:, _HEAD - 2] | head[:, _HEAD - 1])
    found[wide] |= head[wide, _HEAD - 2].astype(np.int64) << 8 | head[wide, _HEAD - 1].astype(np.int64) << 16
    found[v1] = head[v1, _HEAD_V1 - 1]
    return found


def _is_wanted(message_id: NDArray[np.int64]) -> Mask:
    return np.asarray(_SEEDS[np.minimum(message_id, len(_SEEDS) - 1)] != _NO_SEED, np.bool_)


def _vouch(data: Bytes, found: _Candidates, wanted: Mask, sound: Mask) -> Vouch:
    """Inside the chain a wanted frame needs its checksum, any other one a mark where the next frame has it."""

    def vouch(chosen: Places) -> Mask:
        mark = found.end[chosen] + _STAMP
        following = data[np.minimum(mark, len(data) - 1)]
        follows = (mark >= len(data)) | (following == _V1) | (following == _V2)
        return np.where(wanted[chosen], sound[chosen], follows)

    return vouch


def _judge(data: Bytes, found: _Candidates, wanted: Mask, sound: Mask) -> Judge:
    """Is one candidate a frame? Its checksum says so; a type that nobody knows counts if a frame may follow it."""

    @cache
    def block(number: int) -> list[bool | None]:
        """Verdicts of the checksums of a block of candidates, None for unknown types: one by one is far slower."""
        chosen = slice(number * _BLOCK, (number + 1) * _BLOCK)
        seeds = np.array([_seed(message_id) for message_id in found.message_id[chosen].tolist()])
        is_sound = found.at(chosen).is_sound(data, seeds).tolist()
        return [None if seed == _NO_SEED else good for seed, good in zip(seeds.tolist(), is_sound, strict=True)]

    def judge(index: int, in_chain: bool) -> bool:
        mark = int(found.end[index]) + _STAMP
        follows = mark >= len(data) or int(data[mark]) in (_V1, _V2)
        if not in_chain and follows and _is_stamp_torn(data, int(found.start[index]), mark):
            return False
        if wanted[index]:
            return bool(sound[index])
        verdict = block(index // _BLOCK)[index % _BLOCK]
        return follows if verdict is None else verdict

    return judge


def _is_stamp_torn(data: Bytes, start: int, next_mark: int) -> bool:
    """Whether damage reaches into the stamp before a frame that is whole itself: it is days from the next one's."""
    if start == 0 or next_mark >= len(data):
        return False
    this_us, next_us = (int.from_bytes(data[at : at + _STAMP].tobytes(), "big") for at in (start, next_mark - _STAMP))
    return abs(next_us - this_us) > _DAY_US


def _frames(data: Bytes, kept: list[_Candidates], first_us: int, last_us: int, skipped_bytes: int) -> Frames:
    start, payload, length, message_id = (
        np.concatenate([np.zeros(0, np.int64), *(getattr(k, name) for k in kept)])
        for name in ("start", "payload", "length", "message_id")
    )
    system = payload - np.where(payload - start == _HEAD, 5, 3)
    return Frames(
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
    """The checksum's seed of any message, _NO_SEED if the dialect does not know it."""
    if message_id in SEEDS:
        return SEEDS[message_id]
    return _dialect().get(message_id, _NO_SEED)


@cache
def _dialect() -> dict[int, int]:
    """Seeds of all messages. Loaded only where a chain is broken: it is bigger than all the rest."""
    from pymavlink.dialects.v20 import ardupilotmega

    return {number: int(kind.crc_extra) for number, kind in ardupilotmega.mavlink_map.items()}
