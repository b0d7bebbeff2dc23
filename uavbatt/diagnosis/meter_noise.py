"""Noise of the voltage that is left in the rows of a record, estimated from the rows themselves."""

from __future__ import annotations

import numpy as np

from uavbatt.battery.initial_state import IDLE_C_RATE
from uavbatt.battery.model import Array
from uavbatt.fitting import observed
from uavbatt.fitting.observed import ObservedRecord

FAST_ROW_S = 1.5  # slower rows mix changes of the load with the noise
SLOWEST_S = 60.0  # slower rows mix the bend of a discharge with the noise
HELD_SHARE = 0.02  # of the upper current (90 % point), by which most rows of a held load differ at most
LEAST_BENDS = 10  # fewer show no scatter
BENT_BY_ONE = 6.0  # 1² + 2² + 1²: the variance of a second difference, of that of one row


def noise_V(record: ObservedRecord, ohm: float) -> float:
    """Return the noise [V] of both sensors in the compared rows; 0 if rows are too slow to tell it from load.

    It comes from second differences of the voltage plus the drop of the load: changes that both sensors show cancel,
    and noise of one sensor alone is left, which the model cannot follow. Under a held load slow rows show the noise,
    too, and no mean over BIN_S makes it smaller.
    """
    apart_s = spacing_s(record)
    if apart_s > (SLOWEST_S if _holds_load(record) else FAST_ROW_S):
        return 0.0
    bent_V = np.median(np.abs(np.diff(record.voltage_V + ohm * record.current_A, 2)))
    return float(observed.MAD_TO_SD * bent_V / np.sqrt(BENT_BY_ONE * max(observed.BIN_S / apart_s, 1.0)))


def noise_K(record: ObservedRecord) -> float:
    """Return the noise [K] of single temperatures from their second differences; 0 for means, and for slow rows.

    The noise that a file states is of means over BIN_S: a single reading has more. Of means the file knows the noise
    better than one record does, whose scatter would hide what moves the temperature.
    """
    shown = observed.binned(record)
    bent_K = np.diff(shown.temp_C[np.isfinite(shown.temp_C)], 2)
    is_single = observed.FINE_SHARE * observed.BIN_S <= spacing_s(record) <= SLOWEST_S
    if not is_single or bent_K.size < LEAST_BENDS:
        return 0.0
    return float(observed.MAD_TO_SD * np.median(np.abs(bent_K)) / np.sqrt(BENT_BY_ONE))


def _holds_load(record: ObservedRecord) -> bool:
    """Return True for a record, such as a bench test, whose current is nearly the same from row to row."""
    amps = np.abs(record.current_A)
    return bool(np.median(np.abs(np.diff(amps))) < HELD_SHARE * np.percentile(amps, 90))


def resting_noise_V(records: list[ObservedRecord]) -> float:
    """Return the noise [V] of the voltmeter in slow rows at rest before the load; 0 if there are none.

    A bench often writes a row every 10 s and lets the pack rest for a minute first. There no load changes, so that
    second differences show the noise at any spacing. All records count together, because one has few such rows. Without
    it every row at rest would count as free of noise, and a sound data set as one with an unknown effect.
    """
    bent_V = [np.diff(_rested_V(observed.binned(r)), 2) for r in records if spacing_s(r) > FAST_ROW_S]
    together = np.concatenate([np.zeros(0), *bent_V])
    return float(np.sqrt(np.mean(together**2) / BENT_BY_ONE)) if together.size else 0.0


def spacing_s(record: ObservedRecord) -> float:
    """Return the usual time between two rows of a record [s]."""
    return float(np.median(np.diff(record.time_s)))


def _rested_V(record: ObservedRecord) -> Array:
    """Return the voltages of a record before its load."""
    loaded = np.abs(record.current_A) >= IDLE_C_RATE * record.capacity_Ah
    first = int(np.argmax(loaded)) if loaded.any() else loaded.size
    return record.voltage_V[:first]
