"""A porous-electrode pack and the sensors that read it, for labelled flights: it shares nothing with our model.

A Doyle-Fuller-Newman pouch cell (PyBaMM, parameters of Ai et al. 2020) in 4S with 2.2 in parallel: on the loads of the
shared truth it shows the same voltage to 1 mV on a fine mesh, to 7 mV on the one used. `porous_cases.py` and
`worn_packs.py` fly it, in a Python of its own with `pip install pybamm`; 3 s a flight.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

CELLS, PARALLEL, CAPACITY_AH = 4, 2.2, 5.016
IDLE_S, IDLE_A, LONGEST_S = 24.0, 0.27, 2400.0
EMPTY_CELL_V = 3.2
NOISE_V, NOISE_A, NOISE_K, LAG_S, ROW_S = 0.02, 0.25, 0.15, 12.0, 0.5  # of the sensors in the shared truth
KNOT_S = 2
FLIGHTS = 3  # of a case

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
