"""Noise of voltage and temperature in the compared rows of a record, estimated from its rows themselves."""

from __future__ import annotations

import math

import numpy as np

from uavbatt.battery.initial_state import IDLE_C_RATE
from uavbatt.battery.model import Array
from uavbatt.fitting import observed
from uavbatt.fitting.observed import ObservedRecord
from uavbatt.telemetry.quality.last_digit import last_digit

FAST_ROW_S = 1.5  # between slower rows the polarisation follows the load
SLOWEST_S = 60.0  # slower rows mix the bend of a discharge with the noise
HELD_SHARE = 0.02  # of the upper current (90 % point), by which most rows of a held load differ at most
LEAST_BENDS, LEAST_RESTED = 10, 30  # fewer show no scatter
FAR_ABOVE = 4.0 / 3.0  # so much above that of the file is the scatter of single flights
NEARLY_ONE_MORE = 0.1  # rows of a little more than 1 s are five to a bin
MOST_DIGIT = 0.2  # of the upper current (90 % point): larger steps are those of a bench test
ROUNDING = math.sqrt(12.0)  # steps of a meter over the sd of its rounding
BENT_BY_ONE = 6.0  # 1² + 2² + 1²: the variance of a second difference, of that of one row


def noise_V(record: ObservedRecord, ohm: float) -> float:
    """Return the noise [V] of both sensors in the compared rows; 0 if rows are too slow to tell it from load.

    It comes from second differences of the voltage plus the drop of the load: changes that both sensors show cancel,
    and noise of one sensor alone is left, which the model cannot follow. Between slow rows the voltage follows a change
    of the load further than `ohm` [ohm] says, and no mean over BIN_S makes the noise smaller. Nor does it make the
    rounding of coarse sensors smaller, where the noise does not reach from one reading to the next.
    """
    apart_s = spacing_s(record)
    if apart_s > SLOWEST_S:
        return 0.0
    if apart_s > FAST_ROW_S and not _holds_load(record):
        ohm = _followed_ohm(record)
    bent_V = float(np.median(np.abs(np.diff(record.voltage_V + ohm * record.current_A, 2))))
    digit_A = last_digit(record.current_A)
    if digit_A > MOST_DIGIT * np.percentile(np.abs(record.current_A), 90):
        digit_A = 0.0
    rounded_V = math.hypot(last_digit(record.voltage_V), ohm * digit_A) / ROUNDING
    if _of_compared(bent_V, observed.BIN_S) < rounded_V:  # the noise of a single row
        return rounded_V
    return _of_compared(bent_V, apart_s)


def _of_compared(bent: float, apart_s: float) -> float:
    """Return the noise of a compared row, a mean over BIN_S or one row, from the median second difference of rows.

    Bins over rows every 2 s have two or three of them by turns: two count.
    """
    rows = max(math.floor(observed.BIN_S / apart_s + NEARLY_ONE_MORE), 1)
    return observed.MAD_TO_SD * bent / math.sqrt(BENT_BY_ONE * rows)


def _followed_ohm(record: ObservedRecord) -> float:
    """Return by how much the voltage follows the current from row to row [ohm], by least squares."""
    bent_V, bent_A = np.diff(record.voltage_V, 2), np.diff(record.current_A, 2)
    square = float(bent_A @ bent_A)
    return max(-float(bent_V @ bent_A) / square, 0.0) if square > 0.0 else 0.0


def noise_K(record: ObservedRecord, stated_K: float) -> float:
    """Return the noise [K] of the compared temperatures from second differences; `stated_K` [K] unless it is far off.

    The noise that a file states is of means over BIN_S in its own records: a mean of fewer rows, or a single reading,
    has more. If it is as large as usual, the file knows it better than one record does, whose scatter would hide what
    moves the temperature. A thermometer of whole degrees has the noise of its rounding at least.
    """
    apart_s, known_C = spacing_s(record), record.temp_C[np.isfinite(record.temp_C)]
    bent_K, least_K = np.diff(known_C, 2), max(stated_K, last_digit(known_C) / ROUNDING)
    if apart_s > SLOWEST_S or bent_K.size < LEAST_BENDS:
        return least_K
    seen_K = _of_compared(float(np.median(np.abs(bent_K))), apart_s)
    return seen_K if seen_K > FAR_ABOVE * stated_K else least_K


def _holds_load(record: ObservedRecord) -> bool:
    """Return True for a record, such as a bench test, whose current is nearly the same from row to row."""
    amps = np.abs(record.current_A)
    return bool(np.median(np.abs(np.diff(amps))) < HELD_SHARE * np.percentile(amps, 90))


def resting_noise_V(records: list[ObservedRecord]) -> float:
    """Return the noise [V] of the voltmeter in slow rows at rest before the load; 0 if there are few.

    A bench often writes a row every 10 s and lets the pack rest for a minute first. There no load changes, so that
    second differences show the noise at any spacing. All records count together, because one has few such rows. Without
    it every row at rest would count as free of noise, and a sound data set as one with an unknown effect.
    """
    bent_V = [np.diff(_rested_V(observed.binned(r)), 2) for r in records if spacing_s(r) > FAST_ROW_S]
    together = np.concatenate([np.zeros(0), *bent_V])
    return float(np.sqrt(np.mean(together**2) / BENT_BY_ONE)) if together.size >= LEAST_RESTED else 0.0


def spacing_s(record: ObservedRecord) -> float:
    """Return the usual time between two rows of a record [s]."""
    return float(np.median(np.diff(record.time_s)))


def _rested_V(record: ObservedRecord) -> Array:
    """Return the voltages of a record before its load."""
    loaded = np.abs(record.current_A) >= IDLE_C_RATE * record.capacity_Ah
    first = int(np.argmax(loaded)) if loaded.any() else loaded.size
    return record.voltage_V[:first]
