"""Flights of a fleet gathered in one pass: each pack or aircraft over its life, and the errors of the forecasts.

A group is a battery with a serial number, else an aircraft by its flight controller's serial or by the options `--by`
and `--aircraft`; all its flights have the same cells and capacity. Flights that only share a folder are shown together
and never judged, because a folder may hold anything. Only numbers are kept of a flight, so that a page about very many
flights needs little memory.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.fleet.look import urgency
from uavbatt.fleet.row import FlightRow
from uavbatt.report.page import percent

CHECKPOINTS = {"half": "half time", "360": "360 s", "240": "240 s", "120": "120 s", "60": "60 s"}
ENOUGH_FLIGHTS = 4  # a line through fewer leaves too little to judge its own scatter by
LEAST_CHANGE = 0.05  # of a scale: packs of one make differ by that much when new
LEAST_SCALE, LEAST_SD = 1e-3, 1e-3  # no division by less
STEADY = 0.2  # a pack is called steady only if a larger growth is excluded
LISTED_SHARE, FEWEST_LISTED = 0.2, 4  # largest share of flights on the list of those to look at; of few flights, four
MOST_FILES = 3  # named for each reason; the table of flights holds all
MOST_LISTED = 100  # rows of a list that a person may read; the table of flights holds all
_FIGURE = re.compile(r"\d+(\.\d+)?")


@dataclass(frozen=True, slots=True)
class Change:
    """Change holds a scale early and late in a group's life, their difference and its standard deviation."""

    early: float
    late: float
    difference: float
    difference_sd: float

    @property
    def is_certain(self) -> bool:
        """Return True for a change of more than twice its own standard deviation that is big enough to matter."""
        return abs(self.difference) > max(2.0 * self.difference_sd, LEAST_CHANGE)

    @property
    def at_most(self) -> float:
        """Return the largest change that the flights leave possible (two sd), as a share of the early scale."""
        return (abs(self.difference) + 2.0 * self.difference_sd) / max(self.early, LEAST_SCALE)

    @property
    def visible(self) -> float:
        """Return the smallest change that these flights could have shown, as a share of the early scale."""
        return max(2.0 * self.difference_sd, LEAST_CHANGE) / max(self.early, LEAST_SCALE)


class AgeingVerdict(NamedTuple):
    """AgeingVerdict holds the verdict on one pack or aircraft, `grown`, `lost`, `steady` or `cannot tell`, and its
    words."""

    kind: str
    words: str


def verdict(group: Group, resistance: Change | None, capacity: Change | None) -> AgeingVerdict:
    """Judge the health of a group; it is steady only if its flights could have shown a change."""
    if not group.is_identified:
        return AgeingVerdict("cannot tell", "one folder is not one aircraft: give --by or --aircraft")
    if resistance is None or capacity is None:
        return AgeingVerdict("cannot tell", "too few flights")
    if resistance.is_certain and resistance.difference > 0.0:
        return AgeingVerdict("grown", f"ohms grown by {percent(resistance.difference / resistance.early)}")
    if capacity.is_certain and capacity.difference < 0.0:
        return AgeingVerdict("lost", f"capacity lost: {percent(-capacity.difference / capacity.early)}")
    if resistance.at_most <= STEADY:
        return AgeingVerdict("steady", f"steady to within {percent(resistance.at_most)}")
    return AgeingVerdict("cannot tell", f"cannot tell: growth below {percent(resistance.visible)} is not visible")


@dataclass(slots=True)
class Group:
    """Group collects the flights of one pack or aircraft in the order of the table."""

    name: str
    is_identified: bool = True  # by a serial or by the caller, not by a folder alone
    start_s: list[float] = field(default_factory=list)
    resistance: list[tuple[float, float]] = field(default_factory=list)  # scale and its standard deviation
    capacity: list[tuple[float, float]] = field(default_factory=list)
    flown_s: float = 0.0
    energy_Wh: float = 0.0

    def add(self, row: FlightRow) -> None:
        """Add one more flight."""
        start = datetime.fromisoformat(row.start_utc).timestamp() if row.start_utc else math.nan
        self.start_s.append(start)
        self.resistance.append((row.resistance_scale, row.resistance_scale_sd))
        self.capacity.append((row.capacity_scale, row.capacity_scale_sd))
        self.flown_s += row.air_s if math.isfinite(row.air_s) else row.duration_s
        self.energy_Wh += row.energy_Wh if math.isfinite(row.energy_Wh) else 0.0

    @property
    def flights(self) -> int:
        """Return the number of flights."""
        return len(self.start_s)

    @property
    def is_dated(self) -> bool:
        """Return True if the flights can be put on a calendar: all dates known, and not all the same."""
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


