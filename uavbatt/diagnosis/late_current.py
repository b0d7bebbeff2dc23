"""The current of a record read some seconds later: what a delay between the two readings does.

It is worked out once at SHIFTS_S. Between these it is interpolated by cubic convolution (Keys, IEEE Trans. ASSP 29,
1981), which is smooth in the delay: linear interpolation has a corner at zero delay, and a refit would stop there.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_trapezoid

from uavbatt.battery.model import Array
from uavbatt.fitting import observed
from uavbatt.fitting.observed import ObservedRecord, Stack

SHIFTS_S = np.arange(-8.0, 8.01, 0.5)  # the bounds of `current_delay`, in steps of half a row of 1 s
LEAST_BIN_S = 0.5  # less of a bin than that, at an end of the record, has no mean
NEARLY = 1e-3  # of a step: keeps four neighbours around the last shift


def shifted(records: list[ObservedRecord], stack: Stack) -> Array:
    """Return the current [A] at SHIFTS_S after each row, [shifts, rows, records], averaged as in the record."""
    out = np.empty((len(SHIFTS_S), *stack.current_A.shape))
    for j, record in enumerate(records):
        at_s = stack.time_s[:, j] + SHIFTS_S[:, None]
        in_bins = observed.is_fine(record)
        out[:, :, j] = _bin_means(record, at_s) if in_bins else np.interp(at_s, record.time_s, record.current_A)
    return out


def _bin_means(record: ObservedRecord, at_s: Array) -> Array:
    """Return the mean current [A] in the bins around `at_s` [s]; beyond the record that of its first or last bin."""
    charge_As = np.asarray(cumulative_trapezoid(record.current_A, record.time_s, initial=0), dtype=float)
    ends_s = np.clip([at_s - observed.BIN_S / 2, at_s + observed.BIN_S / 2], *record.time_s[[0, -1]])
    (width_s,), (drawn_As,) = np.diff(ends_s, axis=0), np.diff(np.interp(ends_s, record.time_s, charge_As), axis=0)
    held_A = np.where(at_s < record.time_s[0], record.current_A[0], observed.binned(record).current_A[-1])
    means_A: Array = np.where(width_s > LEAST_BIN_S, drawn_As / np.maximum(width_s, LEAST_BIN_S), held_A)
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
