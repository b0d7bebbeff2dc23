"""Vehicle parameters -> the facts that the vehicle states about its battery, as a timeline.

ArduPilot: BATT_ is instance 0, BATT2_ .. BATT9_ the next, then BATTA_ and so on. PX4: BAT1_ is
instance 0; un-numbered BAT_ names are leftovers once BATn_ exists, and are used only without it.
0 and -1 mean "not set" for all of them.

A smart battery states its size itself (SMART_BATTERY_INFO, BATTERY_INFO, battery_status of PX4). That is kept like a
parameter of the vehicle, under the names BATTERY0_CELLS and BATTERY0_MAH. It counts where no parameter states the size,
or only ArduPilot's default. BATTERY0_FULL_MAH is what the gauge of a smart battery says that it holds today: less than
is stated counts always, because packs wear.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from uavbatt.limits import LEAST_FULL_SHARE
from uavbatt.mavlink.fields import PackIdentity
from uavbatt.records import NAN, PackFacts

_UNTOUCHED_CAPACITY_MAH = 3300.0
VOLTAGE_ONLY, ESCS, SUM_OF_OTHERS = 3.0, 9.0, 10.0  # values of BATT_MONITOR
_MOST_MONITORS = 16
_OTHER_CAPACITY = 0.1  # a parameter further from what the battery states is noted
_MAX_CELLS = 100  # beyond it the value is damaged
_SAG_COMPENSATED_TELEMETRY = 64  # bit 6 of BATT_OPTIONS
_OF_PACK = "BATTERY"
ARMED_HOLDS_S = 60.0  # a vehicle that has sent no heartbeat for longer may have landed, and have another pack
BATTERY_NAMES = ("BAT", "FS_BATT", "COM_LOW_BAT")  # how the names of battery parameters begin


class HeardOnce(NamedTuple):
    """HeardOnce holds a change of a parameter that was heard once, and the sequence number of its frame."""

    value: float
    sequence: int


class HeardParameters:
    """HeardParameters decides which statements of a vehicle about its parameters count, in the order of reception.

    The first statement of a parameter counts at once, and so does every change on the ground. In the air a single frame
    may be forged or damaged: there a change of a battery parameter counts when a second frame repeats it. A copy of the
    first frame has its sequence number and is no second one. A frame with the old value ends the doubt. A vehicle whose
    last heartbeat is older than ARMED_HOLDS_S counts as on the ground.
    """

    def __init__(self) -> None:
        self.known: dict[str, float] = {}
        self.doubted: dict[str, HeardOnce] = {}
        self.version = 0  # grows with every change
        self._resumed: set[str] = set()  # parameters that only an earlier process heard

    def counts(self, name: str, value: float, sequence: int, *, is_armed: bool, beat_age_s: float) -> bool:
        """Process a statement of a parameter; return True if it counts from now on.

        sequence : of its frame; is_armed : by the last heartbeat, which came `beat_age_s` [s] before
        """
        was, is_in_air = self.known.get(name), is_armed and beat_age_s <= ARMED_HOLDS_S
        if was is not None and _is_same(was, value):
            self.doubted.pop(name, None)
            self._resumed.discard(name)
            return True
        if was is not None and is_in_air and name.startswith(BATTERY_NAMES):
            doubt = self.doubted.get(name)
            if doubt is None or not _is_same(doubt.value, value) or doubt.sequence == sequence:
                self.doubted[name] = HeardOnce(value, sequence)
                return False
        self.doubted.pop(name, None)
        self._resumed.discard(name)
        self.known[name] = value
        self.version += 1
        return True

    def resume(self, earlier: Mapping[str, float]) -> None:
        """Use parameters from an earlier process; they replace any that were resumed before, and no heard ones."""
        heard = {name: value for name, value in self.known.items() if name not in self._resumed}
        self.known, self._resumed = {**earlier, **heard}, earlier.keys() - heard.keys()
        for name in self.doubted.keys() - self.known.keys():  # the parameter is no longer known
            self.known[name] = self.doubted.pop(name).value
        self.version += 1


def _is_same(a: float, b: float) -> bool:
    return a == b or (a != a and b != b)


def ardupilot_prefix(instance: int) -> str:
    """Return how the parameter names of a battery begin: `BATT_`, `BATT2_` .. `BATT9_`, `BATTA_` ..."""
    if instance == 0:
        return "BATT_"
    return f"BATT{instance + 1}_" if instance < 9 else f"BATT{chr(ord('A') + instance - 9)}_"


def is_of_pack(name: str) -> bool:
    """Return True if a statement is one of a battery about itself, and not a parameter of the vehicle."""
    return name.startswith(_OF_PACK)


def in_words(name: str) -> str:
    """Return the name of a statement in words: a parameter's own, or what a battery says of itself."""
    number, _, what = name.removeprefix(_OF_PACK).partition("_")
    said = {"CELLS": "cells", "MAH": "capacity [mAh]", "FULL_MAH": "capacity of today [mAh]"}
    return f"what battery {number} says of its {said[what]}" if is_of_pack(name) and what in said else name


