"""Flights that were recorded twice: by the aircraft and by the ground station, or a log that was copied.

To a fit they would be two flights that agree, and a check with the other one would be a check of a flight by itself.

Clocks of two recorders differ, and one may not know the date. Both hold readings of the same sensors, though: most
pairs of voltage and current of one recording are found in the other one too, and always the same time later.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.records import Flight
from uavbatt.telemetry.columns import Column
from uavbatt.telemetry.quality.drawn import loaded_A

VOLTAGE_STEP_V, CURRENT_STEP_A = 0.01, 0.02  # formats round differently: readings are the same within these steps
DELAYS_S = 4.0  # a link delays the rows of a flight by times that differ by less
# Two recordings share nearly all readings (98 % at least), flights of one route at most 5 %, or 33 % if the logs tell
# one decimal only: then as many are shared at other delays, too.
SHARED, OTHER_DELAYS = 0.6, 1.0 / 3.0
LEAST_READINGS, MOST_READINGS = 20, 500  # of the shorter recording; more tell no more
PAIR_STEP = 1_000_000  # from one voltage to the next in the number of a pair: more than any current has steps
GAP_S = 5.0  # a row stands for no more time than this


class _Readings(NamedTuple):
    """Readings hold voltage and current of a flight under load, each pair one number, ascending, and its time [s]."""

    pair: NDArray[np.int64]
    time_s: Column


def without_second_recordings(flights: Sequence[Flight]) -> tuple[list[Flight], list[tuple[Flight, Flight]]]:
    """Return the flights, each once, and those left out, each with the recording of it that is kept.

    The one is kept that covers more minutes of the flight, or else the one with the route, or else that of more rows.
    """
    readings = [_readings(flight) for flight in flights]
    kept = list[int]()
    twin_of = dict[int, int]()
    for k in sorted(range(len(flights)), key=lambda k: _worth(flights[k]), reverse=True):
        twin = next((other for other in kept if _is_one_flight(readings[other], readings[k])), None)
        if twin is None:
            kept.append(k)
        else:
            twin_of[k] = twin
    return [flights[k] for k in sorted(kept)], [(flights[k], flights[twin]) for k, twin in sorted(twin_of.items())]


def _worth(flight: Flight) -> tuple[int, bool, int]:
    """Return what a recording is worth: minutes without gaps, whether it tells the route, and rows."""
    covered_s = sum(min(b.time_s - a.time_s, GAP_S) for a, b in pairwise(flight.samples))
    return round(covered_s / 60.0), bool(flight.navigation), len(flight.samples)


def _readings(flight: Flight) -> _Readings:
    """Return the readings of a flight, without those of a row that repeats the one before it."""
    rows = np.array([(s.time_s, s.voltage_V, s.current_A) for s in flight.samples]).reshape(-1, 3)
    rows = rows[np.isfinite(rows).all(axis=1) & (rows[:, 2] > loaded_A(rows[:, 2]))]
    is_new = np.append(True, (np.diff(rows[:, 1:], axis=0) != 0.0).any(axis=1))[: len(rows)]
    time_s, volts, amps = rows[is_new].T
    pair = (np.rint(volts / VOLTAGE_STEP_V) * PAIR_STEP + np.rint(amps / CURRENT_STEP_A)).astype(np.int64)
    order = np.argsort(pair, kind="stable")
    return _Readings(pair[order], time_s[order])


def _is_one_flight(a: _Readings, b: _Readings) -> bool:
    """Return True if most readings of the shorter recording are in the longer one, at one delay."""
    few, many = sorted((a, b), key=lambda readings: len(readings.time_s))
    if len(few.time_s) < LEAST_READINGS:
        return False
    each = -(-len(few.time_s) // MOST_READINGS)
    few = _Readings(few.pair[::each], few.time_s[::each])
    reading, delay_s = _shared(few, many)
    if len(set(reading.tolist())) < SHARED * len(few.time_s):
        return False
    begins_s = np.sort(delay_s)
    matches = np.searchsorted(begins_s, begins_s + DELAYS_S, "right") - np.arange(begins_s.size)
    most = int(np.argmax(matches))
    others = matches[np.abs(begins_s - begins_s[most]) > 2.0 * DELAYS_S]
    is_at = (delay_s >= begins_s[most]) & (delay_s <= begins_s[most] + DELAYS_S)
    is_most = len(set(reading[is_at].tolist())) > SHARED * len(few.time_s)
    return is_most and bool(others.max(initial=0) < OTHER_DELAYS * matches[most])


def _shared(few: _Readings, many: _Readings) -> tuple[NDArray[np.int64], Column]:
    """Return which readings of a recording are in another one, and by how much later there [s], for each match."""
    pairs = many.pair
    reading, delay_s = list[NDArray[np.int64]](), list[Column]()
    for step in (-1, 0, 1):  # a current may be rounded down in one format, and to the nearest in the other
        first, end = np.searchsorted(pairs, few.pair + step, "left"), np.searchsorted(pairs, few.pair + step, "right")
        matches = end - first
        of_few = np.repeat(np.arange(len(few.time_s)), matches)
        of_many = np.arange(len(of_few)) + np.repeat(end - np.cumsum(matches), matches)
        reading.append(of_few)
        delay_s.append(many.time_s[of_many] - few.time_s[of_few])
    return np.concatenate(reading), np.concatenate(delay_s)
