"""Conversion between records and rows of the ledger: columns have the fields' names; NaN and infinity are NULL."""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from uavbatt.battery.high_voltage import ORDINARY_FULL_V
from uavbatt.packs.records import FlightEvidence, FlightRecord, LedgerFlight, Outlook, PackBelief, PackFinding, PackRow
from uavbatt.records import NAN

OUTLOOK = tuple(field.name for field in fields(Outlook))
RETIRE = ("retire_flights", "retire_lo_flights", "retire_hi_flights")
KNOWN = ("known_log_ohm", "known_log_Ah", "known_ohm_trend", "known_Ah_trend")
UPPER = np.triu_indices(4)


class DamagedRow(Exception):
    """DamagedRow is raised for a row whose value is missing, of a wrong type, or not finite where it must be."""


@contextmanager
def reading(row: sqlite3.Row) -> Iterator[None]:
    """Yield for the reading of a row's values. Raises DamagedRow, which names the row by its first column, a number."""
    try:
        yield
    except (ValueError, TypeError, LookupError, RecursionError) as error:  # a column that is not there is an IndexError
        raise DamagedRow(f"row {row[0]}: {error}") from None


def flight_row(flight: FlightRecord) -> dict[str, Any]:
    """Return the columns of a flight as it was flown."""
    row = asdict(flight)
    row.pop("told")
    row.update({f"told_{name}": value for name, value in flight.told._asdict().items()})
    return {name: column_value(value) for name, value in row.items()}


def flight_of(row: sqlite3.Row) -> FlightRecord:
    """Return a flight as it was flown. Raises DamagedRow."""
    with reading(row):
        told = FlightEvidence(*(float(row[f"told_{name}"]) for name in FlightEvidence._fields))
        there = set(row.keys())  # an older ledger that is only read lacks the newer columns
        values = {f.name: row[f.name] for f in fields(FlightRecord) if f.name in there}
        unknown = {f.name: NAN for f in fields(FlightRecord) if f.default is not None and values.get(f.name, 0) is None}
        return FlightRecord(**{**values, **unknown}, told=told)


def remembered_row(found: LedgerFlight) -> dict[str, Any]:
    """Return the columns of the belief after a flight."""
    mean = dict(zip(KNOWN, (float(value) for value in found.known.mean), strict=True))
    upper = [float(f"{value:.6g}") for value in found.known.covariance[UPPER]]
    known = {**mean, "known_covariance": json.dumps(upper), "known_fullest_cell_V": found.fullest_cell_V}
    return {**known, "findings": findings_text(found.findings)}


def remembered_of(row: sqlite3.Row) -> LedgerFlight:
    """Return a flight with the belief after it. Raises DamagedRow."""
    with reading(row):
        covariance = np.zeros((4, 4))
        covariance[UPPER] = json.loads(row["known_covariance"])
        covariance = covariance + np.triu(covariance, 1).T
        mean = np.array([float(row[name]) for name in KNOWN])
        if not (np.isfinite(mean).all() and np.isfinite(covariance).all() and (np.diag(covariance) > 0.0).all()):
            raise ValueError("the belief about the pack is not finite, or has no positive variance")
        fullest_V = row["known_fullest_cell_V"] if "known_fullest_cell_V" in set(row.keys()) else None
        known, findings = PackBelief(mean, covariance), findings_of(row["findings"])
        return LedgerFlight(flight_of(row), known, findings, float(fullest_V or ORDINARY_FULL_V))


def pack_row(pack: PackRow) -> dict[str, Any]:
    """Return the columns of a pack."""
    row = {"name": pack.name, "cells": pack.cells, "rated_Ah": pack.rated_Ah, "type_ohm": pack.type_ohm}
    row |= {"last_utc_s": pack.last_utc_s, **asdict(pack.outlook), "findings": findings_text(pack.findings)}
    return {name: column_value(value) for name, value in row.items()}


def pack_of(row: sqlite3.Row) -> PackRow:
    """Return a pack as it stands. Raises DamagedRow."""
    with reading(row):
        outlook = {name: row[name] for name in OUTLOOK}
        outlook |= {name: math.inf for name in RETIRE if row[name] is None}
        size = (int(row["cells"]), float(row["rated_Ah"]), float(row["type_ohm"]), known_or_nan(row["last_utc_s"]))
        return PackRow(row["name"], *size, Outlook(**outlook), findings_of(row["findings"]))


def findings_text(findings: tuple[PackFinding, ...]) -> str:
    """Return findings as JSON; empty text where there are none."""
    return json.dumps([asdict(f) for f in findings], ensure_ascii=False) if findings else ""


def findings_of(text: str) -> tuple[PackFinding, ...]:
    """Return findings from their JSON."""
    return tuple(PackFinding(**entry) for entry in json.loads(text)) if text else ()


def column_value(value: Any) -> Any:
    """Return a value as its column holds it: NaN and infinity are NULL."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def known_or_nan(value: float | None) -> float:
    """Return the number of a column; NaN where it is NULL."""
    return NAN if value is None else float(value)
