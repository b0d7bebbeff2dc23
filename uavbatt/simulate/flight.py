"""Simulated flights: telemetry of a battery file's own model under a gusty load, with sensors and their noise.

They are for demonstrations, for tests of readers and for trying an effect. A simulated flight shows nothing about the
accuracy of its model.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from uavbatt.battery import equations as eq
from uavbatt.battery import model
from uavbatt.battery.effects import EFFECTS, effect_named, unit_words
from uavbatt.battery.model import Array, Parameters
from uavbatt.battery.pack import Installation, compensated_voltage, grown, metered_voltage, terminal_voltage
from uavbatt.battery.scaling import Pack
from uavbatt.errors import UsageError
from uavbatt.files import atomic_write
from uavbatt.records import Sample
from uavbatt.simulate.dataflash_writer import write_dataflash
from uavbatt.simulate.route import Autopilot, RouteFlight
from uavbatt.simulate.route_writer import dataflash_records, tlog_messages
from uavbatt.simulate.tlog_writer import write_tlog

IDLE_S, AFTER_END_S = 20.0, 20.0
IDLE_SHARE = 0.03
GUST_SD, GUST_TAU_S = 0.12, 15.0
SENSOR_SD = (0.005, 0.15, 0.1)  # volts a cell, amperes, kelvin
LONGEST_S = 6 * 3600.0


@dataclass(frozen=True, slots=True)
class SimulatedFlight:
    """A SimulatedFlight says what to simulate: mean power [W], ambient [°C], charge, rows a second, seed of gusts."""

    power_W: float
    ambient_C: float = 20.0
    start_soc: float = 1.0
    rate_Hz: float = 2.0
    seed: int = 1


def with_effects(pack: Pack, effects: dict[str, float]) -> Pack:
    """Return the pack with the first quantity of each named effect set to a value.

    Raises UsageError for a name that is unknown, or a value out of its bounds.
    """
    cell, installation = pack.cell, pack.installation
    for name, value in effects.items():
        if name not in EFFECTS:
            raise UsageError(f"--effect {name}: expected one of {', '.join(EFFECTS)}")
        effect = effect_named(name)
        quantity = effect.quantities[0]
        if not quantity.low <= value <= quantity.high:
            raise UsageError(
                f"--effect {name}={value:g}: expected {quantity.name} in {quantity.low:g}..{quantity.high:g} "
                f"{unit_words(quantity.unit)}".rstrip()
            )
        if effect.acts_on == "cell":
            cell = Parameters(**{**cell._asdict(), quantity.name: value})
        else:
            installation = Installation(**{**installation._asdict(), quantity.name: value})
    return pack._replace(cell=cell, installation=installation)


def simulate_flight(
    pack: Pack,
    mission: SimulatedFlight,
    power_W: Callable[[float], float] | None = None,
    lands_s: float = math.inf,
) -> list[Sample]:
    """Return the rows of a flight from the ground until shortly after it lands or reaches its cut-off.

    power_W : power [W] at a time [s], before gusts; by default the mean power at all times
    lands_s : when it lands [s], if ever
    """
    random = np.random.default_rng(mission.seed)
    dt_s = 1.0 / mission.rate_Hz
    installation = pack.installation
    cell = grown(pack.cell, installation)
    size = installation.cells * installation.present_capacity_Ah
    start_soc = mission.start_soc + float(installation.start_soc_shift)
    state = model.rested(start_soc, mission.ambient_C)
    lags, samples = model.lags(cell, dt_s), list[Sample]()
    gust, drawn_Ah, low_since_s = 0.0, 0.0, np.inf
    for k in range(int(LONGEST_S * mission.rate_Hz)):
        time_s = k * dt_s
        flying = IDLE_S <= time_s < lands_s
        asked_W = mission.power_W if power_W is None or not flying else power_W(time_s)
        kick = GUST_SD * np.sqrt(-np.expm1(-2.0 * dt_s / GUST_TAU_S)) * random.standard_normal()
        gust = float(eq.relax(gust, 0.0, dt_s, GUST_TAU_S)) + float(kick)
        total_W = asked_W * (np.exp(gust) if flying else IDLE_SHARE) + installation.unmetered_W
        emf_V, resistance = model.source(cell, state)
        rate = model.under_power(cell, emf_V, resistance, total_W / size).c_rate
        current_A = float(rate * installation.present_capacity_Ah)
        state = model.step_with_resistance(cell, state, rate, resistance, mission.ambient_C, dt_s, lags)
        true_V = float(terminal_voltage(installation, cell, state, current_A))
        drawn_Ah += max(_metered(installation, current_A, true_V), 0.0) * dt_s / 3600.0
        samples.append(_row(pack, time_s, true_V, current_A, float(state.sensor_C), drawn_Ah, flying, random))
        low_since_s = min(low_since_s, time_s) if true_V < pack.cutoff_V else np.inf
        if time_s - low_since_s > AFTER_END_S or time_s - lands_s > AFTER_END_S:
            break
    return _delayed(samples, float(installation.delay_s))


def _delayed(samples: list[Sample], delay_s: float) -> list[Sample]:
    """Return the rows with the current of `delay_s` before."""
    if delay_s == 0.0:
        return samples
    time_s = np.array([s.time_s for s in samples])
    late_A = np.interp(time_s - delay_s, time_s, np.array([s.current_A for s in samples]))
    return [replace(s, current_A=float(a)) for s, a in zip(samples, late_A, strict=True)]


def _metered(installation: Installation, current_A: float, true_V: float) -> float:
    """Return the sensor's reading [A] of a true current: the inverse of `pack.true_current`."""
    seen_A = (current_A - installation.unmetered_W / true_V) * installation.gain_I + installation.offset_A
    return float(seen_A)


