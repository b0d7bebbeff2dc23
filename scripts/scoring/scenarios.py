"""Flights of a pack of another model through the live process, each with one thing wrong, by the names of the faults.

`SCENARIOS` are those that once ended without a word (the tests fly them); `MORE` are flown by `wrong_packs.py` alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

from scoring.live_flight import Extra, Flown, flown_live, heartbeat, parameter
from scoring.other_pack import CUTOFF_V, FULL_AH, LIHV, Pack, Power, drawn, flown, rested
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.records import Sample

STATED = PackOptions(cells=4, capacity_Ah=5.0, cutoff_V=CUTOFF_V)
UNSTATED = PackOptions()
ARDUPILOT = {"BATT_CAPACITY": 5000.0, "BATT_CRT_VOLT": CUTOFF_V, "BATT_LOW_VOLT": 14.0}
GROUND_S, EARLY_S, MID_S, LATE_S = 15, 60.0, 200.0, 500.0
IN_TIME_S, LAST_S, TOO_LONG_S = 45.0, 120.0, 25.0
PART = 0.6  # charge at the start where the beginning of the flight does not matter


@dataclass(frozen=True)
class Scenario:
    """A Scenario is what the process is told; the last row is the end of flight."""

    rows: Sequence[Sample]
    options: PackOptions = STATED
    parameters: Mapping[str, float] = field(default_factory=dict)
    is_px4: bool = False
    extras: Sequence[Extra] = ()


def flight(pack: Pack, from_s: float = 0.0, drawn_Ah: float = 0.0) -> list[Sample]:
    """Return a flight on the ground, then in the air to the end."""
    ground = rested(pack, GROUND_S, from_s, drawn_Ah)
    return ground + flown(pack, from_s + GROUND_S, drawn_Ah=ground[-1].consumed_Ah)


@cache
def whole() -> tuple[Sample, ...]:
    """Return the flight that is right in everything."""
    return tuple(flight(Pack()))


@cache
def part() -> tuple[Sample, ...]:
    """Return the same flight from a part of the charge: what is wrong is stated, or happens in the middle."""
    return tuple(flight(Pack(soc=PART)))


def seen(
    rows: Sequence[Sample], change: Callable[[Sample], Sample], since_s: float, until_s: float = math.inf
) -> list[Sample]:
    """Return the flight as a sensor shows it that is wrong for a while."""
    return [change(row) if since_s <= row.time_s < until_s else row for row in rows]


def counted(rows: Sequence[Sample]) -> list[Sample]:
    """Return the rows with the charge as the autopilot counts it from the currents shown."""
    made, drawn_Ah = [], 0.0
    for row in rows:
        drawn_Ah += row.current_A / 3600.0 if math.isfinite(row.current_A) else 0.0
        made.append(replace(row, consumed_Ah=drawn_Ah))
    return made


def another(first: Pack, air_s: int, silent_s: float, second: Pack, restarts: bool = True) -> list[Sample]:
    """Return some flight, a landing, and after a silence a flight to the end with another pack."""
    before = rested(first, GROUND_S, 0.0)
    before += flown(first, float(GROUND_S), air_s, before[-1].consumed_Ah)
    before += rested(first, 20, before[-1].time_s + 1.0, before[-1].consumed_Ah)
    drawn_Ah = 0.0 if restarts else before[-1].consumed_Ah
    return before + flight(second, before[-1].time_s + 1.0 + silent_s, drawn_Ah)


def frozen(voltage: bool, current: bool, since_s: float = EARLY_S) -> list[Sample]:
    """Return a flight with sensors that show for ever what they showed a while after the start, by default a minute."""
    held = next(row for row in whole() if row.time_s >= since_s)

    def change(row: Sample) -> Sample:
        return replace(
            row,
            voltage_V=held.voltage_V if voltage else row.voltage_V,
            current_A=held.current_A if current else row.current_A,
        )

    return counted(seen(whole(), change, since_s))


def stated_by_vehicle(**changed: float) -> Scenario:
    """Return a scenario where the caller states nothing; ArduPilot's parameters do, some of them wrong."""
    return Scenario(part(), UNSTATED, ARDUPILOT | changed)


def px4_cells(cells: int) -> Scenario:
    """Return a scenario where PX4 states another count of cells; the cut-off is the caller's."""
    said = {"BAT1_N_CELLS": cells, "BAT1_CAPACITY": 5000.0}
    return Scenario(part(), replace(UNSTATED, cutoff_V=CUTOFF_V), said, is_px4=True)


