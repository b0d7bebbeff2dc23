"""The values of a data set: runs, the uncertainties of their instruments, and flags of suspect entries.

A run is one (sample, run, ambient) triple; its occasion is its run number.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Positive = Annotated[float, msgspec.Meta(gt=0)]


@dataclass(frozen=True, slots=True)
class Run:
    """Run holds one discharge. NaN = not measured; positive current discharges."""

    sample: str
    run: int
    ambient_C: float
    time_s: Array
    voltage_V: Array
    current_A: Array
    surface_C: Array

    @property
    def place(self) -> str:
        """Return the run's name in an error: `sample A, run 1 at 25 °C`."""
        return f"sample {self.sample}, run {self.run} at {self.ambient_C:g} °C"

    @property
    def is_metered(self) -> bool:
        """Return True if the current was measured."""
        return bool(np.isfinite(self.current_A).all())


class Uncertainty(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Uncertainty states the standard uncertainties and resolutions of the instruments; None = not stated."""

    voltage_resolution_V: Positive | None = None
    voltage_calibration_V: Positive | None = None
    current_resolution_A: Positive | None = None
    current_calibration_A: Positive | None = None
    reading_time_s: Positive | None = None
    temperature_resolution_C: Positive | None = None
    temperature_calibration_C: Positive | None = None


class Flag(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Flag marks a suspect entry: where, what is printed, what it likely is, and why. It is never applied."""

    where: str
    kind: str
    reason: str
    printed: str = ""
    likely: str = ""
    sample: str | None = None
    run: int | None = None
    ambient_C: float | None = None
    time_s: float | None = None
    column: str | None = None


@dataclass(frozen=True, slots=True)
class DataSet:
    """DataSet holds repeated discharge tests of one type of battery; `sha256` is of the content of both files."""

    name: str
    chemistry: str
    cells_series: int
    capacity_Ah: float | None
    cutoff_V: float
    load: str
    source: str
    uncertainty: Uncertainty
    runs: tuple[Run, ...]
    sha256: str
    path: str
    flags: tuple[Flag, ...] = ()

    def __repr__(self) -> str:
        """Return one line, without the tables of the runs."""
        return f"<DataSet {self.name} of {self.path}: {len(self.runs)} runs, {len(self.ambients_C)} temperatures>"

    def at(self, ambient_C: float, tolerance_C: float = 0.25) -> tuple[Run, ...]:
        """Return the runs at one ambient temperature [°C], within `tolerance_C`."""
        return tuple(r for r in self.runs if abs(r.ambient_C - ambient_C) <= tolerance_C)

    @property
    def is_metered(self) -> bool:
        """Return True if the current of most runs was measured: a model is fitted to these, and predicts these."""
        return 2 * sum(run.is_metered for run in self.runs) > len(self.runs)

    @property
    def ambients_C(self) -> tuple[float, ...]:
        """Return every ambient temperature of the set, ascending [°C]."""
        return tuple(sorted({r.ambient_C for r in self.runs}))

    @property
    def first_V(self) -> float:
        """Return the highest voltage that a run begins with [V]; NaN without runs."""
        return max((float(run.voltage_V[0]) for run in self.runs), default=float("nan"))
