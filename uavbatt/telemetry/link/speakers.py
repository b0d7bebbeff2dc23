"""Judgement of each frame of one identity: does it come from the sender that is believed?"""

from __future__ import annotations

from uavbatt.mavlink import framing
from uavbatt.mavlink.fields import BatteryFields
from uavbatt.telemetry.link.senders import MOST_SENDERS, Senders
from uavbatt.telemetry.link.sequence_numbers import SequenceNumbers


class Speakers:
    """Speakers holds the senders of one system and component, and their sequence numbers."""

    def __init__(self) -> None:
        self.senders = Senders()
        self._counts: dict[object, SequenceNumbers] = {}

    def admits(self, frame: bytes, stamp_s: float, address: object, battery: BatteryFields | None) -> bool:
        """Return True if a frame from an address, received at `stamp_s` [s], counts; compare its battery's reading."""
        stream = self._stream_of(frame, stamp_s, address)
        if battery is not None:
            self.senders.compare(stream, battery, stamp_s)
        # Streams of one address that agree are one sender on two links: all of its rows count.
        speaker = stream if self.senders.conflicts(stamp_s) else address
        return self.senders.admits(speaker, stamp_s, battery is not None)

    def _stream_of(self, frame: bytes, stamp_s: float, address: object) -> object:
        """Return the sender of a frame from an address: two may share one address (`sequence_numbers`)."""
        if address not in self._counts:
            if len(self._counts) >= MOST_SENDERS:
                del self._counts[next(iter(self._counts))]  # the first that was heard
            self._counts[address] = SequenceNumbers(address)
        return self._counts[address].stream(framing.sequence(frame), stamp_s)
