"""Two autopilots of one system number behind one address are told apart by the running numbers of their frames.

Every sender numbers its frames 0..255, again and again. Frames of two senders that come by one address show two such
counts, far from each other, that each go on by small steps, by turns. Lost frames make a count jump, a frame that
comes late makes it go back: then a count begins anew, and the one that it left does not go on. A link that passes so
few frames that no count goes on by small steps tells nothing.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

NUMBERS = 256
LOST = 8  # so many frames may be missing within one count
FAR = 32  # nearer counts may be one, with frames that come late
TURNS, WITHIN_S = 8, 10.0  # of the counts, until they are two


class Stream(NamedTuple):
    """The second count of frames that one sender's address shows."""

    sender: object


class Counts:
    """The running numbers of one identity's frames from one address; `stream` tells whose a frame is."""

    def __init__(self, sender: object) -> None:
        self._streams: tuple[object, object] = (sender, Stream(sender))
        self._last: list[int | None] = [None, None]
        self._now = 0  # index of the count that the last frame went on with
        self._turns: deque[float] = deque([-math.inf] * TURNS, maxlen=TURNS)

    def stream(self, number: int, time_s: float) -> object:
        """Return the sender of a frame with this running number: its address, or that address's second `Stream`.

        time_s : of reception [s]. Until two counts have gone on by turns there is one.
        """
        other = 1 - self._now
        if self._steps(other, number) < min(self._steps(self._now, number), LOST + 1):
            if self._is_apart():
                self._turns.append(time_s)
            self._now = other
        elif self._steps(self._now, number) > LOST:
            self._now = other  # a jump: the count that has rested begins anew
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
