"""Choice of the vehicle that is followed, of all that are heard.

The first that speaks of a battery twice is followed; before any does, the first that is heard. It keeps its place until
it has been silent for VEHICLE_SILENT_S while another speaks of batteries. One that was armed then flies on: it is
followed again as soon as it is heard armed, however well the other is heard, for that one is somebody else's.
"""

from __future__ import annotations

from uavbatt.telemetry.vehicle import Vehicle

VEHICLE_SILENT_S = 10.0
AWAITED_S = 3600.0  # after that it has come down somewhere


class Following:
    """Following holds the vehicle that is followed, and one that fell silent in the air and is awaited."""

    def __init__(self) -> None:
        self.vehicle: Vehicle | None = None
        self.awaited: Vehicle | None = None
        self.changes = 0  # grows when another vehicle is followed
        self.words = ""  # what the last change was, at most 50 characters; empty where nobody had spoken before it

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
            if not vehicle.is_beating:  # nobody knows yet whether it has landed
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