def statements_of(pack: PackIdentity) -> list[tuple[str, float]]:
    """Return what a pack states of its size, as statements like the parameters: (name, value)."""
    stated = []
    if pack.cells is not None:
        stated.append((_of_pack(pack.id, "CELLS"), float(pack.cells)))
    if pack.capacity_Ah > 0.0:
        stated.append((_of_pack(pack.id, "MAH"), 1000.0 * pack.capacity_Ah))
    if pack.full_Ah > 0.0:
        stated.append((_of_pack(pack.id, "FULL_MAH"), 1000.0 * pack.full_Ah))
    return stated


def facts_timeline(
    parameters: Iterable[tuple[float, str, float]], instance: int, is_telemetry: bool
) -> tuple[tuple[float, PackFacts], ...]:
    """Return (time [s], facts in force from then on) of one battery, ascending.

    is_telemetry: the voltages came over MAVLink. The sag-compensation option bends only those;
    ArduPilot's on-board log holds the measured voltage whatever the option says.
    """
    known: dict[str, float] = {}
    timeline: list[tuple[float, PackFacts]] = []
    for time_s, name, value in parameters:
        if not name.startswith(BATTERY_NAMES):
            continue
        known[name] = value
        facts = _facts(known, instance, is_telemetry)
        if facts == (timeline[-1][1] if timeline else PackFacts()):
            continue
        if timeline and timeline[-1][0] == time_s:
            timeline.pop()
        timeline.append((time_s, facts))
    return tuple(timeline)


def capacity_notes(known: Mapping[str, float], instance: int) -> list[str]:
    """Return notes about the capacity: of a worn battery by its own gauge, and where parameters and battery differ."""
    return [*_worn_notes(known, instance), *_rated_notes(known, instance)]


def _worn_notes(known: Mapping[str, float], instance: int) -> list[str]:
    """Return a note if the battery itself says that it holds less than its capacity."""
    rated_mAh = _rated_mAh(known, instance)
    share = _full_share(known, instance, rated_mAh)
    if share == 1.0:
        return []
    held = f"{share * rated_mAh:.0f} of {rated_mAh:.0f} mAh"
    return [f"the battery itself says that it holds {held} when full: that counts, if you state none"]


def _rated_notes(known: Mapping[str, float], instance: int) -> list[str]:
    """Return a note if the capacity by the parameters is ArduPilot's default, or not what the battery itself states."""
    of_ardupilot, own_mAh = ardupilot_prefix(instance) + "CAPACITY", _first(known, _of_pack(instance, "MAH"))
    is_untouched = known.get(of_ardupilot) == _UNTOUCHED_CAPACITY_MAH
    if math.isnan(own_mAh):
        untouched = f"{of_ardupilot} is 3300 mAh, ArduPilot's untouched default: it may not be this pack's"
        return [untouched] if is_untouched else []
    name = of_ardupilot if known.get(of_ardupilot, 0.0) > 0.0 else _px4_name(known, instance, "CAPACITY")
    stated_mAh = _first(known, name)
    if is_untouched or not abs(stated_mAh / own_mAh - 1.0) > _OTHER_CAPACITY:
        return []
    return [f"{name} is {stated_mAh:.0f} mAh, and counts; the battery itself states {own_mAh:.0f} mAh"]


def monitor_parameter(instance: int) -> str:
    """Return the name of the parameter that says how an ArduPilot battery is measured.

    Where its value is VOLTAGE_ONLY, a logged 0 A is no reading.
    """
    return ardupilot_prefix(instance) + "MONITOR"


