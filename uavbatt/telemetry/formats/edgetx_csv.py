"""The log that a radio with EdgeTX or OpenTX writes on its SD card, of what the aircraft sends down to it.

    Date, Time          of the radio's clock; a file may hold several flights of a day
    VFAS(V)             voltage of the pack by FrSky's sensor, with Rotorflight Vbat(V), over Crossfire or ELRS RxBt(V)
    Curr(A)             current; positive discharges
    Capa(mAh)           charge drawn, counted by the aircraft: if it begins again, the pack was changed
    FM                  flight mode; `*` behind it (Betaflight), `OK`, `WAIT` and `!ERR` (INAV) mean disarmed
    RQly(%), RSSI(dB)   quality of the link. At 0 it is lost, and the radio writes the last reading again and again
The radio writes up to ten rows a second of a few readings: see `smart_pack`. The percentage is not read. The file does
not tell the capacity, nor the zone of the clock.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from datetime import date, time

from uavbatt.records import NAN
from uavbatt.telemetry.builder import LogBuilder
from uavbatt.telemetry.formats.logger_table import MILLI, NUMBER, Columns, TableRow, read_rows
from uavbatt.telemetry.formats.smart_pack import add_rows

DAY_S = 86_400.0
DISARMED = ("OK", "WAIT", "!ERR")
TELLING = ("voltage_V", "current_A", "motors")  # a row that changes none of them repeats the one before it
LOST = "rows without a link to the aircraft dropped"


def _day_s(cell: str) -> float:
    """Return the beginning of a day as `2026-05-01` [s]."""
    return DAY_S * date.fromisoformat(cell).toordinal()


def _clock_s(cell: str) -> float:
    """Return the time since midnight [s] of a clock as `16:39:41.300`."""
    clock = time.fromisoformat(cell)
    return 3600.0 * clock.hour + 60.0 * clock.minute + clock.second + 1e-6 * clock.microsecond


def _is_disarmed(cell: str) -> float:
    """Return 1 for a flight mode that only a disarmed aircraft shows, else 0."""
    return float(cell.endswith("*") or cell in DISARMED)


COLUMNS: Columns = {
    "time_s": {"Time": _clock_s},
    "day_s": {"Date": _day_s},
    "voltage_V": {"VFAS(V)": NUMBER, "Vbat(V)": NUMBER, "RxBt(V)": NUMBER},
    "current_A": {"Curr(A)": NUMBER},
    "consumed_Ah": {"Capa(mAh)": MILLI},
    "is_disarmed": {"FM": _is_disarmed},
    "quality": {"RQly(%)": NUMBER, "RSSI(dB)": NUMBER},
}


def read_edgetx(source: str, data: bytes) -> LogBuilder:
    """Read the rows of a radio's log; `source` names it in errors. Raises BadInput for a bad table."""
    log = LogBuilder()
    add_rows(_heard(read_rows(source, data, COLUMNS, ("time_s", "day_s", "voltage_V"), log), log), log)
    return log


def _heard(rows: Iterable[TableRow], log: LogBuilder) -> Iterator[TableRow]:
    """Yield the rows that the aircraft has sent, with the time of the day's clock and the motors by the flight mode.

    Many aircraft never mark their flight modes, so that a mode without a mark means armed only after one with it.
    """
    shows_arming = False
    for row in rows:
        values = row.values
        if values.get("quality") == 0.0:
            log.counts[LOST] += 1
            continue
        is_disarmed = values.get("is_disarmed", NAN) == 1.0
        shows_arming = shows_arming or is_disarmed
        motors = float(not is_disarmed) if shows_arming else NAN
        now = {**values, "time_s": values["day_s"] + values["time_s"], "motors": motors}
        yield TableRow(("", *(str(now.get(name)) for name in TELLING)), now)
