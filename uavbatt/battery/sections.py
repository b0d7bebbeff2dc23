"""The sections of a battery file and the range of every number in them.

A number outside its range is a mistake of the unit, or damage: no flying battery has it. The ranges of an effect's
quantities are in `effects`; relations between keys are checked where the file is read.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from uavbatt.limits import CAPACITY_AH, MOST_CELLS

MOST_KNOTS = 4000
LOWEST_CELL_V, HIGHEST_CELL_V = 0.5, 5.0  # for every chemistry that flies, empty or full
LET_THROUGH = "its numbers are not what was sealed, or a verdict on them is fail; nobody vouches for them"

Cells = Annotated[int, msgspec.Meta(ge=1, le=MOST_CELLS)]
Capacity = Annotated[float, msgspec.Meta(ge=CAPACITY_AH[0], le=CAPACITY_AH[1])]
Spread = Annotated[float, msgspec.Meta(gt=0.0, le=2.0)]  # of a logarithm
Rate = Annotated[float, msgspec.Meta(gt=0.0, le=200.0)]  # [1/h]
AtLeastZero = Annotated[float, msgspec.Meta(ge=0.0)]
Positive = Annotated[float, msgspec.Meta(gt=0.0)]
SocKnots = Annotated[
    list[Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]], msgspec.Meta(min_length=2, max_length=MOST_KNOTS)
]
CellVoltages = list[Annotated[float, msgspec.Meta(ge=LOWEST_CELL_V, le=HIGHEST_CELL_V)]]
Resistances = list[Annotated[float, msgspec.Meta(ge=1e-4, le=1.0)]]  # [ohm·Ah]; cells have 0.003 to 0.3
Series = Annotated[list[float], msgspec.Meta(max_length=100_000)]
Volts = Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)]
Error = Annotated[float, msgspec.Meta(ge=0.0, le=100.0)]  # [V] or [K]
Lasting = Annotated[float, msgspec.Meta(ge=0.0, le=1e6)]  # [s]


class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Record is a section of the file: immutable, without unknown keys."""


class Battery(Record, frozen=True):
    """[battery] describes one type of pack; its voltages are the pack's."""

    name: str
    chemistry: str
    cells_series: Cells
    cutoff_V: Positive
    capacity_Ah: Capacity | None = None
    low_V: Positive | None = None
    source: str = ""
    remarks: list[str] = []


class ParameterTable(Record, frozen=True):
    """[parameters] holds the base model OCV + R0 per cell, and how far packs of the type scatter around it."""

    ocv_soc: SocKnots
    ocv_V: CellVoltages
    resistance_soc: SocKnots
    resistance_ohmAh: Resistances
    resistance_scale_sd: Spread
    capacity_scale_sd: Spread
    c_rate: Rate | None = None
    c_rate_sd: AtLeastZero | None = None
    spread_flights: Annotated[int, msgspec.Meta(ge=0)] | None = None  # over which the scatter was measured
    standard_error: dict[str, AtLeastZero] = {}


class EffectEntry(Record, frozen=True):
    """[[effects]] switches an effect on, with its parameters and their standard errors."""

    name: str
    parameters: dict[str, float]
    standard_error: dict[str, AtLeastZero] = {}


class Wander(Record, frozen=True):
    """[discrepancy.wander] describes how the model's error goes on over time, learned from effect-free records.

    Under load the voltage error is an Ornstein-Uhlenbeck process with the sd `voltage_sd_V` at the charges `soc` and
    the time constant `voltage_time_s`, plus white noise; at rest before take-off it is constant with the sd
    `rest_sd_V`. Volts are the pack's. No flight that began colder than `coldest_C` was used. Freshly charged
    packs of the records began with the charge `start_soc`; None: full by the file's own open-circuit voltage.
    """

    soc: SocKnots
    voltage_sd_V: list[Error]
    voltage_time_s: Annotated[float, msgspec.Meta(gt=0.0, le=1e6)]
    voltage_noise_V: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)]
    rest_sd_V: Error
    temperature_sd_K: Error
    temperature_time_s: Annotated[float, msgspec.Meta(gt=0.0, le=1e6)]
    temperature_noise_K: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)]
    coldest_C: Annotated[float, msgspec.Meta(ge=-60.0, le=100.0)] | None = None
    start_soc: Annotated[float, msgspec.Meta(ge=0.5, le=1.0)] | None = None


class Discrepancy(Record, frozen=True):
    """Discrepancy states the error of the model on effect-free data, per pack of `cells_series` cells: [discrepancy].

    Older files have no `wander`; their other numbers are used instead.
    """

    voltage_bias_V: Volts
    voltage_rmse_V: Error
    voltage_autocorrelation_s: Lasting
    temperature_rmse_K: Error
    held_out: bool
    source: str = ""
    wander: Wander | None = None


class CorridorSection(Record, frozen=True):
    """[corridor] holds the mean of repeated tests and its dispersion limit at one ambient temperature."""

    ambient_C: float
    time_s: Series
    mean_V: Series
    limit_V: Series
    runs: int
    occasions: int


class Verdict(Record, frozen=True):
    """A verdict says if one claim of the certificate holds, with the statistics and the reason."""

    claim: str
    verdict: Literal["pass", "fail", "not enough data"]
    ambient_C: float | None = None
    statistics: dict[str, float] = {}
    reason: str = ""


FITTED_LOW, FITTED_HIGH = "fitted_low_C", "fitted_high_C"  # statistics: the temperatures of the fitted records


class Certificate(Record, frozen=True):
    """Certificate says how the file was tested, and on which data: [certificate].

    The status `edited` is never written: it marks a file that was allowed in spite of its certificate.
    """

    status: Literal["certified", "fitted", "generic", "edited"]
    validated_ambient_C: list[float] = []
    verdicts: list[Verdict] = []
    statistics: dict[str, float] = {}
    data_sha256: str = ""
    content_sha256: str = ""
    date: str = ""
    tool_version: str = ""


class BatteryFile(Record, frozen=True):
    """BatteryFile holds the whole battery file, section by section."""

    battery: Battery
    parameters: ParameterTable
    effects: list[EffectEntry]
    discrepancy: Discrepancy
    certificate: Certificate
    corridor: CorridorSection | None = None

    def __repr__(self) -> str:
        """Return one line, without the long tables."""
        return f"<BatteryFile {self.battery.name}: {self.battery.cells_series}S, {self.status}>"

    @property
    def status(self) -> str:
        """Return `certified`, `fitted`, `generic`, or `edited` (allowed in spite of a broken hash or failed
        verdict)."""
        return self.certificate.status

    @property
    def is_measured(self) -> bool:
        """Return True if the numbers are known to come from data of this type of battery."""
        return self.certificate.status in ("certified", "fitted")

    @property
    def caveat(self) -> str:
        """Return the reason why the file is not certified; empty if it is."""
        if self.status == "certified":
            return ""
        return f"battery file is {self.status}, not certified" + (f": {LET_THROUGH}" if self.status == "edited" else "")
