"""The route of one vehicle as it is heard, and the frames that told it last.

An autopilot tells its home and its mission once, or when it is asked. A recording that begins later starts with their
frames, and a process that is started anew in the air takes them from its saved state.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from uavbatt.mavlink.framing import Header
from uavbatt.telemetry.route.messages import HOME_POSITION, MISSION_ACK, OF_AUTOPILOT, OF_OTHERS, NavigationListener

MOST_TRANSFER_FRAMES = 6000
_HOME, _MISSION = b"home", b"mission "


class ToldFrame(NamedTuple):
    """ToldFrame holds a frame, its header and its message."""

    header: Header
    message: Any
    frame: bytes


class HeardRoute:
    """HeardRoute passes messages about the route on to a `NavigationListener`, and keeps the frames that told it last.

    source : system and component of the autopilot; words : the vehicle's frames by key, to which those of home and
    mission are added
    """

    def __init__(self, source: tuple[int, int], own_component: int | None, words: dict[bytes, bytes]) -> None:
        self._source, self._words = source, words
        self._own = None if own_component is None else (source[0], own_component)
        self.listener = NavigationListener(own=self._own)
        self._in_transfer: list[bytes] = []  # frames of the mission transfer that is open

    @property
    def frames(self) -> bytes:
        """Return the frames in which home and mission were told last; without a mission that is known to be wrong."""
        held = self.listener.builder.held
        kept = (_HOME, _MISSION) if held is not None and not held.reason else (_HOME,)
        return b"".join(frame for key, frame in self._words.items() if key.startswith(kept))

    def take(self, time_s: float, message_id: int, message: Any, frame: bytes) -> None:
        """Take a message of the autopilot."""
        if message_id in OF_OTHERS or message_id == MISSION_ACK:
            self._transfer(frame, lambda: self.listener.take(time_s, message_id, message))
            return
        self.listener.take(time_s, message_id, message)
        if message_id == HOME_POSITION:
            self._words[_HOME] = frame

    def take_other(self, time_s: float, message_id: int, message: Any, frame: bytes) -> bool:
        """Take a mission message of another station; return True if it was sent to this autopilot."""
        system, component = self._source
        if (message.target_system, message.target_component) not in ((system, component), (system, 0)):
            return False
        self._transfer(frame, lambda: self.listener.take_other(time_s, message_id, message))
        return True

    def resume(self, time_s: float, heard: Iterable[ToldFrame]) -> None:
        """Take the `frames` of an earlier process, where this one has not heard home or mission itself."""
        has_home = self.listener.now.home is not None
        has_mission = self.listener.builder.held is not None or self.listener.transfer.is_open
        for header, message, frame in heard:
            if has_home if header.message_id == HOME_POSITION else has_mission:
                continue
            if header.source == self._source and header.message_id in OF_AUTOPILOT:
                self.take(time_s, header.message_id, message, frame)
            elif header.message_id in OF_OTHERS:
                self.take_other(time_s, header.message_id, message, frame)

    def forget(self) -> None:
        """Forget the route: it was another vehicle's."""
        self.listener, self._in_transfer = NavigationListener(own=self._own), []
        self._drop((_HOME, _MISSION))

    def _transfer(self, frame: bytes, take: Callable[[], None]) -> None:
        """Process a frame of a mission transfer; the frames of the last complete one are kept."""
        if len(self._in_transfer) < MOST_TRANSFER_FRAMES:
            self._in_transfer.append(frame)
        before = self.listener.builder.held
        take()
        if self.listener.builder.held is not before:
            self._drop((_MISSION,))
            self._words |= {_MISSION + b"%d" % k: kept for k, kept in enumerate(self._in_transfer)}
        if not self.listener.transfer.is_open:
            self._in_transfer = []

    def _drop(self, kinds: tuple[bytes, ...]) -> None:
        for key in [key for key in self._words if key.startswith(kinds)]:
            del self._words[key]
