"""A DJI flight record as CSV, as Flight Reader, PhantomHelp's log viewer and TXTlogToCSVtool write it.

    OSD.flyTime [s]                     or [ms], since the motors started
    OSD.isMotorOn                       or OSD.isMotorUp: True, False
    BATTERY.voltage [V], .current [A]   of the pack; positive discharges. Older files: SMART_BATTERY.voltage [V],
                                        CENTER_BATTERY.current [A]
    BATTERY.temperature [C]             or [F]. Older files call it [C] whatever it is: it is not read there
    BATTERY.cellVoltage1 [V] ..         of the cells. Older files: CENTER_BATTERY.voltageCell1 [V] ..
    BATTERY.fullCapacity [mAh]          what the pack says it holds when full
    DETAILS.aircraftSerial              or RECOVER.aircraftSerial; DETAILS.batterySerial or RECOVER.batterySerial
The dates are local and not read; nor are the pack's percent (`chargeLevel`, `relativeCapacity`) and what is left of it
(`currentCapacity`).
"""

from __future__ import annotations

from uavbatt.mavlink.fields import known_serial
from uavbatt.records import Identity
from uavbatt.telemetry.builder import LogBuilder
from uavbatt.telemetry.formats.logger_table import FAHRENHEIT, MILLI, NUMBER, Columns, first_words, read_rows, truth
from uavbatt.telemetry.formats.smart_pack import add_rows, cells_of

_CELLS = cells_of("BATTERY.cellVoltage{} [V]")
_OLD_CELLS = cells_of("CENTER_BATTERY.voltageCell{} [V]")
COLUMNS: Columns = {
    "time_s": {"OSD.flyTime [s]": NUMBER, "OSD.flyTime [ms]": MILLI},
    "voltage_V": {"BATTERY.voltage [V]": NUMBER, "SMART_BATTERY.voltage [V]": NUMBER},
    "current_A": {"BATTERY.current [A]": NUMBER, "CENTER_BATTERY.current [A]": NUMBER},
    "temp_C": {"BATTERY.temperature [C]": NUMBER, "BATTERY.temperature [F]": FAHRENHEIT},
    "motors": {"OSD.isMotorOn": truth, "OSD.isMotorUp": truth},
    "capacity_mAh": {"BATTERY.fullCapacity [mAh]": NUMBER, "CENTER_BATTERY.fullCapacity [mAh]": NUMBER},
    **{ours: {theirs: NUMBER, _OLD_CELLS[ours]: NUMBER} for ours, theirs in _CELLS.items()},
}
WORDS = {
    "aircraft": ("DETAILS.aircraftSerial", "RECOVER.aircraftSerial"),
    "battery": ("DETAILS.batterySerial", "RECOVER.batterySerial"),
}


def read_dji_record(source: str, data: bytes) -> LogBuilder:
    """Read the rows of a DJI flight record; `source` names it in errors. Raises BadInput for a bad table."""
    said = first_words(data, WORDS)
    serial = known_serial(said.get("battery", ""))
    log = LogBuilder(identity=Identity(hardware=said.get("aircraft", ""), battery_serial=serial))
    add_rows(read_rows(source, data, COLUMNS, ("time_s", "voltage_V"), log), log)
    return log
