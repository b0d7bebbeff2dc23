"""Batteries that are MAVLink components of their own, beside the autopilot of the same system.

Such a component says by its heartbeat that it is a battery; the battery of a gimbal or a payload is none. It speaks for
the vehicle only if the autopilot itself has reported no battery: the companion's own feed `battery` has the same form,
and may come back over a router. Each component has its own guard against a second sender. A battery id belongs to the
first component that sends it, until the autopilot reports the same id.
"""

from __future__ import annotations

from typing import Any

from uavbatt.mavlink import fields
from uavbatt.telemetry.builder import FALLBACK_AFTER_S
from uavbatt.telemetry.link.speakers import Speakers
from uavbatt.telemetry.link.vehicle import Vehicle

MOST_COMPONENTS = 16

Source = tuple[int, int]  # system, component


class BatteryComponents:
    """BatteryComponents decides which messages of battery components count as the vehicle's.

    own_component : the component of the feed `battery`, if that is on
    """

    def __init__(self, own_component: int | None = None) -> None:
        self._own_component = own_component
        self._known: dict[Source, Speakers] = {}
        self._told: dict[int, set[int]] = {}  # ids that each system's autopilot reports
        self._owners: dict[tuple[int, int], Source] = {}  # (system, id)
        self._unused: dict[tuple[Source, int], None] = {}

    def meet(self, source: Source, heartbeat: Any) -> None:
        """Note a component that says by its heartbeat that it is a battery."""
        is_new = source not in self._known and source[1] != self._own_component
        if is_new and fields.is_battery(heartbeat) and len(self._known) < MOST_COMPONENTS:
            self._known[source] = Speakers()

    def tell(self, system: int, battery: fields.BatteryFields) -> None:
        """Note a battery that the autopilot of a system reports; without a voltage it is none."""
        if battery.voltage_V > 0.0:
            self._told.setdefault(system, set()).add(battery.id)

    def speakers(self, source: Source) -> Speakers | None:
        """Return the guard of a battery component; None if the source has not said that it is one."""
        return self._known.get(source)

    def admits(self, vehicle: Vehicle, source: Source, battery: fields.BatteryFields) -> bool:
        """Return True if a component's BATTERY_STATUS counts as a battery of the vehicle."""
        told, key = self._told.get(vehicle.system, set()), (vehicle.system, battery.id)
        is_used = source in self._owners.values()
        if battery.id in told or (told and not is_used) or self._owners.get(key, source) != source:
            self._unused[source, battery.id] = None
            return False
        if vehicle.now_s < FALLBACK_AFTER_S:  # the autopilot may still report it
            return False
        self._owners[key] = source
        return True

    def conflicts(self, system: int, stamp_s: float) -> list[tuple[int, str]]:
        """Return the batteries of components in use whose senders disagree, with the quantity in words."""
        return [
            (number, words)
            for source in dict.fromkeys(self._owners.values())
            if source[0] == system
            for number, words in self._known[source].senders.conflicts(stamp_s)
        ]

    def notes(self, system: int) -> list[str]:
        """Return a note for each battery of a component of the system that is heard and not used."""
        found = []
        for source, number in self._unused:
            if source[0] == system:
                what = f"battery {number} of component {source[1]} is heard and not used"
                found.append(f"{what}: {self._reason(source, number)}")
        return found

    def _reason(self, source: Source, number: int) -> str:
        owner = self._owners.get((source[0], number), source)
        if number in self._told.get(source[0], set()) or owner == source:
            return "the autopilot reports its own batteries"
        return f"component {owner[1]} reports it"
