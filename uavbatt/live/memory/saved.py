"""One battery in the saved state, and the checks of its numbers before it is resumed.

A state file may be damaged or edited. Its types are checked where it is read, its numbers here. A state with values
that no battery in flight can have is not resumed, and the reason is given: a wrong belief that looks certain is worse
than none.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from typing import Annotated, Any

import msgspec
import numpy as np

from uavbatt.battery.high_voltage import ORDINARY_FULL_V
from uavbatt.battery.model import Array
from uavbatt.battery.sections import HIGHEST_CELL_V, Capacity, Cells
from uavbatt.battery.state_space import SIZE, X, mixed_covariance
from uavbatt.estimator import EstimatorMemory
from uavbatt.limits import HIGHEST_C_RATE
from uavbatt.records import PackFacts

Column = Annotated[list[float], msgspec.Meta(min_length=SIZE, max_length=SIZE)]
Square = Annotated[list[Column], msgspec.Meta(min_length=SIZE, max_length=SIZE)]
Weight = Annotated[float, msgspec.Meta(gt=0.0, le=1.0)]
FullestCell = Annotated[float, msgspec.Meta(ge=ORDINARY_FULL_V, le=HIGHEST_CELL_V)]
MOST_MEMBERS = 64

# Lowest and highest mean of each component, and lowest and highest standard deviation. The lowest is below what any
# flight reaches: 0.003 of charge, 4 % of resistance, 1 % of capacity, 6 mV. Overpotentials at rest are 0.
PLAUSIBLE: dict[int, tuple[tuple[float, float], tuple[float, float]]] = {
    X.SOC: ((-0.5, 1.05), (2e-4, 1.0)),
    X.POLARISATION: ((-2.0, 2.0), (0.0, 1.0)),
    X.DIFFUSION: ((-2.0, 2.0), (0.0, 1.0)),
    X.CORE: ((-60.0, 150.0), (5e-3, 60.0)),
    X.SENSOR: ((-60.0, 150.0), (5e-3, 60.0)),
    X.LOG_RESISTANCE: ((-3.0, 3.0), (1e-3, 3.0)),
    X.LOG_CAPACITY: ((-3.0, 3.0), (3e-4, 3.0)),
    X.BIAS: ((-1.0, 1.0), (1e-4, 1.0)),
    X.REACTION: ((-0.5, 0.5), (1e-4, 0.5)),
}
ASYMMETRY, INDEFINITE, ROUNDED = 1e-6, 1e-6, 1e-6  # of correlations and weights: errors of rounding
# Ending of a field's name (its unit) -> largest possible value in the memory of a flight; longest endings first.
LARGEST = {
    "_Ah": 1e4, "_A": 2000.0, "_W": 400_000.0, "_J": 1e11, "_V": 200.0, "_C": 200.0, "_s": 1e6,
}  # fmt: skip
LARGEST_OTHER = 1e6


@dataclass(frozen=True, slots=True)
class SavedBattery:
    """SavedBattery holds the belief of a battery, `since_row_s` [s] before its last row, and the memory of its
    flight."""

    since_row_s: Annotated[float, msgspec.Meta(ge=0.0, le=86_400.0)]
    means: Annotated[list[Column], msgspec.Meta(min_length=1, max_length=MOST_MEMBERS)]
    covariances: Annotated[list[Square], msgspec.Meta(min_length=1, max_length=MOST_MEMBERS)]
    weights: Annotated[list[Weight], msgspec.Meta(min_length=1, max_length=MOST_MEMBERS)]
    ambient_C: Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)]
    cells: Cells
    capacity_Ah: Capacity
    facts: PackFacts
    consumed_Ah: float
    current_A: float
    past: EstimatorMemory
    fullest_cell_V: FullestCell = ORDINARY_FULL_V


def implausible(was: SavedBattery) -> str:
    """Return in words what is impossible in a saved battery; empty if it may be resumed."""
    return implausible_belief(was.means, was.covariances, was.weights) or _implausible_memory(was)


def implausible_belief(means: list[Column], covariances: list[Square], weights: list[Weight]) -> str:
    """Return in words what is impossible in a sum of Gaussians as a belief about a battery; empty if it is possible.

    Only the sum must be plausible: a single member with a tiny weight may hold strange values.
    """
    if not len(means) == len(covariances) == len(weights):
        return "members of a belief without a mean, a covariance or a weight"
    if not abs(sum(weights) - 1.0) <= ROUNDED:
        return f"weights whose sum is {sum(weights):g}"
    x, P, weight = np.array(means), np.array(covariances), np.array(weights)
    if not (np.isfinite(x).all() and np.isfinite(P).all()):
        return "a belief that is no number"
    for covariance in P:
        if why_not := _no_covariance(covariance):
            return why_not
    return _implausible_moments(weight @ x, mixed_covariance(x, P, weight))


def _implausible_moments(mean: Array, covariance: Array) -> str:
    variance = np.diag(covariance)
    for component, ((low, high), (low_sd, high_sd)) in PLAUSIBLE.items():
        name = X._fields[component].lower()
        if not low <= mean[component] <= high:
            return f"a belief of {name} {mean[component]:g}"
        if not low_sd**2 <= variance[component] <= high_sd**2:
            return f"a belief that knows {name} to a variance of {variance[component]:g}"
    return ""


def _no_covariance(covariance: Array) -> str:
    """Return in words why a matrix [9, 9] is no covariance; empty if it is one."""
    variance = np.diag(covariance)
    if (variance < 0.0).any():
        return "a negative variance"
    scale = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    correlation = covariance / np.outer(scale, scale)
    if np.abs(correlation - correlation.T).max() > ASYMMETRY:
        return "a covariance that is not symmetric"
    if np.abs(correlation).max() > 1.0 + INDEFINITE or np.linalg.eigvalsh(correlation)[0] < -INDEFINITE:
        return "a covariance that is not one"
    return ""


def _implausible_memory(was: SavedBattery) -> str:
    largest_W = HIGHEST_C_RATE * was.capacity_Ah * was.cells * HIGHEST_CELL_V
    for name, number in _numbers("", (was.facts, was.past, {"_A": was.current_A, "_Ah": was.consumed_Ah})):
        largest = next((size for end, size in LARGEST.items() if name.endswith(end)), LARGEST_OTHER)
        if name.endswith("_W"):
            largest = min(largest, largest_W)
        if not (math.isnan(number) or abs(number) <= largest):
            return f"a memory of {name.strip('_')} {number:g}"
    flown = was.past.forecaster.flight
    if flown.flown_s < 0.0 or abs(flown.flown_J) > largest_W * flown.flown_s:
        return f"a memory of {flown.flown_J:g} J in {flown.flown_s:g} s"
    if not was.past.forecaster.route.is_possible:
        return "a memory of a route that no flight teaches"
    expected = was.past.forecaster.at_take_off
    if expected is not None and not expected.is_possible:
        return "a memory of a take-off that no forecast gives"
    if not flown.load.history.is_possible:
        return "a memory of powers that no flight asks"
    return ""


def _numbers(name: str, value: Any) -> Iterator[tuple[str, float]]:
    """Yield every number in a record and in the records inside it, with the name of its field."""
    if isinstance(value, bool) or value is None:
        return
    if isinstance(value, int | float):
        yield name, value
    elif is_dataclass(value):
        for field in fields(value):
            yield from _numbers(field.name, getattr(value, field.name))
    elif isinstance(value, tuple):
        for field_name, inner in zip(getattr(value, "_fields", [name] * len(value)), value, strict=True):
            yield from _numbers(field_name, inner)
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield from _numbers(key, inner)
