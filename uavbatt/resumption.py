"""The saved state from a start until its batteries have been heard: whose it is, and what became of it, in words."""

from __future__ import annotations

from collections.abc import Mapping

from uavbatt.feed.state import Found, State, Vehicle
from uavbatt.saved import SavedBattery


class Resumption:
    """What an earlier process left; handed out to the vehicle that it was made for, and to no other."""

    def __init__(self, found: Found[SavedBattery]) -> None:
        self.age_s = found.age_s  # when this process began
        self._state: State[SavedBattery] | None = found.state
        self._met: Vehicle | None = None
        self._note = f"not resumed: {found.why_not}" if found.why_not else ""

    @property
    def note(self) -> str:
        """Where it stands; what becomes of each battery, its own estimator says."""
        if self._state is not None and self._met is None:
            return f"a state {self.age_s:.0f} s old waits for system {self._state.vehicle.system}"
        return self._note

    def meet(self, vehicle: Vehicle) -> Mapping[str, float]:
        """The vehicle has been heard; its saved parameters, the first time and if it is the one."""
        if self._met is not None or self._state is None:
            return {}
        self._met = vehicle
        return {} if self._refused(vehicle) or self._state is None else self._state.parameters

    def is_contradicted(self, vehicle: Vehicle) -> bool:
        """True if what has been heard of the vehicle since shows that the state was another's: it counts no more."""
        return self._met is not None and self._state is not None and self._refused(vehicle)

    def of(self, instance: int) -> SavedBattery | None:
        """The saved battery; None where there is none, or it has been handed to nobody yet."""
        if self._met is None or self._state is None:
            return None
        return self._state.batteries.get(str(instance))

    def _refused(self, vehicle: Vehicle) -> bool:
        assert self._state is not None
        was = self._state.vehicle
        if (was.system, was.component) != (vehicle.system, vehicle.component):
            self._note = f"not resumed: saved state is of system {was.system}, heard is system {vehicle.system}"
        elif was.hardware and vehicle.hardware and was.hardware != vehicle.hardware:
            self._note = "not resumed: saved state is of another aircraft (serial number of the autopilot)"
        else:
            return False
        self._state = None
        return True
