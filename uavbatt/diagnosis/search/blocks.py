"""Evidence by block of the flight: the chi-square that the best model saves in each of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.model import Array
from uavbatt.diagnosis.refit.problem import Problem, Refit
from uavbatt.diagnosis.refit.whitening import Rows

TAKE_OFF_S = 60.0  # the climb from the ground, whose current is the highest of a flight
BLOCKS = ("rest", "take-off", "first third", "middle third", "last third", "temperature")


class EvidenceBlock(NamedTuple):
    """EvidenceBlock holds a block's name, how many numbers all records have there, and the chi-square they save."""

    name: str
    numbers: int
    saved: float


def evidence_by_block(problem: Problem, before: Refit, after: Refit) -> tuple[EvidenceBlock, ...]:
    """Return the chi-square of `before` minus that of `after`, by block; each whitened number counts in its own row."""
    numbers, saved = np.zeros(len(BLOCKS), dtype=int), np.zeros(len(BLOCKS))
    for j, volts in enumerate(problem.evidence.volts):
        gain = before.residual[j] ** 2 - after.residual[j] ** 2
        time_s = problem.evidence.stack.time_s[volts.rows, j]
        places = _places(time_s, volts.rest)
        np.add.at(numbers, places, 1)
        np.add.at(saved, places, gain[: places.size])
        warm = problem.evidence.temps[j]
        if warm is not None:
            numbers[-1] += warm.rows.size
            saved[-1] += np.sum(gain[places.size : places.size + warm.rows.size])
    return tuple(EvidenceBlock(n, int(k), float(s)) for n, k, s in zip(BLOCKS, numbers, saved, strict=True) if k)


def _places(time_s: Array, rest: NDArray[np.bool_]) -> Rows:
    """Return the block of each row of voltage: rest, the first minute under load, thirds of the remaining flight."""
    since_s = time_s - np.min(time_s[~rest])
    share = (since_s - TAKE_OFF_S) / max(float(since_s[-1]) - TAKE_OFF_S, 1.0)
    thirds = 2 + np.clip((share * 3.0).astype(int), 0, 2)
    return np.where(rest, 0, np.where(since_s < TAKE_OFF_S, 1, thirds))
