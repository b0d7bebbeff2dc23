#!/usr/bin/env python3
"""The kept cases: effects planted into effect-free flights of the simulated truth, and what diagnosis makes of them.

Run: .venv/bin/python scripts/diagnose_cases_kept.py [BATTERY.battery.toml] [--only WORD]
Needs the shared data (UAVBATT_DATA or ../shared/data). Without a battery file it fits the one of the truth first.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import diagnose_cases_inject as plant
import numpy as np
from diagnose_cases_inject import Change, Flown
from scoring import data
from scoring.truth import truth_battery

from uavbatt.battery import battery_file
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing.pack_size import PackOptions, pack_from
from uavbatt.diagnosis.diagnosis import Diagnosis, diagnose
from uavbatt.log_replay.run import engine_for

EQUIVALENT = (
    {"current_offset", "unmetered_load"},
    {"capacity_fade", "weak_cell", "current_gain", "rate_capacity"},
    {"voltage_gain", "voltage_offset"},
    {"harness_resistance", "resistance_growth"},
    {"slow_diffusion", "polarisation", "hysteresis", "charge_transfer"},
)


@dataclass(frozen=True)
class Case:
    """A Case is an effect, how to plant it at a size, its size, the flights it is planted into, and its quantity."""

    effect: str
    change: Callable[[float], Change]
    size: float
    flights: str
    neutral: float = 0.0
    quantity: str = ""

    def at(self, share: float) -> Change:
        """Return the change that plants the effect at a share of its size."""
        return self.change(self.neutral + share * (self.size - self.neutral))


CASES = (
    Case("current_gain", plant.current_gain, 1.08, "p1", 1.0, "gain_I"),
    Case("current_gain", plant.current_gain, 0.92, "r0", 1.0, "gain_I"),
    Case("current_offset", plant.current_offset, 1.0, "r0", quantity="offset_A"),
    Case("unmetered_load", plant.unmetered, 18.0, "p1", quantity="unmetered_W"),
    Case("voltage_gain", plant.voltage_gain, 1.015, "p1", 1.0, "gain_V"),
    Case("voltage_offset", plant.voltage_offset, -0.2, "r0", quantity="offset_V"),
    Case("temperature_offset", plant.temperature_offset, 9.0, "p1", quantity="offset_K"),
    Case("temperature_lag", plant.temperature_lag, 120.0, "r0", 2.0),
    Case("current_delay", plant.current_delay, 3.0, "p1", quantity="delay_s"),
    Case("harness_resistance", plant.harness, 0.010, "r0", quantity="harness_ohm"),
    Case("sag_compensation", plant.sag_compensation, 0.016, "p1", quantity="compensation_ohm"),
    Case("resistance_growth", plant.resistance_growth, 0.25, "p1"),
    Case("capacity_fade", plant.fade, 0.12, "p1", quantity="fade"),
    Case("weak_cell", plant.weak_cell, 0.15, "r0"),
    Case("initial_charge", plant.initial_charge, 0.08, "p1"),
    Case("rate_capacity", plant.rate_capacity, 0.04, "r0"),
    Case("hysteresis", plant.hysteresis, 0.025, "p1"),
    Case("slow_diffusion", plant.slow_voltage, 0.006, "r0"),
    Case("airflow_cooling", plant.cooled, 1.0, "p1"),
    Case("charge_transfer", plant.charge_transfer, 0.6, "r0", 1.0),
)
PAIRS = (
    ("voltage_offset", "current_gain", plant.both(plant.current_gain(1.08), plant.voltage_offset(-0.2)), "p1"),
    ("current_gain", "temperature_offset", plant.both(plant.current_gain(1.08), plant.temperature_offset(-10.0)), "r0"),
    ("harness_resistance", "unmetered_load", plant.both(plant.harness(0.012), plant.unmetered(20.0)), "p1"),
    ("capacity_fade", "voltage_offset", plant.both(plant.fade(0.12), plant.voltage_offset(0.2)), "r0"),
    ("resistance_growth", "current_offset", plant.both(plant.resistance_growth(0.3), plant.current_offset(1.0)), "p1"),
)


def pools(battery: BatteryFile) -> dict[str, list[Flown]]:
    """Return the effect-free flights by the name of their case."""
    places = {"r0": "reference/r0", "p1": "practice/p1"}
    truth = data.folder() / "truth"
    return {k: plant.flights(truth / v, truth / "answers" / v, battery) for k, v in places.items()}


def run(flown: list[Flown], change: Change, battery: BatteryFile, *without: str) -> Diagnosis:
    """Return the diagnosis of the flights with the change in them."""
    records = [change(f).observed() for f in flown]
    return diagnose(
        records,
        battery,
        pack_from(battery, PackOptions(plant.CELLS, plant.CAPACITY_AH)),
        without,
        engine=engine_for(is_long=True),
    )


def kin(effect: str) -> set[str]:
    """Return the effects that no reading of voltage, current and temperature tells from this one."""
    return {effect}.union(*(c for c in EQUIVALENT if effect in c))


def confident(found: Diagnosis) -> str:
    """Return the name that is stated alone and without doubt; empty if there is none."""
    if found.verdict == "effect_found" and len(found.classes) == 1 and len(found.classes[0].members) == 1:
        return found.classes[0].members[0]
    return ""


def words(found: Diagnosis, quantity: str = "") -> str:
    """Return verdict and classes in one cell of a table."""
    listed = " + ".join("/".join(c.members) for c in found.classes) or "–"
    mark = {"undeclared_effect": "undeclared: ", "effect_found": "", "no_missing_effect": "none: "}[found.verdict]
    told = found.classes[0].parameters.get(quantity) if found.classes else None
    return mark + listed + (f" {told.value:.4g} [{told.lo:.4g}, {told.hi:.4g}]" if told else "")


def first_has(found: Diagnosis, effect: str) -> bool:
    """Return True if the truth is among the members of the first class."""
    return bool(found.classes) and effect in found.classes[0].members


def mark(good: bool) -> str:
    """Return the mark of a table cell: a tick if good, else a cross."""
    return "✓" if good else "✗"


def singles(battery: BatteryFile, pool: dict[str, list[Flown]], only: str) -> None:
    """Print the table of the planted effects: whole, half, and with the true effect withheld."""
    print("\n| planted | flights | whole size | half size | withheld |\n|---|---|---|---|---|")
    whole, halves, wrong, kindred, cases = 0, 0, 0, 0, [c for c in CASES if only in c.effect]
    for case in cases:
        flown = pool[case.flights]
        full = run(flown, case.at(1.0), battery)
        half = run(flown, case.at(0.5), battery)
        withheld = run(flown, case.at(1.0), battery, case.effect)
        name = confident(withheld)
        whole, halves = whole + first_has(full, case.effect), halves + first_has(half, case.effect)
        wrong, kindred = wrong + bool(name and name not in kin(case.effect)), kindred + bool(name in kin(case.effect))
        print(
            f"| {case.effect} {case.size:g} | {case.flights} | {mark(first_has(full, case.effect))} "
            f"{words(full, case.quantity)} | {mark(first_has(half, case.effect))} {words(half, case.quantity)} | "
            f"{mark(not name or name in kin(case.effect))} {words(withheld)} |",
            flush=True,
        )
    n = len(cases)
    print(f"\nFirst class right: {whole} of {n}; at half the size: {halves} of {n}. With the true effect withheld, one "
          f"name without doubt: {wrong} of {n} wrong, {kindred} of {n} of the same equivalence class.")  # fmt: skip


def effect_free(battery: BatteryFile, pool: dict[str, list[Flown]]) -> None:
    """Print flights with nothing planted, in several combinations."""
    p, r = pool["p1"], pool["r0"]
    sets = {"p1": p, "r0": r, "p1 1, 2 and r0 3, 4": p[:2] + r[2:], "r0 1, 2 and p1 3, 4": r[:2] + p[2:],
            "p1 1 to 3": p[:3], "p1 2 and 4": [p[1], p[3]], "all eight": p + r}  # fmt: skip
    print("\n| nothing planted | diagnosis |\n|---|---|")
    alarms = 0
    for name, flown in sets.items():
        found = run(flown, lambda f: f, battery)
        alarms += found.verdict != "no_missing_effect"
        print(f"| {name} | {mark(found.verdict == 'no_missing_effect')} {words(found)} |", flush=True)
    print(f"\nFalse alarms: {alarms} of {len(sets)}.")


def pairs(battery: BatteryFile, pool: dict[str, list[Flown]]) -> None:
    """Print what becomes of two effects at once."""
    print("\n| two planted | flights | diagnosis |\n|---|---|---|")
    good = 0
    for one, other, change, name in PAIRS:
        found = run(pool[name], change, battery)
        told = [set(c.members) for c in found.classes]
        right = len(told) == 2 and any(one in a and other in b for a, b in (told, told[::-1]))
        good += right
        print(f"| {one} + {other} | {name} | {mark(right)} {words(found)} |", flush=True)
    print(f"\nBoth effects in two classes: {good} of {len(PAIRS)}.")


def invariances(battery: BatteryFile, pool: dict[str, list[Flown]]) -> None:
    """Print what becomes of renamed and shuffled files, and of an effect of no size."""
    change, flown = plant.current_gain(1.08), pool["p1"]
    first = run(flown, change, battery)
    second = run([replace(flown[i], name=f"log {i}") for i in (2, 0, 3, 1)], change, battery)
    nothing = [c.effect for c in CASES if run(pool[c.flights][:2], c.at(0.0), battery).verdict != "no_missing_effect"]
    print(f"\nRenamed and shuffled: {mark(first.verdict == second.verdict and first.classes == second.classes)}. "
          f"Effects of no size that were found: {', '.join(nothing) or 'none'}.")  # fmt: skip


def asked_for(description: str) -> tuple[BatteryFile, str]:
    """Return the battery of the command line, fitted when absent, and the word that planted effects shall hold."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("battery", nargs="?", type=Path, help="battery file of the truth, fitted when absent")
    parser.add_argument("--only", default="", help="planted effects whose name holds this word, and nothing else")
    asked = parser.parse_args()
    battery = battery_file.read_battery(asked.battery) if asked.battery else truth_battery(data.folder())
    return battery, asked.only


def main() -> int:
    """Print the tables."""
    battery, only = asked_for(__doc__ or "")
    pool = pools(battery)
    np.seterr(all="raise", under="ignore")
    singles(battery, pool, only)
    if not only:
        for table in (effect_free, pairs, invariances):
            table(battery, pool)
    return 0


if __name__ == "__main__":
    sys.exit(main())
