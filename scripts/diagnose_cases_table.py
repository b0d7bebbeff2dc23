#!/usr/bin/env python3
"""The table of diagnosed cases beside their labels, and how many were right.

Run: .venv/bin/python scripts/diagnose_cases_table.py FOLDER    (the JSON of `scripts/diagnose_cases`)
Right is: nothing found where nothing is wrong; `undeclared_effect` where the effect has no name; else the label among
the names of the first class (also if that is no more than what small effect may hide where nothing is found), and both
labels in classes of their own for two. A wrong name is a class without the label, told with a probability above 0.4.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

from scoring import data

TRUTH = data.place() / "truth"
SAME = {"partial_charge": "initial_charge", "undeclared": "undeclared"}
SURE = 0.4
# How the quantity of an effect begins in a label, whatever its unit.
QUANTITIES = {
    "current_gain": "current_gain", "voltage_gain": "voltage_gain", "voltage_offset": "voltage_offset",
    "current_offset": "current_offset", "current_delay": "current_delay", "unmetered_load": "unmetered",
    "temperature_offset": "temp_offset", "temperature_lag": "temp_lag", "harness_resistance": "harness",
    "hysteresis": "hysteresis", "capacity_fade": "capacity", "initial_charge": ("start_soc", "initial_soc"),
}  # fmt: skip


def labels() -> dict[str, tuple[str, str]]:
    """Return case -> (effect, size)."""
    told: dict[str, tuple[str, str]] = {}
    for path in (TRUTH / "practice" / "labels.json", TRUTH / "cases" / "labels.json"):
        for name, entry in json.loads(path.read_text()).items():
            told[Path(name).name] = (entry["effect"], entry.get("size", "clear"))
    return told


def kind(effect: str, size: str) -> str:
    """Return the row of the counts that a case belongs to."""
    if effect in ("none", "undeclared"):
        return effect
    return "pair" if "+" in effect else size


def wanted(effect: str) -> list[str]:
    """Return the names of the one or two effects of a label, as a diagnosis tells them."""
    return [SAME.get(name, name) for name in effect.split("+")]


def right(effect: str, found: dict[str, Any]) -> bool:
    """Return True if the diagnosis says what the label says."""
    classes = [set(c["members"]) for c in found["classes"]]
    if effect == "none":
        return bool(found["verdict"] == "no_missing_effect")
    if effect == "undeclared":
        return bool(found["verdict"] == "undeclared_effect")
    names = wanted(effect)
    if len(names) == 2:
        one, other = names
        return len(classes) == 2 and any(one in a and other in b for a, b in (classes, classes[::-1]))
    return bool(classes) and names[0] in classes[0]


def hiding(found: dict[str, Any]) -> bool:
    """Return True if nothing was told as found, and names only as what small effect may hide."""
    return bool(found["verdict"] == "no_missing_effect" and found["classes"])


def wrong_names(effect: str, found: dict[str, Any]) -> int:
    """Return how many classes are told as if they were sure and hold no label."""
    names = set(wanted(effect))
    return sum(c["probability"] > SURE and not names & set(c["members"]) for c in found["classes"])


def true_value(effect: str, label: dict[str, Any]) -> float | None:
    """Return how large an effect is by the label, in the unit of its quantity; None where the label has another."""
    if effect not in QUANTITIES:
        return None
    parts = (label.get(part, {}) for part in ("cell", "sensors", "flight", "values"))
    stated = (v for part in parts for name, v in part.items() if name.startswith(QUANTITIES[effect]))
    value: float | None = next(stated, None)
    if value is None:
        return None
    return {"capacity_fade": 1.0 - value, "initial_charge": value - 1.0}.get(effect, value)


def values_inside(label: dict[str, Any], found: dict[str, Any]) -> list[bool]:
    """Return for each effect that is first in its class: True if the label's value is in its 95 % interval."""
    inside = []
    for c in found["classes"]:
        name, told = c["members"][0], next(iter(c["parameters"].values()))
        true = true_value(name, label) if name in wanted(label["effect"]) else None
        if true is not None:
            inside.append(bool(told["lo"] <= true <= told["hi"]))
    return inside


def words(found: dict[str, Any]) -> str:
    """Return the classes in one cell of a table."""
    told = []
    for c in found["classes"]:
        name, value = next(iter(c["parameters"].items()))
        interval = f"{name} {value['value']:.3g} [{value['lo']:.3g}, {value['hi']:.3g}]"
        told.append(f"{' or '.join(f'`{m}`' for m in c['members'])}: {interval}, p {c['probability']:.2f}")
    return f"{found['verdict']}" + (": " if told else "") + " + ".join(told)


def main() -> int:
    """Print the table and the counts."""
    told, good, seen, wrong = labels(), Counter[str](), Counter[str](), 0
    print("| case | label | | diagnosis | voltage, held out [mV] | remaining time [s] |\n|---|---|---|---|---|---|")
    for path in sorted(Path(sys.argv[1]).glob("[bpk][0-9]*.json")):
        found = json.loads(path.read_text())
        effect, size = told[path.stem]
        seen[kind(effect, size)] += 1
        good[kind(effect, size)] += right(effect, found)
        wrong += wrong_names(effect, found)
        b, a = found["before"], found["after"]
        errors = f"{1000 * b['voltage_rmse_V']:.0f} → {1000 * a['voltage_rmse_V']:.0f}"
        times = " → ".join("–" if e["remaining_mae_s"] is None else f"{e['remaining_mae_s']:.0f}" for e in (b, a))
        mark = "✓" if right(effect, found) else "✗"
        print(f"| {path.stem} | {effect} {size} | {mark} | {words(found)} | {errors} | {times} |")
    print("\n" + ", ".join(f"{k}: {good[k]} of {n}" for k, n in seen.items()) + f"; wrong names above {SURE}: {wrong}.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
