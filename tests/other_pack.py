"""A pack of a model that is not ours (open-circuit voltages, ohms, lag), flown at constant power with gusts."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from uavbatt.records import Sample

CELLS, CUTOFF_V, TEMP_C = 4, 13.2, 25.0
FULL_AH, POWER_W = 5.0, 300.0
SOC = (-0.05, 0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
OCV_V = (2.4, 3.2, 3.42, 3.58, 3.675, 3.7, 3.72, 3.755, 3.785, 3.825, 3.875, 3.945, 4.01, 4.085, 4.175)  # a cell
OHM, LAG_OHM, LAG_S = 0.003, 0.001, 20.0  # a cell of FULL_AH: 4 mohm when the load has lasted
GUST, GUST_S = 0.04, 3.0  # sd of the power, and how long a gust lasts [s]
END_MEAN_S = 5


@dataclass
class Pack:
    """What it holds now; `step` draws from it for a second."""

    capacity_Ah: float = FULL_AH
    soc: float = 1.0
    size_Ah: float = FULL_AH  # what it held when it was new: small packs have more ohms, worn ones have not
    lag_V: float = 0.0

    def step(self, power_W: float) -> tuple[float, float]:
        """Pack voltage [V] and current [A] at the end of a second under a power."""
        ohm = OHM * FULL_AH / self.size_Ah
        open_V = CELLS * (float(np.interp(self.soc, SOC, OCV_V)) - self.lag_V)
        root = max(open_V**2 - 4.0 * CELLS * ohm * power_W, 0.0)
        amps = (open_V - math.sqrt(root)) / (2.0 * CELLS * ohm)
        self.soc -= amps / 3600.0 / self.capacity_Ah
        share = math.exp(-1.0 / LAG_S)
        self.lag_V = share * self.lag_V + (1.0 - share) * amps * LAG_OHM * FULL_AH / self.size_Ah
        return open_V - CELLS * ohm * amps, amps


def rested(pack: Pack, seconds: int, from_s: float, drawn_Ah: float = 0.0) -> list[Sample]:
    """On the ground, the electronics on."""
    return list(_rows(pack, [5.0] * seconds, from_s, drawn_Ah, armed=False))


def flown(pack: Pack, from_s: float, seconds: int = 3600, drawn_Ah: float = 0.0, seed: int = 3) -> list[Sample]:
    """In the air until the end of flight (mean of 5 s below the cut-off) or for so long; the last row is the end."""
    made: list[Sample] = []
    last: deque[float] = deque(maxlen=END_MEAN_S)
    for row in _rows(pack, _gusts(seconds, seed), from_s, drawn_Ah, armed=True):
        made.append(row)
        last.append(row.voltage_V)
        if len(last) == END_MEAN_S and sum(last) / END_MEAN_S < CUTOFF_V:
            break
    return made


def _rows(pack: Pack, powers_W: list[float], from_s: float, drawn_Ah: float, armed: bool) -> Iterator[Sample]:
    for k, power_W in enumerate(powers_W):
        volts, amps = pack.step(power_W)
        drawn_Ah += amps / 3600.0
        yield Sample(from_s + k, volts, amps, TEMP_C, drawn_Ah, armed=armed)


def _gusts(seconds: int, seed: int) -> list[float]:
    dice, share, gust, made = np.random.default_rng(seed), math.exp(-1.0 / GUST_S), 0.0, []
    for normal in dice.standard_normal(seconds):
        gust = share * gust + math.sqrt(1.0 - share**2) * float(normal)
        made.append(POWER_W * (1.0 + GUST * gust))
    return made
