"""Size and speed of a pack ledger: opening it, one look-up, and the list of all packs.

    python scripts/bench_packs.py [--packs 10000] [--flights 300]

Writes the flights of one pack many times over, as rows, so that it measures the ledger and not the slow filter.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from uavbatt.packs import ageing, rows
from uavbatt.packs.ledger import Ledger, inserted
from uavbatt.packs.outlook import outlook
from uavbatt.packs.records import FlightEvidence, FlightRecord, PackRow

OHM, RATED_AH, FIRST_UTC_S, DAY_S = 0.013, 5.0, 1.79e9, 86_400.0


def main(arguments: list[str] | None = None) -> int:
    """Build the ledger, time it, print the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--packs", type=int, default=10_000)
    parser.add_argument("--flights", type=int, default=300)
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "packs.sqlite"
        _build(path, given.packs, given.flights)
        size = path.stat().st_size
        print(f"{given.packs} packs of {given.flights} flights: {size / 1e6:.0f} MB, "
              f"{size / (given.packs * given.flights):.0f} bytes a flight")  # fmt: skip
        _time(path, _name(given.packs // 2))
    return 0


def _build(path: Path, packs: int, flights: int) -> None:
    every = ageing.history([_flight(number) for number in range(flights)])
    values = [{**rows.flight_row(after.flight), **rows.remembered_row(after)} for after in every]
    seen = outlook(every[-1].known, RATED_AH, flights, "a-make")
    with Ledger(path) as ledger, ledger.writing() as connection:
        for number in range(packs):
            pack = PackRow(_name(number), 4, RATED_AH, OHM, every[-1].flight.start_utc_s, seen, ())
            key = connection.execute(*inserted("packs", rows.pack_row(pack))).lastrowid
            statement, _ = inserted("flights", {**values[0], "pack": key})
            connection.executemany(statement, [{**row, "pack": key} for row in values])


def _time(path: Path, name: str) -> None:
    began = time.perf_counter()
    with Ledger(path) as ledger:
        opened = time.perf_counter()
        ledger.last(name)
        looked_up = time.perf_counter()
        count = len(ledger.packs())
        listed = time.perf_counter()
    print(f"opening {1e3 * (opened - began):.1f} ms, one look-up {1e3 * (looked_up - opened):.1f} ms, "
          f"{count} packs read in {listed - looked_up:.2f} s")  # fmt: skip


def _flight(number: int) -> FlightRecord:
    wiggle = 0.02 * float(np.sin(number))
    told = FlightEvidence(math.log(OHM) + wiggle, math.log(RATED_AH) - wiggle, 0.04**2, 0.04**2, 0.0)
    return FlightRecord(
        key=f"{number:016x}", told=told, cells=4, rated_Ah=RATED_AH, type_ohm=OHM, battery="bench",
        battery_sha256="0" * 64, start_utc_s=FIRST_UTC_S + DAY_S * number, duration_s=900.0, source=f"{number:08d}.BIN",
        soc_start=1.0, soc_end=0.3, charge_Ah=3.5, energy_Wh=52.0, temp_mean_C=25.0, temp_max_C=31.0,
    )  # fmt: skip


def _name(number: int) -> str:
    return f"pack-{number:05d}"


if __name__ == "__main__":
    sys.exit(main())
