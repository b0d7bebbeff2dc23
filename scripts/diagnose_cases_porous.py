#!/usr/bin/env python3
"""The quick table of labelled cases in any folder: verdicts and values only.

Run: .venv/bin/python scripts/diagnose_cases_porous.py BATTERY.battery.toml FOLDER... [--only odd|even|NAME,NAME]
FOLDER holds CASE/flight_K.csv or .tlog and labels.json: what `scripts/porous_cases.py` wrote, or `truth/cases` of the
shared data. For each case: label, right or not, the classes, seconds; then how many were right by kind, and how many of
these were not told as found but as what may hide, and how often the 95 % interval of a named effect holds its value.
"""

from __future__ import annotations

import json
import sys
import time
from collections import Counter
from dataclasses import asdict

from diagnose_cases_pack import arguments, flights, ready
from diagnose_cases_table import SURE, hiding, kind, right, values_inside, words, wrong_names

from uavbatt.diagnosis.diagnosis import diagnose


def chosen(names: list[str], only: str) -> list[str]:
    """Return the names of cases that were asked for, numbered ones by odd and even."""
    if only in ("odd", "even"):
        return [n for n in names if int("".join(c for c in n if c.isdigit())) % 2 == (only == "odd")]
    return [n for n in names if not only or n in only.split(",")]


def main() -> int:
    """Print the table and the counts."""
    parser = arguments()
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    file, pack, engine = ready(given.battery)
    seen, good, hides, wrong, inside = Counter[str](), Counter[str](), Counter[str](), 0, list[bool]()
    print("| case | label | | diagnosis | s |\n|---|---|---|---|---|")
    for folder in given.folders:
        labels = json.loads((folder / "labels.json").read_text())
        for name in chosen([n for n in labels if (folder / n).resolve().is_dir()], given.only):
            effect, size = labels[name]["effect"], labels[name].get("size", "clear")
            records = flights(folder / name)
            began_s = time.process_time()
            found = diagnose(records, file, pack, engine=engine)
            told = {"verdict": found.verdict, "classes": [asdict(c) for c in found.classes]}
            took_s = time.process_time() - began_s
            seen[kind(effect, size)] += 1
            good[kind(effect, size)] += right(effect, told)
            hides[kind(effect, size)] += right(effect, told) and hiding(told)
            wrong += wrong_names(effect, told)
            held = values_inside(labels[name], told)
            inside += held
            mark = ("✓" if right(effect, told) else "✗") + ("" if all(held) else " ↔")  # ↔: a value outside
            alarm = " !" if wrong_names(effect, told) else ""
            print(
                f"| {name.rpartition('/')[2]} | {effect} {size} | {mark}{alarm} | {words(told)} | {took_s:.1f} |",
                flush=True,
            )
    counts = (f"{k}: {good[k]} of {n}" + (f" ({hides[k]} may hide)" if hides[k] else "") for k, n in seen.items())
    print("\n" + ", ".join(counts) + f"; wrong names above {SURE}: {wrong}.")
    print(f"Values inside their 95 % intervals: {sum(inside)} of {len(inside)}.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
