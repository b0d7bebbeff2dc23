"""Charge and energy that a flight drew (the one place that integrates); which rows are under load, or with a pack."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.records import NAN, Sample
from uavbatt.telemetry.columns import Columns

LONGEST_STEP_S = 30.0
LOADED_SHARE = 1.0 / 3.0  # share of the flight's high current
LEAST_AT_REST, LEAST_LOADED = 0.7, 0.5  # of the usual voltage: a lower one is not that of a pack


class DrawnCharge(NamedTuple):
    """DrawnCharge holds the charge [Ah] and energy [Wh] that a flight drew, by the trapezium rule.

    time_s : sum of the steps with known voltage and current [s]; gaps do not count
    counter_Ah : rise of the autopilot's own counter in the same steps [Ah]; NaN if unknown
    """

    charge_Ah: float = NAN
    energy_Wh: float = NAN
    time_s: float = 0.0
    counter_Ah: float = NAN


def drawn(samples: Iterable[Sample], limit_s: float) -> DrawnCharge:
    """Return the charge and energy that a flight drew; a step longer than `limit_s` [s] is a gap.

    A counter that falls was reset (reboot, new pack): that step is left out.
    """
    charge_As, energy_J, counter_Ah = list[float](), list[float](), list[float]()
    time_s = 0.0
    for a, b in itertools.pairwise(samples):
        step_s = b.time_s - a.time_s
        if step_s > limit_s:
            continue
        charge_As.append(0.5 * (a.current_A + b.current_A) * step_s)
        energy_J.append(0.5 * (a.voltage_V * a.current_A + b.voltage_V * b.current_A) * step_s)
        counter_Ah.append(b.consumed_Ah - a.consumed_Ah)
        time_s += step_s if math.isfinite(energy_J[-1]) else 0.0
    return DrawnCharge(
        _sum(charge_As) / 3600.0, _sum(energy_J) / 3600.0, time_s, _sum(step for step in counter_Ah if step >= 0.0)
    )


def _sum(values: Iterable[float]) -> float:
    """Return the sum of the known values; NaN if none is known."""
    known = [value for value in values if math.isfinite(value)]
    return sum(known) if known else NAN


def given_J(rows: Columns) -> float:
    """Return the energy that a battery gave [J], by trapezoids; a step longer than LONGEST_STEP_S is a gap."""
    step_s, power_W = np.diff(rows.time_s), rows.voltage_V * rows.current_A
    return float(np.nansum((0.5 * (power_W[1:] + power_W[:-1]) * step_s)[step_s <= LONGEST_STEP_S]))


def loaded_A(current_A: NDArray[np.float64]) -> float:
    """Return the current [A] above which a row is under load; infinite if it is not known.

    That is so without a current, and if more flows into the pack than out of it: then its sign may be reversed.

    It is a third of the high current: the larger of the 90 % point of all rows, and the current above which half of the
    charge was drawn. The second counts if the flight is a small part of the log.
    """
    known_A = np.sort(current_A[np.isfinite(current_A)])
    if not known_A.size or np.sum(known_A) < 0.0:
        return math.inf
    drawn = np.cumsum(np.maximum(known_A, 0.0))
    half_A = known_A[np.searchsorted(drawn, 0.5 * drawn[-1])]
    return LOADED_SHARE * float(max(np.percentile(known_A, 90), half_A))


def with_pack(voltage_V: NDArray[np.float64], current_A: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return True for each row in which the voltage is that of a pack.

    An autopilot on USB power, or with a supply of its own, speaks on while its pack is out, and a voltmeter may rise
    slowly when the pack is connected. Under load an emptied pack may be low.
    """
    known_V = voltage_V[np.isfinite(voltage_V)]
    usual_V = float(np.median(known_V)) if known_V.size else math.inf
    least = np.where(current_A < loaded_A(current_A), LEAST_AT_REST, LEAST_LOADED)
    return np.asarray(voltage_V > least * usual_V)
