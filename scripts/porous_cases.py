#!/usr/bin/env python3
"""Labelled flights of a porous-electrode pack, to diagnose: made by a simulator that shares nothing with ours.

Run: PYTHON scripts/porous_cases.py FOLDER [--seed N]   (a Python of its own with `pip install pybamm`; 3 s a flight)
A Doyle-Fuller-Newman pouch cell (PyBaMM, parameters of Ai et al. 2020) in 4S with 2.2 in parallel: on the loads of the
shared truth it shows the same voltage to 1 mV on a fine mesh, to 7 mV on the one used. Writes FOLDER/CASE/flight_K.csv
(telemetry CSV) and FOLDER/labels.json, and keeps what the simulator gave in FOLDER/flown/*.csv, so that a second run
only writes the readings anew. Odd numbers are to build on, even ones to look at once. FOLDER/healthy/ holds flights in
which nothing is wrong. With --seed the cases are drawn: effect, sign and size by chance, on flights of their own.
"""

from __future__ import annotations

import argparse
import json
import sys
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

CELLS, PARALLEL, CAPACITY_AH = 4, 2.2, 5.016
IDLE_S, IDLE_A, LONGEST_S = 24.0, 0.27, 2400.0
EMPTY_CELL_V = 3.2
NOISE_V, NOISE_A, NOISE_K, LAG_S, ROW_S = 0.02, 0.25, 0.15, 12.0, 0.5  # of the sensors in the shared truth
KNOT_S = 2
FLIGHTS, HEALTHY_GROUPS, HEALTHY_MORE = 3, 7, 27

Array = np.ndarray


@dataclass(frozen=True)
class Weather:
    """Weather bounds the level power [W] of the flights and the air [°C] of each flight of a case."""

    power_W: tuple[float, float]
    air_C: tuple[tuple[float, float], ...]


ANY = Weather((125.0, 190.0), ((4.0, 38.0),) * FLIGHTS)
SHARED = Weather((150.0, 190.0), ((15.0, 20.0), (6.0, 10.5), (28.0, 32.0)))  # as the labelled cases of the shared truth


@dataclass(frozen=True)
class Cell:
    """A Cell says how the cell differs from the one on the bench."""

    capacity: float = 1.0
    exchange: float = 1.0
    diffusivity: float = 1.0
    cooling: float = 1.0
    start_soc: float = 1.0
    weakest: float = 1.0  # charge that one cell of the series holds, of the others'


@dataclass(frozen=True)
class Sensors:
    """Sensors says how the readings differ from the truth."""

    current_gain: float = 1.0
    current_offset_A: float = 0.0
    unmetered_W: float = 0.0
    voltage_gain: float = 1.0
    voltage_offset_V: float = 0.0
    temp_offset_K: float = 0.0
    temp_lag_s: float = LAG_S
    current_delay_s: float = 0.0
    harness_ohm: float = 0.0
    hysteresis_V: float = 0.0
    other: str = ""  # an effect that has no name among ours


@dataclass(frozen=True)
class Case:
    """A Case has its label, size, cell and sensors; flights are of group `group` where the cell is as on the bench."""

    effect: str
    size: str
    cell: Cell = field(default_factory=Cell)
    sensors: Sensors = field(default_factory=Sensors)
    group: int = 0


