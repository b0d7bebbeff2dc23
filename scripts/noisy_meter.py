#!/usr/bin/env python3
"""The packs of `wrong_packs.py` through worse voltmeters: coarse steps, and noise from row to row.

    python scripts/noisy_meter.py

Every third flight of the estimator's table with a true current, generic and fitted (two minutes on two cores).
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

from itertools import product
from multiprocessing import Pool

import numpy as np
from scoring import wrong_cases
from scoring.wrong_judged import Judged, judged_through
from scoring.wrong_tables import alarm_words

EACH, EVERY_NTH, SEED = 6, 3, 5
STEPS_V, NOISE_V = (0.1, 0.2, 0.5), (0.0, 0.05, 0.1, 0.3)
BATTERIES = (wrong_cases.GENERIC, wrong_cases.FITTED)
CASES = [c for c in wrong_cases.sampled(EACH) if "reads" not in c.capacity_class][::EVERY_NTH]


def judged(number: int, step_V: float, noise_V: float) -> Judged:
    """Return one flight in figures, whose voltmeter has these steps (0: none) and this noise."""
    dice = np.random.default_rng(SEED)

    def misread(true_V: float) -> float:
        shown_V = true_V + noise_V * float(dice.standard_normal())
        return round(shown_V / step_V) * step_V if step_V else shown_V

    return judged_through(CASES[number], misread)


def line(words: str, found: list[Judged]) -> str:
    """Return one row of the table, over the flights that had a number two minutes before their end."""
    known = [j for j in found if np.isfinite(j.before[120.0].error_s)]
    if not known:
        return f"| {words} | 0 of {len(found)} | – | – | – | – |"
    error_s = np.mean([abs(j.before[120.0].error_s) for j in known])
    excess_s, nees = max(j.lo_excess_s for j in known), np.mean([j.nees for j in known])
    cells = (
        words,
        f"{len(known)} of {len(found)}",
        f"{error_s:.0f}",
        f"{excess_s:.0f}",
        alarm_words(known),
        f"{nees:.2f}",
    )
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Fly all flights through all voltmeters and print the table."""
    meters = [(step_V, 0.0) for step_V in STEPS_V] + [(0.0, noise_V) for noise_V in NOISE_V]
    calls = [(number, *meter) for meter, number in product(meters, range(len(CASES)))]
    with Pool() as pool:
        answers = dict(zip(calls, pool.starmap(judged, calls, chunksize=1), strict=True))
    print(
        "| voltmeter on 4S | with a number | off at 120 s | 5 % point too long by at most | alarm with | NEES of soc |"
    )
    print("|---|---:|---:|---:|---:|---:|")
    for battery, (step_V, noise_V) in product(BATTERIES, meters):
        found = [j for (_, *meter), j in answers.items() if meter == [step_V, noise_V] and j.case.battery == battery]
        words = f"{battery}, steps of {step_V:g} V" if step_V else f"{battery}, noise of {noise_V:g} V"
        print(line(words, found))


if __name__ == "__main__":
    main()
