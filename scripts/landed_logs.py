#!/usr/bin/env python3
"""A crew's logs: flights that land with a fifth to a third of the charge teach battery and vehicle file.

    python scripts/landed_logs.py [LOGS]

Three makes that are not our model, each teaches by six flights (or LOGS, ten at most) with packs of every age, and is
then flown to the cut-off with three other packs: in level flight and with climbs (18 flights), as a sprayer whose tank
empties, and with a load that is set down on the way (9 flights each; two minutes on two cores). Prints the error of the
time left with the flight's own later power, the learned load, and without a vehicle file.
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("OMP_NUM_THREADS", "1")

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from multiprocessing import Pool

import numpy as np
from peers.columns import FloatArray
from scoring.lines import logged, ours, replayed
from scoring.other_pack import CELLS, CUTOFF_V, FULL_AH, IDLE_W, MAKES, ORDINARY, Make, Pack, Power, drawn, flight, read
from scoring.wrong_cases import LANDS_AT, MIXED_AGES

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.fitting.battery import RecordedPack, fit_battery
from uavbatt.fitting.vehicle import fit_vehicle
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.load.library import UnknownAircraft, learned_load
from uavbatt.prediction.load.scenarios import Load
from uavbatt.records import Flight

BEFORE_END_S = (480.0, 360.0, 240.0, 120.0, 60.0)
LEARNED_FROM, LEVEL_W, CLIMB = 6, 280.0, 0.3
LOAD, EMPTY_S, SET_DOWN_S = 0.5, (420.0, 520.0), (250.0, 420.0)  # of the mass without it; when it is gone
LANDING_S, LANDING_SHARE, REST_S = 40, 0.8, 30  # of the power in level flight
FLOWN = ((0.99, 1.0, 24.0), (0.93, 1.2, 18.0), (0.87, 1.5, 27.0))  # capacity / stated, ohms / make's, air [°C]
LOADS = ("log (true load)", "learned", "no vehicle file")
PACK = PackOptions(cells=CELLS, capacity_Ah=FULL_AH, cutoff_V=CUTOFF_V)


@dataclass(frozen=True, slots=True)
class Unloading(Power):
    """Unloading says how the power falls with a load that is sprayed or set down on the way."""

    is_sprayed: bool = False

    def rows_W(self, seed: int) -> Iterator[float]:
        """Yield the power of each second [W], without end: it goes with the mass to the power of 1.5."""
        gone_s = float(np.random.default_rng([seed, 1]).uniform(*(EMPTY_S if self.is_sprayed else SET_DOWN_S)))
        for time_s, watts in enumerate(Power.rows_W(self, seed)):
            left = max(1.0 - time_s / gone_s, 0.0) if self.is_sprayed else float(time_s < gone_s)
            yield watts * (1.0 + LOAD * left) ** 1.5


FLIGHTS: dict[str, tuple[Power, ...]] = {
    "level flight and climbs": (Power(LEVEL_W), Power(LEVEL_W, climb=CLIMB)),
    "a sprayer": (Unloading(LEVEL_W / 1.4, is_sprayed=True),),
    "a load that is set down": (Unloading(LEVEL_W / 1.4),),
}


def landed(pack: Pack, power: Power, land_soc: float, seed: int) -> Flight:
    """Return the log of a flight whose crew lands as the charge falls below `land_soc`."""

    def powers_W() -> Iterator[float]:
        for watts in power.rows_W(seed):
            if pack.soc < land_soc:
                return
            yield watts

    rows = list(drawn(pack, [IDLE_W] * 15, 0.0, armed=False).rows)
    rows += drawn(pack, powers_W(), float(len(rows))).rows
    rows += drawn(pack, [LANDING_SHARE * power.level_W] * LANDING_S, float(len(rows))).rows
    rows += drawn(pack, [IDLE_W] * REST_S, float(len(rows)), armed=False).rows
    shown = tuple(read(rows, ORDINARY, seed))
    return Flight(f"log {seed}", "csv", shown, duration_s=shown[-1].time_s)


def judged(make: Make, power: Power, logs: int) -> FloatArray:
    """Return what was said minus the truth [s]: [packs, loads, instants, 5 % point, median and 95 % point]."""
    past = [
        landed(Pack(FULL_AH * share, 1.0, FULL_AH, ohms, make, CELLS, air_C), power, soc, k)
        for k, ((share, ohms, air_C, *_), soc) in enumerate(zip(MIXED_AGES[:logs], LANDS_AT * 2, strict=False))
    ]
    battery = fit_battery(RecordedPack(make.name, CELLS, FULL_AH, CUTOFF_V), [], past).file
    vehicle = fit_vehicle(make.name, past, battery, PACK)
    found = []
    for k, (share, ohms, air_C) in enumerate(FLOWN):
        pack = Pack(FULL_AH * share, 1.0, FULL_AH, ohms, make, CELLS, air_C)
        flown = flight(pack, power, seed=50 + k)
        loads: tuple[Load, ...] = (logged(flown.flight()), learned_load(vehicle), UnknownAircraft())
        found.append([_said(flown.flight(), load, battery, flown.end_s) for load in loads])
    return np.array(found)


def _said(log: Flight, load: Load, battery: BatteryFile, end_s: float) -> FloatArray:
    lines = ours(replayed(log, battery, PACK, ForecastSettings(load, forecast_period_s=5.0)))
    assert lines.lo_s is not None and lines.hi_s is not None
    said = np.stack([lines.lo_s, lines.remaining_s, lines.hi_s])
    at = np.searchsorted(lines.time_s, end_s - np.array(BEFORE_END_S) + 1e-6) - 1
    return np.asarray((said[:, at] - np.array(BEFORE_END_S)).T)


def main() -> None:
    """Fly all and print a table of each kind of flight."""
    logs = int(sys.argv[1]) if len(sys.argv) > 1 else LEARNED_FROM
    with Pool(2) as pool:
        for kind, powers in FLIGHTS.items():
            error_s = np.concatenate(pool.starmap(judged, product(MAKES, powers, [logs]), chunksize=1))
            print("\n".join(_table(kind, error_s)), flush=True)


def _table(kind: str, error_s: FloatArray) -> Iterator[str]:
    """Yield the lines of a table; error_s [s] : [flights, loads, instants, 5 % point, median and 95 % point]."""
    yield f"| {kind}: MAE (bias); 5 % point at most [s] | {' | '.join(f'{s:.0f}' for s in BEFORE_END_S)} |"
    yield f"|---|{'---|' * len(BEFORE_END_S)}"
    for n, name in enumerate(LOADS):
        of_load = error_s[:, n]
        cells = [
            f"{np.abs(of_load[:, k, 1]).mean():.0f} ({of_load[:, k, 1].mean():+.0f}); {of_load[:, k, 0].max():+.0f}"
            for k in range(len(BEFORE_END_S))
        ]
        yield f"| {name} | {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
