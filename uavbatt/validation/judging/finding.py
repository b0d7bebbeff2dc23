"""A finding about the tests, and the words that findings share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

NAMES = {"voltage_V": "voltage", "surface_C": "surface temperature"}
UNITS = {"voltage_V": "V", "surface_C": "°C"}


@dataclass(frozen=True, slots=True)
class Finding:
    """A finding tells one thing about the tests; `severity` is what it means for trust in the result."""

    kind: str
    title: str
    detail: str
    severity: Literal["serious", "warning", "note"]
    numbers: Mapping[str, float] = field(default_factory=dict)


def minutes(times_s: Iterable[float]) -> str:
    """Return times [s] as a list in minutes."""
    return ", ".join(f"{t / 60:g}" for t in times_s) + " min"
