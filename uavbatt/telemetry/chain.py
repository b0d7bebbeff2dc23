"""A log is a chain: each record begins where the last one ends. Whole arrays of candidates are walked at once.

A candidate is a place where a record could begin. As long as each candidate ends where the next begins, a stretch of
them is taken in one go; only where the chain breaks (damage, or bytes inside a record that look like the head of one)
is a candidate judged singly. A file is walked window by window, so that the arrays stay small however long it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Places = NDArray[np.int64]
Mask = NDArray[np.bool_]
Judge = Callable[[int, bool], bool]  # (index of the candidate, did the last record end here?) -> is it sound?

_FIRST_WINDOW, _WINDOW = 1 << 18, 1 << 22  # bytes; the second keeps all arrays of a window in a processor's cache


class Chain:
    """How far a file has been walked; what lies between sound records is counted as skipped."""

    def __init__(self) -> None:
        self.position = 0
        self.in_chain = False
        self.skipped = 0
        self.gap_start = 0  # of the gap that ends at `position`, if it is one

    def take(self, starts: Places, ends: Places, sure: Mask | None, judge: Judge, until: int) -> Mask:
        """Which of the candidates are records, from `position` on until one ends at or behind `until`.

        starts, ends: ascending, one candidate each; all that begin before `until` must be there. sure: inside the
        chain, these need no judge when the next candidate begins where they end (None: all of them).
        """
        taken = np.zeros(len(starts), np.bool_)
        joined = np.zeros(len(starts), np.bool_)
        joined[:-1] = ends[:-1] == starts[1:]
        if sure is not None:
            joined &= sure
        stops = np.flatnonzero(~joined)
        while self.position < until:
            index = int(starts.searchsorted(self.position))
            if index == len(starts):
                self._skip(until)
                break
            if starts[index] > self.position:
                self._skip(int(starts[index]))
            if not self.in_chain and not judge(index, False):
                self._skip(min(int(starts[index + 1]), until) if index + 1 < len(starts) else until)
                continue
            last = int(stops[stops.searchsorted(index)])
            if last > index:
                taken[index:last] = True
                self.position, self.in_chain = int(starts[last]), True
            elif not self.in_chain or judge(index, True):
                taken[index] = True
                self.position, self.in_chain = int(ends[index]), True
            else:
                self._skip(min(int(starts[index + 1]), until) if index + 1 < len(starts) else until)
        return taken

    def copy(self) -> Chain:
        """A copy to try on."""
        return copy(self)

    def _skip(self, to: int) -> None:
        if self.in_chain or self.position == 0:
            self.gap_start = self.position
        self.skipped += to - self.position
        self.position, self.in_chain = to, False


def windows(size: int) -> Iterator[tuple[int, int]]:
    """Consecutive (begin, end) that cover a file of `size` bytes; the first is short: descriptions stand in front."""
    begin, length = 0, _FIRST_WINDOW
    while begin < size:
        yield begin, min(begin + length, size)
        begin, length = begin + length, _WINDOW


def gathered(data: Bytes, starts: Places, width: int) -> Bytes:
    """`width` bytes from each start (ascending), one row each; behind the end of the data stand zeros."""
    inside = int(starts.searchsorted(len(data) - width, side="right"))
    found = np.zeros((len(starts), width), np.uint8)
    if inside:
        found[:inside] = sliding_window_view(data, width)[starts[:inside]]
    for row in range(inside, len(starts)):
        rest = data[starts[row] : starts[row] + width]
        found[row, : len(rest)] = rest
    return found