def precision(pairs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weights 1/sd² of scales with their sds, [flights, 2]."""
    weights: NDArray[np.float64] = 1.0 / np.maximum(pairs[:, 1], LEAST_SD) ** 2
    return weights


def _mean(pairs: NDArray[np.float64]) -> tuple[float, float]:
    """Return the weighted mean and its standard error, which is at least that of the scatter of the flights."""
    weight = precision(pairs)
    mean = float(np.average(pairs[:, 0], weights=weight))
    scatter = float(np.std(pairs[:, 0], ddof=1)) / math.sqrt(len(pairs))
    return mean, max(float(1.0 / math.sqrt(weight.sum())), scatter)


@dataclass(slots=True)
class Overview:
    """Overview holds all that the page of a fleet shows; `gathered` fills it."""

    groups: dict[str, Group] = field(default_factory=dict)
    errors: dict[str, list[float]] = field(default_factory=lambda: {key: [] for key in CHECKPOINTS})
    inside: dict[str, int] = field(default_factory=lambda: dict.fromkeys(CHECKPOINTS, 0))
    refused: dict[str, int] = field(default_factory=lambda: dict.fromkeys(CHECKPOINTS, 0))
    look: list[FlightRow] = field(default_factory=list)
    looked: int = 0
    reasons: dict[str, int] = field(default_factory=dict)  # without their figures
    failed: dict[str, list[str]] = field(default_factory=dict)  # reason -> the first few files
    failures: dict[str, int] = field(default_factory=dict)
    certificates: set[str] = field(default_factory=set)

    @property
    def flights(self) -> int:
        """Return the number of flights that could be replayed."""
        return sum(g.flights for g in self.groups.values())


def gathered(rows: Iterable[FlightRow]) -> Overview:
    """Gather the rows of a fleet in one pass."""
    overview = Overview()
    for row in rows:
        if row.status != "ok":
            overview.failures[row.reason] = overview.failures.get(row.reason, 0) + 1
            files = overview.failed.setdefault(row.reason, [])
            files += [row.file] if len(files) < MOST_FILES else []
            continue
        name, is_identified = _whose(row)
        overview.groups.setdefault(name, Group(name, is_identified)).add(row)
        overview.certificates.add(row.certificate)
        if row.look:
            overview.looked += 1
            overview.look = _most_urgent([*overview.look, row], MOST_LISTED)
            for reason in row.look.split("; "):
                kind = _FIGURE.sub("…", reason)
                overview.reasons[kind] = overview.reasons.get(kind, 0) + 1
        _score(overview, row)
    overview.look = _most_urgent(overview.look, max(math.ceil(LISTED_SHARE * overview.flights), FEWEST_LISTED))
    return overview


def _most_urgent(rows: Sequence[FlightRow], count: int) -> list[FlightRow]:
    return sorted(rows, key=urgency, reverse=True)[:count]


def _whose(row: FlightRow) -> tuple[str, bool]:
    """Return the name of a flight's pack or aircraft, and True if it is identified (not only by a folder)."""
    size = f"{row.cells or '?'}S {row.capacity_Ah:g} Ah" if math.isfinite(row.capacity_Ah) else f"{row.cells or '?'}S"
    if row.battery_serial:
        return f"battery {row.battery_serial} ({size})", True
    if row.aircraft_from in ("--by", "--aircraft") and row.aircraft:
        return f"{row.aircraft} ({size})", True
    if row.hardware:
        return f"aircraft {row.hardware} ({size})", True
    return f"folder {row.aircraft or '?'} ({size})", False


def _score(overview: Overview, row: FlightRow) -> None:
    for key in CHECKPOINTS:
        inside, error_s = getattr(row, f"inside_{key}"), getattr(row, f"error_{key}_s")
        if inside is None:
            continue
        overview.inside[key] += inside
        if math.isfinite(error_s):
            overview.errors[key].append(error_s)
        else:
            overview.refused[key] += 1
