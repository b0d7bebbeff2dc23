"""Limits of the page's connections: their number, and the time that one may be open without asking for anything.

Whoever connects takes a descriptor of the process that flies, before any token is asked: so the table is small
(MOST_CONNECTIONS), and a connection on which no request is under way for REQUEST_WITHIN_S is closed, also one that
sends its header a byte at a time. In a full table the newcomer gets the place of the connection that has been without
a request for longest, else of the oldest stream (a browser opens its stream again): idle connections, however many,
keep nobody from the page.

Little is held for a reader that is slower than its stream (SENT_AHEAD): what waits in a buffer is late, so that the
stream waits instead, and goes on with what is known then.
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
    """A connection to the page has a place in the table of all."""

    table: dict[Connection, float]  # when it came, or its last answer was whole [s, clock of the loop]

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a place in the table, another's if none is free."""
        if len(self.table) >= MOST_CONNECTIONS:
            min(self.table, key=lambda other: (other.is_asking, self.table[other])).drop()
        self.table[self] = self.loop.time()
        super().connection_made(transport)
        transport.set_write_buffer_limits(high=0)
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SENT_AHEAD)
        self.loop.call_later(LOOK_PERIOD_S, self._look)

    def connection_lost(self, exc: Exception | None) -> None:
        """Give the place in the table back."""
        self.table.pop(self, None)
        super().connection_lost(exc)

    def on_response_complete(self) -> None:
        """Count the connection as idle from now on."""
        if self in self.table:
            self.table[self] = self.loop.time()
        super().on_response_complete()

    @property
    def is_asking(self) -> bool:
        """Return True if a request has come whole and its answer has not been sent whole."""
        return self.cycle is not None and not self.cycle.response_complete

    def drop(self) -> None:
        """Close at once, without waiting until an answer has been fetched."""
        self.table.pop(self, None)
        self.transport.abort()

    def _look(self) -> None:
        """Close the connection if it has been idle for too long; else look again a second later."""
        if self not in self.table:
            return
        if not self.is_asking and self.loop.time() - self.table[self] >= REQUEST_WITHIN_S:
            self.drop()
            return
        self.loop.call_later(LOOK_PERIOD_S, self._look)


def protocol() -> type[asyncio.Protocol]:
    """Return the protocol of one server, with a table of its own."""
    return type("Connection", (Connection,), {"table": {}})
