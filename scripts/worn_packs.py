#!/usr/bin/env python3
"""Worn packs that the ledger's figures were not made with: forecasts of single flights, nothing remembered.

Run: PYTHON scripts/worn_packs.py make FOLDER            (a Python of its own with `pip install pybamm`; 3 s a flight)
     .venv/bin/python scripts/worn_packs.py score FOLDER BATTERY
Twenty-six packs of the porous-electrode simulator (`porous_pack.py`), three flights each: less charge, slow
electrodes, ohms in the contacts, not always charged to full. BATTERY is fitted from truth/lab and truth/reference
(`uavbatt fit`). The load of the flight itself is known to the forecast, so that the battery alone is scored.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from porous_pack import CAPACITY_AH, CELLS, Cell, Sensors, flown, readings, write

CUTOFF_V, FLYING_A = 13.2, 3.0
FLIGHTS = 3
# Of each pack the cell, and ohms of the contacts.
PACKS = (
    (Cell(), 0.0),
    (Cell(capacity=0.93, exchange=0.8, start_soc=0.97), 0.0),
    (Cell(capacity=0.88, exchange=0.65), 0.0),
    (Cell(capacity=0.8, exchange=0.55, start_soc=0.95), 0.0),
    (Cell(capacity=0.9), 0.02),
    (Cell(capacity=0.85, exchange=0.8, start_soc=0.97), 0.015),
    (Cell(capacity=0.95, exchange=0.6), 0.0),
    (Cell(capacity=0.85), 0.0),
)
FIFTH, SEVENTH = (Cell(capacity=0.78, exchange=0.7), 0.01), (Cell(capacity=0.9, exchange=0.5, diffusivity=0.8), 0.005)
# Drawn by chance once the filter had its ninth component, and looked at once.
DRAWN = (
    (Cell(capacity=0.751, exchange=0.788, start_soc=0.96), 0.0108),
    (Cell(capacity=0.773, exchange=0.781, start_soc=0.96), 0.0107),
    (Cell(capacity=0.807, exchange=0.922, start_soc=0.96), 0.0),
    (Cell(capacity=0.984, exchange=0.551, start_soc=0.96), 0.0),
    (Cell(capacity=0.942, exchange=0.971), 0.0),
    (Cell(capacity=0.86, exchange=0.473), 0.0125),
    (Cell(capacity=0.85, exchange=0.641), 0.0177),
    (Cell(capacity=0.808, exchange=0.529, start_soc=0.96), 0.0),
    (Cell(capacity=0.976, exchange=0.75), 0.0),
    (Cell(capacity=0.931, exchange=0.709), 0.0),
)
# Three series, each with the seeds of its flights and of its noise; the second has two other packs among them.
SERIES = (
    (7_700_000, 7000, PACKS),
    (8_800_000, 9000, (*PACKS[:4], FIFTH, PACKS[5], SEVENTH, PACKS[7])),
    (9_900_000, 9500, DRAWN),
)
INSTANTS = ("25%", "50%", "120 s", "60 s")


def make(folder: Path) -> None:
    """Fly the packs and write FOLDER/WNN/flight_K.csv; W01 to W16, then W21 to W30, which were drawn last."""
    for series, (seed, noise_seed, packs) in enumerate(SERIES):
        for number, (cell, contacts_ohm) in enumerate(packs):
            name = f"W{len(packs) * series + number + 1:02d}"
            for k in range(1, FLIGHTS + 1):
                true = flown(folder / "flown", cell, seed + 100 * number + k)
                noise = np.random.default_rng(noise_seed + 10 * number + k)
                write(folder / name / f"flight_{k}.csv", readings(true, Sensors(harness_ohm=contacts_ohm), noise))
            print(name, flush=True)


def score(folder: Path, battery: Path) -> None:
    """Print the errors of every flight [s], positive is too long; `!` where the interval misses the truth."""
    from scoring.lines import logged, ours, replayed

    from uavbatt.battery.battery_file import read_battery
    from uavbatt.battery.sizing.pack_size import PackOptions
    from uavbatt.prediction.forecaster import ForecastSettings
    from uavbatt.scoring.end_of_flight import end_of_flight
    from uavbatt.telemetry import read_log

    file, options = read_battery(battery), PackOptions(cells=CELLS, capacity_Ah=CAPACITY_AH, cutoff_V=CUTOFF_V)
    found: list[list[tuple[float, bool | None]]] = []
    for path in sorted(folder.glob("W*/flight_*.csv")):
        flight = read_log(path)
        time_s, volts, amps = np.array([(s.time_s, s.voltage_V, s.current_A) for s in flight.samples]).T
        end_s = end_of_flight(time_s, volts, cutoff_V=CUTOFF_V)
        if not np.isfinite(end_s):
            continue
        run = replayed(flight, file, options, ForecastSettings(logged(flight), forecast_period_s=10.0))
        at = ours(run).scored("", "", float(time_s[np.argmax(amps > FLYING_A)]), end_s).at
        found.append([(at[instant].error_s, at[instant].inside) for instant in INSTANTS])
        shown = "  ".join(f"{error_s:+5.0f}{' ' if inside else '!'}" for error_s, inside in found[-1])
        print(f"{path.parent.name} {path.stem}  {shown}", flush=True)
    for k, instant in enumerate(INSTANTS):
        errors_s, held = np.array([row[k][0] for row in found]), sum(row[k][1] is True for row in found)
        figures = f"{np.abs(errors_s).mean():.0f} s off, bias {errors_s.mean():+.0f} s, {held} of {len(found)} inside"
        print(f"{instant}: {figures}")


if __name__ == "__main__":
    if len(sys.argv) == 3 and sys.argv[1] == "make":
        make(Path(sys.argv[2]))
    elif len(sys.argv) == 4 and sys.argv[1] == "score":
        score(Path(sys.argv[2]), Path(sys.argv[3]))
    else:
        sys.exit(__doc__)
