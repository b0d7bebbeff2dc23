#!/usr/bin/env python3
"""Lithium-ion packs of which only cells, capacity and cut-off are stated, read with each of the two generic files.

    python scripts/lithium_ion.py [--each 20]

Packs of 70 to 103 % of the stated 5 Ah, charged to 85 % and more, flown at 70 to 220 W (90 s on two cores).
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
from itertools import product
from multiprocessing import Pool

import numpy as np
from scoring.lithium_ion import MAKES, case
from scoring.wrong_judged import Judged, judged
from scoring.wrong_tables import alarm_words

from uavbatt.battery.battery_file import GENERIC, GENERIC_LITHIUM_ION

FILES = (GENERIC, GENERIC_LITHIUM_ION)


def line(battery: str, make: str, found: list[Judged]) -> str:
    """Return one row of the table."""
    half = np.nanmean([abs(j.half.error_s) / j.flown_s for j in found])
    late_s = np.nanmean([abs(j.before[120.0].error_s) for j in found])
    excess_s = max(np.nanmax([j.lo_excess_s for j in found]), 0.0)
    alarm = alarm_words(found)
    inside, refused = np.mean([j.covered for j in found]), np.mean([j.refused for j in found])
    cells = (battery, make, f"{half:.0%}", f"{late_s:.0f}", f"{excess_s:.0f}", alarm, f"{inside:.0%}", f"{refused:.0%}")
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Fly all packs with both files and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--each", type=int, default=20, help="flights of each make")
    cases = [case(*call) for call in product(FILES, range(len(MAKES) * parser.parse_args().each))]
    with Pool() as pool:
        answers = pool.map(judged, cases, chunksize=1)
    print(
        "| battery file | make | off at half time | off at 120 s [s] | 5 % point too long by at most [s] "
        "| alarm with [s] left | inside | no number |"
    )
    print("|---|---|---:|---:|---:|---:|---:|---:|")
    for battery, make in product(FILES, MAKES):
        print(line(battery, make.name, [j for j in answers if (j.case.battery, j.case.make) == (battery, make)]))


if __name__ == "__main__":
    main()
