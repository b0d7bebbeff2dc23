"""One row a flight: the columns of the fleet's table, with their units in the names.

An unknown value is NaN, None or empty, never 0. `error_*_s` is forecast less truth at that time before the end, if the
log shows the end; positive is optimistic.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from datetime import datetime
from typing import Any

import msgspec

from uavbatt.nan_equal import nan_equal
from uavbatt.records import NAN

OK, BAD = "ok", "bad"
LOST = "lost"  # its bytes could not be read, or its worker died: the next run tries the log again
START_FORMAT = "%Y-%m-%dT%H:%M:%SZ"
LARGEST_INT = 2**63 - 1
IDENTITIES = ("battery_serial", "hardware", "system", "firmware", "kind")  # columns that may name an aircraft
CHECKPOINTS = ("half", "360", "240", "120", "60")


@nan_equal
@dataclass(frozen=True, slots=True, kw_only=True)
class FlightRow:
    """A FlightRow holds the result of one flight, the first of its log or a later one (`flight`).

    `status`: OK, or BAD or LOST with the reason in words.
    """

    file: str
    flight: int = 1
    status: str = OK
    reason: str = ""
    look: str = ""
    kind: str = ""
    aircraft: str = ""
    aircraft_from: str = ""  # --by, --aircraft or folder: a folder is no identity
    system: int | None = None
    hardware: str = ""
    firmware: str = ""
    battery_serial: str = ""
    instance: int | None = None
    instances: str = ""
    start_utc: str = ""
    duration_s: float = NAN
    air_s: float = NAN
    rows: int = 0
    battery: str = ""
    certificate: str = ""
    cells: int | None = None
    capacity_Ah: float = NAN
    cutoff_V: float = NAN
    charge_Ah: float = NAN
    energy_Wh: float = NAN
    mean_power_W: float = NAN
    temp_C: float = NAN
    end_voltage_V: float = NAN
    end_soc: float = NAN
    end_soc_sd: float = NAN
    end_of_flight_s: float = NAN
    refused_share: float = NAN
    mean_nis: float = NAN
    resistance_scale: float = NAN
    resistance_scale_sd: float = NAN
    capacity_scale: float = NAN
    capacity_scale_sd: float = NAN
    error_half_s: float = NAN
    error_360_s: float = NAN
    error_240_s: float = NAN
    error_120_s: float = NAN
    error_60_s: float = NAN
    inside_half: bool | None = None
    inside_360: bool | None = None
    inside_240: bool | None = None
    inside_120: bool | None = None
    inside_60: bool | None = None
    trust: str = ""
    skipped_bytes: int = 0
    warnings: str = ""
    size_bytes: int = 0

    def plain(self) -> dict[str, Any]:
        """Return it as a dictionary of plain values; NaN becomes None."""
        return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in asdict(self).items()}


def row_of(plain: Mapping[str, Any]) -> FlightRow:
    """Return the row of a dictionary that `FlightRow.plain` made; keys that this version does not know are left out.

    Raises ValueError when it is no row: a name is missing, a value is of another type or fits no table.
    """
    values = {name: NAN if plain[name] is None and kind == "float" else plain[name] for name, kind in COLUMNS
              if name in plain}  # fmt: skip
    try:
        row = msgspec.convert(values, FlightRow)
    except msgspec.ValidationError as error:
        raise ValueError(str(error)) from None
    if row.status not in (OK, BAD, LOST):
        raise ValueError(f"status `{row.status}`")
    if row.flight < 1:
        raise ValueError(f"flight {row.flight}")
    if row.start_utc:
        datetime.strptime(row.start_utc, START_FORMAT)
    if any(isinstance(value, int) and abs(value) > LARGEST_INT for value in values.values()):
        raise ValueError("a whole number beyond 64 bits")
    return row


COLUMNS: tuple[tuple[str, str], ...] = tuple((f.name, str(f.type)) for f in fields(FlightRow))
