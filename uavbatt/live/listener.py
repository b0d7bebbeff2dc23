"""Bytes of the autopilot's link -> complete frames with a good checksum and, if there is a key, a good signature.

The bytes of each sender are searched separately. `notes` tells the operator who is heard, and what is rejected and why;
each note goes to the log once.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from uavbatt.live.config import Config
from uavbatt.live.log import tell
from uavbatt.mavlink import framing
from uavbatt.mavlink.endpoint import Chunk
from uavbatt.mavlink.outgoing import BATTERY
from uavbatt.mavlink.signing import Verifier
from uavbatt.telemetry.formats.mission_file import read_mission
from uavbatt.telemetry.link.reader import LiveReader, checksum

MOST_SENDERS = 32
MOST_TOLD = 100  # notes that go to the log


class HeardFrame(NamedTuple):
    """HeardFrame holds a complete and valid frame with its sender."""

    data: bytes
    header: framing.Header
    sender: object


class Listener:
    """Listener finds frames, checks them, and counts the bad ones."""

    def __init__(self, config: Config, key: bytes | None) -> None:
        self.counts = {"frames": 0, "bad_checksums": 0, "rejected_signatures": 0}
        link = config.link
        own_battery = BATTERY if "battery" in config.feed.kinds else None
        self.reader = LiveReader(
            link.system, link.component, link.own_component, has_clock=link.clock, own_battery=own_battery
        )
        if config.pack.mission:
            self.reader.planned = read_mission(config.pack.mission)
        self._is_good = checksum()
        self._verifier = Verifier(key) if key is not None else None
        self._frames: dict[object, framing.Frames] = {}
        self._has_proxy = "proxy" in config.feed.kinds
        self._signing: dict[tuple[int, int], bool] = {}  # (system, component) -> its battery messages are signed
        self._told: set[str] = set()

    def frames(self, pieces: Iterable[Chunk]) -> Iterator[HeardFrame]:
        """Yield the good frames in the pieces that have come in, in order."""
        for data, sender in pieces:
            if sender not in self._frames and len(self._frames) >= MOST_SENDERS:
                self._frames.pop(next(iter(self._frames)))
            found = self._frames.setdefault(sender, framing.Frames())
            for frame in found.feed(data):
                if not self._is_good(frame):
                    found.reject()
                    self.counts["bad_checksums"] += 1
                    continue
                self.counts["frames"] += 1
                header = framing.header(frame)
                if self._verifier is not None and not self._verifier.accepts(frame, header):
                    self.counts["rejected_signatures"] += 1
                    continue
                if header.message_id == framing.BATTERY_STATUS:
                    self._signing[header.source] = framing.is_signed(frame)
                yield HeardFrame(frame, header, sender)

    def notes(self) -> list[str]:
        """Return notes for the operator about the link."""
        vehicle = self.reader.followed
        source = (vehicle.system, vehicle.component) if vehicle is not None else None
        found = self.reader.notes()
        if self._has_proxy and source is not None and self._signing.get(source, False):
            found.append("the autopilot signs its frames: the proxy passes them as they are, without our time")
        self._tell_once(found, found)
        if self._verifier is not None:
            judged = self._verifier.notes(source)
            self._tell_once(judged, ("".join(c for c in note if not c.isdigit()) for note in judged))
            found += judged
        return found

    def _tell_once(self, notes: Iterable[str], kinds: Iterable[str]) -> None:
        """Write each kind of note to the log once; a count that has grown is not written again."""
        for note, kind in zip(notes, kinds, strict=True):
            if kind not in self._told and len(self._told) < MOST_TOLD:
                self._told.add(kind)
                tell(note)
