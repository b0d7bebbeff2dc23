"""Open descriptors: a stream with its bytes that wait to be sent, and how a loop waits.

Waiting is `poll`: `select` raises for a descriptor above 1023, which any process may reach whose limit is higher.
"""

from __future__ import annotations

import os
import select
import socket
from collections.abc import Iterable

LARGEST_READ = 65_536
MOST_PENDING = 131_072  # bytes that a slow stream may lag behind before it is dropped


def wait(descriptors: Iterable[int], longest_s: float) -> None:
    """Sleep until something has come in on one of the descriptors, or one has broken."""
    waiting = select.poll()
    for descriptor in descriptors:
        waiting.register(descriptor, select.POLLIN)
    waiting.poll(1000.0 * longest_s)


def takes_bytes(descriptor: int) -> bool:
    """Return True if a write would not wait."""
    waiting = select.poll()
    waiting.register(descriptor, select.POLLOUT)
    return any(events & select.POLLOUT for _, events in waiting.poll(0.0))


class Pipe:
    """Pipe is one open stream: a descriptor, with the bytes that wait to be sent."""

    def __init__(self, fd: int, owner: socket.socket | None = None) -> None:
        self.fd, self._owner, self._pending = fd, owner, b""

    def read(self) -> bytes | None:
        """Return the bytes that have come in; empty when nothing; None when the other side is gone."""
        try:
            return os.read(self.fd, LARGEST_READ) or None
        except BlockingIOError:
            return b""
        except OSError:
            return None

    def write(self, data: bytes) -> bool:
        """Send the bytes and keep what does not fit; return False when the other side is gone or too slow."""
        self._pending += data
        try:
            while self._pending:
                self._pending = self._pending[os.write(self.fd, self._pending) :]
        except BlockingIOError:
            return len(self._pending) <= MOST_PENDING
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Release the descriptor."""
        if self._owner is not None:
            self._owner.close()
        else:
            os.close(self.fd)
