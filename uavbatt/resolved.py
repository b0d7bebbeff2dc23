"""The pack that is estimated, as told by the caller, the vehicle, the voltage and the battery file, in this order."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uavbatt.battery.file import BatteryFile
from uavbatt.errors import UsageError
from uavbatt.prediction.learned import UnknownAircraft
from uavbatt.prediction.load import Load
from uavbatt.records import NAN, PackFacts

FULLEST_CELL_V = 4.40  # cells are sold that charge to 4.35 V
EMPTIEST_CELL_V = 3.0


@dataclass(frozen=True, slots=True)
class PackOptions:
    """What the caller states of the pack; None or NaN = not stated."""

    cells: int | None = None
    capacity_Ah: float = NAN
    cutoff_V: float = NAN
    low_V: float = NAN
    reserve_soc: float = 0.0
    ambient_C: float = NAN
    load: Load = UnknownAircraft()
    forecast_period_s: float = 5.0


@dataclass(frozen=True, slots=True)
class Resolved:
    """The pack as it is estimated, and where each number came from."""

    battery: str
    status: str
    cells: int
    cells_from: str
    capacity_Ah: float
    capacity_from: str
    cutoff_V: float
    cutoff_from: str
    low_V: float
    low_from: str

    @property
    def words(self) -> str:
        """The size of the pack and its cut-off, each with where it came from."""
        return (
            f"{self.cells}S from {self.cells_from}, {self.capacity_Ah:g} Ah from {self.capacity_from}, "
            f"cut-off {self.cutoff_V:g} V from {self.cutoff_from}"
        )


def resolve(
    battery: BatteryFile,
    given: PackOptions,
    said: PackFacts,
    guessed_cells: int,
    guessed_from: str = "first voltage",
) -> Resolved:
    """Stated by the caller, else by the vehicle, else guessed (cells) or by the battery file.

    Raises UsageError when nobody states the capacity.
    """
    typed = battery.battery
    cells, cells_from = _first((given.cells, "--cells"), (said.cells_series, "vehicle"), (guessed_cells, guessed_from))
    capacity_Ah, capacity_from = _first(
        (given.capacity_Ah, "--capacity-ah"), (said.capacity_Ah, "vehicle"), (typed.capacity_Ah, "battery file")
    )
    if not math.isfinite(capacity_Ah):
        raise UsageError(f"capacity: neither the vehicle nor battery `{typed.name}` states one: give --capacity-ah")
    share = cells / typed.cells_series
    cutoff_V, cutoff_from = _first(
        (given.cutoff_V, "--cutoff-voltage"),
        (said.critical_voltage_V, "vehicle"),
        (typed.cutoff_V * share, "battery file"),
    )
    low_V, low_from = _first(
        (given.low_V, "--low-voltage"),
        (said.low_voltage_V, "vehicle"),
        (None if typed.low_V is None else typed.low_V * share, "battery file"),
        (NAN, "nobody"),
    )
    return Resolved(
        battery=typed.name,
        status=battery.status,
        cells=int(cells),
        cells_from=cells_from,
        capacity_Ah=float(capacity_Ah),
        capacity_from=capacity_from,
        cutoff_V=float(cutoff_V),
        cutoff_from=cutoff_from,
        low_V=float(low_V),
        low_from=low_from,
    )


def certificate_remark(battery: BatteryFile, pack: Resolved) -> str:
    """What the certificate does not cover of this pack; empty when it covers it."""
    typed = battery.battery
    if battery.caveat:
        return battery.caveat
    if (pack.cells, pack.capacity_Ah) == (typed.cells_series, typed.capacity_Ah):
        return ""
    size = f"{typed.cells_series}S" + (f" {typed.capacity_Ah:g} Ah" if typed.capacity_Ah else "")
    return f"the certificate is for a {size} pack; this one is scaled from it"


def cells_from_voltage(voltage_V: float, typical: int) -> int:
    """Cells in series that fit the first voltage: the battery file's own if plausible, else the fewest."""
    if EMPTIEST_CELL_V <= voltage_V / typical <= FULLEST_CELL_V:
        return typical
    return max(1, math.ceil(voltage_V / FULLEST_CELL_V))


def _first(*candidates: tuple[float | int | None, str]) -> tuple[float, str]:
    """The first candidate that is known, with its source; NaN and the last source when none is."""
    for value, source in candidates:
        if value is not None and math.isfinite(value):
            return value, source
    return NAN, candidates[-1][1]