def forged(name: str, value: float) -> Scenario:
    """Return a scenario with one PARAM_VALUE that nobody asked for, in the air, with the autopilot's identity."""
    frame = Extra(MID_S, parameter(name, value), sender="elsewhere")
    return Scenario(part(), UNSTATED, ARDUPILOT, extras=[frame])


def wrong_vehicle() -> Scenario:
    """Return a scenario with three heartbeats of system 42 before the vehicle speaks."""
    frames = [Extra(0.0, heartbeat(False, False), system=42, sender="other") for _ in range(3)]
    return Scenario(part(), extras=frames)


def warm_pack(pack_C: float, air_C: float) -> list[Sample]:
    """Return a flight of a pack that was kept warm, in cold air."""
    pack = Pack(air_C=air_C)
    pack.temp_C = pack_C
    return flight(pack)


def twelve_cells() -> Scenario:
    """Return a scenario of a part-charged pack of 12 cells, which nobody states: it shows what a full 11S would."""
    pack = Pack(soc=0.55, cells=12)
    ground = rested(pack, GROUND_S, 0.0)
    powers = (3.0 * watts for _, watts in zip(range(3600), Power().rows_W(3), strict=False))
    air = drawn(pack, powers, float(GROUND_S), ground[-1].consumed_Ah, cutoff_V=3.0 * CUTOFF_V)
    return Scenario([*ground, *air.rows], UNSTATED, {"BATT_CAPACITY": 5000.0})


def payload_on_the_ground() -> list[Sample]:
    """Return a flight with half a C for ten minutes before the take-off, disarmed."""
    pack = Pack()
    ground = drawn(pack, [40.0] * 600, 0.0, armed=False).rows
    return [*ground, *flown(pack, 600.0, drawn_Ah=ground[-1].consumed_Ah)]


SCENARIOS: dict[str, Callable[[], Scenario]] = {
    "nothing_wrong": lambda: Scenario(whole()),
    "warm_pack_in_cold_air": lambda: Scenario(warm_pack(25.0, 0.0)),
    "cells_unstated_12_part": twelve_cells,
    "healthy_lihv": lambda: Scenario(flight(Pack(make=LIHV))),
    "payload_on_the_ground": lambda: Scenario(payload_on_the_ground()),
    "nothing_wrong_from_60": lambda: Scenario(part()),
    "worn_80_percent": lambda: Scenario(flight(Pack(capacity_Ah=4.0))),
    "swap_nosilence_to_50": lambda: Scenario(another(Pack(), 30, 0.0, Pack(soc=0.5), restarts=False)),
    "current_half": lambda: Scenario(
        counted(seen(whole(), lambda row: replace(row, current_A=0.5 * row.current_A), 0.0))
    ),
    "current_stuck_2A": lambda: Scenario(counted(seen(whole(), lambda row: replace(row, current_A=2.0), EARLY_S))),
    "voltage_stuck_early": lambda: Scenario(frozen(voltage=True, current=False)),
    "voltage_and_current_stuck": lambda: Scenario(frozen(voltage=True, current=True)),
    "swap_silent_small_pack": lambda: Scenario(another(Pack(), 200, 60.0, Pack(2.2, size_Ah=2.2))),
    "param_default_3300_of_2200": lambda: Scenario(
        flight(Pack(2.2, size_Ah=2.2)), UNSTATED, ARDUPILOT | {"BATT_CAPACITY": 3300.0}
    ),
    "silence30h_pack_45": lambda: Scenario(another(Pack(), 200, 30 * 3600.0, Pack(soc=0.45))),
    "wrong_vehicle_first": wrong_vehicle,
    "one_forged_param_midflight": lambda: forged("BATT_CAPACITY", 50_000.0),
    "one_forged_crt_midflight": lambda: forged("BATT_CRT_VOLT", 3.3),
    "current_dies_-1": lambda: Scenario(seen(part(), lambda row: replace(row, current_A=math.nan), MID_S)),
    "current_dies_0A": lambda: Scenario(counted(seen(part(), lambda row: replace(row, current_A=0.0), MID_S))),
    "regen_-10A_20s": lambda: Scenario(
        counted(seen(part(), lambda row: replace(row, current_A=-10.0), MID_S, MID_S + 20.0))
    ),
    "n_cells_3": lambda: px4_cells(3),
    "n_cells_1": lambda: px4_cells(1),
    "crt_volt_3.3": lambda: stated_by_vehicle(BATT_CRT_VOLT=3.3),
    "crt_volt_0.5": lambda: stated_by_vehicle(BATT_CRT_VOLT=0.5),
    "crt_volt_1e-38": lambda: stated_by_vehicle(BATT_CRT_VOLT=1e-38),
    "capacity_x10": lambda: stated_by_vehicle(BATT_CAPACITY=50_000.0),
    "low_volt_25": lambda: stated_by_vehicle(BATT_LOW_VOLT=25.0),
}
SOUND = {
    "nothing_wrong",
    "wrong_vehicle_first",
    "one_forged_param_midflight",
    "one_forged_crt_midflight",
    "low_volt_25",
    "warm_pack_in_cold_air",
    "cells_unstated_12_part",
    "healthy_lihv",
    "payload_on_the_ground",
}


