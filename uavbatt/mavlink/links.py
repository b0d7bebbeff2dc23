"""Endpoints (`endpoint.parse`) as raw sockets and serial lines. No dependencies but the standard library.

A link never blocks, and never raises an error because its peer is absent: it tries again with a growing pause (0.5 s to
10 s), and `problem` says why it is not open. Only UDP looks up the name of its host when it is made, and refuses an
unknown name. Links carry bytes; `framing` reads them.
"""

from __future__ import annotations

import errno
import math
import os
import socket
from collections.abc import Iterator
from typing import NamedTuple

from uavbatt.errors import UsageError
from uavbatt.mavlink.endpoint import Chunk, Endpoint, Link, parse, unusable
from uavbatt.mavlink.pipe import LARGEST_READ, Pipe, watched
from uavbatt.mavlink.resolver import Resolver, address_of, family_of
from uavbatt.mavlink.tcp_server import TcpServer

SHORTEST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 10.0
PEER_FORGOTTEN_S = 60.0
SILENT_AUTOPILOT_S = 60.0
MOST_PEERS = 32
READS_A_TURN = 64


def open_link(text: str, silent_after_s: float = math.inf) -> Link:
    """Open the link of an endpoint string. Raises UsageError for a bad string or a local address that is taken.

    silent_after_s : a client of `tcpin` that has sent nothing by then is dropped [s]; a ground station may only listen
    """
    at = check_endpoint(text)
    if at.kind in ("udpin", "udpout"):
        return UdpLink(at)
    return TcpServer(at, silent_after_s) if at.kind == "tcpin" else StreamLink(at)


def check_endpoint(text: str) -> Endpoint:
    """Return the parsed endpoint string. Raises UsageError for one that can never be opened."""
    at = parse(text)
    if at.kind == "serial":
        _speed(at)
    return at


def open_autopilot(text: str) -> Link:
    """Open the link of an autopilot, which drops clients that send nothing. Raises as `open_link`."""
    return open_link(text, SILENT_AUTOPILOT_S)


class Peer(NamedTuple):
    """Peer counts the datagrams of a peer that sent to a listening socket, and keeps the time of the last [s]."""

    datagrams: int
    heard_s: float


class UdpLink:
    """UdpLink carries datagrams: `udpin` learns its peers from what they send, `udpout` has one.

    Raises UsageError for an unknown host, and for a local address that is taken.
    """

    is_stream, problem = False, ""

    def __init__(self, at: Endpoint) -> None:
        self._peers: dict[tuple[str, int], Peer] = {}
        self._fixed = at.kind == "udpout"
        try:
            self._address = (address_of(at.host), at.port)
            self._socket = socket.socket(family_of(self._address[0]), socket.SOCK_DGRAM)
        except OSError as error:
            raise unusable(at, error) from None
        self._socket.setblocking(False)
        try:
            if not self._fixed:
                self._socket.bind(self._address)
        except OSError as error:
            self._socket.close()
            raise unusable(at, error) from None

    def filenos(self) -> Iterator[int]:
        """Yield the one socket."""
        yield self._socket.fileno()

    def read(self, now_s: float) -> list[Chunk]:
        """Return the datagrams that wait, at most 64 a turn."""
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
        """Send one datagram to the peer, or to every peer heard lately."""
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
            # drop the peer that sent least, so that many peers that send once cannot push out an autopilot
            for gone in forgotten or [min(self._peers, key=lambda p: self._peers[p])]:
                del self._peers[gone]
        was = self._peers.get(sender)
        self._peers[sender] = Peer(1 if was is None else was.datagrams + 1, now_s)


class StreamLink:
    """StreamLink is a TCP client or a serial line that is opened again whenever it breaks."""

    is_stream = True

    def __init__(self, at: Endpoint) -> None:
        self._at = at
        self._pipe: Pipe | None = None
        self._connecting: socket.socket | None = None
        self._pause_s, self._next_s, self._deadline_s = SHORTEST_PAUSE_S, float("-inf"), 0.0
        self._resolver, self._address = Resolver(at.host), ""
        self._name = at.host if at.kind == "serial" else at.text
        self.problem = ""

    def filenos(self) -> Iterator[int]:
        """Yield the descriptor, when open."""
        if self._pipe is not None:
            yield self._pipe.fd

    def read(self, now_s: float) -> list[Chunk]:
        """Return the bytes that have come in; open the line when it is closed."""
        pipe = self._opened(now_s)
        if pipe is None:
            return []
        data = pipe.read()
        if data is None:
            self._broken(now_s, f"lost {self._name}")
            return []
        if data:
            self._pause_s = SHORTEST_PAUSE_S
        if data or pipe.write(b""):
            return [(data, None)] if data else []
        self._broken(now_s, f"lost {self._name}")
        return []

    def write(self, data: bytes, now_s: float) -> None:
        """Send the bytes, opening the line if it is closed; what cannot be sent is lost."""
        pipe = self._opened(now_s)
        if pipe is not None and not pipe.offer(data, now_s):
            self._broken(now_s, f"lost {self._name}")

    def close(self) -> None:
        """Release what is open."""
        for thing in (self._pipe, self._connecting):
            if thing is not None:
                thing.close()
        self._pipe = self._connecting = None

    def _broken(self, now_s: float, why: str) -> None:
        self.close()
        self.problem = f"{why}, trying again"
        self._next_s = now_s + self._pause_s
        self._pause_s = min(2.0 * self._pause_s, LONGEST_PAUSE_S)

    def _opened(self, now_s: float) -> Pipe | None:
        if self._pipe is not None:
            return self._pipe
        if now_s < self._next_s:
            return None
        try:
            self._pipe = Pipe(_serial(self._at)) if self._at.kind == "serial" else self._connected(now_s)
        except OSError as error:
            self._broken(now_s, f"cannot open {self._name}: {error.strerror or error}")
        if self._pipe is not None:
            self.problem = ""
        return self._pipe

    def _connected(self, now_s: float) -> Pipe | None:
        """Return the connection once it is made; None until then. Raises OSError if it failed."""
        if self._connecting is None:
            address = self._resolver.address()
            if address is None:
                return None
            self._address = address
            self._connecting = socket.socket(family_of(address), socket.SOCK_STREAM)
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
        return watched(made)


def _speed(at: Endpoint) -> int:
    """Return the system's own number for a baud rate."""
    import termios

    speed: int | None = getattr(termios, f"B{at.port}", None)
    if speed is None:
        raise UsageError(f"endpoint `{at.text}`: {at.port} is no baud rate of this system")
    return speed


def _serial(at: Endpoint) -> int:
    """Open a raw, non-blocking serial line. Raises OSError if there is none, or if another program reads it.

    Two readers would each get a part of every frame.
    """
    import fcntl
    import termios
    import tty

    speed = _speed(at)
    fd = os.open(at.host, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        tty.setraw(fd)
        mode = termios.tcgetattr(fd)
        mode[2] = (mode[2] | termios.CLOCAL | termios.CREAD) & ~termios.CRTSCTS
        mode[4] = mode[5] = speed
        termios.tcsetattr(fd, termios.TCSANOW, mode)
    except BlockingIOError:
        os.close(fd)
        raise OSError(errno.EBUSY, "another program has it open") from None
    except termios.error as error:
        os.close(fd)
        raise OSError(errno.ENOTTY, f"no serial line ({error.args[-1]})") from None
    return fd
