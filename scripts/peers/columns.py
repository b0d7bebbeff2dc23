"""Samples as arrays, and what a calibrated peer learns from an earlier flight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from uavbatt.records import Sample

FloatArray = NDArray[np.float64]


def column(samples: Sequence[Sample], name: str) -> FloatArray:
    """Return one field of all samples."""
    return np.array([getattr(sample, name) for sample in samples], dtype=float)


def armed(samples: Sequence[Sample]) -> NDArray[np.bool_]:
    """Return at each sample if the vehicle is armed; a log that never says so is one flight from its first row."""
    flags = [sample.armed for sample in samples]
    if all(flag is None for flag in flags):
        return np.ones(len(flags), dtype=bool)
    return np.array([bool(flag) for flag in flags])


def integral_h(time_s: FloatArray, rate: FloatArray) -> FloatArray:
    """Return the running trapezoid of `rate` over hours: A -> Ah, W -> Wh. A step with an unknown end adds nothing."""
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(time_s) / 3600.0
    return np.concatenate([[0.0], np.cumsum(np.nan_to_num(steps, nan=0.0))])


def drawn_Ah(samples: Sequence[Sample], until_s: float) -> float:
    """Return the charge [Ah] drawn up to the first row at or after `until_s` [s]: `usable_Ah` of the next flight."""
    return _at(samples, integral_h(column(samples, "time_s"), column(samples, "current_A")), until_s)


def drawn_Wh(samples: Sequence[Sample], until_s: float) -> float:
    """Return the energy [Wh] at the terminals up to the first row at or after `until_s` [s]: `usable_Wh`."""
    power_W = column(samples, "voltage_V") * column(samples, "current_A")
    return _at(samples, integral_h(column(samples, "time_s"), power_W), until_s)


def _at(samples: Sequence[Sample], running: FloatArray, until_s: float) -> float:
    row = int(np.searchsorted(column(samples, "time_s"), until_s - 1e-6))
    return float(running[min(row, running.size - 1)])