def _row(
    pack: Pack,
    time_s: float,
    true_V: float,
    current_A: float,
    sensor_C: float,
    drawn_Ah: float,
    flying: bool,
    random: np.random.Generator,
) -> Sample:
    installation = pack.installation
    noise: Array = random.standard_normal(3) * np.array(SENSOR_SD) * np.array([installation.cells, 1.0, 1.0])
    metered_A = _metered(installation, current_A, true_V)
    reported_V = compensated_voltage(installation, metered_voltage(installation, true_V), current_A)
    return Sample(
        time_s=time_s,
        voltage_V=float(reported_V) + float(noise[0]),
        current_A=max(metered_A + float(noise[1]), 0.0),
        temp_C=sensor_C + installation.offset_K + float(noise[2]),
        consumed_Ah=drawn_Ah,
        reported_soc=max(1.0 - drawn_Ah / installation.capacity_Ah, 0.0),
        armed=flying,
    )


def check_kind(path: Path, route: RouteFlight | None = None) -> None:
    """Raise UsageError for a file name whose suffix names no log that can be written, with this route."""
    kind = path.suffix.lower()
    if kind not in (".tlog", ".bin", ".csv"):
        raise UsageError(f"{path}: expected a name that ends in .tlog, .BIN or .csv")
    if kind == ".bin" and route is not None and route.autopilot.is_px4:
        raise UsageError(f"{path}: expected .tlog or .csv: the mission is a PX4's, and .BIN is a log of ArduPilot")


def write_log(path: Path, samples: list[Sample], pack: Pack, route: RouteFlight | None = None) -> None:
    """Write the flight as `.tlog`, `.BIN` or `.csv`, by the suffix. Raises UsageError as `check_kind` does."""
    check_kind(path, route)
    kind, parameters = path.suffix.lower(), _parameters(pack, route.autopilot if route is not None else None)
    flown = route.flown(samples[-1].time_s) if route is not None else None
    if kind == ".csv":
        _write_csv(path, samples)
    elif kind == ".bin":
        write_dataflash(path, samples, parameters, route=list(dataflash_records(flown)) if flown is not None else ())
    elif flown is None:
        write_tlog(path, samples, parameters)
    else:
        route_messages = tlog_messages(flown)
        write_tlog(path, samples, parameters, route=route_messages, mode_at=flown.mode_at, is_px4=flown.is_px4)


def _parameters(pack: Pack, autopilot: Autopilot | None) -> dict[str, float]:
    """Return the parameters of the vehicle: of speed and return where a route is flown, and of the battery."""
    of_route = dict(autopilot.parameters) if autopilot is not None else {}
    capacity_mAh, cells = round(float(pack.installation.capacity_Ah) * 1000.0), pack.installation.cells
    empty_V = pack.cutoff_V / cells
    if autopilot is not None and autopilot.is_px4:
        return of_route | {"BAT1_N_CELLS": cells, "BAT1_CAPACITY": float(capacity_mAh), "BAT1_V_EMPTY": empty_V}
    return of_route | {
        "BATT_MONITOR": 4.0,
        "BATT_CAPACITY": capacity_mAh,
        "BATT_LOW_VOLT": round(pack.low_V, 3) if np.isfinite(pack.low_V) else 0.0,
        "BATT_CRT_VOLT": round(pack.cutoff_V, 3),
        "BATT_OPTIONS": 0.0,
    }


def _write_csv(path: Path, samples: list[Sample]) -> None:
    with atomic_write(path) as stream:
        stream.write("time_s,voltage_V,current_A,temp_C,consumed_Ah,reported_soc,armed\n")
        for s in samples:
            stream.write(
                f"{s.time_s:.3f},{s.voltage_V:.3f},{s.current_A:.2f},{s.temp_C:.2f},{s.consumed_Ah:.4f},"
                f"{s.reported_soc:.3f},{int(bool(s.armed))}\n"
            )
