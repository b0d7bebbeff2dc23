"""Live frames -> rows of every battery of the vehicle that is followed.

    frame (any system) -> its vehicle -> is its sender believed? -> `Vehicle`: rows, parameters, the armed bit

Who is followed, `Following` chooses. With system or component given only such vehicles count. Each autopilot is read
for itself, so that nothing of one (its parameters, rows that wait) ever mixes with another's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from uavbatt.mavlink import fields, framing
from uavbatt.navigation import NOWHERE, Navigation
from uavbatt.records import PackFacts
from uavbatt.telemetry.following import Following
from uavbatt.telemetry.formats.mission_file import PlannedFlight
from uavbatt.telemetry.formats.tlog_frames import decoder
from uavbatt.telemetry.lateness import BOOT_TIME_AT, boot_time_s
from uavbatt.telemetry.route.messages import OF_AUTOPILOT, OF_OTHERS
from uavbatt.telemetry.vehicle import BATTERY_IDS, LiveRow, Vehicle, battery_fields

__all__ = ["LiveReader", "LiveRow", "Taken", "checksum"]

MOST_VEHICLES = 16
_TOLD_BY = frozenset((*BATTERY_IDS, fields.HEARTBEAT, fields.PARAM_VALUE, fields.AUTOPILOT_VERSION))
WANTED = _TOLD_BY | OF_AUTOPILOT | OF_OTHERS
AUTOPILOT_COMPONENT = 1


class Taken(NamedTuple):
    """Taken holds the rows that a frame completes, and True if the frame is the followed vehicle's (to be recorded)."""

    rows: list[LiveRow]
    is_ours: bool


NOTHING = Taken([], False)


def is_sound(frame: bytes, end: int, extra: int) -> bool:
    """Return True if the checksum behind the payload, which ends at `end`, is right; `extra` is the message's seed."""
    from pymavlink.generator.mavcrc import x25crc

    crc = x25crc(frame[1:end] + bytes([extra]))
    return bool(crc.crc == frame[end] | frame[end + 1] << 8)


def checksum() -> Callable[[bytes], bool]:
    """Return a function that is True for a whole frame whose checksum is good or whose message this dialect lacks."""
    from pymavlink.dialects.v20 import ardupilotmega

    extras = {number: kind.crc_extra for number, kind in ardupilotmega.mavlink_map.items()}

    def is_good(frame: bytes) -> bool:
        extra = extras.get(framing.header(frame).message_id)
        if extra is None:
            return True
        return is_sound(frame, (6 if frame[0] == framing.V1 else framing.V2_HEADER) + frame[1], extra)

    return is_good


