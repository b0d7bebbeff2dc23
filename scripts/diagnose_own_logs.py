#!/usr/bin/env python3
"""Crews that diagnose healthy flights with a battery file of their own logs: how often it raises an alarm.

Run: .venv/bin/python scripts/diagnose_own_logs.py [--sets 20] [--only KIND]
Packs of makes that are not ours, each as good as new. The logs of a set, of the fit and of the diagnosis alike, end
with the flight, or go on with a rest on the ground or a short hop; or the voltage freezes in flight.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from scoring.other_pack import IDLE_W, MAKES, ORDINARY, Make, Pack, Power, Sensors, drawn, flight, read

from uavbatt.battery.sizing.pack_size import PackOptions, pack_from
from uavbatt.diagnosis.diagnosis import Diagnosis, diagnose
from uavbatt.errors import NotEnoughData
from uavbatt.fitting.battery import RecordedPack, fit_battery
from uavbatt.fitting.failed_sensors import without_failed
from uavbatt.fitting.observed import from_flight
from uavbatt.log_replay.run import engine_for
from uavbatt.records import Flight, Sample
from uavbatt.telemetry.cleaning.readings import MAX_CELL_C

CELLS, CUTOFF_V, NOMINAL_V = 4, 13.2, 14.8
SIZES_AH, C_RATES, AIR_C, FLOWN = (1.3, 2.2, 5.0, 10.0, 16.0), (1.5, 6.0), (5.0, 32.0), (1.0, 0.7, 0.5)
FITTED, LEAST_DIAGNOSED, MOST_DIAGNOSED = 4, 2, 4

Dice = np.random.Generator
After = Callable[[Pack, list[Sample], float, Dice], list[Sample]]


def _nothing(pack: Pack, rows: list[Sample], watts: float, dice: Dice) -> list[Sample]:
    return rows


def _rest(pack: Pack, rows: list[Sample], watts: float, dice: Dice) -> list[Sample]:
    """Add one to ten minutes on the ground, the electronics on."""
    return [*rows, *_drawn(pack, rows, [IDLE_W] * int(dice.integers(60, 600)), armed=False)]


def _hop(pack: Pack, rows: list[Sample], watts: float, dice: Dice) -> list[Sample]:
    """Add half a minute on the ground, a hop of as long, and a minute on the ground."""
    for powers_W, armed in (([IDLE_W] * 30, False), ([0.9 * watts] * 30, True), ([IDLE_W] * 60, False)):
        rows = [*rows, *_drawn(pack, rows, powers_W, armed=armed)]
    return rows


FROZEN = "frozen"
KINDS: dict[str, After] = {"flight alone": _nothing, "rest": _rest, "hop": _hop, FROZEN: _nothing}


def _frozen(rows: list[Sample], dice: Dice) -> list[Sample]:
    """Let the voltage freeze for 10 to 40 s in the second quarter of the flight."""
    first, count = int(dice.integers(len(rows) // 4, len(rows) // 2)), int(dice.integers(10, 40))
    return [
        replace(row, voltage_V=rows[first].voltage_V) if first <= k < first + count else row
        for k, row in enumerate(rows)
    ]


def _drawn(pack: Pack, rows: list[Sample], powers_W: list[float], *, armed: bool) -> list[Sample]:
    last = rows[-1]
    return list(drawn(pack, powers_W, last.time_s + 1.0, last.consumed_Ah, armed=armed, cutoff_V=0.0).rows)


def _log(name: str, make: Make, size_Ah: float, watts: float, kind: str, dice: Dice) -> Flight:
    """Return a healthy flight of a pack of this make, in some weather, as a log of this kind."""
    pack = Pack(size_Ah, size_Ah=size_Ah, make=make, air_C=float(dice.uniform(*AIR_C)))
    power, share = Power(watts * float(dice.uniform(0.85, 1.15))), float(dice.choice(FLOWN))
    seconds = int((2.0 if share == 1.0 else share) * 3600.0 * size_Ah * NOMINAL_V / watts)
    seed = int(dice.integers(1_000_000))
    rows = KINDS[kind](pack, list(flight(pack, power, Sensors(), seed=seed, seconds=seconds).rows), watts, dice)
    seen = read(rows, replace(ORDINARY, voltage_sd_V=0.012, current_sd_A=0.02 * watts / NOMINAL_V), seed)
    return Flight(name, "csv", tuple(_frozen(seen, dice) if kind == FROZEN else seen))


def diagnosed(kind: str, number: int) -> Diagnosis:
    """Fit some logs of a make, and diagnose others. Raises NotEnoughData if they show nothing.

    kind : of KINDS; number : of the set
    """
    dice = np.random.default_rng([number, *kind.encode()])
    make, size_Ah = MAKES[int(dice.integers(len(MAKES)))], float(dice.choice(SIZES_AH))
    watts = size_Ah * NOMINAL_V * float(dice.uniform(*C_RATES))
    count = FITTED + int(dice.integers(LEAST_DIAGNOSED, MOST_DIAGNOSED + 1))
    logs = [_log(f"log {k}", make, size_Ah, watts, kind, dice) for k in range(count)]
    sound = [without_failed(log, CELLS, size_Ah)[0] for log in logs]
    file = fit_battery(RecordedPack("own", CELLS, size_Ah, CUTOFF_V), [], sound[:FITTED]).file
    records = [from_flight(log, CELLS, size_Ah, hottest_start_C=MAX_CELL_C) for log in sound[FITTED:]]
    pack = pack_from(file, PackOptions(CELLS, size_Ah, CUTOFF_V))
    return diagnose(records, file, pack, engine=engine_for(is_long=True))


def main() -> int:
    """Print each alarm, and how many there were of each kind of logs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=20)
    parser.add_argument("--only", choices=tuple(KINDS))
    given = parser.parse_args()
    for kind in [given.only] if given.only else KINDS:
        verdicts = Counter[str]()
        for number in range(given.sets):
            try:
                found = diagnosed(kind, number)
            except NotEnoughData:
                verdicts["not enough data"] += 1
                continue
            verdicts[found.verdict] += 1
            if found.verdict != "no_missing_effect":
                words = " + ".join(f"{'/'.join(c.members)} {c.probability:.2f}" for c in found.classes) or "–"
                print(f"{kind}, set {number}: {found.verdict}: {words}", flush=True)
        print(f"{kind}: {', '.join(f'{n} {verdict}' for verdict, n in verdicts.items())}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
