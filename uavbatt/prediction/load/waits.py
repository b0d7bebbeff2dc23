"""Waits on the ground before, between and after the flights of a pack: neither a forecast nor a truth counts them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavbatt.battery.model import Array
from uavbatt.records import Sample

LOADED_SHARE = 1.0 / 3.0  # of the 90 % point of the power: less is no flight
Waits = tuple[tuple[float, float], ...]  # begin and end of each [s]


def waits_of(time_s: Array, is_waiting: NDArray[np.bool_]) -> Waits:
    """Return begin and end of each stretch of rows that wait: it ends with the next other row, else never."""
    edges = np.flatnonzero(np.diff(is_waiting, prepend=False, append=False))
    edges_s = np.append(time_s, np.inf)[edges].tolist()
    return tuple(zip(edges_s[::2], edges_s[1::2], strict=True))


def waits_in(rows: Sequence[Sample], power_W: Array) -> Waits:
    """Return the waits after a flight: rows without load, and disarmed by the vehicle's word.

    After the last load the word is not needed: the load beyond a log is that of the flight, not of the ground.

    power_W : of each row [W], [rows]
    """
    loaded = power_W > LOADED_SHARE * np.percentile(power_W, 90)
    if not loaded.any():
        return ()
    has_flown, flies_on = np.maximum.accumulate(loaded), np.maximum.accumulate(loaded[::-1])[::-1]
    disarmed = np.array([row.armed is False for row in rows])
    return waits_of(np.array([row.time_s for row in rows]), has_flown & ~loaded & (disarmed | ~flies_on))


def in_air_s(since_s: ArrayLike, until_s: ArrayLike, waits: Waits) -> Array:
    """Return the time from `since_s` to `until_s` [s], less the waits between them."""
    passed_s = np.asarray(until_s, float) - np.asarray(since_s, float)
    waited_s = [np.maximum(np.minimum(end_s, until_s) - np.maximum(begin_s, since_s), 0.0) for begin_s, end_s in waits]
    return np.asarray(passed_s - sum(waited_s))
