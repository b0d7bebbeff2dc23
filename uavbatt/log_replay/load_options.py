"""The words for the load to come, on the command line (`--load`) or in Python (`load=`)."""

from __future__ import annotations

import math

import numpy as np

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.pack import Installation, true_power
from uavbatt.battery.scaling import installation_of
from uavbatt.battery.vehicle_file import VehicleFile
from uavbatt.errors import UsageError
from uavbatt.prediction.load.library import UnknownAircraft, learned_load
from uavbatt.prediction.load.scenarios import STATED_SPREAD, ConstantLoad, Load, LoggedLoad, RecentMean
from uavbatt.prediction.load.waits import waits_of
from uavbatt.records import Flight
from uavbatt.telemetry.quality.drawn import loaded_A

OPTION = "--load "  # as the command line spells it
WORDS = ("learned", "recent", "log")


def stated_load(
    text: str,
    flight: Flight,
    vehicle: VehicleFile | None,
    battery: BatteryFile | None = None,
    name: str = OPTION,
) -> Load:
    """Return the load to come for the word that the user gives.

    text: `learned` (from the vehicle file, else that of an unknown aircraft), `recent`, `log` or a power [W].
    flight: the powers of the vehicle file are those of as many batteries as it joins.
    battery: its sensor effects correct the logged power of `log`.
    name: how the caller spells the option, for the error.
    Raises UsageError for another word, and for `log` where the flight has no power.
    """
    if text == "learned":
        return UnknownAircraft() if vehicle is None else learned_load(vehicle.of_batteries(flight.joined))
    if text == "recent":
        return RecentMean()
    if text == "log":
        return logged_load(flight, battery, name)
    return ConstantLoad(_watts(text, name), STATED_SPREAD)


def logged_load(flight: Flight, battery: BatteryFile | None = None, name: str = OPTION) -> LoggedLoad:
    """Return the flight's own power, without its waits on the ground; `battery` and `name` as for `stated_load`.

    Raises UsageError where the flight has no power.
    """
    rows = [s for s in flight.samples if math.isfinite(s.voltage_V) and math.isfinite(s.current_A)]
    if len(rows) < 2:
        raise UsageError(f"{flight.source}: {name}log: expected rows with voltage and current")
    sensors = Installation(1, 1.0) if battery is None else installation_of(battery, 1, 1.0)
    time_s, volts, amps = np.array([(s.time_s, s.voltage_V, s.current_A) for s in rows]).T
    power_W = np.maximum(true_power(sensors, volts, amps), 0.0)
    begins_s = tuple(begin_s for begin_s, _ in flight.discharges)
    waits = waits_of(time_s, np.array([row.armed is False for row in rows]), amps > loaded_A(amps))
    return LoggedLoad(time_s, power_W, begins_s, waits)


def check_word(text: str) -> None:
    """Raise UsageError for an unknown word, before any flight is read."""
    if text not in WORDS:
        _watts(text, OPTION)


def _watts(text: str, name: str) -> float:
    try:
        watts = float(text)
    except ValueError:
        watts = math.nan
    if not (math.isfinite(watts) and watts > 0.0):
        raise UsageError(f"{name}{text}: expected {', '.join(WORDS)} or a positive number of watts")
    return watts
