"""The proxy between autopilot and ground stations: a small process of its own that goes on if the estimator fails.

    autopilot <-> proxy <-> ground stations          every byte as it came, in both directions, but:
                    ^                                BATTERY_STATUS of a battery whose time is known gets the time
                    | control socket (unix stream)
                estimator                            gets every byte of the autopilot, and missions that are written
                                                     to it; sends the time left

Rewritten frames: unsigned MAVLink 2 frames of message 147 with a good checksum, of a system, component and battery id
for which the estimator sent a time less than 3 s ago. The new time is that time less its age, at least 1 s. A time of
the autopilot's own is replaced only while ours is `ok`, and the replacement is logged. The estimator gets the original
frame and records it. A datagram stays one datagram; a stream's partial frame waits at most 20 ms. Control messages:
`kind (1 byte) | length (u16, little endian) | body`.

Run as `python -m uavbatt.live.feeds.proxy JSON` with the keys of `ProxySettings`. Standard library only.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import struct
import sys
from contextlib import suppress
from typing import NamedTuple

from uavbatt.errors import UavbattError
from uavbatt.live import clock
from uavbatt.live.feeds.rewriter import Rewriter
from uavbatt.live.log import tell
from uavbatt.mavlink.endpoint import Link
from uavbatt.mavlink.framing import Frames, Splitter, header
from uavbatt.mavlink.links import open_autopilot, open_link
from uavbatt.mavlink.originated import may_reach_autopilot
from uavbatt.mavlink.pipe import Pipe, wait

HOLD_S = 0.020
LOG_PERIOD_S = 10.0
HELLO, ESTIMATE, TO_GCS, TO_AUTOPILOT, QUIT = b"H", b"E", b"G", b"A", b"Q"
TELEMETRY, STATS, FROM, STATION = b"T", b"P", b"F", b"S"
WRITES_MISSION = frozenset((38, 39, 44, 45, 73))  # MISSION_ WRITE_PARTIAL_LIST, ITEM, COUNT, CLEAR_ALL, ITEM_INT
MOST_STATIONS = 16  # ground stations whose frames are put together
LONGEST_BODY = 60_000


class ProxySettings(NamedTuple):
    """ProxySettings holds the settings that the proxy gets at its start."""

    autopilot: str
    gcs: list[str]
    control: str
    request: bool = False  # whether the estimator may ask the autopilot for rates and parameters
    request_mission: bool = False  # ... and for its mission
    soc: bool = False  # rewrite battery_remaining as well


def message(kind: bytes, body: bytes) -> bytes:
    """Return a control message."""
    return kind + struct.pack("<H", len(body)) + body


class Messages:
    """Messages splits a control stream into messages."""

    def __init__(self) -> None:
        self._data = b""

    def feed(self, data: bytes) -> list[tuple[bytes, bytes]]:
        """Return (kind, body) of every message that is complete now."""
        self._data += data
        made = []
        while len(self._data) >= 3:
            end = 3 + int.from_bytes(self._data[1:3], "little")
            if len(self._data) < end:
                break
            made.append((self._data[:1], self._data[3:end]))
            self._data = self._data[end:]
        return made


class Control:
    """Control is the control socket. It has one client, the newest; a client that is slow or gone is dropped."""

    def __init__(self, path: str) -> None:
        self._path, self._messages = path, Messages()
        self._client: Pipe | None = None
        if os.path.exists(path):
            os.unlink(path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.bind(path)
        os.chmod(path, 0o600)
        self._socket.listen(2)
        self._socket.setblocking(False)

    def filenos(self) -> list[int]:
        """Return the file descriptors to wait on."""
        return [self._socket.fileno(), *([self._client.fd] if self._client is not None else [])]

    def read(self) -> list[tuple[bytes, bytes]]:
        """Return the messages of the estimator, (kind, body) each."""
        try:
            made, _ = self._socket.accept()
            made.setblocking(False)
            self.close_client()
            self._client, self._messages = Pipe(made.fileno(), made), Messages()
        except OSError:  # no client waits, or it has left again
            pass
        if self._client is None:
            return []
        data = self._client.read()
        if data is None:
            self.close_client()
            return []
        return self._messages.feed(data) if data else []

    def write(self, kind: bytes, body: bytes) -> None:
        """Send a message to the estimator, if it is connected; a long body goes in parts."""
        for at in range(0, max(len(body), 1), LONGEST_BODY):
            if self._client is not None and not self._client.write(message(kind, body[at : at + LONGEST_BODY])):
                self.close_client()

    def close_client(self) -> None:
        """Close the connection to the estimator."""
        if self._client is not None:
            self._client.close()
        self._client = None

    def close(self) -> None:
        """Close the socket and delete its file."""
        self.close_client()
        self._socket.close()
        if os.path.exists(self._path):
            os.unlink(self._path)


class Proxy:
    """Proxy passes bytes on in a loop; `turn` is one pass of it."""

    def __init__(self, settings: ProxySettings) -> None:
        self._settings = settings
        self.rewriter = Rewriter(settings.soc)
        self.autopilot = open_autopilot(settings.autopilot)
        self.stations: list[Link] = [open_link(text) for text in settings.gcs]
        self.control = Control(settings.control)
        self._splitters: dict[object, tuple[Splitter, float]] = {}
        self._written: dict[object, Frames] = {}
        self._log_s = float("-inf")
        self._from = ""  # sender of the telemetry that the estimator got last
        self._first_stream: object = None
        self.is_asked_to_quit = False

    def wait(self) -> None:
        """Sleep until a byte comes; at most 20 ms while a partial frame is held."""
        waiting = any(splitter.waiting for splitter, _ in self._splitters.values())
        ready = [fd for link in (self.autopilot, *self.stations) for fd in link.filenos()]
        wait([*ready, *self.control.filenos()], HOLD_S / 2 if waiting else 0.25)

    def turn(self, now_s: float) -> None:
        """Pass on what has come in."""
        for kind, body in self.control.read():
            self._take_message(kind, body, now_s)
        for station in self.stations:
            for data, sender in station.read(now_s):
                self.autopilot.write(data, now_s)
                self._missions_to_estimator(data, (id(station), sender))
        for data, sender in self.autopilot.read(now_s):
            if self.autopilot.is_stream:
                self._stream(data, sender, now_s)
            else:
                self._to_stations(self.rewriter.datagram(data, now_s), now_s)
                self._to_estimator(data, sender)
        for sender, (splitter, since_s) in self._splitters.items():
            if splitter.waiting and now_s - since_s >= HOLD_S:
                self._pass(splitter.flush(), sender, now_s)
        if self.rewriter.replaced and now_s >= self._log_s:
            self._log_s = now_s + LOG_PERIOD_S
            self._log_replaced()

    def _log_replaced(self) -> None:
        """Log the autopilot's own times that were replaced since the last line."""
        told, self.rewriter.replaced = self.rewriter.replaced, {}
        for (system, component, battery), (own_s, left_s) in told.items():
            place = f"system {system} component {component} battery {battery}"
            tell(f"{place}: its own {own_s} s replaced by {left_s} s", "uavbatt proxy")

    def close(self) -> None:
        """Release all sockets."""
        for link in (self.autopilot, *self.stations):
            link.close()
        self.control.close()

    def _stream(self, data: bytes, sender: object, now_s: float) -> None:
        splitter, since_s = self._splitters.get(sender) or (Splitter(), now_s)
        if len(self._splitters) > 64:
            self._splitters.clear()
        was_waiting = splitter.waiting
        made = splitter.feed(data)
        self._splitters[sender] = (splitter, since_s if was_waiting and not made else now_s)
        for piece, whole in made:
            if whole:
                self._to_stations(self.rewriter.frame(piece, now_s), now_s)
                self._to_estimator(piece, sender)
            else:
                self._pass(piece, sender, now_s)

    def _pass(self, data: bytes, sender: object, now_s: float) -> None:
        self._to_stations(data, now_s)
        self._to_estimator(data, sender)

    def _to_estimator(self, data: bytes, sender: object) -> None:
        """Send telemetry to the estimator, and before it the sender if that has changed."""
        if isinstance(sender, tuple):
            place = f"{sender[0]}:{sender[1]}"
        else:  # streams have no name; usually there is only one, which gets the empty name
            self._first_stream = self._first_stream or sender
            place = "" if sender is self._first_stream else str(id(sender))
        if place != self._from:
            self._from = place
            self.control.write(FROM, place.encode())
        self.control.write(TELEMETRY, data)

    def _missions_to_estimator(self, data: bytes, sender: object) -> None:
        """Send frames with which a ground station writes a mission to the estimator, which needs the route."""
        if sender not in self._written and len(self._written) >= MOST_STATIONS:
            self._written.pop(next(iter(self._written)))
        for frame in self._written.setdefault(sender, Frames()).feed(data):
            if header(frame).message_id in WRITES_MISSION:
                self.control.write(STATION, frame)

    def _to_stations(self, data: bytes, now_s: float) -> None:
        for station in self.stations:
            station.write(data, now_s)

    def _take_message(self, kind: bytes, body: bytes, now_s: float) -> None:
        if kind == ESTIMATE:
            self.rewriter.take(body)
        elif kind == TO_GCS:
            self._to_stations(body, now_s)
        elif kind == TO_AUTOPILOT and self._may_ask(header(body).message_id):
            self.autopilot.write(body, now_s)
        elif kind == HELLO:
            self._from = ""  # it may be another estimator
            stats = {
                "settings": self._settings._asdict(),
                "pid": os.getpid(),
                "rewritten": self.rewriter.rewritten,
                "problem": self.autopilot.problem,
            }
            self.control.write(STATS, json.dumps(stats).encode())
        elif kind == QUIT:
            self.is_asked_to_quit = True

    def _may_ask(self, message_id: int) -> bool:
        asks, reads = self._settings.request, self._settings.request_mission
        return (asks or reads) and may_reach_autopilot(message_id, asks, reads)


def main() -> int:
    """Run the proxy until SIGTERM, SIGINT or QUIT; return the process's exit code: 2 if it cannot start, else 0."""
    stopped: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda signum, frame: stopped.append(signum))
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    with suppress(OSError):  # highest priority for frames, if that is allowed
        os.nice(-10 - os.nice(0))
    try:
        proxy = Proxy(ProxySettings(**json.loads(sys.argv[1])))
    except (UavbattError, OSError) as error:
        tell(str(error), "uavbatt proxy")
        return 2
    while not (stopped or proxy.is_asked_to_quit):
        proxy.wait()
        proxy.turn(clock.now_s())
    proxy.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
