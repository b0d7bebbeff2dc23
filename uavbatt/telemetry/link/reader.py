"""Live frames -> rows of every battery of the vehicle that is followed.

    frame (any system) -> its vehicle -> is its sender believed? -> `Vehicle`: rows, parameters, the armed bit

`VehicleChoice` chooses the vehicle that is followed; if a system or component is given, only such vehicles count. Each
autopilot has a reader of its own, so that the parameters and waiting rows of two vehicles never mix.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from uavbatt.mavlink import fields, framing
from uavbatt.navigation import NOWHERE, Navigation
from uavbatt.telemetry.formats.mission_file import PlannedFlight
from uavbatt.telemetry.formats.tlog_frames import decoder
from uavbatt.telemetry.link.battery_components import BatteryComponents
from uavbatt.telemetry.link.heard_route import ToldFrame
from uavbatt.telemetry.link.lateness import BOOT_TIME_AT, boot_time_s
from uavbatt.telemetry.link.live_row import BATTERY_IDS, LiveRow, battery_fields
from uavbatt.telemetry.link.vehicle import Vehicle
from uavbatt.telemetry.link.vehicle_choice import VehicleChoice
from uavbatt.telemetry.parameters import in_words
from uavbatt.telemetry.route.messages import OF_AUTOPILOT, OF_OTHERS

__all__ = ["LiveReader", "LiveRow", "TakenFrame", "checksum"]

MOST_VEHICLES = 16
MOST_UNMET = 64  # packs that are remembered before their vehicle is heard
_TOLD_BY = frozenset((*BATTERY_IDS, fields.HEARTBEAT, fields.PARAM_VALUE, fields.AUTOPILOT_VERSION))
WANTED = _TOLD_BY | OF_AUTOPILOT | OF_OTHERS
AUTOPILOT_COMPONENT = 1


class TakenFrame(NamedTuple):
    """TakenFrame holds the rows that a frame completes; `is_ours` : it is of the followed vehicle and is recorded."""

    rows: list[LiveRow]
    is_ours: bool


NOTHING = TakenFrame([], False)


def is_sound(frame: bytes, end: int, extra: int) -> bool:
    """Return True if the checksum behind the payload, which ends at `end`, is right; `extra` is the message's seed."""
    from pymavlink.generator.mavcrc import x25crc

    crc = x25crc(frame[1:end] + bytes([extra]))
    return bool(crc.crc == frame[end] | frame[end + 1] << 8)


def checksum() -> Callable[[bytes], bool]:
    """Return a check of complete frames: True if the checksum is good, or if this dialect lacks the message."""
    from pymavlink.dialects.v20 import ardupilotmega

    extras = {number: kind.crc_extra for number, kind in ardupilotmega.mavlink_map.items()}

    def is_good(frame: bytes) -> bool:
        extra = extras.get(framing.header(frame).message_id)
        if extra is None:
            return True
        return is_sound(frame, (6 if frame[0] == framing.V1 else framing.V2_HEADER) + frame[1], extra)

    return is_good


