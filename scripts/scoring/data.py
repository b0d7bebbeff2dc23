"""The measured data, which are not part of the repository: where they are, and the flights of the benchmark."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

from uavbatt.errors import BadInput
from uavbatt.records import Flight
from uavbatt.scoring.end_of_flight import end_of_flight
from uavbatt.telemetry import read_log

M100_CELLS, M100_CUTOFF_V, M100_LOADED_A = 6, 21.6, 8.0


def place() -> Path:
    """Return `$UAVBATT_DATA`, else `../shared/data` beside the checkout, whether it is there or not."""
    return Path(os.environ.get("UAVBATT_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))


def folder() -> Path:
    """Return the folder of the measured data. Raises BadInput when there is none."""
    found = place()
    if not (found / "flights").is_dir():
        raise BadInput(found, "", "the folder of the measured data: set UAVBATT_DATA to it")
    return found


@dataclass(frozen=True, slots=True)
class M100:
    """An M100 flight belongs to the benchmark; `end_s` is NaN where the log does not reach the cut-off."""

    name: str
    aircraft: str
    flight: Flight
    end_s: float

    @property
    def start_s(self) -> float:
        """Return the time of the first row under load [s]."""
        return next(s.time_s for s in self.flight.samples if s.current_A > M100_LOADED_A)


def m100(data: Path) -> list[M100]:
    """Read all flights of the three aircraft; the aircraft is the last part of the file's name."""
    paths = sorted((data / "flights" / "m100").glob("m100_*.csv"))
    if not paths:
        raise BadInput(data / "flights" / "m100", "", "flights m100_*.csv")
    return [_m100(path) for path in paths]


def _m100(path: Path) -> M100:
    flight = read_log(path)
    rows = flight.samples
    end_s = end_of_flight(
        [s.time_s for s in rows],
        [s.voltage_V for s in rows],
        [s.current_A for s in rows],
        cutoff_V=M100_CUTOFF_V,
        min_current_A=M100_LOADED_A,
    )
    return M100(path.stem, path.stem.rsplit("_", 1)[-1], flight, end_s)


def ended(flights: list[M100]) -> list[M100]:
    """Return the flights whose end is in the log."""
    return [f for f in flights if math.isfinite(f.end_s)]
