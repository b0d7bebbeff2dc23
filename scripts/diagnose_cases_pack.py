"""The simulated pack that the labelled cases fly: its size, its battery file, its records, for the scripts beside."""

from __future__ import annotations

import os
from argparse import ArgumentParser
from pathlib import Path
from typing import NamedTuple

os.environ.setdefault("OMP_NUM_THREADS", "1")

from uavbatt.battery import battery_file
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.scaling import Pack
from uavbatt.battery.sizing.pack_size import PackOptions, pack_from
from uavbatt.engine import Engine
from uavbatt.fitting.observed import ObservedRecord, from_flight
from uavbatt.log_replay.run import engine_for
from uavbatt.telemetry import read_log
from uavbatt.telemetry.cleaning.readings import MAX_CELL_C

CELLS, CAPACITY_AH, CUTOFF_V = 4, 5.016, 13.2


class Ready(NamedTuple):
    """Ready holds a battery file, the pack that it makes, and what simulates it: the arguments of `diagnose`."""

    file: BatteryFile
    pack: Pack
    engine: Engine


def arguments(*first: str) -> ArgumentParser:
    """Return the arguments of a script: the battery file, other paths, folders of cases."""
    parser = ArgumentParser()
    for name in ("battery", *first):
        parser.add_argument(name, type=Path)
    parser.add_argument("folders", type=Path, nargs="+")
    return parser


def ready(path: Path) -> Ready:
    """Read a battery file for the simulated pack."""
    file = battery_file.read_battery(path)
    return Ready(file, pack_from(file, PackOptions(CELLS, CAPACITY_AH, CUTOFF_V)), engine_for(is_long=True))


def records(logs: list[Path]) -> list[ObservedRecord]:
    """Read flights of the simulated pack."""
    return [from_flight(read_log(path), CELLS, CAPACITY_AH, hottest_start_C=MAX_CELL_C) for path in logs]


def flights(folder: Path) -> list[ObservedRecord]:
    """Read the flights of a case in the order of their names."""
    return records(sorted(path for path in folder.iterdir() if path.suffix in (".csv", ".tlog")))
