"""Replay output: one line per telemetry row, as JSON Lines or CSV.

`COLUMNS` is the one list of keys, for both formats and for every other view of a line. A line is made once by `line`
and is the same everywhere: unknown (NaN), unbounded (inf) and refused numbers are `None`, which is `null` in JSON Lines
and an empty cell in CSV; `warnings` is a list, joined with `; ` in CSV.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Protocol, TextIO

import msgspec

from uavbatt.files import atomic_write, json_for
from uavbatt.records import Estimate, Remaining, Route, Status

COLUMNS: Mapping[str, int | None] = {
    "time_s": 3,
    "soc": 5,
    "soc_sd": 5,
    "remaining_s": 1,
    "remaining_lo_s": 1,
    "remaining_hi_s": 1,
    "remaining_to_low_s": 1,
    "voltage_V": 4,
    "current_A": 4,
    "temp_C": 2,
    "power_W": 3,
    "innovation_V": 5,
    "status": None,
    "reason": None,
    "warnings": None,
}
"""Key -> decimals (None: not a number). Each step lies well under what the sensor or the model can tell."""

ROUTE_COLUMNS: Mapping[str, int | None] = {
    "load": None,
    "route_left_s": 1,
    "route_soc": 4,
    "route_soc_lo": 4,
    "route_soc_hi": 4,
    "route_risk": 4,
    "home_soc": 4,
    "home_soc_lo": 4,
    "turn_back_s": 1,
    "turn_back_lo_s": 1,
    "turn_back_hi_s": 1,
    "route_reason": None,
}
"""The keys that a line has in addition where a route or home is known."""

REMAINING_KEYS = ("remaining_s", "remaining_lo_s", "remaining_hi_s", "remaining_to_low_s")
SOC_KEYS = ("soc", "soc_sd")

Value = float | str | list[str] | None
Line = dict[str, Value]


def speaker(estimate: Estimate, remaining: Remaining) -> Estimate | Remaining:
    """Return whose status and reason count for a row: the forecast's, or the estimate's if the forecast is ok.

    The forecast is the number that matters, and it is never better than the estimate that it comes from.
    """
    return estimate if remaining.status is Status.OK else remaining


def line(estimate: Estimate, remaining: Remaining) -> Line:
    """Return the output line of one row; its keys are `COLUMNS`, then those of a route where one is known.

    Status and reason are those of the `speaker`. A refused number is None, whatever its value; if the estimate is
    refused, so is the forecast.
    """
    refused: tuple[str, ...] = ()
    if estimate.status is Status.REFUSED:
        refused = SOC_KEYS + REMAINING_KEYS
    elif remaining.status is Status.REFUSED:
        refused = REMAINING_KEYS
    made: Line = {
        key: None if key in refused else rounded(getattr(remaining if key in REMAINING_KEYS else estimate, key), digits)
        for key, digits in COLUMNS.items()
        if digits is not None
    }
    said = speaker(estimate, remaining)
    made["status"], made["reason"] = said.status.value, str(said.reason)
    made["warnings"] = [str(warning) for warning in estimate.warnings]  # msgspec encodes no subclass of str
    return made if remaining.route is None else made | _route(remaining.route)


def _route(route: Route) -> Line:
    """Return the values of `ROUTE_COLUMNS`, in that order."""
    values = {key: getattr(route, key.removeprefix("route_")) for key in ROUTE_COLUMNS}
    values["route_reason"] = "; ".join(filter(None, (route.reason, route.assumed)))
    return {
        key: values[key] if digits is None else rounded(values[key], digits) for key, digits in ROUTE_COLUMNS.items()
    }


def clock(seconds: float, unknown: str = "unknown") -> str:
    """Return a time [s] as minutes and seconds, `12:05`; the word `unknown` if it is not finite."""
    if not math.isfinite(seconds):
        return unknown
    minutes, rest = divmod(round(abs(seconds)), 60)
    sign = "\N{MINUS SIGN}" if seconds < 0 and (minutes or rest) else ""
    return f"{sign}{minutes}:{rest:02d}"


def counted(n: int, noun: str) -> str:
    """Return a count with the name of what is counted, in the plural where there is not one: `3 flights`."""
    return f"{n} {noun}{'' if n == 1 else 's'}"


def rounded(value: float, decimals: int) -> float | None:
    """Return `value` to `decimals` places; None when it is not finite, and never a negative zero."""
    return round(float(value), decimals) + 0.0 if math.isfinite(value) else None


class Sink(Protocol):
    """A sink takes the lines in order."""

    def write(self, line: Line) -> None:
        """Write one line."""


class JsonLinesSink:
    """JsonLinesSink writes one JSON object a line, with the keys in the order of `COLUMNS`."""

    def __init__(self, file: TextIO) -> None:
        self._file = file

    def write(self, line: Line) -> None:
        """Write one line; raises KeyError here rather than at the reader for a key too many or too few."""
        self._file.write(json_for(self._file, msgspec.json.encode(in_order(line)).decode()) + "\n")


class CsvSink:
    """CsvSink writes a header row, then one row a line; an empty cell is what JSON Lines calls null."""

    def __init__(self, file: TextIO, *, with_route: bool) -> None:
        self._rows = csv.writer(file, lineterminator="\n")
        self._columns = (*COLUMNS, *(ROUTE_COLUMNS if with_route else ()))
        self._rows.writerow(self._columns)

    def write(self, line: Line) -> None:
        """Write one row; what the line does not have is an empty cell."""
        found = in_order(line)
        values = (found.get(key) for key in self._columns)
        self._rows.writerow("; ".join(value) if isinstance(value, list) else value for value in values)


def in_order(line: Line) -> Line:
    """Return `line` with exactly the keys of `COLUMNS`, in their order; with a route those of `ROUTE_COLUMNS` behind.

    Raises KeyError for a key too many or too few.
    """
    declared = (*COLUMNS, *(ROUTE_COLUMNS if "load" in line else ()))
    if line.keys() != set(declared):
        raise KeyError(f"line keys differ from the declared ones: {sorted(line.keys() ^ set(declared))}")
    return {key: line[key] for key in declared}


@contextmanager
def _opened(path: str | Path, kind: Callable[[TextIO], Sink]) -> Iterator[Sink]:
    with atomic_write(path) as file:
        yield kind(file)


def json_lines(path: str | Path) -> AbstractContextManager[Sink]:
    """Return a context that gives a JSON Lines sink to `path` (`-`: standard output)."""
    return _opened(path, JsonLinesSink)


def csv_table(path: str | Path, with_route: bool = False) -> AbstractContextManager[Sink]:
    """Return a context that gives a CSV sink to `path` (`-`: standard output); `with_route` adds a route's columns."""
    return _opened(path, lambda file: CsvSink(file, with_route=with_route))
