"""Choice of the vehicle that is followed, of all that are heard.

The first vehicle that sends two messages of a battery is followed; before that, the first vehicle that is heard. It is
followed until it has been silent for VEHICLE_SILENT_S while another sends battery messages. A vehicle that was armed
when it fell silent is probably still in the air: it is awaited, and followed again as soon as it is heard armed,
because the other vehicle is probably not ours.
"""

from __future__ import annotations

from uavbatt.telemetry.link.vehicle import Vehicle

VEHICLE_SILENT_S = 10.0
AWAITED_S = 3600.0  # no flight lasts longer without telemetry


class VehicleChoice:
    """VehicleChoice holds the vehicle that is followed, and a vehicle that fell silent in the air and is awaited."""

    def __init__(self) -> None:
        self.vehicle: Vehicle | None = None
        self.awaited: Vehicle | None = None
        self.changes = 0  # counts changes of the followed vehicle
        self.words = ""  # the last change in words, at most 50 characters; empty for the first vehicle with a battery

    def look_at(self, vehicle: Vehicle, stamp_s: float) -> bool:
        """Take in that a vehicle is heard at `stamp_s` [s]; return True if it is followed from now on."""
        old = self.vehicle
        if self.awaited is not None and stamp_s - self.awaited.heard_s > AWAITED_S:
            self.awaited = None
        if old is vehicle:
            return False
        if old is None:
            self._begin(vehicle, "")
        elif vehicle is self.awaited:
            if not vehicle.is_beating:  # it is not known yet whether it has landed
                return False
            self.awaited = None
            if not vehicle.armed:
                return False
            self._begin(vehicle, f"System {vehicle.system} is heard again and followed")
        elif vehicle.speaks and not (old.speaks and stamp_s - old.heard_s <= VEHICLE_SILENT_S):
            if old.speaks and old.armed and self.awaited is None:
                self.awaited = old
            words = f"System {old.system} is silent: following system {vehicle.system}"
            self._begin(vehicle, words if old.speaks else "")
        return vehicle is self.vehicle

    def _begin(self, vehicle: Vehicle, words: str) -> None:
        self.vehicle, self.words = vehicle, words
        self.changes += 1
