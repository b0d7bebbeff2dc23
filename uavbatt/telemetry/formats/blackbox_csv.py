"""A blackbox log as CSV, as `blackbox_decode` writes it of Betaflight's, INAV's and Cleanflight's logs.

    time (us)               or (ms), (s): since the flight controller started
    vbatLatest (V)          or (mV); INAV: vbat (V). Of the pack, to 0.1 or 0.01 V
    amperageLatest (A)      or (mA); INAV: amperage (A). Positive discharges
The loop is logged up to 8000 times a second, the battery is measured some tens of times: rows are means over 0.1 s,
each with the time of its last. `energyCumulative (mAh)` is the sum of the same current and tells nothing more.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from uavbatt.records import NAN, Sample
from uavbatt.telemetry.builder import LogBuilder
from uavbatt.telemetry.formats.logger_table import MILLI, NUMBER, Columns, TableRow, read_rows, scaled

PERIOD_S = 0.1
COLUMNS: Columns = {
    "time_s": {"time (us)": scaled(1e-6), "time (ms)": MILLI, "time (s)": NUMBER},
    "voltage_V": {"vbatLatest (V)": NUMBER, "vbatLatest (mV)": MILLI, "vbat (V)": NUMBER, "vbat (mV)": MILLI},
    "current_A": {
        "amperageLatest (A)": NUMBER, "amperageLatest (mA)": MILLI, "amperage (A)": NUMBER, "amperage (mA)": MILLI,
    },
}  # fmt: skip


def read_blackbox(source: str, data: bytes) -> LogBuilder:
    """Read the rows of a decoded blackbox log; `source` names it in errors. Raises BadInput for a bad table."""
    log = LogBuilder()
    _add_means(read_rows(source, data, COLUMNS, ("time_s", "voltage_V"), log), log)
    return log


def _add_means(rows: Iterable[TableRow], log: LogBuilder) -> None:
    """Put the mean of every whole period into the log; the last one, which may be cut, is left out."""
    volts, amps = list[float](), list[float]()
    begin_s = last_s = -math.inf
    for row in rows:
        if math.isnan(row.values["time_s"]):
            log.counts["rows without a time dropped"] += 1
            continue
        time_s = log.time_s(row.values["time_s"])
        if time_s - begin_s >= PERIOD_S and volts:
            log.add(0, Sample(last_s, _mean(volts), _mean(amps)))
            volts, amps = [], []
        if not volts:
            begin_s = time_s
        last_s = time_s
        volts.append(row.values["voltage_V"])
        amps.append(row.values.get("current_A", NAN))


def _mean(values: list[float]) -> float:
    """Return the mean of the measured values; NaN if there is none."""
    known = [value for value in values if not math.isnan(value)]
    return math.fsum(known) / len(known) if known else NAN
