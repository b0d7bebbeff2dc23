"""The saved state after a start: which vehicle it is of, and whether it was resumed, in words."""

from __future__ import annotations

from collections.abc import Mapping

from uavbatt.live.memory.saved import SavedBattery
from uavbatt.live.memory.state import FoundState, SavedState, SavedVehicle


class Resumption:
    """Resumption gives the state that an earlier process saved to the same vehicle only, each battery once."""

    def __init__(self, found: FoundState[SavedBattery]) -> None:
        self.age_s = found.age_s  # when this process began
        self._state: SavedState[SavedBattery] | None = found.state
        self._left = dict(found.state.batteries) if found.state is not None else {}
        self._why_not = found.why_not
        self._met: SavedVehicle | None = None

    @property
    def note(self) -> str:
        """Return a note on the saved state as a whole; `TrackedBattery.resumed` tells of each battery."""
        if self._state is not None and self._met is None:
            return f"a state {self.age_s:.0f} s old waits for system {self._state.vehicle.system}"
        why_not = self._why_not or self._mismatch(self._met)
        return f"not resumed: {why_not}" if why_not else ""

    def meet(self, vehicle: SavedVehicle) -> tuple[Mapping[str, float], bytes]:
        """Take in the vehicle that is followed; return its saved parameters and what it told.

        They are empty if the state is not of this vehicle.
        """
        self._met = vehicle
        if self._state is None or self._mismatch(vehicle):
            return {}, b""
        return self._state.parameters, self._state.told

    def is_contradicted(self, vehicle: SavedVehicle) -> bool:
        """Return True if the vehicle, as it is known now, was given the state of another vehicle."""
        if self._state is None or self._met is None or self._mismatch(self._met):
            return False
        self._met = vehicle
        return bool(self._mismatch(vehicle))

    def of(self, instance: int) -> SavedBattery | None:
        """Return a saved battery of the followed vehicle; None if there is none, or it was given before."""
        return None if self._met is None or self._mismatch(self._met) else self._left.pop(str(instance), None)

    def left(self, vehicle: SavedVehicle) -> Mapping[str, SavedBattery]:
        """Return the saved batteries of this vehicle that have not been heard since, if the state is of it."""
        return {} if self._met is None or self._mismatch(vehicle) else self._left

    def _mismatch(self, vehicle: SavedVehicle | None) -> str:
        """Return the reason why the state is not of this vehicle, as far as that is known; empty if it is."""
        if self._state is None or vehicle is None:
            return ""
        was = self._state.vehicle
        if (was.system, was.component) != (vehicle.system, vehicle.component):
            return f"saved state is of system {was.system}, heard is system {vehicle.system}"
        if was.hardware and vehicle.hardware and was.hardware != vehicle.hardware:
            return "saved state is of another aircraft (serial number of the autopilot)"
        return ""
