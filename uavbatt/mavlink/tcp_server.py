"""`tcpin:HOST:PORT`: a server to which every client may connect; each gets all bytes.

A client is dropped if it reads too slowly, and, on the autopilot's link, if it has sent nothing within a minute. If all
places are taken, a new client gets the place of the oldest client that has never sent anything, else of the one that
has been silent for longest; it is refused if all have sent in the last QUIET_S. So an autopilot always finds a place
among silent clients, and keeps it while it sends.
"""

from __future__ import annotations

import socket
from collections.abc import Iterator

from uavbatt.mavlink.endpoint import Chunk, Endpoint, unusable
from uavbatt.mavlink.pipe import Pipe, watched
from uavbatt.mavlink.resolver import address_of, family_of

MOST_CLIENTS = 32
QUIET_S = 5.0  # heartbeats come every second


class TcpServer:
    """TcpServer holds the listening socket and its clients, at most MOST_CLIENTS.

    Raises UsageError for a local address that is taken.
    """

    is_stream, problem = True, ""

    def __init__(self, at: Endpoint, silent_after_s: float) -> None:
        self._clients: dict[Pipe, tuple[bool, float]] = {}  # has it spoken, and when it last did or came [s]
        self._silent_after_s = silent_after_s
        try:
            address = address_of(at.host)
            is_both = address == "::" and socket.has_dualstack_ipv6()  # a datagram socket on :: hears both
            self._socket = socket.create_server((address, at.port), family=family_of(address), dualstack_ipv6=is_both)
        except OSError as error:
            raise unusable(at, error) from None
        self._socket.setblocking(False)

    def filenos(self) -> Iterator[int]:
        """Yield the listening socket and the clients."""
        yield self._socket.fileno()
        yield from (client.fd for client in self._clients)

    def read(self, now_s: float) -> list[Chunk]:
        """Return the bytes that the clients sent; drop clients that left or are silent, accept new ones."""
        found: list[Chunk] = []
        for client, (has_spoken, since_s) in list(self._clients.items()):
            data = client.read()
            if data:
                self._clients[client] = (True, now_s)
                found.append((data, client))
                continue
            is_silent = not has_spoken and now_s - since_s > self._silent_after_s
            if data is None or is_silent or not client.write(b""):
                self._drop(client)
        self._accept(now_s)
        return found

    def write(self, data: bytes, now_s: float) -> None:
        """Send to every client that is not behind, also to one that has just connected."""
        self._accept(now_s)
        for client in list(self._clients):
            if not client.offer(data, now_s):
                self._drop(client)

    def close(self) -> None:
        """Release all sockets."""
        for client in list(self._clients):
            self._drop(client)
        self._socket.close()

    def _accept(self, now_s: float) -> None:
        """Accept the clients that wait, MOST_CLIENTS a turn at most; refuse those without a place."""
        for _ in range(MOST_CLIENTS):
            try:
                made, _address = self._socket.accept()
            except OSError:
                return
            if not self._has_place(now_s):
                made.close()
                continue
            self._clients[watched(made)] = (False, now_s)

    def _has_place(self, now_s: float) -> bool:
        """Return True if there is room for one more; make it where a client may be dropped."""
        if len(self._clients) < MOST_CLIENTS:
            return True
        weakest = min(self._clients, key=lambda client: self._clients[client])
        has_spoken, since_s = self._clients[weakest]
        if has_spoken and now_s - since_s <= QUIET_S:
            return False
        self._drop(weakest)
        return True

    def _drop(self, client: Pipe) -> None:
        client.close()
        del self._clients[client]
