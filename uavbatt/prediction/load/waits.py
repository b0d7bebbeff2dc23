"""Waits on the ground, disarmed, between two flights of one pack: neither a forecast nor a truth counts them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavbatt.battery.model import Array

Waits = tuple[tuple[float, float], ...]  # begin and end of each [s]


def waits_of(time_s: Array, is_waiting: NDArray[np.bool_]) -> Waits:
    """Return begin and end of each stretch of rows that wait; it ends with the next row that does not."""
    begins, ends = np.flatnonzero(np.diff(is_waiting, prepend=False, append=False)).reshape(-1, 2).T
    return tuple(zip(time_s[begins].tolist(), time_s[np.minimum(ends, time_s.size - 1)].tolist(), strict=True))


def in_air_s(since_s: ArrayLike, until_s: ArrayLike, waits: Waits) -> Array:
    """Return the time from `since_s` to `until_s` [s], less the waits between them."""
    passed_s = np.asarray(until_s, float) - np.asarray(since_s, float)
    waited_s = [np.maximum(np.minimum(end_s, until_s) - np.maximum(begin_s, since_s), 0.0) for begin_s, end_s in waits]
    return np.asarray(passed_s - sum(waited_s))
