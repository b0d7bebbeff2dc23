#!/usr/bin/env python3
"""Time of a diagnosis of four flights, with and without compiled code, and its parts.

Run: .venv/bin/python scripts/diagnose_speed.py BATTERY.battery.toml [FOLDER] [--profile]
FOLDER holds four flights (default: truth/practice/p3 of the shared data). The battery file is what
`scripts/diagnose_cases` writes. The first compiled run pays for loading what was compiled before; the second does not.
--profile prints the functions that take most of the second one.
"""

from __future__ import annotations

import argparse
import cProfile
import pstats
import sys
import time
from pathlib import Path

from diagnose_cases_pack import flights, ready
from scoring import data

from uavbatt.diagnosis.diagnosis import diagnose
from uavbatt.engine import PLAIN
from uavbatt.log_replay.run import engine_for

TRUTH = data.place() / "truth"


def main() -> int:
    """Print wall and processor time of each run."""
    parser = argparse.ArgumentParser()
    parser.add_argument("battery", type=Path)
    parser.add_argument("folder", type=Path, nargs="?", default=TRUTH / "practice" / "p3")
    parser.add_argument("--profile", action="store_true")
    given = parser.parse_args()
    file, pack, _ = ready(given.battery)
    records = flights(given.folder)
    print(f"{len(records)} flights of {given.folder.name}\n\n| engine | wall [s] | processor [s] |\n|---|---|---|")
    runs = (
        ("plain numpy", PLAIN),
        ("compiled, first", engine_for(is_long=True)),
        ("compiled", engine_for(is_long=True)),
    )
    for name, engine in runs:
        began_s, worked_s = time.perf_counter(), time.process_time()
        diagnose(records, file, pack, engine=engine)
        print(f"| {name} | {time.perf_counter() - began_s:.1f} | {time.process_time() - worked_s:.1f} |", flush=True)
    if given.profile:
        profile = cProfile.Profile()
        profile.runcall(diagnose, records, file, pack, engine=engine_for(is_long=True))
        pstats.Stats(profile).sort_stats("tottime").print_stats(14)
    return 0


if __name__ == "__main__":
    sys.exit(main())
