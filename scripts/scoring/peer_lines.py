"""The peers on one flight: with the nameplate alone, and with what a careful pilot calibrated on other flights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from peers import ardupilot, inav, px4
from peers.columns import FloatArray, column, drawn_Ah, drawn_Wh

from scoring.lines import Lines
from uavbatt.records import Flight, Sample

MAH = "ArduPilot mAh, calibrated"
PX4_CALIBRATED, INAV_CALIBRATED = "PX4, calibrated", "INAV, calibrated"


@dataclass(frozen=True, slots=True)
class PeerPack:
    """A PeerPack is the pack as its nameplate says it, and as earlier flights to the end have shown it."""

    cells: int
    rated_Ah: float
    usable_Ah: float
    usable_Wh: float
    px4_set: px4.Parameters


def calibrated(
    cells: int, rated_Ah: float, flights: Sequence[tuple[Flight, float]], px4_set: px4.Parameters | None = None
) -> PeerPack:
    """Return the pack by flights with their ends [s]: the mean of what was drawn until then."""
    usable_Ah = float(np.mean([drawn_Ah(flight.samples, end_s) for flight, end_s in flights]))
    usable_Wh = float(np.mean([drawn_Wh(flight.samples, end_s) for flight, end_s in flights]))
    return PeerPack(cells, rated_Ah, usable_Ah, usable_Wh, px4_set or px4.Parameters())


def peer_lines(pack: PeerPack, rows: Sequence[Sample]) -> dict[str, Lines]:
    """Return what each peer says at every row."""
    cells, rated_Ah, usable_Ah, px4_set = pack.cells, pack.rated_Ah, pack.usable_Ah, pack.px4_set
    said: dict[str, Callable[[], FloatArray]] = {
        "PX4, rated": lambda: px4.predict(rows, rated_Ah, cells, parameters=px4_set),
        PX4_CALIBRATED: lambda: px4.predict(rows, rated_Ah, cells, usable_Ah=usable_Ah, parameters=px4_set),
        "ArduPilot mAh, rated": lambda: ardupilot.predict(rows, rated_Ah, cells),
        MAH: lambda: ardupilot.predict(rows, rated_Ah, cells, usable_Ah=usable_Ah),
        "INAV, rated": lambda: inav.predict(rows, rated_Ah, cells),
        INAV_CALIBRATED: lambda: inav.predict(rows, rated_Ah, cells, usable_Wh=pack.usable_Wh),
    }
    time_s = column(rows, "time_s")
    return {name: Lines(time_s, predict()) for name, predict in said.items()}