def cases() -> list[Case]:
    """Return every case in order; the groups of healthy flights go round."""
    c, s = Cell, Sensors
    listed = [
        Case("none", "clear"), Case("none", "clear"), Case("none", "clear"), Case("none", "clear"),
        Case("current_gain", "clear", sensors=s(current_gain=0.91)),
        Case("current_gain", "clear", sensors=s(current_gain=1.07)),
        Case("current_offset", "clear", sensors=s(current_offset_A=1.1)),
        Case("current_offset", "half", sensors=s(current_offset_A=0.5)),
        Case("voltage_offset", "clear", sensors=s(voltage_offset_V=-0.2)),
        Case("voltage_gain", "clear", sensors=s(voltage_gain=0.986)),
        Case("harness_resistance", "clear", sensors=s(harness_ohm=0.013)),
        Case("harness_resistance", "half", sensors=s(harness_ohm=0.006)),
        Case("temperature_offset", "clear", sensors=s(temp_offset_K=-10.0)),
        Case("temperature_offset", "half", sensors=s(temp_offset_K=5.0)),
        Case("temperature_lag", "clear", sensors=s(temp_lag_s=110.0)),
        Case("temperature_lag", "half", sensors=s(temp_lag_s=60.0)),
        Case("current_delay", "clear", sensors=s(current_delay_s=3.0)),
        Case("unmetered_load", "half", sensors=s(unmetered_W=10.0)),
        Case("unmetered_load", "clear", sensors=s(unmetered_W=22.0)),
        Case("hysteresis", "clear", sensors=s(hysteresis_V=0.025)),
        Case("voltage_offset", "half", sensors=s(voltage_offset_V=0.1)),
        Case("voltage_gain", "half", sensors=s(voltage_gain=1.007)),
        Case("current_gain", "quarter", sensors=s(current_gain=1.02)),
        Case("temperature_offset", "quarter", sensors=s(temp_offset_K=2.5)),
        Case("unmetered_load", "quarter", sensors=s(unmetered_W=5.0)),
        Case("voltage_offset", "quarter", sensors=s(voltage_offset_V=-0.05)),
        Case("current_gain+temperature_offset", "clear", sensors=s(current_gain=0.93, temp_offset_K=9.0)),
        Case("voltage_offset+current_gain", "clear", sensors=s(voltage_offset_V=-0.2, current_gain=1.08)),
        Case("harness_resistance+temperature_offset", "clear", sensors=s(harness_ohm=0.013, temp_offset_K=-10.0)),
        Case("temperature_lag+unmetered_load", "clear", sensors=s(temp_lag_s=120.0, unmetered_W=20.0)),
        Case("undeclared", "clear", sensors=s(other="converter_drift")),
        Case("undeclared", "clear", sensors=s(other="saturating_current")),
        Case("undeclared", "clear", sensors=s(other="load_now_and_then")),
        Case("undeclared", "clear", sensors=s(other="voltage_creeps")),
        Case("capacity_fade", "clear", c(capacity=0.88)), Case("capacity_fade", "half", c(capacity=0.94)),
        Case("resistance_growth", "clear", c(exchange=0.5)), Case("resistance_growth", "half", c(exchange=0.7)),
        Case("airflow_cooling", "clear", c(cooling=4.0)), Case("slow_diffusion", "clear", c(diffusivity=0.45)),
        Case("weak_cell", "clear", c(weakest=0.85)), Case("partial_charge", "clear", c(start_soc=0.78)),
        Case("capacity_fade+resistance_growth", "clear", c(capacity=0.9, exchange=0.55)),
        Case("capacity_fade+voltage_offset", "clear", c(capacity=0.88), s(voltage_offset_V=0.2)),
        Case("airflow_cooling+current_gain", "clear", c(cooling=4.0), s(current_gain=1.08)),
        Case("resistance_growth", "quarter", c(exchange=0.85)), Case("capacity_fade", "quarter", c(capacity=0.97)),
    ]  # fmt: skip
    return [replace(case, group=k % HEALTHY_GROUPS) for k, case in enumerate(listed)]


