"""Flights of a fleet gathered in one pass: each pack or aircraft over its life, and the errors of the forecasts.

A group is a battery with a serial number, else an aircraft. Only numbers are kept of a flight, so that a page about
very many flights stays small in memory.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from uavbatt.fleet.row import Row

CHECKPOINTS = {"half": "half time", "360": "360 s", "240": "240 s", "120": "120 s", "60": "60 s"}
ENOUGH_FLIGHTS = 4
MOST_LISTED = 100
_FIGURE = re.compile(r"\d+(\.\d+)?")


@dataclass(frozen=True, slots=True)
class Change:
    """A scale early and late in a group's life, their difference and its standard deviation."""

    early: float
    late: float
    difference: float
    difference_sd: float

    @property
    def is_certain(self) -> bool:
        """True for a change of more than twice its own standard deviation that is big enough to matter."""
        return abs(self.difference) > max(2.0 * self.difference_sd, 0.05)


@dataclass(slots=True)
class Group:
    """Flights of one pack or aircraft, in the order of the table; filled while the rows go by."""

    name: str
    start_s: list[float] = field(default_factory=list)
    resistance: list[tuple[float, float]] = field(default_factory=list)  # scale and its standard deviation
    capacity: list[tuple[float, float]] = field(default_factory=list)
    flown_s: float = 0.0
    energy_Wh: float = 0.0

    def add(self, row: Row) -> None:
        """Add one more flight."""
        start = datetime.fromisoformat(row.start_utc).timestamp() if row.start_utc else math.nan
        self.start_s.append(start)
        self.resistance.append((row.resistance_scale, row.resistance_scale_sd))
        self.capacity.append((row.capacity_scale, row.capacity_scale_sd))
        self.flown_s += row.duration_s
        self.energy_Wh += row.energy_Wh if math.isfinite(row.energy_Wh) else 0.0

    @property
    def flights(self) -> int:
        """Number of flights."""
        return len(self.start_s)

    @property
    def is_dated(self) -> bool:
        """True when the flights can be put on a calendar: all dates known, and not all the same."""
        start_s = np.array(self.start_s)
        return bool(np.all(np.isfinite(start_s)) and np.ptp(start_s) > 3600.0)

    def in_time(self, values: Sequence[tuple[float, float]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return positions and (scale, sd) by date, or by number where the dates are not known."""
        pairs = np.array(values, np.float64).reshape(-1, 2)
        if not self.is_dated:
            return np.arange(1.0, len(pairs) + 1.0), pairs
        order = np.argsort(self.start_s, kind="stable")
        return np.array(self.start_s)[order], pairs[order]


def change(group: Group, values: Sequence[tuple[float, float]]) -> Change | None:
    """Compare the first third of the flights with the last; None for too few flights."""
    _, pairs = group.in_time(values)
    if len(pairs) < ENOUGH_FLIGHTS:
        return None
    third = max(len(pairs) // 3, 2)
    early, late = _mean(pairs[:third]), _mean(pairs[-third:])
    return Change(early[0], late[0], late[0] - early[0], math.hypot(early[1], late[1]))


def _mean(pairs: NDArray[np.float64]) -> tuple[float, float]:
    """Weighted mean and its standard error, not smaller than the scatter of the flights says."""
    weight = 1.0 / np.maximum(pairs[:, 1], 1e-3) ** 2
    mean = float(np.average(pairs[:, 0], weights=weight))
    scatter = float(np.std(pairs[:, 0], ddof=1)) / math.sqrt(len(pairs))
    return mean, max(float(1.0 / math.sqrt(weight.sum())), scatter)


@dataclass(slots=True)
class Overview:
    """Everything that the page tells; filled by `gathered`."""

    groups: dict[str, Group] = field(default_factory=dict)
    errors: dict[str, list[float]] = field(default_factory=lambda: {key: [] for key in CHECKPOINTS})
    inside: dict[str, int] = field(default_factory=lambda: dict.fromkeys(CHECKPOINTS, 0))
    refused: dict[str, int] = field(default_factory=lambda: dict.fromkeys(CHECKPOINTS, 0))
    look: list[Row] = field(default_factory=list)
    looked: int = 0
    reasons: dict[str, int] = field(default_factory=dict)  # without their figures
    failed: dict[str, list[str]] = field(default_factory=dict)  # reason -> the first few files
    failures: dict[str, int] = field(default_factory=dict)
    certificates: set[str] = field(default_factory=set)

    @property
    def flights(self) -> int:
        """Number of flights that could be flown."""
        return sum(g.flights for g in self.groups.values())


def gathered(rows: Iterable[Row]) -> Overview:
    """Gather the rows of a fleet in one pass."""
    found = Overview()
    for row in rows:
        if row.status != "ok":
            found.failures[row.reason] = found.failures.get(row.reason, 0) + 1
            files = found.failed.setdefault(row.reason, [])
            files += [row.file] if len(files) < 3 else []
            continue
        name = f"battery {row.battery_serial}" if row.battery_serial else row.aircraft or "unknown aircraft"
        found.groups.setdefault(name, Group(name)).add(row)
        found.certificates.add(row.certificate)
        if row.look:
            found.looked += 1
            found.look += [row] if len(found.look) < MOST_LISTED else []
            for reason in row.look.split("; "):
                kind = _FIGURE.sub("…", reason)
                found.reasons[kind] = found.reasons.get(kind, 0) + 1
        _score(found, row)
    return found


def _score(found: Overview, row: Row) -> None:
    for key in CHECKPOINTS:
        inside, error_s = getattr(row, f"inside_{key}"), getattr(row, f"error_{key}_s")
        if inside is None:
            continue
        found.inside[key] += inside
        if math.isfinite(error_s):
            found.errors[key].append(error_s)
        else:
            found.refused[key] += 1
