"""The current of a record read some seconds later: what a delay between the two readings does; and, as its rival, the
current that goes with a voltage or a current behind a filter.

Both are worked out at SHIFTS_S. Between these it is interpolated by cubic convolution (Keys, IEEE Trans. ASSP 29,
1981), which is smooth in the delay: linear interpolation has a corner at zero delay, and a refit would stop there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.signal import lfilter

from uavbatt.battery.model import Array
from uavbatt.fitting import observed
from uavbatt.fitting.observed import ObservedRecord, Stack

SHIFTS_S = np.arange(-8.0, 8.01, 0.5)  # the bounds of `current_delay`, in steps of half a row of 1 s
LEAST_OF_BIN = 0.1  # less of a bin than that, at an end of the record, has no mean
NEARLY = 1e-3  # of a step: keeps four neighbours around the last shift
FILTER_STEP_S = 0.5  # of the grid on which a current is filtered: the shortest filter takes one step


def shifted(records: list[ObservedRecord], stack: Stack) -> Array:
    """Return the current [A] at SHIFTS_S after each row, [shifts, rows, records], averaged as in the record."""
    out = np.empty((len(SHIFTS_S), *stack.current_A.shape))
    for j, record in enumerate(records):
        at_s = stack.time_s[:, j] + SHIFTS_S[:, None]
        out[:, :, j] = _as_recorded(record, record.time_s, record.current_A, at_s)
    return out


def followed(records: Sequence[ObservedRecord], stack: Stack) -> Array:
    """Return the current [A] that goes with filtered readings, [shifts, rows, records], averaged as in the record.

    At a shift of -tau seconds it is the current behind a first-order filter of tau, which fits a voltage read behind
    one; at +tau it is the current before such a filter, i + tau di/dt, for a current read behind one.
    """
    out = np.empty((len(SHIFTS_S), *stack.current_A.shape))
    for j, record in enumerate(records):
        even_s = np.arange(record.time_s[0], record.time_s[-1] + FILTER_STEP_S, FILTER_STEP_S)
        even_A = _means(record.time_s, record.current_A, even_s, FILTER_STEP_S)
        for k, shift_s in enumerate(SHIFTS_S):
            out[k, :, j] = _as_recorded(record, even_s, _filtered_A(even_A, shift_s), stack.time_s[:, j])
    return out


def _filtered_A(current_A: Array, shift_s: float) -> Array:
    """Return a current [A], every FILTER_STEP_S, behind a filter (shift below 0) or before one (above 0)."""
    if shift_s >= 0:
        before_A: Array = current_A + shift_s * np.gradient(current_A, FILTER_STEP_S)
        return before_A
    kept = np.exp(FILTER_STEP_S / shift_s)
    behind_A: Array = lfilter([1 - kept], [1, -kept], current_A, zi=[kept * current_A[0]])[0]
    return behind_A


def _as_recorded(record: ObservedRecord, time_s: Array, current_A: Array, at_s: Array) -> Array:
    """Return a current [A], known at `time_s`, at `at_s` [s]: averaged over bins if `record` comes in such."""
    if observed.is_fine(record):
        return _means(time_s, current_A, at_s, observed.BIN_S)
    return np.interp(at_s, time_s, current_A)


def _means(time_s: Array, current_A: Array, at_s: Array, width_s: float) -> Array:
    """Return the mean current [A] in bins of `width_s` around `at_s` [s].

    Before the record it is that of the first row, after it that of the last `width_s`.
    """
    charge_As = np.asarray(cumulative_trapezoid(current_A, time_s, initial=0), dtype=float)
    ends_s = np.clip([at_s - width_s / 2, at_s + width_s / 2], *time_s[[0, -1]])
    (lasts_s,), (drawn_As,) = np.diff(ends_s, axis=0), np.diff(np.interp(ends_s, time_s, charge_As), axis=0)
    held_A = np.where(at_s < time_s[0], current_A[0], np.mean(current_A[time_s > time_s[-1] - width_s]))
    least_s = LEAST_OF_BIN * width_s
    means_A: Array = np.where(lasts_s > least_s, drawn_As / np.maximum(lasts_s, least_s), held_A)
    return means_A


def metered_current(current_A: Array, shifted_A: Array, delay_s: Array) -> Array:
    """Return the metered current [A], [rows, columns], read `delay_s` [columns] seconds later.

    current_A : as recorded [rows, records]; shifted_A : the same at SHIFTS_S [shifts, rows, records]. The columns hold
    all records of the first variant, then those of the next.
    """
    records = current_A.shape[1]
    position = np.clip((delay_s - SHIFTS_S[0]) / (SHIFTS_S[1] - SHIFTS_S[0]), 1, len(SHIFTS_S) - 2 - NEARLY)
    lower = position.astype(int)
    column = np.arange(delay_s.size)
    weights = np.zeros((len(SHIFTS_S), delay_s.size))  # of the shifted currents on either side
    for place, weight in enumerate(_keys(position - lower), start=-1):
        weights[lower + place, column] = weight
    weights[np.searchsorted(SHIFTS_S, 0.0)] -= 1.0  # only the change: the record itself may be averaged in another way
    current = np.tile(current_A, (1, delay_s.size // records))
    for j in range(records):
        current[:, j::records] += shifted_A[:, :, j].T @ weights[:, j::records]
    return current


def _keys(t: Array) -> tuple[Array, Array, Array, Array]:
    """Return the weights of four neighbours at a share t of the middle gap (Keys 1981, eq. 15)."""
    return (
        0.5 * t * (t * (2.0 - t) - 1.0),
        0.5 * (t * t * (3.0 * t - 5.0) + 2.0),
        0.5 * t * (t * (4.0 - 3.0 * t) + 1.0),
        0.5 * t * t * (t - 1.0),
    )
