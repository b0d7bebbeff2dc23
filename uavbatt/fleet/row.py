"""One row a flight: the columns of the fleet's table, with their units in the names.

What is not known is NaN, None or empty, never a zero. `error_*_s` is forecast less truth that long before the end,
where the log shows the end; positive is optimistic.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from typing import Any

from uavbatt.records import NAN

OK, BAD = "ok", "bad"
LOST = "lost"  # bytes not to be had, or a worker that died: not the log's own fault, tried again by the next run
CHECKPOINTS = ("half", "360", "240", "120", "60")


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """What is told of one flight. `status`: OK, or BAD or LOST with the reason in words."""

    file: str
    status: str = OK
    reason: str = ""
    look: str = ""
    kind: str = ""
    aircraft: str = ""
    system: int | None = None
    hardware: str = ""
    firmware: str = ""
    battery_serial: str = ""
    instance: int | None = None
    instances: str = ""
    start_utc: str = ""
    duration_s: float = NAN
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
        """As a dictionary of plain values; NaN becomes None."""
        return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in asdict(self).items()}


def row_of(plain: dict[str, Any]) -> Row:
    """The row of a dictionary that `Row.plain` made; keys that this version does not know are left out."""
    known = {f.name: f for f in fields(Row)}
    values = {name: value for name, value in plain.items() if name in known}
    for name, value in values.items():
        if value is None and known[name].type == "float":
            values[name] = NAN
    return Row(**values)


COLUMNS: tuple[tuple[str, str], ...] = tuple((f.name, str(f.type)) for f in fields(Row))
