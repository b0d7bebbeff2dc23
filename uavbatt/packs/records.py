"""Records of the ledger about packs and flights: frozen values, in ohms and ampere-hours.

A pack's health is ln of its resistance [ohm per cell, at 25 °C and half charge] and ln of its capacity [Ah]. Neither
depends on the battery file that the flight was read with, so that the ledger stays valid with a new file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from uavbatt.battery.high_voltage import ORDINARY_FULL_V
from uavbatt.battery.model import Array
from uavbatt.nan_equal import nan_equal
from uavbatt.records import NAN

OWN = "@"  # joins the hash of a log's first rows and the start of the flight, if two flights have the same first rows


class FlightEvidence(NamedTuple):
    """FlightEvidence holds what one flight shows of a pack: ln of ohms and of ampere-hours, variances, covariance."""

    log_ohm: float
    log_Ah: float
    variance_ohm: float
    variance_Ah: float
    covariance: float

    @property
    def mean(self) -> Array:
        """Return the mean [2]: ln of ohms, ln of ampere-hours."""
        return np.array([self.log_ohm, self.log_Ah])

    @property
    def matrix(self) -> Array:
        """Return the covariance [2, 2]."""
        return np.array([[self.variance_ohm, self.covariance], [self.covariance, self.variance_Ah]])


@nan_equal
@dataclass(frozen=True, slots=True)
class FlightRecord:
    """A FlightRecord holds one flight of one pack; it does not depend on the flights before it."""

    key: str  # hash of the log's first rows, the same for the same log; with OWN if two flights have the same rows
    told: FlightEvidence
    cells: int
    rated_Ah: float
    type_ohm: float  # resistance of a cell by the battery file, at 25 °C and half charge
    battery: str
    battery_sha256: str
    start_utc_s: float = NAN
    duration_s: float = NAN
    source: str = ""  # the log's name
    soc_start: float = NAN
    soc_end: float = NAN
    charge_Ah: float = NAN
    energy_Wh: float = NAN
    temp_mean_C: float = NAN
    temp_max_C: float = NAN
    weak_cell: int = 0  # number of the lowest cell under load, from 1; 0 if cells are not measured
    weak_cell_V: float = NAN  # distance below the mean of the cells
    cycles: int | None = None  # by the pack's own counter
    fullest_cell_V: float = NAN  # voltage of a full cell at rest, at least ORDINARY_FULL_V

    @property
    def has_thermometer(self) -> bool:
        """Return True if the temperature of the pack was measured."""
        return math.isfinite(self.temp_mean_C)

    def is_same_as(self, other: FlightRecord) -> bool:
        """Return True if two records are of one flight: their times overlap, or, without a clock, their keys agree."""
        if math.isnan(self.start_utc_s + other.start_utc_s):
            return self.key == other.key
        return _overlap(self, other)  # keys may agree by chance: many flights begin with a full pack at rest

    def is_of(self, key: str, start_utc_s: float) -> bool:
        """Return True if this flight is of the log with that key and start [s since 1970; NaN if unknown]."""
        if self.start_utc_s == start_utc_s:
            return self.key.partition(OWN)[0] == key.partition(OWN)[0]
        return math.isnan(self.start_utc_s + start_utc_s) and self.key == key

    def with_own_key(self) -> FlightRecord:
        """Return the record with a key of its own, for a flight whose log has the same first rows as another's."""
        return replace(self, key=f"{self.key}{OWN}{self.start_utc_s:.3f}")


def _overlap(a: FlightRecord, b: FlightRecord) -> bool:
    """Return True if the flights, whose starts are known, share more than half of the shorter one's time."""
    if a.start_utc_s == b.start_utc_s:
        return True
    shared_s = min(a.start_utc_s + a.duration_s, b.start_utc_s + b.duration_s) - max(a.start_utc_s, b.start_utc_s)
    return shared_s > 0.5 * min(a.duration_s, b.duration_s)


class PackBelief(NamedTuple):
    """PackBelief holds the belief about a pack after a flight: mean [4] and covariance [4, 4].

    ln of ohms, ln of ampere-hours, and the change of both from flight to flight.
    """

    mean: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class PackFinding:
    """A PackFinding is something odd that a flight showed of its pack: `kind` for programs, `words` for people."""

    # of sudden_ohms, sudden_loss, another_pack, weak_cell, charged_too_fast, counter, higher_charge, generic_file
    kind: str
    words: str


class LedgerFlight(NamedTuple):
    """LedgerFlight holds a flight of the ledger, the belief about the pack after it, and its findings."""

    flight: FlightRecord
    known: PackBelief
    findings: tuple[PackFinding, ...]
    fullest_cell_V: float = ORDINARY_FULL_V  # highest of all flights so far


@dataclass(frozen=True, slots=True)
class Outlook:
    """An Outlook tells of a pack's health with 90 % intervals, its trend, and when to retire it."""

    flights: int
    capacity_Ah: float
    capacity_lo_Ah: float
    capacity_hi_Ah: float
    resistance_ohm: float
    resistance_lo_ohm: float
    resistance_hi_ohm: float
    capacity_trend: float  # relative change a flight
    capacity_trend_sd: float
    resistance_trend: float
    resistance_trend_sd: float
    retire_flights: float  # until the capacity is RETIRED_AT of the rated one; infinite where no end is in sight
    retire_lo_flights: float
    retire_hi_flights: float


@dataclass(frozen=True, slots=True)
class PackRow:
    """A PackRow holds one pack of the ledger, as it stands after its last flight."""

    name: str
    cells: int
    rated_Ah: float
    type_ohm: float
    last_utc_s: float
    outlook: Outlook
    findings: tuple[PackFinding, ...]