class LiveReader:
    """LiveReader takes frames in order of reception, and gives the rows of the vehicle that it follows."""

    def __init__(
        self,
        system: int | None = None,
        component: int | None = None,
        own_component: int | None = None,
        *,
        has_clock: bool = True,
        own_battery: int | None = None,
    ) -> None:
        self._asked, self._own_component, self._has_clock = (system, component), own_component, has_clock
        self._components = BatteryComponents(own_battery)
        self._decode = decoder()
        self._vehicles: dict[tuple[int, int], Vehicle] = {}
        self._heard: dict[int, None] = {}  # systems of autopilots, in order
        self._unmet: dict[tuple[int, int], tuple[fields.PackIdentity, bytes]] = {}  # packs of systems not heard yet
        self._resumed: Mapping[str, float] = {}
        self.planned: PlannedFlight | None = None
        self._known: Navigation | None = None  # of the route, by the link alone
        self._flown = NOWHERE  # the same with the planned mission
        self.following = VehicleChoice()
        self._now_s = -math.inf

    @property
    def followed(self) -> Vehicle | None:
        """Return the vehicle that is followed; None before one is heard."""
        return self.following.vehicle

    @property
    def late_s(self) -> float:
        """Return the delay of the followed vehicle's frames by its own clock [s]; 0 if the clock is not to be used."""
        vehicle = self.followed
        return vehicle.lateness.late_s(self._now_s) if vehicle is not None and self._has_clock else 0.0

    @property
    def navigation(self) -> Navigation:
        """Return route and place of the vehicle; a mission from a file has priority over one heard on the link."""
        vehicle = self.followed
        known = vehicle.route.now if vehicle is not None else NOWHERE
        if self.planned is None:
            return known
        if self._known is not known:
            self._known, self._flown = known, self.planned.flown(known)
        return self._flown

    @property
    def parameters(self) -> Mapping[str, float]:
        """Return the vehicle's parameters, by name, without those in doubt."""
        vehicle = self.followed
        return vehicle.parameters.known if vehicle is not None else self._resumed

    def resume(self, parameters: Mapping[str, float], told: bytes = b"") -> None:
        """Use parameters, and the frames (`Vehicle.told`), that an earlier process heard of the followed vehicle.

        They replace any parameters that were resumed before. What is heard from the vehicle itself has priority. While
        no vehicle is followed, the parameters wait for it.
        """
        if self.followed is None:
            self._resumed = dict(parameters)
            return
        complete = [(framing.header(frame), self._decode(frame), frame) for frame in framing.Frames().feed(told)]
        self.followed.resume(parameters, [ToldFrame(*heard) for heard in complete if heard[1]])

    def forget_resumed(self) -> None:
        """Forget parameters of an earlier process, and the route: they are another vehicle's."""
        if self.followed is not None:
            self.followed.heard_route.forget()
        self.resume({})

    def conflict(self, instance: int) -> str:
        """Return in words what the senders of a battery disagree on; empty while they agree."""
        return dict(self._conflicts()).get(instance, "")

    def _conflicts(self) -> list[tuple[int, str]]:
        """Return the batteries of the followed vehicle whose senders disagree, with the quantity in words."""
        vehicle = self.followed
        if vehicle is None:
            return []
        of_components = self._components.conflicts(vehicle.system, self._now_s)
        return [*of_components, *vehicle.speakers.senders.conflicts(self._now_s)]

    def notes(self) -> list[str]:
        """Return notes for the operator about the vehicles and senders that are heard."""
        found, vehicle = [], self.followed
        if len(self._heard) > 1 or (self._heard and vehicle is None):
            whom = f"following {vehicle.system}" if vehicle is not None else f"waiting for {self._wanted}"
            found.append(f"heard system{'s' * (len(self._heard) > 1)} {', '.join(map(str, self._heard))}; {whom}")
        if vehicle is None:
            return found
        awaited = self.following.awaited
        if awaited is not None:
            found.append(f"system {awaited.system} fell silent in the air: followed again when it speaks")
        for number, words in self._conflicts():
            found.append(f"two senders speak for system {vehicle.system} and disagree on battery {number}: {words}")
        found += [*self._components.notes(vehicle.system), *vehicle.notes]
        for name, doubt in vehicle.parameters.doubted.items():
            change = f"{in_words(name)} changed in flight from {vehicle.parameters.known[name]:g} to {doubt.value:g}"
            found.append(f"{change}: counts when it is heard again")
        return found

    def take(self, frame: bytes, header: framing.Header, stamp_s: float, sender: object = None) -> TakenFrame:
        """Process a frame, and return the rows that it completes.

        stamp_s : time of reception [s], never falling; sender : address of the sender, if known
        """
        self._now_s = stamp_s
        if header.message_id in fields.IDENTITY_LENGTH:
            self._meet(frame, header)
        message: Any = None
        if header.message_id in WANTED:
            message = self._decode(frame)
            if not message:
                return NOTHING
            if header.message_id in _TOLD_BY:
                self._hear(header, message)
        vehicle = self._vehicles.get(header.source)
        if vehicle is None:
            taken = self._of_component(header, stamp_s, message, frame, sender)
            return taken if taken is not None else self._of_a_part(header, stamp_s, message, frame)
        time_s = vehicle.passes(stamp_s)
        battery = battery_fields(header.message_id, message) if header.message_id in BATTERY_IDS else None
        if not vehicle.speakers.admits(frame, stamp_s, sender, battery):
            return NOTHING
        if battery is not None:
            self._components.tell(header.system, battery)
        if header.message_id in BOOT_TIME_AT:
            vehicle.lateness = vehicle.lateness.after(stamp_s, boot_time_s(frame, header.message_id))
        rows = vehicle.take(header.message_id, message, battery, frame, time_s) if message is not None else []
        if battery is not None or self.followed is None:
            self._follow(vehicle, stamp_s)
        vehicle.heard_s = stamp_s
        return TakenFrame(rows, True) if vehicle is self.followed else self._of_a_part(header, stamp_s, None, frame)

    def _meet(self, frame: bytes, header: framing.Header) -> None:
        """Process what a pack states of itself, which any component of the vehicle may send."""
        end = framing.V2_HEADER + frame[1]
        if frame[0] != framing.V2 or not is_sound(frame, end, fields.IDENTITY_EXTRA[header.message_id]):
            return
        said = fields.pack_identity(header.message_id, frame[framing.V2_HEADER : end])
        known = [vehicle for (system, _), vehicle in self._vehicles.items() if system == header.system]
        for vehicle in known:
            vehicle.meet(said, frame)
        if not known and len(self._unmet) < MOST_UNMET:
            self._unmet[header.system, said.id] = said, frame

    @property
    def _wanted(self) -> str:
        parts = zip(("system", "component"), self._asked, strict=True)
        return " ".join(f"{what} {number}" for what, number in parts if number is not None)

    def _of_component(
        self, header: framing.Header, stamp_s: float, message: Any, frame: bytes, sender: object
    ) -> TakenFrame | None:
        """Process a battery component's BATTERY_STATUS; None if it does not count but is of a part of the vehicle."""
        if header.message_id != fields.BATTERY_STATUS:
            return None
        source = header.source
        in_turn = (vehicle for vehicle in (self.followed, *self._vehicles.values()) if vehicle is not None)
        vehicle = next((vehicle for vehicle in in_turn if vehicle.system == header.system), None)
        speakers = self._components.speakers(source)
        if vehicle is None or speakers is None:
            return None
        battery = battery_fields(header.message_id, message)
        if not speakers.admits(frame, stamp_s, sender, battery):
            return NOTHING
        time_s = vehicle.passes(stamp_s)
        if not self._components.admits(vehicle, source, battery):
            return None
        rows = vehicle.take(header.message_id, message, battery, frame, time_s)
        self._follow(vehicle, stamp_s)
        return TakenFrame(rows, True) if vehicle is self.followed else None

    def _of_a_part(self, header: framing.Header, stamp_s: float, message: Any, frame: bytes) -> TakenFrame:
        """Process a frame without a row: of another component of the vehicle, or of a station that writes a mission."""
        followed = self.followed
        if followed is None:
            return NOTHING
        is_to_us = message is not None and header.message_id in OF_OTHERS
        if is_to_us and followed.heard_route.take_other(followed.now_s, header.message_id, message, frame):
            return TakenFrame([], True)
        if header.system != followed.system:
            return NOTHING
        followed.passes(stamp_s)
        return TakenFrame([], True)

    def _hear(self, header: framing.Header, message: Any) -> None:
        """Add an autopilot when it is recognised: by its heartbeat, or by certain messages of component 1."""
        source = header.source
        if source in self._vehicles:
            return
        system, component = self._asked
        is_heartbeat = header.message_id == fields.HEARTBEAT
        if is_heartbeat:
            self._components.meet(source, message)
        if not (fields.is_autopilot(message) if is_heartbeat else source[1] == (component or AUTOPILOT_COMPONENT)):
            return
        if len(self._heard) < MOST_VEHICLES:
            self._heard[header.system] = None
        if system not in (None, header.system) or component not in (None, header.component):
            return
        if len(self._vehicles) >= MOST_VEHICLES:
            kept = (self.followed, self.following.awaited)
            others = [s for s, vehicle in self._vehicles.items() if vehicle not in kept]
            del self._vehicles[min(others, key=lambda s: self._vehicles[s].heard_s)]
        self._vehicles[source] = vehicle = Vehicle(*source, self._own_component)
        for said, frame in [met for (system, _), met in self._unmet.items() if system == header.system]:
            vehicle.meet(said, frame)

    def _follow(self, vehicle: Vehicle, stamp_s: float) -> None:
        """Follow this vehicle if `VehicleChoice` chooses it; an awaited one that is heard again keeps its
        parameters."""
        old, is_again = self.followed, vehicle is self.following.awaited
        if not self.following.look_at(vehicle, stamp_s):
            return
        if old is not None and old.speaks:
            self._resumed = {}  # they were another's
        if not is_again:
            vehicle.resume(self._resumed)