# Of each effect: what it changes, the neutral value, and the value at a clear size; with `either`, of either sign.
CLEAR: dict[str, tuple[str, float, float]] = {
    "current_gain": ("current_gain", 1.0, 1.08),
    "current_offset": ("current_offset_A", 0.0, 1.0),
    "unmetered_load": ("unmetered_W", 0.0, 21.0),
    "voltage_gain": ("voltage_gain", 1.0, 1.015),
    "voltage_offset": ("voltage_offset_V", 0.0, 0.2),
    "temperature_offset": ("temp_offset_K", 0.0, 10.0),
    "temperature_lag": ("temp_lag_s", LAG_S, 120.0),
    "current_delay": ("current_delay_s", 0.0, 3.0),
    "harness_resistance": ("harness_ohm", 0.0, 0.0125),
    "hysteresis": ("hysteresis_V", 0.0, 0.025),
    "capacity_fade": ("capacity", 1.0, 0.88),
    "resistance_growth": ("exchange", 1.0, 0.5),
    "airflow_cooling": ("cooling", 1.0, 4.0),
    "slow_diffusion": ("diffusivity", 1.0, 0.45),
    "weak_cell": ("weakest", 1.0, 0.85),
    "partial_charge": ("start_soc", 1.0, 0.78),
}
EITHER = ("current_gain", "voltage_gain", "voltage_offset", "temperature_offset")
NAMELESS = (
    "converter_drift",
    "saturating_current",
    "load_now_and_then",
    "voltage_creeps",
    "gain_drifts",
    "contact_opens",
)
PAIRS = (
    ("current_gain", "temperature_offset"), ("voltage_offset", "current_gain"), ("capacity_fade", "resistance_growth"),
    ("harness_resistance", "temperature_offset"), ("temperature_lag", "unmetered_load"),
    ("capacity_fade", "voltage_offset"), ("airflow_cooling", "current_gain"), ("voltage_gain", "temperature_offset"),
    ("resistance_growth", "temperature_offset"), ("current_delay", "current_gain"),
    ("harness_resistance", "voltage_offset"), ("airflow_cooling", "unmetered_load"),
)  # fmt: skip
SHARES = {"clear": 1.0, "half": 0.5, "quarter": 0.25}
QUARTERS = (
    "current_gain", "current_offset", "unmetered_load", "voltage_gain", "voltage_offset", "temperature_offset",
    "harness_resistance", "capacity_fade", "resistance_growth", "temperature_lag", "airflow_cooling",
)  # fmt: skip


def drawn(seed: int) -> list[Case]:
    """Return forty cases about as a user would meet them: effect, sign and size are drawn."""
    random = np.random.default_rng(seed)
    every, quarters = (
        random.permutation(list(CLEAR)),
        random.permutation(list(QUARTERS)),
    )
    more = random.permutation([name for name in CLEAR if name != "slow_diffusion"])
    pairs = [PAIRS[i] for i in random.permutation(len(PAIRS))[:6]]
    listed = [_drawn((str(name),), "clear", random) for name in every[:10]]
    listed += [_drawn((str(name),), "half", random) for name in more[:9]]
    listed += [_drawn((str(name),), "quarter", random) for name in quarters[:6]]
    listed += [_drawn(pair, "clear", random) for pair in pairs]
    others = random.permutation(list(NAMELESS))[:4]
    listed += [Case("undeclared", "clear", sensors=Sensors(other=str(name))) for name in others]
    listed += [Case("none", "clear") for _ in range(5)]
    return [replace(case, group=k % HEALTHY_GROUPS) for k, case in enumerate(listed)]


def _drawn(names: tuple[str, ...], size: str, random: np.random.Generator) -> Case:
    """Return one or two effects, each of 0.8 to 1.2 of its size."""
    cell, sensors = Cell(), Sensors()
    for name in names:
        quantity, neutral, clear = CLEAR[name]
        share = SHARES[size] * random.uniform(0.8, 1.2) * (random.choice([-1.0, 1.0]) if name in EITHER else 1.0)
        value = neutral + share * (clear - neutral)
        if quantity in ("exchange", "diffusivity", "cooling"):  # factors: half of the size is the root
            value = clear ** abs(share)
        if hasattr(cell, quantity):
            cell = replace(cell, **{quantity: round(value, 3)})
        else:
            changed: dict[str, Any] = {quantity: round(value, 4)}
            sensors = replace(sensors, **changed)
    return Case("+".join(names), size, cell, sensors)


def load_A(random: np.random.Generator, bounds_W: tuple[float, float]) -> Array:
    """Return a multirotor's current at 1 Hz [A]: legs of a minute or two, gusts of twenty seconds, after the idle."""
    count = int(LONGEST_S)
    legs = np.repeat(random.normal(0.0, 0.09, 60), random.integers(40, 130, 60))[:count]
    legs = np.resize(legs, count)
    gusts = np.zeros(count)
    for k in range(1, count):
        gusts[k] = 0.95 * gusts[k - 1] + random.normal(0.0, 0.12 * np.sqrt(1.0 - 0.95**2))
    power_W = random.uniform(*bounds_W) * np.exp(legs + gusts)
    amps = np.empty(count)
    drawn = 0.0
    for k in range(count):
        volts = 16.5 - 2.4 * drawn - 0.06 * (amps[k - 1] if k else 0.0)
        amps[k] = IDLE_A if k < IDLE_S else power_W[k] / max(volts, 12.5)
        drawn += amps[k] / 3600.0 / CAPACITY_AH
    every = np.arange(0, count, KNOT_S)  # corners cost the solver its long steps
    return np.interp(np.arange(count), every, amps[every])


