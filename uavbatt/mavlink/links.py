"""Endpoints (`endpoint.parse`) as raw sockets and serial lines. No dependencies but the standard library.

A link never blocks and never raises for a peer that is not there: what cannot be opened or has broken off is tried
again with a growing pause (0.5 s to 10 s). A client of a stream that does not take its bytes is dropped.
Bytes only: what they mean is `framing`'s matter.
"""

from __future__ import annotations

import errno
import os
import socket
import threading
from collections.abc import Iterator
from typing import NamedTuple

from uavbatt.errors import UsageError
from uavbatt.mavlink.endpoint import Chunk, Endpoint, Link, parse

SHORTEST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 10.0
PEER_FORGOTTEN_S = 60.0
MOST_PEERS = 32
LARGEST_READ = 65_536
MOST_PENDING = 131_072  # bytes that a slow stream may lag behind before it is dropped
READS_A_TURN = 64


def open_link(text: str) -> Link:
    """The link of an endpoint string. Raises UsageError for a bad string or a local address that is taken."""
    at = parse(text)
    if at.kind in ("udpin", "udpout"):
        return UdpLink(at)
    return TcpServer(at) if at.kind == "tcpin" else StreamLink(at)


class Peer(NamedTuple):
    """Who sent to a listening socket: how many datagrams, and when the last."""

    datagrams: int
    heard_s: float


class UdpLink:
    """Datagrams. `udpin` learns its peers from what they send; `udpout` has one."""

    is_stream = False

    def __init__(self, at: Endpoint) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._peers: dict[tuple[str, int], Peer] = {}
        self._fixed = at.kind == "udpout"
        try:
            self._address = (socket.gethostbyname(at.host), at.port)
            if not self._fixed:
                self._socket.bind(self._address)
        except OSError as error:
            self._socket.close()
            raise UsageError(f"endpoint `{at.text}`: {error.strerror or error}") from None

    def filenos(self) -> Iterator[int]:
        """One socket."""
        yield self._socket.fileno()

    def read(self, now_s: float) -> list[Chunk]:
        """The datagrams that wait, at most 64 a turn."""
        found: list[Chunk] = []
        for _ in range(READS_A_TURN):
            try:
                data, sender = self._socket.recvfrom(LARGEST_READ)
            except BlockingIOError:
                break
            except OSError:  # a port that nobody listens on answers with an error
                continue
            if not self._fixed:
                self._remember(sender, now_s)
            found.append((data, sender))
        return found

    def write(self, data: bytes, now_s: float) -> None:
        """One datagram to the peer, or to every peer heard lately."""
        lately = [p for p, peer in self._peers.items() if now_s - peer.heard_s < PEER_FORGOTTEN_S]
        peers = [self._address] if self._fixed else lately
        for peer in peers:
            try:
                self._socket.sendto(data, peer)
            except OSError:
                continue

    def close(self) -> None:
        """Release the socket."""
        self._socket.close()

    def _remember(self, sender: tuple[str, int], now_s: float) -> None:
        if sender not in self._peers and len(self._peers) >= MOST_PEERS:
            forgotten = [p for p, peer in self._peers.items() if now_s - peer.heard_s >= PEER_FORGOTTEN_S]
            # whoever sent least gives way: an autopilot that streams is not pushed out by many that send once
            for gone in forgotten or [min(self._peers, key=lambda p: self._peers[p])]:
                del self._peers[gone]
        was = self._peers.get(sender)
        self._peers[sender] = Peer(1 if was is None else was.datagrams + 1, now_s)


class Pipe:
    """One open stream: a descriptor with the bytes it has not taken yet."""

    def __init__(self, fd: int, owner: socket.socket | None = None) -> None:
        self.fd, self._owner, self._pending = fd, owner, b""

    def read(self) -> bytes | None:
        """What has come in; empty when nothing; None when the other side is gone."""
        try:
            return os.read(self.fd, LARGEST_READ) or None
        except BlockingIOError:
            return b""
        except OSError:
            return None

    def write(self, data: bytes) -> bool:
        """Send, keep what does not fit; False when the other side is gone or too slow."""
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


class Resolver:
    """Finds the address of a host without making anybody wait: a slow resolver is asked in a thread of its own."""

    def __init__(self, host: str) -> None:
        self._host = host
        self._thread: threading.Thread | None = None
        self._found: str | OSError | None = None

    def address(self) -> str | None:
        """The address; None while it is looked for. Raises OSError when it was not found; the next call looks anew."""
        if _is_address(self._host):
            return self._host
        if self._thread is None:
            self._thread = threading.Thread(target=self._look, name="resolver", daemon=True)
            self._thread.start()
        if self._thread.is_alive():
            return None
        self._thread, found = None, self._found
        if isinstance(found, OSError):
            raise found
        return found

    def _look(self) -> None:
        try:
            self._found = socket.gethostbyname(self._host)
        except (OSError, UnicodeError) as error:  # a label of more than 63 characters is no host name
            self._found = error if isinstance(error, OSError) else OSError(errno.EINVAL, str(error))