def stated(rows: Sequence[Sample], **changed: float) -> Scenario:
    """Return a scenario where the caller states something wrong."""
    return Scenario(rows, replace(STATED, **changed))  # type: ignore[arg-type]


MORE: dict[str, Callable[[], Scenario]] = {
    "worn_70_percent": lambda: Scenario(flight(Pack(capacity_Ah=0.7 * FULL_AH, resistance=1.4))),
    "worn_80_percent_lihv": lambda: Scenario(flight(Pack(capacity_Ah=0.8 * FULL_AH, make=LIHV))),
    "swap_nosilence_to_75": lambda: Scenario(another(Pack(), 200, 0.0, Pack(soc=0.75), restarts=False)),
    "swap_silent_to_60": lambda: Scenario(another(Pack(), 200, 60.0, Pack(soc=0.6))),
    "swap_silent_to_worn": lambda: Scenario(another(Pack(), 200, 60.0, Pack(capacity_Ah=0.75 * FULL_AH))),
    "swap_to_full": lambda: Scenario(another(Pack(soc=0.6), 200, 60.0, Pack())),
    "current_0.7": lambda: Scenario(
        counted(seen(whole(), lambda row: replace(row, current_A=0.7 * row.current_A), 0.0))
    ),
    "current_1.3": lambda: Scenario(
        counted(seen(whole(), lambda row: replace(row, current_A=1.3 * row.current_A), 0.0))
    ),
    "voltage_stuck_late": lambda: Scenario(frozen(voltage=True, current=False, since_s=LATE_S)),
    "caller_cells_3": lambda: stated(part(), cells=3, cutoff_V=9.9),
    "caller_capacity_x1.5": lambda: stated(part(), capacity_Ah=1.5 * FULL_AH),
    "caller_capacity_x3": lambda: stated(part(), capacity_Ah=3.0 * FULL_AH),
    "caller_capacity_half": lambda: stated(part(), capacity_Ah=0.5 * FULL_AH),
    "caller_cutoff_15.6": lambda: stated(part(), cutoff_V=15.6),
}


@cache
def said(name: str) -> tuple[Flown, float]:
    """Return what the process said of a scenario, and when the flight ended [s]."""
    told = (SCENARIOS | MORE)[name]()
    made = flown_live(told.rows, told.options, parameters=told.parameters, is_px4=told.is_px4, extras=told.extras)
    return made, told.rows[-1].time_s


def is_heard(name: str, in_time_s: float = IN_TIME_S) -> bool:
    """Return True if the crew hears of the end in time, by an alarm or, if the number cannot be right, a warning."""
    flown, end_s = said(name)
    return flown.alarm_s() <= end_s - in_time_s or (name not in SOUND and has_warned(flown, end_s))


def has_warned(flown: Flown, end_s: float) -> bool:
    """Return True if the number was withdrawn in time, in a text that the crew has heard on this flight."""
    late_s = end_s - IN_TIME_S
    shown = [row for row in flown.rows if row.time_s <= late_s][-1]
    heard = [text for text in flown.texts if text.time_s <= late_s and math.isnan(text.left_s)]
    return shown.status in ("refused", "converging") and bool(shown.warnings or shown.reason) and bool(heard)


def lo_excess_s(flown: Flown, end_s: float) -> float:
    """Return how much too long the lower end was at worst in the last two minutes [s]; NaN when none was shown."""
    last = [row for row in flown.rows if row.time_s > end_s - LAST_S]
    shown = [row.remaining_lo_s - (end_s - row.time_s) for row in last if math.isfinite(row.remaining_lo_s)]
    return max(shown, default=math.nan)