def cell_V(cell: Cell, amps: Array, air_C: float) -> tuple[Array, Array, Array]:
    """Return times [s], voltage of one cell [V] and its temperature [degC] under the pack's current, to its end."""
    import pybamm

    pybamm.set_logging_level("ERROR")
    values = pybamm.ParameterValues("Ai2020")
    time_s = np.arange(amps.size, dtype=float)
    shared = amps / PARALLEL / cell.capacity
    values["Current function [A]"] = pybamm.Interpolant(time_s, shared, pybamm.t, interpolator="linear")
    values["Ambient temperature [K]"] = values["Initial temperature [K]"] = air_C + 273.15
    values["Lower voltage cut-off [V]"] = EMPTY_CELL_V
    values["Total heat transfer coefficient [W.m-2.K-1]"] *= cell.cooling
    for side in ("Negative", "Positive"):
        _scale(values, f"{side} electrode exchange-current density [A.m-2]", cell.exchange)
        _scale(values, f"{side} particle diffusivity [m2.s-1]", cell.diffusivity)
    mesh = {"x_n": 10, "x_s": 5, "x_p": 10, "r_n": 10, "r_p": 10}  # 6 mV from twice as fine, at a sixth of the time
    solver = pybamm.IDAKLUSolver(rtol=1e-3, atol=1e-4)
    model = pybamm.lithium_ion.DFN({"thermal": "lumped"})
    simulation = pybamm.Simulation(model, parameter_values=values, var_pts=mesh, solver=solver)
    solved = simulation.solve([0.0, time_s[-1]], t_interp=time_s, initial_soc=cell.start_soc)
    until = time_s[time_s <= solved.t[-1]]
    return until, solved["Voltage [V]"](until), solved["X-averaged cell temperature [K]"](until) - 273.15


def _scale(values: dict[str, Callable[..., Any]], name: str, factor: float) -> None:
    function = values[name]
    if factor != 1.0:
        values[name] = lambda *given: factor * function(*given)


def flown(folder: Path, cell: Cell, seed: int, weather: Weather = ANY) -> Array:
    """Return time, voltage, current, temperature of one flight of the pack [rows, 4]; read from the folder if there.

    The last two digits of the seed are the number of the flight in its case, from 1 on.
    """
    path = folder / f"{'-'.join(f'{v:g}' for v in vars(cell).values())}-{seed}.csv"
    if not path.exists():
        random = np.random.default_rng(seed)
        amps = load_A(random, weather.power_W)
        air_C = random.uniform(*weather.air_C[(seed % 100 - 1) % FLIGHTS])
        time_s, volts, temps = cell_V(replace(cell, weakest=1.0), amps, air_C)
        pack_V = CELLS * volts
        if cell.weakest < 1.0:
            weak_s, weak_V, _ = cell_V(replace(cell, capacity=cell.capacity * cell.weakest, weakest=1.0), amps, air_C)
            rows = min(time_s.size, weak_s.size)
            time_s, temps, pack_V = time_s[:rows], temps[:rows], (CELLS - 1) * volts[:rows] + weak_V[:rows]
        table = np.column_stack([time_s, pack_V, amps[: time_s.size], temps])
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(path, table, fmt="%.5f", delimiter=",")
    return np.loadtxt(path, delimiter=",")


def readings(true: Array, sensors: Sensors, random: np.random.Generator) -> Array:
    """Return what the sensors show at 2 Hz [rows, 4]."""
    time_s = np.arange(0.0, true[-1, 0], ROW_S)
    volts, amps, core_C = (np.interp(time_s, true[:, 0], true[:, k]) for k in (1, 2, 3))
    drawn = np.cumsum(amps) * ROW_S / 3600.0 / CAPACITY_AH
    volts = volts - sensors.harness_ohm * amps - CELLS * sensors.hysteresis_V * np.clip(drawn / 0.05, 0.0, 1.0)
    shown_A = np.interp(time_s - sensors.current_delay_s, time_s, amps - sensors.unmetered_W / volts)
    surface_C = _late(core_C, sensors.temp_lag_s)
    volts, shown_A = _other(sensors.other, time_s, volts, shown_A, surface_C)
    volts = sensors.voltage_gain * volts + sensors.voltage_offset_V + random.normal(0.0, NOISE_V, time_s.size)
    shown_A = sensors.current_gain * shown_A + sensors.current_offset_A + random.normal(0.0, NOISE_A, time_s.size)
    surface_C = surface_C + sensors.temp_offset_K + random.normal(0.0, NOISE_K, time_s.size)
    return np.column_stack([time_s, volts, np.maximum(shown_A, 0.0), surface_C])


