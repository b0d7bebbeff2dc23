#!/usr/bin/env python3
"""The shared missions with a power that changes in flight: a payload taken up or set down, ice that grows.

    python scripts/changing_power.py

The change is put into current and voltage of each flight, as more (or less) power than it really needed. The truth is
the forecast of the same flight with its own later power. Battery and vehicle are those of `score.py --only routes`.
Prints a table of the errors, from five minutes after the change began to its end (three minutes on two cores).
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
from collections.abc import Callable
from dataclasses import replace
from multiprocessing import Pool
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scoring.data import folder
from scoring.lines import logged, ours
from scoring.routes import Known, known_of_missions, run_of

from uavbatt.records import Flight, Sample
from uavbatt.telemetry import read_log

BEGINS_S, KNOWN_AFTER_S, SHORTEST_S = 300.0, 300.0, 900.0
PACK_OHM = 0.048
GROWS_S, CARRIED_S = 900.0, 300.0
# The power against that of the flight as it was, by the time since the change begins [s].
CHANGES: dict[str, Callable[[float], float]] = {
    "none": lambda since_s: 1.0,
    "a payload is taken up: 35 % more": lambda since_s: 1.35,
    "a payload is taken up: 15 % more": lambda since_s: 1.15,
    "a payload is carried for five minutes: 35 % more": lambda since_s: 1.35 if since_s < CARRIED_S else 1.0,
    "a payload is set down: 25 % less": lambda since_s: 0.75,
    "ice: up to 50 % more within a quarter of an hour": lambda since_s: 1.0 + 0.5 * min(since_s / GROWS_S, 1.0),
    "ice: up to 20 % more within a quarter of an hour": lambda since_s: 1.0 + 0.2 * min(since_s / GROWS_S, 1.0),
}
WAYS = ("route known", "no route")


def changed(flight: Flight, change: Callable[[float], float]) -> Flight:
    """Return the flight with a changed power: other currents, and the drop of the voltage that they make."""
    begin_s = flight.samples[0].time_s + BEGINS_S

    def row(sample: Sample) -> Sample:
        more_A = (change(sample.time_s - begin_s) - 1.0) * sample.current_A if sample.time_s >= begin_s else 0.0
        return replace(sample, current_A=sample.current_A + more_A, voltage_V=sample.voltage_V - PACK_OHM * more_A)

    return replace(flight, samples=tuple(row(sample) for sample in flight.samples))


def errors(path: Path, known: Known, change: str, way: str) -> NDArray[np.float64]:
    """Return the errors of median and 5 % point [s] in each line of a flight, [2, lines]."""
    flight = changed(read_log(path), CHANGES[change])
    flown = flight if way == WAYS[0] else replace(flight, navigation=())
    said, true = ours(run_of(flown, known, known.library)), ours(run_of(flown, known, logged(flight)))
    assert said.lo_s is not None
    counts = said.time_s - flight.samples[0].time_s >= BEGINS_S + KNOWN_AFTER_S
    return np.stack([said.remaining_s - true.remaining_s, said.lo_s - true.remaining_s])[:, counts]


def main() -> None:
    """Fly all long missions with all changes, with and without their route, and print the table."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    data = folder()
    paths = sorted((data / "missions/practice").glob("*.tlog"))
    paths = [path for path in paths if read_log(path).duration_s > SHORTEST_S]
    known = known_of_missions(data)
    calls = [(path, known, change, way) for change in CHANGES for way in WAYS for path in paths]
    with Pool() as pool:
        found = pool.starmap(errors, calls, chunksize=1)
    print(f"{len(paths)} missions of {SHORTEST_S / 60.0:.0f} minutes and more")
    print("| change | way | median off (bias) [s] | 5 % point too long: share of the time | at most [s] |")
    print("|---|---|---:|---:|---:|")
    for change in CHANGES:
        for way in WAYS:
            median_s, lo_s = np.concatenate([e for c, e in zip(calls, found, strict=True) if c[2:] == (change, way)], 1)
            off, bias, late = np.nanmean(abs(median_s)), np.nanmean(median_s), np.mean(lo_s > 0.0)
            print(f"| {change} | {way} | {off:.0f} ({bias:+.0f}) | {late:.0%} | {max(np.nanmax(lo_s), 0.0):.0f} |")


if __name__ == "__main__":
    main()
