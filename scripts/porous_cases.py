#!/usr/bin/env python3
"""Labelled flights of a porous-electrode pack, to diagnose: made by a simulator that shares nothing with ours.

Run: PYTHON scripts/porous_cases.py FOLDER [--seed N]   (a Python of its own with `pip install pybamm`; 3 s a flight)
The pack is that of `porous_pack.py`. Writes FOLDER/CASE/flight_K.csv (telemetry CSV) and FOLDER/labels.json, and keeps
what the simulator gave in FOLDER/flown/*.csv, so that a second run only writes the readings anew. Odd numbers are to
build on, even ones to look at once. FOLDER/healthy/ holds flights in which nothing is wrong. With --seed the cases are
drawn: effect, sign and size by chance, on flights of their own.
"""

from __future__ import annotations

import argparse
import json
import sys
import zlib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from porous_pack import ANY, FLIGHTS, LAG_S, SHARED, Cell, Sensors, flown, readings, write

HEALTHY_GROUPS, HEALTHY_MORE = 7, 27


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
