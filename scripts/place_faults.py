#!/usr/bin/env python3
"""The shared missions with faults of place, velocity, wind, home or progress: what becomes of the turn-back?

    python scripts/place_faults.py

Battery and vehicle are those of `score.py --only routes` (five minutes on two cores).
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import tempfile
from multiprocessing import Pool
from pathlib import Path

from scoring.data import folder
from scoring.place_faults import FAULTS, write_with_fault
from scoring.routes import (
    BEFORE_TURN_S,
    Known,
    TurnBackErrors,
    answer_of,
    known_of_missions,
    run_of,
    turn_back_errors,
    turn_back_means,
)

from uavbatt.telemetry import read_log


def said(data: Path, known: Known, fault: str, name: str) -> TurnBackErrors:
    """Return the errors of the turn-back of one mission with a fault."""
    with tempfile.TemporaryDirectory() as made:
        path = Path(made) / f"{name}.tlog"
        write_with_fault(data / "missions/practice" / path.name, path, FAULTS[fault]())
        flight = read_log(path)
    run = run_of(flight, known, known.library)
    return turn_back_errors(answer_of(data, name)["turn_back_s"], run)


def line(fault: str, found: list[TurnBackErrors]) -> str:
    """Return one row of the table."""
    alarms_s = [one.alarm_s for one in found]
    return f"| {fault} | {' | '.join(turn_back_means(found)[:-1])} | {min(alarms_s):+.0f} | {max(alarms_s):+.0f} |"


def main() -> None:
    """Fly all missions that have a turn-back with all faults, and print the table."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    data = folder()
    names = [path.stem for path in sorted((data / "missions/practice").glob("*.tlog"))]
    names = [name for name in names if answer_of(data, name)["turn_back_s"] is not None]
    known = known_of_missions(data)
    calls = [(data, known, fault, name) for fault in FAULTS for name in names]
    with Pool() as pool:
        answers = pool.starmap(said, calls, chunksize=1)
    print(f"| fault | {' | '.join(f'{s:.0f} s before' for s in BEFORE_TURN_S)} | earliest alarm | latest alarm |")
    print("|---|---:|---:|---:|---:|---:|")
    for fault in FAULTS:
        print(line(fault, [one for (*_, of, _), one in zip(calls, answers, strict=True) if of == fault]))


if __name__ == "__main__":
    main()
