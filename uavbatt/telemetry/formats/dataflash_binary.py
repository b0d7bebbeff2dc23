"""DataFlash binary logs (.BIN): find all records at once, tolerate damage.

A record is A3 95 <type> <payload>; a type's length, format characters and labels come from its
FMT record (type 128, 89 bytes: type, length, name[4], format[16], labels[64]). A record counts only if the next one
starts where it ends; an unknown type is a bad byte. pymavlink's index, in C, is no faster than this one in numpy
(both 40 to 50 ms for 60 MB), ends at the first damaged place (it lost three quarters of the rows of a log with 4 kB of
noise in it) and prints every bad byte, so that it is not used.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbatt.telemetry.builder import LogBuilder
from uavbatt.telemetry.formats.chain import Bytes, Chain, Judge, Mask, Places, Vouch, gathered, places_where, windows
from uavbatt.telemetry.formats.dataflash_identity import TELLING, identity
from uavbatt.telemetry.formats.dataflash_route import OF_ROUTE, navigation
from uavbatt.telemetry.formats.dataflash_rows import USED, WANTED, Moment, RowLayout, Table, fold

HEADER = b"\xa3\x95"
FMT_TYPE = 128
_FMT = struct.Struct("<BB4s16s64s")
_FMT_LENGTH = 3 + _FMT.size
_UNKNOWN = -1
_READ = (WANTED, TELLING, OF_ROUTE)
_WINDOW = 1 << 19  # bytes; the index of its records is small enough for the allocator to keep from window to window

# Format character -> (numpy's code, divisor). Divided, as pymavlink does: 2533 / 100 is 25.33, 2533 * 0.01 is not.
CHARACTERS = {
    "a": ("S64", 0), "b": ("i1", 0), "B": ("u1", 0), "g": ("<f2", 0), "h": ("<i2", 0), "H": ("<u2", 0),
    "i": ("<i4", 0), "I": ("<u4", 0), "f": ("<f4", 0), "n": ("S4", 0), "N": ("S16", 0), "Z": ("S64", 0),
    "c": ("<i2", 100), "C": ("<u2", 100), "e": ("<i4", 100), "E": ("<u4", 100), "L": ("<i4", 10_000_000),
    "d": ("<f8", 0), "M": ("i1", 0), "q": ("<i8", 0), "Q": ("<u8", 0),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Definition:
    """_Definition holds one FMT record; a type with unknown characters has no layout, and its records are skipped."""

    type: int
    length: int
    layout: RowLayout | None


class _Definitions:
    """_Definitions holds the definitions in force at the place that the walk has reached."""

    def __init__(self) -> None:
        self.known = [_Definition(FMT_TYPE, _FMT_LENGTH, None)]
        self.of_type = np.full(256, _UNKNOWN, np.int64)  # type -> index into `known`
        self.of_type[FMT_TYPE] = 0

    def applied(self, types: Bytes, starts: Places, formats: list[tuple[int, _Definition]]) -> NDArray[np.int64]:
        """Return the index of the definition of each header; a definition counts for the headers behind it."""
        found = self.of_type[types]
        for position, said in formats:
            if said != self._at(said.type):
                self.of_type[said.type] = len(self.known)
                found[(types == said.type) & (starts > position)] = len(self.known)
                self.known.append(said)
        return found

    def _at(self, kind: int) -> _Definition | None:
        index = int(self.of_type[kind])
        return None if index == _UNKNOWN else self.known[index]

    def copy(self) -> _Definitions:
        """Return a copy, on which a walk can be tried."""
        twin = _Definitions()
        twin.known, twin.of_type = list(self.known), self.of_type.copy()
        return twin


def read_dataflash(data: bytes | memoryview) -> LogBuilder:
    """Read all batteries' rows and the parameters of a binary DataFlash log."""
    log = LogBuilder()
    records = _Records(np.frombuffer(data, np.uint8))
    log.skipped_bytes = records.skipped_bytes
    log.identity = identity(records.tables(TELLING), records.first)
    clock = fold(records.tables(WANTED), records.first, records.last, log)
    log.navigation = navigation(records.tables(OF_ROUTE), clock, log.identity.firmware, log.parameters)
    return log


