#!/usr/bin/env python3
"""The deciding constants of the diagnosis, compared with records in which nothing is wrong: what chance gives.

Run: .venv/bin/python scripts/diagnose_cases_chance.py BATTERY.battery.toml
Effect-free are r0, p1, b3, k01 and k02, and the flights of cases whose sensor is known to be wrong and by how much: the
reading is put right. Printed: chi-square per number (noise that is sized right gives 0.9 to 1.1), the most that any
candidate is worth (EARNED stands above it), and what is left once the file's errors are at their most probable (LEFT).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from diagnose_cases_pack import flights, ready
from scoring import data

from uavbatt.diagnosis.diagnosis import problem_of
from uavbatt.diagnosis.refit.candidates import NOTHING, candidates
from uavbatt.diagnosis.refit.evidence import IDLE_NOISE_A, idle_A
from uavbatt.diagnosis.refit.misfit import LEFT, left_per_number, per_number
from uavbatt.diagnosis.refit.solver import SETTLED, refit
from uavbatt.diagnosis.search.trial import EARNED, FIRST_TURNS, trial
from uavbatt.fitting.observed import ObservedRecord

TRUTH = data.place() / "truth"
Right = Callable[[ObservedRecord], ObservedRecord]


def gain(size: float) -> Right:
    """Return the correction of a current that was read `size` times too large."""
    return lambda r: replace(r, current_A=r.current_A / size)


def offset(size_A: float) -> Right:
    """Return the correction of a current to which `size_A` [A] was added."""
    return lambda r: replace(r, current_A=r.current_A - size_A)


def load(size_W: float) -> Right:
    """Return the correction of a load of `size_W` [W] that the sensor did not see."""
    return lambda r: replace(r, current_A=r.current_A + size_W / r.voltage_V)


def volts(size: float) -> Right:
    """Return the correction of a voltage that was read `size` times too large."""
    return lambda r: replace(r, voltage_V=r.voltage_V / size)


def leads(size_ohm: float) -> Right:
    """Return the correction for leads of `size_ohm` [ohm] between the pack and the sensor."""
    return lambda r: replace(r, voltage_V=r.voltage_V + size_ohm * r.current_A)


def warmth(size_K: float) -> Right:
    """Return the correction of a temperature to which `size_K` [K] was added."""
    return lambda r: replace(r, temp_C=r.temp_C - size_K)


CASES: tuple[tuple[str, Right], ...] = (
    ("reference/r0", lambda r: r), ("practice/p1", lambda r: r), ("blind/b3", lambda r: r), ("cases/k01", lambda r: r),
    ("cases/k02", lambda r: r), ("practice/p2", gain(1.09)), ("practice/p3", leads(0.012)),
    ("practice/p5", warmth(-11.0)), ("practice/p6", load(22.0)), ("blind/b1", volts(1.015)), ("blind/b4", offset(0.9)),
    ("cases/k03", gain(1.08)), ("cases/k05", offset(1.0)), ("cases/k07", volts(0.993)), ("cases/k09", leads(0.012)),
    ("cases/k11", warmth(-5.0)), ("cases/k19", load(20.0)),
)  # fmt: skip


def main() -> int:
    """Print the table."""
    file, pack, _ = ready(Path(sys.argv[1]))
    print("| flights | chi-square per number, V | temperature | most that any candidate is worth | left |")
    print("|---|---|---|---|---|")
    for name, put_right in CASES:
        records = [put_right(r) for r in flights(TRUTH / name)]
        problem = problem_of(records, file, pack)
        idle = idle_A(problem.evidence) + IDLE_NOISE_A
        options = candidates(file, problem.base, has_temperature=True, idle_A=idle, without=())
        nothing = refit(problem, [NOTHING], iterations=SETTLED)[0]
        tried = trial(problem, nothing, options, FIRST_TURNS)
        most = max(zip(tried.worths, tried.fits, strict=True), key=lambda wf: wf[0].value)
        plain, left = per_number(problem, nothing), left_per_number(problem, nothing)
        told = f"{most[0].value:.1f} {most[1].candidate.name} | {left.voltage:.2f}, {left.temperature:.2f}"
        print(f"| {name} | {plain.voltage:.2f} | {plain.temperature:.2f} | {told} |", flush=True)
    print(f"\nAn effect is named from {EARNED:g} on; the model is doubted from {LEFT:g} on.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
