"""Rows of a log as numpy columns, for the readers of big logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbatt.records import NAN, Sample

Column = NDArray[np.float64]
Order = NDArray[np.int64]

UNKNOWN = 2  # value of `armed`; 0 is no, 1 is yes
_ARMED = (False, True, None)


@dataclass(frozen=True, slots=True)
class Columns:
    """Columns hold battery rows, one entry a row; NaN is unknown. `cells_V` has a line for each row, or is None."""

    time_s: Column
    voltage_V: Column
    current_A: Column
    temp_C: Column
    consumed_Ah: Column
    reported_soc: Column
    armed: NDArray[np.int8]
    cells_V: NDArray[np.float64] | None = None

    def at(self, chosen: Any) -> Columns:
        """Return some of the rows, chosen by mask or index."""
        return Columns(
            time_s=self.time_s[chosen],
            voltage_V=self.voltage_V[chosen],
            current_A=self.current_A[chosen],
            temp_C=self.temp_C[chosen],
            consumed_Ah=self.consumed_Ah[chosen],
            reported_soc=self.reported_soc[chosen],
            armed=self.armed[chosen],
            cells_V=None if self.cells_V is None else self.cells_V[chosen],
        )

    @property
    def first_current_s(self) -> float:
        """Return the time of the first row that reports a current [s]; NaN if none does."""
        known = np.isfinite(self.current_A)
        return float(self.time_s[np.argmax(known)]) if known.any() else NAN

    def samples(self) -> list[Sample]:
        """Return the rows as samples."""
        columns = (self.time_s, self.voltage_V, self.current_A, self.temp_C, self.consumed_Ah, self.reported_soc)
        armed = [_ARMED[a] for a in self.armed.tolist()]
        numbers = [_as_list(c) for c in columns]
        if self.cells_V is None:
            return list(map(Sample, *numbers, armed))
        return list(map(Sample, *numbers, armed, [_without_nan(line) for line in self.cells_V.tolist()]))


def _as_list(column: Column) -> list[float]:
    """Return the numbers as a list, every NaN as the object `records.NAN`, so that equal rows compare as equal."""
    unknown = np.isnan(column)
    if unknown.all():
        return [NAN] * len(column)
    return [NAN if v != v else v for v in column.tolist()] if unknown.any() else column.tolist()


def _without_nan(cells_V: list[float]) -> tuple[float, ...]:
    return tuple(v for v in cells_V if v == v)


def rows_of(samples: Sequence[Sample]) -> Columns:
    """Return samples as columns."""
    numbers = [(s.time_s, s.voltage_V, s.current_A, s.temp_C, s.consumed_Ah, s.reported_soc) for s in samples]
    width = max((len(s.cell_voltages_V) for s in samples), default=0)
    cells_V = [[*s.cell_voltages_V, *[NAN] * (width - len(s.cell_voltages_V))] for s in samples]
    time_s, voltage_V, current_A, temp_C, consumed_Ah, reported_soc = np.array(numbers, np.float64).reshape(-1, 6).T
    armed = np.array([_ARMED.index(s.armed) for s in samples], np.int8)
    cells = np.array(cells_V, np.float64) if width else None
    return Columns(time_s, voltage_V, current_A, temp_C, consumed_Ah, reported_soc, armed, cells)


def distinct(values: NDArray[Any]) -> list[int]:
    """Return the different whole numbers in the order of their first appearance.

    np.unique is not used, because it imports a fifth of numpy more.
    """
    found: list[int] = []
    while len(values):
        found.append(int(values[0]))
        values = values[values != values[0]]
    return found


def latest_before(order: Order, events: Order) -> Order:
    """Return the index of the last of `events` before each place of `order` (both ascending), -1 where none is."""
    return np.asarray(events.searchsorted(order, side="left") - 1, np.int64)
