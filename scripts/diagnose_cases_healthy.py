#!/usr/bin/env python3
"""Healthy sets: how often diagnosis raises an alarm where nothing is wrong.

Run: .venv/bin/python scripts/diagnose_cases_healthy.py BATTERY.battery.toml FOLDER
         [--sets 50] [--follow] [--no-temperature]
FOLDER holds healthy flights of the pack (`scripts/porous_cases.py` writes them to healthy/), each used in several sets.
Sets of 3, 4 and 8 flights in turn, drawn without putting back; --follow takes each set as flights in order of time;
--no-temperature leaves the thermometer out.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from diagnose_cases_pack import ready, records

from uavbatt.diagnosis.diagnosis import diagnose
from uavbatt.diagnosis.follow import Follow, follow

SIZES = (3, 4, 8)


def main() -> int:
    """Print each alarm, and how many there were."""
    parser = argparse.ArgumentParser()
    parser.add_argument("battery", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sets", type=int, default=50)
    parser.add_argument("--follow", action="store_true")
    parser.add_argument("--no-temperature", action="store_true")
    given = parser.parse_args()
    file, pack, engine = ready(given.battery)
    sound = records(sorted(given.folder.glob("*.csv")))
    if given.no_temperature:
        sound = [replace(record, temp_C=np.full_like(record.temp_C, np.nan)) for record in sound]
    random, alarms, seen = np.random.default_rng(16), Counter[int](), Counter[int]()
    for number in range(given.sets):
        size = SIZES[number % len(SIZES)]
        drawn = [sound[i] for i in random.choice(len(sound), size, replace=False)]
        found = (follow if given.follow else diagnose)(drawn, file, pack, engine=engine)
        seen[size] += 1
        if found.verdict != "no_missing_effect":
            alarms[size] += 1
            told = [e.found for e in found.effects] if isinstance(found, Follow) else found.classes
            words = " + ".join(f"{'/'.join(c.members)} {c.probability:.2f}" for c in told) or "–"
            print(f"set {number} of {size}: {found.verdict}: {words}", flush=True)
    counts = ", ".join(f"{alarms[n]} of {seen[n]} sets of {n}" for n in SIZES)
    print(f"alarms: {sum(alarms.values())} of {given.sets}: {counts}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
