"""Signatures of received frames (MAVLink 2): does the sender have the key, and is the frame new?

    signature (13): link id | timestamp (u48, little endian, 10 us since 2015) | first 48 bits of
                    SHA-256(key, frame from its first byte up to and with the timestamp)

The timestamp of a stream (system, component, link id) always rises; a new stream may be at most a minute behind the
newest frame of all. It is not compared with the clock of this computer, because neither companion nor autopilot may
know the time. Frames without a signature count as long as their sender has never sent a good signature: so a vehicle
that does not sign is heard, and nobody without the key can send in the name of a vehicle that signs.
"""

from __future__ import annotations

import hashlib
import hmac
from collections import Counter

from uavbatt.mavlink import framing

NEW_STREAM_BEHIND = 60 * 100_000  # ticks of 10 us
WRONG, UNSIGNED, LATE = "with a wrong signature", "without a signature", "sent again or late"


class Verifier:
    """Verifier judges the signatures of frames in order of reception, and counts the frames that it rejects."""

    def __init__(self, key: bytes) -> None:
        self._key = key
        self._streams: dict[tuple[int, int, int], int] = {}
        self._newest = 0
        self._signing: set[tuple[int, int]] = set()  # who has shown a good signature
        self._rejected: Counter[tuple[int, str]] = Counter()  # system, why

    def accepts(self, frame: bytes, header: framing.Header) -> bool:
        """Return True if a complete frame is accepted."""
        why = self._fault(frame, header)
        if not why:
            return True
        if len(self._rejected) < 64 or (header.system, why) in self._rejected:
            self._rejected[header.system, why] += 1
        return False

    def notes(self, followed: tuple[int, int] | None) -> list[str]:
        """Return notes for the operator on the followed vehicle (system, component) and on rejected frames."""
        found = [f"{n} frames of system {of} {why} rejected" for (of, why), n in sorted(self._rejected.items())]
        if any(why == WRONG for _, why in self._rejected) and not self._signing:
            found.append("no frame fits the key: is link.signing_key_file the vehicle's?")
        if followed is not None and followed not in self._signing:
            found.append(f"system {followed[0]} does not sign its frames: whoever is on the link can speak for it")
        return found

    def _fault(self, frame: bytes, header: framing.Header) -> str:
        sender = header.source
        if not framing.is_signed(frame):
            return UNSIGNED if sender in self._signing else ""
        body, signature = frame[:-6], frame[-6:]
        if not hmac.compare_digest(hashlib.sha256(self._key + body).digest()[:6], signature):
            return WRONG
        stream = (*sender, body[-7])
        ticks = int.from_bytes(body[-6:], "little")
        if ticks <= self._streams.get(stream, self._newest - NEW_STREAM_BEHIND):
            return LATE
        self._streams[stream] = ticks
        self._newest = max(self._newest, ticks)
        self._signing.add(sender)
        return ""
