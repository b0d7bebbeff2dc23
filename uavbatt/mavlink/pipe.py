"""Open descriptors: a stream with its bytes that wait to be sent, and how a loop waits.

A stream may be slower than what is sent on it: a radio of 1200 baud, a modem behind a hill. What waits there is late,
and the other end cannot see that: a time left of a minute ago looks like a new one. So telemetry is lost, not kept,
while a stream is behind; what is sent once (`framing.SENT_ONCE`) waits.

Waiting for a descriptor is `poll`: `select` raises for one above 1023, which any process may reach whose limit is
higher.
"""

from __future__ import annotations

import fcntl
import os
import select
import socket
import struct
import termios
from collections.abc import Iterable

from uavbatt.mavlink.framing import is_sent_once

LARGEST_READ = 65_536
MOST_PENDING = 131_072  # bytes that a slow stream may lag behind before it is dropped
BEHIND_S = 0.25  # a burst of telemetry may take so long to send
STALLED_S = 10.0  # a stream that is behind for so long has no reader
NOT_SENT = 0x894B  # SIOCOUTQNSD of Linux: what a TCP connection has not sent yet


# A host that disappears (no power, out of range) is given up after this time, not after the quarter of an hour of TCP.
# The link to the autopilot is then opened again, perhaps at another address.
UNANSWERED_S = 10
_TCP_OPTIONS = {
    "TCP_NODELAY": 1,
    "TCP_KEEPIDLE": UNANSWERED_S // 2,
    "TCP_KEEPINTVL": 1,
    "TCP_KEEPCNT": UNANSWERED_S // 2,
    "TCP_USER_TIMEOUT": 1000 * UNANSWERED_S,
}


def watched(connection: socket.socket) -> Pipe:
    """Return a TCP connection as a pipe: it does not block, sends at once, and breaks when nobody answers any more."""
    connection.setblocking(False)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in _TCP_OPTIONS.items():
        if hasattr(socket, name):  # not every system has all
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
    return Pipe(connection.fileno(), connection)


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


def unsent(descriptor: int, is_socket: bool) -> int:
    """Return the bytes that the system holds for a socket or a serial line and has not sent; 0 where it cannot tell."""
    try:
        held = fcntl.ioctl(descriptor, NOT_SENT if is_socket else termios.TIOCOUTQ, bytes(4))
    except OSError:
        return 0
    return int(struct.unpack("i", held)[0])


class Pipe:
    """Pipe is one open stream: a descriptor, with the bytes that wait to be sent."""

    def __init__(self, fd: int, owner: socket.socket | None = None) -> None:
        self.fd, self._owner, self._pending = fd, owner, b""
        self._free_s: float | None = None  # the last time at which nothing waited

    def read(self) -> bytes | None:
        """Return the bytes that have come in; empty when nothing; None when the other side is gone."""
        try:
            return os.read(self.fd, LARGEST_READ) or None
        except BlockingIOError:
            return b""
        except OSError:
            return None

    def offer(self, data: bytes, now_s: float) -> bool:
        """Send frames unless they would come late: telemetry is lost while the stream is behind.

        Return False when the other side is gone, too slow, or reads no more; `now_s` is a monotonic clock [s].
        """
        if self._free_s is None or not (self._pending or unsent(self.fd, self._owner is not None)):
            self._free_s = now_s
        behind_s = now_s - self._free_s
        is_read = behind_s <= STALLED_S
        if behind_s > BEHIND_S and not is_sent_once(data):
            return is_read
        return self.write(data) and is_read

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