def _facts(known: Mapping[str, float], instance: int, is_telemetry: bool) -> PackFacts:
    """Return the facts of `instance` from all parameters known so far."""
    prefix = ardupilot_prefix(instance)
    cells = _first(known, _px4_name(known, instance, "N_CELLS"), _of_pack(instance, "CELLS"))
    empty_V = _first(known, _px4_name(known, instance, "V_EMPTY"))
    capacity_mAh = _rated_mAh(known, instance)
    low_names = [prefix + "LOW_VOLT"] + (["FS_BATT_VOLTAGE"] if instance == 0 else [])
    critical_V = _first(known, prefix + "CRT_VOLT")
    options = known.get(prefix + "OPTIONS")
    return PackFacts(
        cells_series=int(cells) if 1 <= cells <= _MAX_CELLS else None,
        capacity_Ah=capacity_mAh / 1000 if capacity_mAh > 0 else NAN,
        low_voltage_V=_first(known, *low_names),
        critical_voltage_V=critical_V if critical_V > 0 or not cells * empty_V > 0 else cells * empty_V,
        sag_compensated=None if options is None else is_telemetry and _has_bit(options),
        temperature_of_escs=known.get(prefix + "MONITOR") == ESCS,
        full_share=_full_share(known, instance, capacity_mAh),
        acts_below_soc=_acts_below_soc(known, instance, capacity_mAh),
    )


def _acts_below_soc(known: Mapping[str, float], instance: int, capacity_mAh: float) -> float:
    """Return the charge left, as a share of the capacity, at which the autopilot returns or lands; NaN if it does not.

    An ArduPilot states charges in mAh, until version 3.5 one for the first battery; PX4 states a share.
    """
    if known.get("COM_LOW_BAT_ACT", 0.0) > 0.0:
        return _first(known, "BAT_CRIT_THR")
    prefix = ardupilot_prefix(instance)
    acting = [(prefix + "LOW_MAH", prefix + "FS_LOW_ACT"), (prefix + "CRT_MAH", prefix + "FS_CRT_ACT")]
    acting += [("FS_BATT_MAH", "FS_BATT_ENABLE")] if instance == 0 else []
    charges_mAh = [known.get(charge, 0.0) for charge, action in acting if known.get(action, 0.0) > 0.0]
    return max((charge_mAh for charge_mAh in charges_mAh if charge_mAh > 0.0), default=NAN) / capacity_mAh


def _rated_mAh(known: Mapping[str, float], instance: int) -> float:
    """Return the capacity of a new pack [mAh]: by the parameters, else by what the battery itself states."""
    prefix = ardupilot_prefix(instance)
    capacity_mAh = _first(known, prefix + "CAPACITY", _px4_name(known, instance, "CAPACITY"))
    if not math.isnan(capacity_mAh) and capacity_mAh != _UNTOUCHED_CAPACITY_MAH:
        return capacity_mAh
    is_sum = known.get(prefix + "MONITOR") == SUM_OF_OTHERS
    return _summed_mAh(known, instance) if is_sum else known.get(_of_pack(instance, "MAH"), capacity_mAh)


def _full_share(known: Mapping[str, float], instance: int, rated_mAh: float) -> float:
    """Return what the battery says that it holds today, as a share of the rated capacity; 1 where it says nothing."""
    share = _first(known, _of_pack(instance, "FULL_MAH")) / rated_mAh
    return share if LEAST_FULL_SHARE <= share < 1.0 else 1.0


def _summed_mAh(known: Mapping[str, float], instance: int) -> float:
    """Return the capacity of a monitor that sums others and has none of its own [mAh]; NaN while a part is unknown.

    The parts are the monitors in BATTn_SUM_MASK; if it is 0, every other monitor that is on and sums nothing.
    """
    said = known.get(ardupilot_prefix(instance) + "SUM_MASK", NAN)
    if not math.isfinite(said):
        return NAN
    mask = int(said) or -1
    parts = [
        ardupilot_prefix(other)
        for other in range(_MOST_MONITORS)
        if other != instance
        and known.get(monitor_parameter(other), 0.0) not in (0.0, SUM_OF_OTHERS)
        and mask >> other & 1
    ]
    return sum(_first(known, prefix + "CAPACITY") for prefix in parts) if parts else NAN


def _has_bit(options: float) -> bool:
    return math.isfinite(options) and bool(int(options) & _SAG_COMPENSATED_TELEMETRY)


def _of_pack(instance: int, what: str) -> str:
    """Return the name under which a statement of a battery about itself is kept."""
    return f"{_OF_PACK}{instance}_{what}"


def _px4_name(known: Mapping[str, float], instance: int, what: str) -> str:
    numbered = any(name.startswith(f"BAT{n}_") for n in range(1, 5) for name in known)
    return f"BAT_{what}" if instance == 0 and not numbered else f"BAT{instance + 1}_{what}"


def _first(known: Mapping[str, float], *names: str) -> float:
    """Return the first of the named parameters that is set (> 0), else NaN."""
    return next((known[name] for name in names if known.get(name, 0.0) > 0), NAN)