def _late(core_C: Array, tau_s: float) -> Array:
    shown, kept = np.empty_like(core_C), np.exp(-ROW_S / tau_s)
    value = core_C[0]
    for k, target in enumerate(core_C):
        value = target + (value - target) * kept
        shown[k] = value
    return shown


def _other(name: str, time_s: Array, volts: Array, amps: Array, temps: Array) -> tuple[Array, Array]:
    """Return voltage and current as sensors show them whose fault has no name."""
    flying_s = np.maximum(time_s - IDLE_S, 0.0)
    if name == "converter_drift":
        return volts * (1.0 + 0.0015 * (temps - 25.0)), amps
    if name == "saturating_current":
        return volts, amps / (1.0 + (amps / 28.0) ** 2)
    if name == "load_now_and_then":
        return volts, amps - np.where(np.sin(2.0 * np.pi * flying_s / 420.0) > 0.2, 30.0, 0.0) / volts
    if name == "voltage_creeps":
        return volts + 0.25 * np.sin(2.0 * np.pi * flying_s / 700.0), amps
    if name == "gain_drifts":
        return volts, amps * (1.0 + 0.15 * flying_s / max(float(flying_s[-1]), 1.0))
    if name == "contact_opens":
        return volts - np.where(flying_s > 0.45 * flying_s[-1], 0.03, 0.0) * amps, amps
    return volts, amps


def write(path: Path, table: Array) -> None:
    """Write one flight as telemetry CSV."""
    path.parent.mkdir(parents=True, exist_ok=True)
    header = "time_s,voltage_V,current_A,temp_C"
    np.savetxt(path, table, fmt=("%.1f", "%.3f", "%.2f", "%.2f"), delimiter=",", header=header, comments="")


def main() -> int:
    """Write the cases and the healthy flights."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--shared-weather", action="store_true", help="air and power of the labelled cases")
    given = parser.parse_args()
    folder, seed, labels, weather = given.folder, given.seed, {}, SHARED if given.shared_weather else ANY
    for number, case in enumerate(drawn(seed) if seed else cases(), start=1):
        name = f"s{seed}x{number:02d}" if seed else f"n{number:02d}"
        first = 1_000_000 * seed + (100 * case.group if case.cell == Cell() else 10_000 + 100 * number)
        for k in range(1, FLIGHTS + 1):
            random = np.random.default_rng(zlib.crc32(f"{name} {k}".encode()))
            table = readings(flown(folder / "flown", case.cell, first + k, weather), case.sensors, random)
            write(folder / name / f"flight_{k}.csv", table)
        labels[name] = {"effect": case.effect, "size": case.size, "cell": changed(case.cell)}
        labels[name]["sensors"] = changed(case.sensors)
        (folder / "labels.json").write_text(json.dumps(labels, indent=1) + "\n")
        print(name, case.effect, case.size, flush=True)
    if not seed:
        write_healthy(folder)
    return 0


def changed(values: Cell | Sensors) -> dict[str, object]:
    """Return the fields that are not as they should be."""
    usual = type(values)()
    return {name: value for name, value in vars(values).items() if value != getattr(usual, name)}


def write_healthy(folder: Path) -> None:
    """Write flights in which nothing is wrong, one file each."""
    seeds = [100 * g + k for g in range(HEALTHY_GROUPS) for k in range(1, FLIGHTS + 1)]
    seeds += [5_000 + k for k in range(HEALTHY_MORE)]
    for seed in seeds:
        random = np.random.default_rng(90_000 + seed)
        write(folder / "healthy" / f"{seed}.csv", readings(flown(folder / "flown", Cell(), seed), Sensors(), random))


if __name__ == "__main__":
    sys.exit(main())
