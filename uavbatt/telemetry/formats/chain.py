"""Search for the records of a log as a chain: each record begins where the last one ends.

A candidate is a place where a record could begin. While each candidate ends where the next one begins, a whole run of
them is accepted at once. A candidate is judged alone only where the chain breaks: by damage, or by bytes inside a
record that look like the head of a record. A file is searched window by window, so that the arrays stay small.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator
from copy import copy

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Places = NDArray[np.int64]
Mask = NDArray[np.bool_]
Vouch = Callable[[Places], Mask]  # indices of candidates -> are they sound, given that the last record ended there?
Judge = Callable[[int, bool], bool]  # (index of the candidate, did the last record end here?) -> is it sound?

_FIRST_WINDOW = 1 << 18  # bytes
_BLOCK = 1 << 16  # bytes; masks of this size the allocator keeps, bigger ones come anew from the kernel, page by page


class Chain:
    """A Chain walks through a file: it holds its place, and counts the bytes between sound records as skipped."""

    def __init__(self) -> None:
        self.position = 0
        self.in_chain = False
        self.skipped = 0
        self.gap_start = 0  # start of the gap that ends at `position`, if there is one

    def take(self, starts: Places, ends: Places, sure: Mask | None, vouch: Vouch, judge: Judge, until: int) -> Mask:
        """Return a mask of the candidates that are records, from `position` on until one ends at or behind `until`.

        starts, ends: ascending, one candidate each; all that begin before `until` must be there. sure: inside the
        chain, these are records when the next candidate begins where they end (None: all of them). vouch: the same
        for those where it does not. judge: everything else, one by one.
        """
        taken = np.zeros(len(starts), np.bool_)
        if not len(starts):
            self._skip(until)
            return taken
        joined = np.append(ends[:-1] == starts[1:], False)
        if sure is not None:
            joined &= sure
        places = np.flatnonzero(~joined)
        stops, vouched = places.tolist(), vouch(places).tolist()
        following = starts.searchsorted(ends[places]).tolist()  # the first record at or behind the end of a stop
        stop, index = 0, int(starts.searchsorted(self.position))
        while self.position < until:
            if index == len(starts) or starts[index] > self.position:
                self._skip(min(int(starts[index]), until) if index < len(starts) else until)
                continue
            if not self.in_chain and not judge(index, False):
                index += 1
                continue
            stop = bisect_left(stops, index, stop)
            last = stops[stop]
            taken[index:last] = True
            if (index == last and not self.in_chain) or vouched[stop] or judge(last, True):
                taken[last] = True
                self.position, self.in_chain, index = int(ends[last]), True, following[stop]
            else:
                self.position, self.in_chain, index = int(starts[last]), True, last + 1
        return taken

    def copy(self) -> Chain:
        """Return a copy, on which a walk can be tried."""
        return copy(self)

    def _skip(self, to: int) -> None:
        if self.in_chain or self.position == 0:
            self.gap_start = self.position
        self.skipped += to - self.position
        self.position, self.in_chain = to, False


def windows(size: int, length: int) -> Iterator[tuple[int, int]]:
    """Yield consecutive (begin, end) that cover a file of `size` bytes; the first is short: descriptions come first."""
    begin, end = 0, min(_FIRST_WINDOW, size)
    while begin < size:
        yield begin, end
        begin, end = end, min(end + length, size)


def places_where(is_so: Callable[[int, int], Mask], begin: int, end: int) -> Places:
    """Return the places from `begin` to `end` where `is_so` (asked for stretches of them) holds, ascending."""
    blocks = [(at, min(at + _BLOCK, end)) for at in range(begin, end, _BLOCK)]
    return np.concatenate([np.zeros(0, np.int64), *(np.flatnonzero(is_so(*block)) + block[0] for block in blocks)])


def gathered(data: Bytes, starts: Places, width: int) -> Bytes:
    """Return `width` bytes from each start (ascending), one row each; behind the end of the data stand zeros."""
    inside = int(starts.searchsorted(len(data) - width, side="right"))
    found = np.zeros((len(starts), width), np.uint8)
    if inside:
        found[:inside] = sliding_window_view(data, width)[starts[:inside]]
    for row in range(inside, len(starts)):
        rest = data[starts[row] : starts[row] + width]
        found[row, : len(rest)] = rest
    return found