class LiveReader:
    """LiveReader takes frames in order of reception, follows one vehicle, and says whom it heard."""

    def __init__(
        self,
        system: int | None = None,
        component: int | None = None,
        own_component: int | None = None,
        *,
        has_clock: bool = True,
    ) -> None:
        self._asked, self._own_component, self._has_clock = (system, component), own_component, has_clock
        self._decode = decoder()
        self._vehicles: dict[tuple[int, int], Vehicle] = {}
        self._heard: dict[int, None] = {}  # systems of autopilots, in order
        self._resumed: Mapping[str, float] = {}
        self.planned: PlannedFlight | None = None
        self.following = Following()
        self.rejected = 0
        self._now_s = -math.inf

    @property
    def followed(self) -> Vehicle | None:
        """Return the vehicle that is followed; None before one is heard."""
        return self.following.vehicle

    @property
    def awaited(self) -> Vehicle | None:
        """Return the vehicle that fell silent in the air, and is followed again when it speaks."""
        return self.following.awaited

    @property
    def system(self) -> int | None:
        """Return the system of the followed vehicle; before there is one, the system that was asked for."""
        return self.followed.system if self.followed is not None else self._asked[0]

    @property
    def component(self) -> int | None:
        """Return the component of the followed autopilot; before there is one, the one that was asked for."""
        return self.followed.component if self.followed is not None else self._asked[1]

    @property
    def is_found(self) -> bool:
        """Return True if a vehicle has been found."""
        return self.followed is not None

    @property
    def now_s(self) -> float:
        """Return the time of the vehicle's last frame, from its first [s]."""
        return self.followed.now_s if self.followed is not None else 0.0

    @property
    def armed(self) -> bool | None:
        """Return the armed bit of the vehicle's last heartbeat; None before it."""
        return self.followed.armed if self.followed is not None else None

    @property
    def is_px4(self) -> bool:
        """Return True if the followed autopilot is PX4."""
        return self.followed is not None and self.followed.is_px4 is True

    @property
    def late_s(self) -> float:
        """Return how late the followed vehicle's frames come, by its own clock [s]; 0 where that is not to be asked."""
        if self.followed is None or not self._has_clock:
            return 0.0
        return self.followed.lateness.late_s(self._now_s)

    @property
    def navigation(self) -> Navigation:
        """Return what is known of the vehicle's route and place; a mission that a file plans wins over what passes."""
        known = self.followed.route.now if self.followed is not None else NOWHERE
        if self.planned is None:
            return known
        home = known.home or self.planned.home
        return replace(known, mission=self.planned.mission, home=home, transferring=False)

    @property
    def battery_ids(self) -> set[int]:
        """Return the ids of the batteries of which BATTERY_STATUS speaks."""
        return self.followed.battery_ids if self.followed is not None else set()

    @property
    def parameters(self) -> Mapping[str, float]:
        """Return the vehicle's parameters that count, by name."""
        return self.followed.parameters.known if self.followed is not None else self._resumed

    @property
    def doubted(self) -> Mapping[str, float]:
        """Return the parameters that are said to have changed in flight, and do not count yet, by name."""
        found = self.followed.parameters.doubted if self.followed is not None else {}
        return {name: doubt.value for name, doubt in found.items()}

    @property
    def hardware(self) -> str:
        """Return the serial number of the followed autopilot; empty until it has told it."""
        return self.followed.hardware if self.followed is not None else ""

    def pack(self, instance: int) -> fields.PackIdentity:
        """Return who the pack of a battery is, as far as anybody has said."""
        return self.followed.pack(instance) if self.followed is not None else fields.PackIdentity(instance)

    @property
    def version(self) -> tuple[int, int]:
        """Return two numbers: one grows when another vehicle is followed, the other when a parameter changes."""
        return self.following.changes, self.followed.parameters.version if self.followed is not None else 0

    def resume(self, parameters: Mapping[str, float]) -> None:
        """Take over parameters that an earlier process heard of this vehicle, instead of any resumed before.

        Before a vehicle is followed they wait for it. What the vehicle itself says goes before.
        """
        if self.followed is not None:
            self.followed.resume(parameters)
        else:
            self._resumed = dict(parameters)

    def facts(self, instance: int) -> PackFacts:
        """Return the vehicle's words so far about one battery."""
        return self.followed.facts(instance) if self.followed is not None else PackFacts()

    def conflict(self, instance: int) -> str:
        """Name what the senders of a battery disagree on; empty while they agree."""
        return self.followed.senders.conflict(instance, self._now_s) if self.followed is not None else ""

    def notes(self) -> list[str]:
        """Return notes for the operator about who is heard and who is believed."""
        found, vehicle = [], self.followed
        if len(self._heard) > 1 or (self._heard and vehicle is None):
            whom = f"following {vehicle.system}" if vehicle is not None else f"waiting for {self._wanted}"
            found.append(f"heard system{'s' * (len(self._heard) > 1)} {', '.join(map(str, self._heard))}; {whom}")
        if vehicle is None:
            return found
        if self.awaited is not None:
            found.append(f"system {self.awaited.system} fell silent in the air: followed again when it speaks")
        for number, words in vehicle.senders.conflicts(self._now_s):
            found.append(f"two senders speak for system {vehicle.system} and disagree on battery {number}: {words}")
        found += vehicle.voltages.notes
        for name, value in self.doubted.items():
            change = f"{name} changed in flight from {self.parameters[name]:g} to {value:g}"
            found.append(f"{change}: counts when it is heard again")
        return found

    def take(self, frame: bytes, header: framing.Header, stamp_s: float, sender: object = None) -> Taken:
        """Take in a frame, and return what it gives.

        stamp_s : time of reception [s], never falling; sender : who sent it, if that is known
        """
        self._now_s = stamp_s
        if header.message_id in fields.IDENTITY_LENGTH:
            self._meet(frame, header)
        message: Any = None
        if header.message_id in WANTED:
            message = self._decode(frame)
            if not message:
                self.rejected += 1
                return NOTHING
            if header.message_id in _TOLD_BY:
                self._hear(header, message)
        vehicle = self._vehicles.get((header.system, header.component))
        if vehicle is None:
            return self._of_a_part(header, stamp_s, message, frame)
        time_s, stream = vehicle.passes(stamp_s), vehicle.stream_of(frame, stamp_s, sender)
        battery = battery_fields(header.message_id, message) if header.message_id in BATTERY_IDS else None
        if battery is not None:
            vehicle.senders.compare(stream, battery, stamp_s)
        # Streams of one address that agree are one autopilot on two links: all of its rows count.
        speaker = stream if vehicle.senders.conflicts(stamp_s) else sender
        if not vehicle.senders.admits(speaker, stamp_s, battery is not None):
            return NOTHING
        if header.message_id in BOOT_TIME_AT:
            vehicle.lateness = vehicle.lateness.after(stamp_s, boot_time_s(frame, header.message_id))
        rows = vehicle.take(header.message_id, message, battery, frame, time_s) if message is not None else []
        if battery is not None or self.followed is None:
            self._follow(vehicle, stamp_s)
        vehicle.heard_s = stamp_s
        return Taken(rows, True) if vehicle is self.followed else self._of_a_part(header, stamp_s, None, frame)

    def _meet(self, frame: bytes, header: framing.Header) -> None:
        """Take in the identity of a pack, which any component of its vehicle may send."""
        end = framing.V2_HEADER + frame[1]
        if frame[0] != framing.V2 or not is_sound(frame, end, fields.IDENTITY_EXTRA[header.message_id]):
            return
        said = fields.pack_identity(header.message_id, frame[framing.V2_HEADER : end])
        for (system, _), vehicle in self._vehicles.items():
            if system == header.system and (said.serial or said.cycles is not None):
                vehicle.packs[said.id] = said

    @property
    def _wanted(self) -> str:
        parts = zip(("system", "component"), self._asked, strict=True)
        return " ".join(f"{what} {number}" for what, number in parts if number is not None)

    def _of_a_part(self, header: framing.Header, stamp_s: float, message: Any, frame: bytes) -> Taken:
        """Take in a frame that makes no row, of another component of the vehicle or a station that writes a mission."""
        if self.followed is None:
            return NOTHING
        is_to_us = message is not None and header.message_id in OF_OTHERS
        if is_to_us and self.followed.take_other(header.message_id, message, frame):
            return Taken([], True)
        if header.system != self.followed.system:
            return NOTHING
        self.followed.passes(stamp_s)
        return Taken([], True)

    def _hear(self, header: framing.Header, message: Any) -> None:
        """Get to know an autopilot: its heartbeat, or component 1 speaking of batteries, parameters or itself."""
        source = (header.system, header.component)
        if source in self._vehicles:
            return
        system, component = self._asked
        is_heartbeat = header.message_id == fields.HEARTBEAT
        if not (fields.is_autopilot(message) if is_heartbeat else source[1] == (component or AUTOPILOT_COMPONENT)):
            return
        if len(self._heard) < MOST_VEHICLES:
            self._heard[header.system] = None
        if system not in (None, header.system) or component not in (None, header.component):
            return
        if len(self._vehicles) >= MOST_VEHICLES:
            others = [s for s, vehicle in self._vehicles.items() if vehicle not in (self.followed, self.awaited)]
            del self._vehicles[min(others, key=lambda s: self._vehicles[s].heard_s)]
        self._vehicles[source] = Vehicle(*source, self._own_component)

    def _follow(self, vehicle: Vehicle, stamp_s: float) -> None:
        """Follow this vehicle if it is its turn; one that is heard again knows its own parameters."""
        old, is_again = self.followed, vehicle is self.awaited
        if not self.following.look_at(vehicle, stamp_s):
            return
        if old is not None and old.speaks:
            self._resumed = {}  # they were another's
        if not is_again:
            vehicle.resume(self._resumed)
