"""Waits on the ground before, between and after the flights of a pack: neither a forecast nor a truth counts them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavbatt.battery.model import Array

Waits = tuple[tuple[float, float], ...]  # begin and end of each [s]


def waits_of(time_s: Array, disarmed: NDArray[np.bool_], loaded: NDArray[np.bool_]) -> Waits:
    """Return begin and end of each wait: rows without load, disarmed by the vehicle's word or after the last load.

    A wait ends with the next row that is none, else never.
    """
    is_over = ~np.maximum.accumulate(loaded[::-1])[::-1] & loaded.any()
    edges = np.flatnonzero(np.diff(~loaded & (disarmed | is_over), prepend=False, append=False))
    edges_s = np.append(time_s, np.inf)[edges].tolist()
    return tuple(zip(edges_s[::2], edges_s[1::2], strict=True))


def in_air_s(since_s: ArrayLike, until_s: ArrayLike, waits: Waits) -> Array:
    """Return the time from `since_s` to `until_s` [s], less the waits between them."""
    passed_s = np.asarray(until_s, float) - np.asarray(since_s, float)
    waited_s = [np.maximum(np.minimum(end_s, until_s) - np.maximum(begin_s, since_s), 0.0) for begin_s, end_s in waits]
    return np.asarray(passed_s - sum(waited_s))