class _Records:
    """_Records holds the places of the wanted records, by definition, and the first and last record with a time."""

    def __init__(self, data: Bytes) -> None:
        self.data = data
        self.first: Moment | None = None
        self.last: Moment | None = None
        self._definitions = _Definitions()
        self._places: dict[int, list[Places]] = {}
        self._padding = _padding_start(data)
        self._chain = Chain()
        for begin, end in windows(len(data), _WINDOW):
            self._walk(begin, end)
        ended_in_padding = not self._chain.in_chain and self._chain.gap_start >= self._padding
        self.skipped_bytes = self._chain.skipped - ended_in_padding * (len(data) - self._chain.gap_start)

    def tables(self, wanted: re.Pattern[str]) -> list[Table]:
        """Return the records of the wanted names as columns, one table for each definition that was in force."""
        kept = [(self._definitions.known[index].layout, parts) for index, parts in self._places.items()]
        return [
            _table(self.data, np.concatenate(parts), layout)
            for layout, parts in kept
            if layout is not None and wanted.match(layout.name)
        ]

    def _walk(self, begin: int, end: int) -> None:
        """Take the records that begin in a window of the file."""
        starts = _headers(self.data, begin, end)
        types = self.data[starts + 2]
        formats = self._formats(starts[types == FMT_TYPE])
        while True:
            definitions = self._definitions.copy()
            found = definitions.applied(types, starts, formats)
            known = found != _UNKNOWN
            where, which = starts[known], found[known]
            ends = where + np.array([known.length for known in definitions.known])[which]
            inside = ends <= len(self.data)
            if not inside.all():
                where, which, ends = where[inside], which[inside], ends[inside]
            chain = self._chain.copy()
            taken = chain.take(where, ends, None, *self._sound(ends), end)
            where, which = where[taken], which[taken]
            records = set(where[which == 0].tolist())
            # bytes inside another record only looked like a definition: walk again without it
            sound = [f for f in formats if f[0] in records]
            if len(sound) == len(formats):
                break
            formats = sound
        self._chain, self._definitions = chain, definitions
        self._keep(where, which)

    def _keep(self, where: Places, which: NDArray[np.int64]) -> None:
        layouts = [known.layout for known in self._definitions.known]
        timed = np.array([layout is not None and layout.ticks_per_s > 0 for layout in layouts])
        for index in np.flatnonzero(np.bincount(which)).tolist():
            layout = layouts[index]
            if layout is not None and any(names.match(layout.name) for names in _READ):
                self._places.setdefault(index, []).append(where[which == index])
        with_time = timed[which]
        if with_time.any():
            ends = int(np.argmax(with_time)), len(which) - 1 - int(np.argmax(with_time[::-1]))
            first, last = (self._moment(where[i], layouts[which[i]]) for i in ends)
            self.first, self.last = self.first or first, last

    def _moment(self, position: int, layout: RowLayout | None) -> Moment:
        assert layout is not None
        one = _table(self.data, np.array([position]), RowLayout(layout.name, layout.chars[:1], layout.labels[:1]))
        return Moment(int(position), float(one.numbers[layout.labels[0]][0]) / layout.ticks_per_s)

    def _formats(self, starts: Places) -> list[tuple[int, _Definition]]:
        """Return place and meaning of every FMT record that looks sound."""
        found = []
        for position in starts.tolist():
            if position + _FMT_LENGTH <= len(self.data) and self._continues(position + _FMT_LENGTH):
                said = _definition(self.data[position + 3 : position + _FMT_LENGTH].tobytes())
                if said is not None:
                    found.append((position, said))
        return found

    def _sound(self, ends: Places) -> tuple[Vouch, Judge]:
        """Return the two checks of a record: it is sound if the log goes on where it ends."""

        def judge(index: int, _: bool) -> bool:
            return self._continues(int(ends[index]))

        def vouch(chosen: Places) -> Mask:
            end = np.minimum(ends[chosen], len(self.data) - 2)
            follows: Mask = (self.data[end] == HEADER[0]) & (self.data[end + 1] == HEADER[1])
            return np.asarray(follows | (ends[chosen] >= min(len(self.data) - 1, self._padding)), np.bool_)

        return vouch, judge

    def _continues(self, end: int) -> bool:
        """Return True if a sound record may end at `end`: before a header, padding, or the end of the file."""
        if end >= len(self.data) - 1 or end >= self._padding:
            return True
        return bool(self.data[end] == HEADER[0] and self.data[end + 1] == HEADER[1])


def _headers(data: Bytes, begin: int, end: int) -> Places:
    """Return the places of every A3 95 from `begin` to `end` that a type follows."""
    stop = min(end, len(data) - 2)
    if stop <= begin:
        return np.zeros(0, np.int64)

    def is_header(at: int, to: int) -> Mask:
        return np.asarray((data[at:to] == HEADER[0]) & (data[at + 1 : to + 1] == HEADER[1]), np.bool_)

    return places_where(is_header, begin, stop)


def _padding_start(data: Bytes) -> int:
    """Return where erased flash (0xFF) or zeros begin that last to the file's end; its size if there are none."""
    if not len(data) or data[-1] not in (0x00, 0xFF):
        return len(data)
    length = 1
    while length < len(data) and np.all(data[-2 * length : len(data) - length] == data[-1]):
        length *= 2
    tail = data[-2 * length :]
    other = np.flatnonzero(tail != data[-1])
    return len(data) - len(tail) + (int(other[-1]) + 1 if len(other) else 0)


def _definition(payload: bytes) -> _Definition | None:
    kind, length, name, chars, labels = _FMT.unpack(payload)
    if length < 3 or kind == FMT_TYPE:
        return None
    layout = RowLayout(_text(name), _text(chars), tuple(_text(labels).split(",")))
    readable = all(c in CHARACTERS for c in layout.chars) and len(layout.chars) == len(layout.labels)
    return _Definition(kind, length, layout if readable and _record(layout.chars).itemsize + 3 == length else None)


def _record(chars: str) -> np.dtype[Any]:
    """Return the layout of a payload with these format characters; its fields are numbered."""
    return np.dtype([(str(i), CHARACTERS[c][0]) for i, c in enumerate(chars)])


def _table(data: Bytes, starts: Places, layout: RowLayout) -> Table:
    """Return the columns of the records of one layout, only those that are used."""
    record = _record(layout.chars)
    values: Any = gathered(data, starts + 3, record.itemsize).view(record)[:, 0]
    numbers, texts = {}, {}
    for index, (label, char) in enumerate(zip(layout.labels, layout.chars, strict=True)):
        if not USED.match(label):
            continue
        code, divisor = CHARACTERS[char]
        column = values[str(index)]
        if code.startswith("S"):
            texts[label] = [_text(raw) for raw in column.tolist()]
            continue
        with np.errstate(invalid="ignore"):  # a NaN may be a signalling one
            number = column.astype(np.float64)
        numbers[label] = number / divisor if divisor else number
    return Table(layout, starts, numbers, texts)


def _text(raw: bytes) -> str:
    return raw.split(b"\0")[0].decode("latin-1")
