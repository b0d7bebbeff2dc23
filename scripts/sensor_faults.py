#!/usr/bin/env python3
"""Flights with a fault of a sensor or of the link, drawn in size and moment: how long is the 5 % point too long?

    python scripts/sensor_faults.py [--each 12]

The packs are those of `wrong_packs.py` with a true current, generic and fitted by turns (three minutes on two cores).
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
from dataclasses import dataclass
from itertools import product
from multiprocessing import Pool

import numpy as np
from scoring import wrong_cases
from scoring.lines import ours
from scoring.sensor_faults import FAULTS, with_fault
from scoring.wrong_judged import estimator, late_excess_s, worst_s

from uavbatt.estimation import sensor_faults
from uavbatt.log_replay.run import steps
from uavbatt.notice import Notice, kind_of
from uavbatt.records import Flight

CASES = [c for c in wrong_cases.sampled(6) if "reads" not in c.capacity_class]
TOO_LONG_S = 15.0
SENSOR_KINDS = {notice.kind for notice in vars(sensor_faults).values() if isinstance(notice, Notice)}


@dataclass(frozen=True, slots=True)
class Told:
    """Told holds what was said of a flight: the worst excess of the 5 % point in the last two minutes [s], NaN without
    a number; the share of those rows without a number; whether a warning named a sensor."""

    excess_s: float
    silent: float
    is_named: bool


def told(name: str, number: int) -> Told:
    """Return what was said of flight `number` with a fault."""
    case = CASES[(5 * number) % len(CASES)]
    flown = case.flown()
    rows, begins_s = with_fault(flown.rows, FAULTS[name], seed=number)
    run = list(steps(Flight(case.name, "csv", rows), estimator(case)))
    excess_s = late_excess_s(ours(run), flown.end_s)
    words = [w for row in run if row.estimate.time_s >= begins_s for w in row.estimate.warnings]
    return Told(
        excess_s=worst_s(excess_s),
        silent=float(np.mean(~np.isfinite(excess_s))) if excess_s.size else 1.0,
        is_named=any(kind_of(word) in SENSOR_KINDS for word in words),
    )


def line(name: str, found: list[Told]) -> str:
    """Return one row of the table."""
    excess_s = np.array([one.excess_s for one in found])
    known = excess_s[np.isfinite(excess_s)]
    worst = f"{max(known.max(), 0.0):.0f}" if known.size else "–"
    cells = (
        f"{len(found)}",
        worst,
        f"{(known > TOO_LONG_S).sum()}",
        f"{np.mean([one.silent for one in found]):.0%}",
        f"{sum(one.is_named for one in found)}",
    )
    return f"| {name} | {' | '.join(cells)} |"


def main() -> None:
    """Fly all flights with all faults and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--each", type=int, default=12, help="flights of each fault")
    each = parser.parse_args().each
    calls = list(product(FAULTS, range(each)))
    with Pool() as pool:
        answers = pool.starmap(told, calls, chunksize=1)
    print("| fault | flights | 5 % point too long by at most | by over 15 s | without a number | sensor named |")
    print("|---|---:|---:|---:|---:|---:|")
    for name in FAULTS:
        print(line(name, [one for (of, _), one in zip(calls, answers, strict=True) if of == name]))


if __name__ == "__main__":
    main()
