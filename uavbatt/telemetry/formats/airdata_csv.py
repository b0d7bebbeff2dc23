"""The CSV export of AirData: a flight of a DJI aircraft, ten rows a second from its start.

    time(millisecond)           since the start
    voltage(v), current(A)      of the pack; positive discharges; 0 V until the pack has spoken
    voltageCell1 ..             of the cells; 0 for a cell that the pack does not have
    battery_temperature(c)      or (f), by the units of the account
    datetime(utc)               of the row, to a second: the first is the date of the flight
The pack's own percentage is not read. The capacity is not in the file.
"""

from __future__ import annotations

from datetime import UTC, datetime

from uavbatt.records import NAN, Identity
from uavbatt.telemetry.builder import LogBuilder
from uavbatt.telemetry.formats.logger_table import FAHRENHEIT, MILLI, NUMBER, Columns, first_words, read_rows
from uavbatt.telemetry.formats.smart_pack import add_rows, cells_of
from uavbatt.telemetry.identity import utc_s

COLUMNS: Columns = {
    "time_s": {"time(millisecond)": MILLI},
    "voltage_V": {"voltage(v)": NUMBER},
    "current_A": {"current(A)": NUMBER},
    "temp_C": {"battery_temperature(c)": NUMBER, "battery_temperature(f)": FAHRENHEIT},
    **{ours: {theirs: NUMBER} for ours, theirs in cells_of("voltageCell{}").items()},
}
WORDS = {"start_utc": ("datetime(utc)",)}


def read_airdata(source: str, data: bytes) -> LogBuilder:
    """Read the rows of an export of AirData; `source` names it in errors. Raises BadInput for a bad table."""
    said = first_words(data, WORDS).get("start_utc", "")
    log = LogBuilder(identity=Identity(start_utc_s=_utc_s(said)))
    add_rows(read_rows(source, data, COLUMNS, ("time_s", "voltage_V"), log), log)
    return log


def _utc_s(said: str) -> float:
    """Return the seconds since 1970 of a time as `2026-05-01 10:00:00`; NaN for anything else."""
    try:
        return utc_s(datetime.fromisoformat(said).replace(tzinfo=UTC).timestamp())
    except ValueError:
        return NAN
