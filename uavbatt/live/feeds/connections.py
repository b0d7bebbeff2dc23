"""Limits of the page's connections: how many there may be, and how long one may be open without a request.

A connection uses a file descriptor of the flying process before its token is checked. So there are MOST_CONNECTIONS at
most, and one without a request for REQUEST_WITHIN_S is closed, even if it sends its header a byte at a time. If all
places are taken, a new connection gets the place of the one that has been idle for longest, else of the oldest stream
(a browser opens its stream again). So idle connections never keep anybody from the page.

Little is held for a reader that is slower than its stream (SENT_AHEAD): data in a buffer would be late. The stream
waits instead, and continues with what is known then.
"""

from __future__ import annotations

import asyncio
import socket

from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_CONNECTIONS = 64
MOST_WAITING = 256  # connections not yet accepted; the server accepts all of them at once
REQUEST_WITHIN_S = 10.0
LOOK_PERIOD_S = 1.0
SENT_AHEAD = 4096  # bytes, some events; the system takes twice as much for its own needs


class Connection(H11Protocol):
    """Connection is one connection to the page, with a place in the table of all connections."""

    table: dict[Connection, float]  # -> when it was made, or when its last answer was complete [s, clock of the loop]

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a place in the table; if none is free, take another connection's."""
        if len(self.table) >= MOST_CONNECTIONS:
            min(self.table, key=lambda other: (other.is_asking, self.table[other])).drop()
        self.table[self] = self.loop.time()
        super().connection_made(transport)
        transport.set_write_buffer_limits(high=0)
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SENT_AHEAD)
        self.loop.call_later(LOOK_PERIOD_S, self._look)

    def connection_lost(self, exc: Exception | None) -> None:
        """Free the place in the table."""
        self.table.pop(self, None)
        super().connection_lost(exc)

    def on_response_complete(self) -> None:
        """Count the connection as idle from now on."""
        if self in self.table:
            self.table[self] = self.loop.time()
        super().on_response_complete()

    @property
    def is_asking(self) -> bool:
        """Return True if a complete request has come and its answer is not completely sent."""
        return self.cycle is not None and not self.cycle.response_complete

    def drop(self) -> None:
        """Close at once, without waiting for an answer to be sent."""
        self.table.pop(self, None)
        self.transport.abort()

    def _look(self) -> None:
        """Close the connection if it has been idle for too long; else check again a second later."""
        if self not in self.table:
            return
        if not self.is_asking and self.loop.time() - self.table[self] >= REQUEST_WITHIN_S:
            self.drop()
            return
        self.loop.call_later(LOOK_PERIOD_S, self._look)


def protocol() -> type[asyncio.Protocol]:
    """Return the protocol of one server, with a table of its own."""
    return type("Connection", (Connection,), {"table": {}})
