"""DataFlash binary logs (.BIN): walk the records, tolerate damage.

A record is A3 95 <type> <payload>; a type's length, format characters and labels come from its
FMT record (type 128, 89 bytes: type, length, name[4], format[16], labels[64]). pymavlink supplies the
meaning of the format characters; the walk is ours, because pymavlink's index ends at the first
damaged place (it lost three quarters of the rows of a log with 4 kB of noise in it) and prints
every bad byte. Here a record counts only if the next one starts where it ends.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from uavbatt.telemetry.builder import LogBuilder
from uavbatt.telemetry.dataflash_rows import WANTED, Layout, Record, Value, fold

HEADER = b"\xa3\x95"
FMT_TYPE = 128
FMT_LENGTH = 89
FMT_START = HEADER + bytes([FMT_TYPE])


@dataclass(frozen=True, slots=True)
class _Decoder:
    layout: Layout
    unpacker: struct.Struct
    divisors: tuple[float | None, ...]


def read(data: bytes) -> LogBuilder:
    """All batteries' rows and the parameters of a binary DataFlash log."""
    log = LogBuilder()
    fold(_records(data, log), log)
    return log


def _records(data: bytes, log: LogBuilder) -> Iterator[Record]:
    """The wanted records, and the first and last of any kind that carry a time."""
    characters = _format_characters()
    decoders: dict[int, _Decoder] = {}
    lengths = [0] * 256
    lengths[FMT_TYPE] = FMT_LENGTH
    started = False
    last_timed: tuple[_Decoder, int] | None = None
    for kind, position in _walk(data, lengths, log):
        if kind == FMT_TYPE:
            _learn(data, position, characters, decoders, lengths)
            continue
        decoder = decoders.get(kind)
        if decoder is None:
            continue
        timed = decoder.layout.ticks_per_s > 0
        if timed:
            last_timed = (decoder, position)
        if WANTED.match(decoder.layout.name) or (timed and not started):
            started = started or timed
            yield decoder.layout, _values(data, position, decoder)
    if last_timed is not None:
        decoder, position = last_timed
        # under a name of its own: only its time is wanted
        yield Layout("END", "Q", decoder.layout.labels[:1]), _values(data, position, decoder)[:1]


def _walk(data: bytes, lengths: list[int], log: LogBuilder) -> Iterator[tuple[int, int]]:
    """(type, payload position) of every sound record; what lies between is counted as skipped."""
    position, size = 0, len(data)
    while position < size:
        if data.startswith(HEADER, position) and position + 3 <= size:
            kind = data[position + 2]
            end = position + lengths[kind]
            if end > position and end <= size and _continues(data, end):
                yield kind, position + 3
                position = end
                continue
        following = data.find(HEADER, position + 1)
        following = size if following < 0 else following
        if not (following == size and _is_padding(data, position)):
            log.skipped_bytes += following - position
        position = following


def _continues(data: bytes, end: int) -> bool:
    """Is `end` a place where a sound record may end: before a header, the end, or padding to it."""
    return data.startswith(HEADER, end) or end >= len(data) - 1 or _is_padding(data, end)


def _is_padding(data: bytes, start: int) -> bool:
    """Erased flash (0xFF) or zeros from `start` to the end of the file."""
    if start >= len(data) or data[start] not in (0x00, 0xFF):
        return False
    return data.count(data[start : start + 1], start) == len(data) - start


def _learn(
    data: bytes,
    position: int,
    characters: dict[str, tuple[str, float | None]],
    decoders: dict[int, _Decoder],
    lengths: list[int],
) -> None:
    """Take over one FMT record; a type with unknown characters can be walked over but not read."""
    kind, length, name, chars, labels = struct.unpack_from("<BB4s16s64s", data, position)
    if length < 3 or kind == FMT_TYPE:
        return
    lengths[kind] = length
    layout = Layout(_text(name), _text(chars), tuple(_text(labels).split(",")))
    decoders.pop(kind, None)
    if all(c in characters for c in layout.chars) and len(layout.chars) == len(layout.labels):
        unpacker = struct.Struct("<" + "".join(characters[c][0] for c in layout.chars))
        if unpacker.size + 3 == length:
            decoders[kind] = _Decoder(layout, unpacker, tuple(characters[c][1] for c in layout.chars))


def _values(data: bytes, position: int, decoder: _Decoder) -> list[Value]:
    raw = decoder.unpacker.unpack_from(data, position)
    return [
        _text(value) if isinstance(value, bytes) else value if divisor is None else value / divisor
        for value, divisor in zip(raw, decoder.divisors, strict=True)
    ]


def _text(raw: bytes) -> str:
    return raw.split(b"\0")[0].decode("latin-1")


def _format_characters() -> dict[str, tuple[str, float | None]]:
    """Format character -> (struct code, divisor), from pymavlink.

    Divided, as pymavlink does: 2533 / 100 is 25.33, while 2533 * 0.01 is not.
    """
    from pymavlink.DFReader import FORMAT_TO_STRUCT

    return {
        char: (code, None if scale is None else float(round(1 / scale)))
        for char, (code, scale, _) in FORMAT_TO_STRUCT.items()
    }
