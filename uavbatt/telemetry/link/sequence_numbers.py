"""Separation of two autopilots with one system id behind one address, by the sequence numbers of their frames.

Every sender numbers its frames 0..255, again and again. If two senders share an address, there are two such sequences,
far from each other, and both go on by small steps in turn. Lost frames make a sequence jump, and a late frame makes it
go back: then one sequence begins anew, but the old one does not go on. On a link that loses most frames no sequence
goes on by small steps, and nothing can be said.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

NUMBERS = 256
LOST = 8  # frames that may be missing in one sequence
FAR = 32  # nearer sequences may be one, whose frames come late
TURNS, WITHIN_S = 8, 10.0  # changes between two sequences, after which they are two senders


class Stream(NamedTuple):
    """Stream is the second sequence of frames from one address."""

    sender: object


class SequenceNumbers:
    """SequenceNumbers follows the sequence numbers of a vehicle's frames from one address."""

    def __init__(self, sender: object) -> None:
        self._streams: tuple[object, object] = (sender, Stream(sender))
        self._last: list[int | None] = [None, None]
        self._now = 0  # index of the count that the last frame went on with
        self._turns: deque[float] = deque([-math.inf] * TURNS, maxlen=TURNS)

    def stream(self, number: int, time_s: float) -> object:
        """Return the sender of a frame with this sequence number: its address, or the second `Stream` of that address.

        time_s : of reception [s]. There is one sender until two sequences have gone on in turn.
        """
        other, steps = 1 - self._now, self._steps(self._now, number)
        if self._steps(other, number) < min(steps, LOST + 1):
            if self._is_apart():
                self._turns.append(time_s)
            self._now = other
        elif steps > LOST:
            self._now = other  # a jump: the sequence that was idle begins anew
        self._last[self._now] = number
        return self._streams[self._now if time_s - self._turns[0] <= WITHIN_S else 0]

    def _steps(self, count: int, number: int) -> int:
        """Return by how many steps a number goes on with a count; NUMBERS where there is none yet."""
        last = self._last[count]
        return NUMBERS if last is None else (number - last) % NUMBERS

    def _is_apart(self) -> bool:
        """Return True if the counts are so far from each other that no lost or late frame explains both."""
        one, other = self._last
        if one is None or other is None:
            return False
        return FAR < (one - other) % NUMBERS < NUMBERS - FAR