def _is_address(host: str) -> bool:
    try:
        socket.inet_aton(host)
    except OSError:
        return False
    return True


class StreamLink:
    """A TCP client or a serial line that is opened again whenever it breaks."""

    is_stream = True

    def __init__(self, at: Endpoint) -> None:
        self._at = at
        self._pipe: Pipe | None = None
        self._connecting: socket.socket | None = None
        self._pause_s, self._next_s, self._deadline_s = SHORTEST_PAUSE_S, float("-inf"), 0.0
        self._resolver, self._address = Resolver(at.host), ""

    def filenos(self) -> Iterator[int]:
        """The descriptor, when open."""
        if self._pipe is not None:
            yield self._pipe.fd

    def read(self, now_s: float) -> list[Chunk]:
        """What has come in; opens the line when it is closed."""
        pipe = self._opened(now_s)
        if pipe is None:
            return []
        data = pipe.read()
        if data is None:
            self._broken(now_s)
            return []
        if data:
            self._pause_s = SHORTEST_PAUSE_S
        if data or pipe.write(b""):
            return [(data, None)] if data else []
        self._broken(now_s)
        return []

    def write(self, data: bytes, now_s: float) -> None:
        """Send, if the line is open."""
        pipe = self._opened(now_s)
        if pipe is not None and not pipe.write(data):
            self._broken(now_s)

    def close(self) -> None:
        """Release what is open."""
        for thing in (self._pipe, self._connecting):
            if thing is not None:
                thing.close()
        self._pipe = self._connecting = None

    def _broken(self, now_s: float) -> None:
        self.close()
        self._next_s = now_s + self._pause_s
        self._pause_s = min(2.0 * self._pause_s, LONGEST_PAUSE_S)

    def _opened(self, now_s: float) -> Pipe | None:
        if self._pipe is not None:
            return self._pipe
        if now_s < self._next_s:
            return None
        try:
            self._pipe = Pipe(_serial(self._at)) if self._at.kind == "serial" else self._connected(now_s)
        except OSError:
            self._broken(now_s)
        return self._pipe

    def _connected(self, now_s: float) -> Pipe | None:
        """A connection that is being made counts as closed; OSError when it failed."""
        if self._connecting is None:
            address = self._resolver.address()
            if address is None:
                return None
            self._address = address
            self._connecting = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            self._connecting.setblocking(False)
            self._deadline_s = now_s + 5.0
        code = self._connecting.connect_ex((self._address, self._at.port))
        if code in (errno.EINPROGRESS, errno.EALREADY):
            if now_s > self._deadline_s:
                raise OSError(errno.ETIMEDOUT, "no answer")
            return None
        if code not in (0, errno.EISCONN):
            raise OSError(code, os.strerror(code))
        made, self._connecting = self._connecting, None
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return Pipe(made.fileno(), made)


class TcpServer:
    """Accepts clients; each gets everything, and one that is slow is dropped."""

    is_stream = True

    def __init__(self, at: Endpoint) -> None:
        self._clients: list[Pipe] = []
        try:
            self._socket = socket.create_server((at.host, at.port))
        except OSError as error:
            raise UsageError(f"endpoint `{at.text}`: {error.strerror or error}") from None
        self._socket.setblocking(False)

    def filenos(self) -> Iterator[int]:
        """The listening socket and the clients."""
        yield self._socket.fileno()
        yield from (client.fd for client in self._clients)

    def read(self, now_s: float) -> list[Chunk]:
        """What the clients sent; takes in new ones, forgets those that left."""
        self._accept()
        found: list[Chunk] = []
        for client in list(self._clients):
            data = client.read()
            if data:
                found.append((data, client))
            elif data is None or not client.write(b""):
                self._drop(client)
        return found

    def write(self, data: bytes, now_s: float) -> None:
        """Send to every client, the one that has just come as well."""
        self._accept()
        for client in list(self._clients):
            if not client.write(data):
                self._drop(client)

    def close(self) -> None:
        """Release all sockets."""
        for client in list(self._clients):
            self._drop(client)
        self._socket.close()

    def _accept(self) -> None:
        while len(self._clients) < MOST_PEERS:
            try:
                made, _ = self._socket.accept()
            except OSError:
                return
            made.setblocking(False)
            made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._clients.append(Pipe(made.fileno(), made))

    def _drop(self, client: Pipe) -> None:
        client.close()
        self._clients.remove(client)


def _serial(at: Endpoint) -> int:
    """A raw, non-blocking serial line; OSError when it is not there or is no serial line."""
    import termios
    import tty

    speed = getattr(termios, f"B{at.port}", None)
    if speed is None:
        raise UsageError(f"endpoint `{at.text}`: {at.port} is no baud rate of this system")
    fd = os.open(at.host, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        tty.setraw(fd)
        mode = termios.tcgetattr(fd)
        mode[2] = (mode[2] | termios.CLOCAL | termios.CREAD) & ~termios.CRTSCTS
        mode[4] = mode[5] = speed
        termios.tcsetattr(fd, termios.TCSANOW, mode)
    except termios.error as error:
        os.close(fd)
        raise OSError(errno.ENOTTY, str(error)) from None
    return fd
