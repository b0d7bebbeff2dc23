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


LONG_SPAN = 6  # instants in a row: from so many on, only the first and the last are named


def minutes(times_s: Iterable[float]) -> str:
    """Return times [s] as a list in minutes, many whole minutes in a row as `2 to 9`."""
    spans: list[list[float]] = []
    for minute in (t / 60 for t in times_s):
        if spans and minute == spans[-1][-1] + 1:
            spans[-1].append(minute)
        else:
            spans.append([minute])
    return ", ".join(_span(span) for span in spans) + " min"


def _span(span: list[float]) -> str:
    ends = len(span) >= LONG_SPAN
    return f"{span[0]:g} to {span[-1]:g}" if ends else ", ".join(f"{minute:g}" for minute in span)
