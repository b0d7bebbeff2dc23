"""The meaning of ArduPilot's DataFlash records, shared by the binary and the text form.

Fields are found by the labels of the log's own FMT records, never by position; the integer
character `h` of old `CURR` records means centivolts and centiamps, `f` volts and amps.
    CURR, CUR2              until Copter 3.6: battery 0 and 1
    BAT, BAT2 .. BAT9       4.0: one message a battery; later BAT with a field Instance or Inst
    BCL, BCL2 ..            cell millivolts, written right after BAT with the same time
    PARM, ARM, EV           parameters, arming (EV 10 armed, 11 disarmed)
CurrTot is mAh. VoltR is the autopilot's guess of the resting voltage and is not read.
Temp 0 means that there is no sensor.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from uavbatt.records import NAN, Sample
from uavbatt.telemetry.builder import LogBuilder, known
from uavbatt.telemetry.parameters import is_voltage_only

Value = float | int | str

WANTED = re.compile(r"(CURR|CUR\d|BAT\d?|BCL\d?|PARM|ARM|EV)$")
_BATTERY = re.compile(r"(CURR|CUR\d|BAT\d?)$")
_CELL = re.compile(r"V\d+$")
_TICKS_PER_S = {"TimeUS": 1e6, "TimeMS": 1e3}
_EV_ARMED = {10: True, 11: False}


@dataclass(frozen=True, slots=True)
class Layout:
    """One FMT record: the message's name, one format character and one label a field."""

    name: str
    chars: str
    labels: tuple[str, ...]

    @property
    def ticks_per_s(self) -> float:
        """Ticks of the time field per second, 0 if there is none.

        Only a first field counts: the `TimeMS` inside old GPS records is the time of week.
        """
        return _TICKS_PER_S.get(self.labels[0], 0.0) if self.labels else 0.0


Record = tuple[Layout, Sequence[Value]]


def fold(records: Iterable[Record], log: LogBuilder) -> None:
    """Push every battery row, parameter and arming change of `records` into `log`, in order."""
    parameters: dict[str, float] = {}
    untimed: dict[int, int] = {}
    for layout, values in records:
        fields = dict(zip(layout.labels, values, strict=False))
        ticks_per_s = layout.ticks_per_s
        time_s = log.time_s(_number(values[0]) / ticks_per_s) if ticks_per_s else log.now_s
        if _BATTERY.match(layout.name):
            instance = _instance(layout.name, fields)
            if not ticks_per_s:
                time_s = float(untimed.setdefault(instance, 0))
                untimed[instance] += 1
                log.now_s = max(log.now_s, time_s)
            log.add(instance, _sample(layout, fields, time_s, log.armed, is_voltage_only(parameters, instance)))
        elif layout.name.startswith("BCL"):
            _attach_cells(log, _instance(layout.name, fields), time_s, fields)
        elif layout.name == "PARM" and "Name" in fields:
            name, value = str(fields["Name"]), _number(fields.get("Value", NAN))
            parameters[name] = value
            log.add_parameter(time_s, name, value)
        elif layout.name in ("ARM", "EV"):
            log.armed = _armed(layout.name, fields, log.armed)
    if untimed:
        log.notes.append("battery records carry no time: one second a record assumed")


def _number(value: Value) -> float:
    return NAN if isinstance(value, str) else known(float(value))


def _instance(name: str, fields: Mapping[str, Value]) -> int:
    """Battery instance: the record's own field, else the number in its name (BAT2 is instance 1)."""
    for label in ("Instance", "Inst"):
        if label in fields:
            number = _number(fields[label])
            return int(number) if number == number else 0
    return max(int(name[3:]) - 1, 0) if name[3:].isdigit() else 0


def _sample(
    layout: Layout, fields: Mapping[str, Value], time_s: float, armed: bool | None, voltage_only: bool
) -> Sample:
    chars = dict(zip(layout.labels, layout.chars, strict=False))

    def scaled(label: str) -> float:
        value = _number(fields.get(label, NAN))
        return value / 100 if chars.get(label) in ("h", "H") else value

    temp_C = _number(fields.get("Temp", NAN))
    percent = _number(fields.get("RemPct", NAN))
    return Sample(
        time_s=time_s,
        voltage_V=scaled("Volt"),
        current_A=NAN if voltage_only else scaled("Curr"),
        temp_C=NAN if temp_C == 0 else temp_C,
        consumed_Ah=NAN if voltage_only else _number(fields.get("CurrTot", NAN)) / 1000,
        reported_soc=percent / 100 if 0 <= percent <= 100 else NAN,
        armed=armed,
    )


def _attach_cells(log: LogBuilder, instance: int, time_s: float, fields: Mapping[str, Value]) -> None:
    """Give the cells to the row of the same instant; 0 (none) and 65535 are no cells."""
    rows = log.rows.get(instance)
    cells_mV = [_number(value) for label, value in fields.items() if _CELL.match(label)]
    cells_V = tuple(mV / 1000 for mV in cells_mV if 1 < mV < 65535)
    if rows and cells_V and math.isclose(rows[-1].time_s, time_s, abs_tol=1e-3):
        rows[-1] = replace(rows[-1], cell_voltages_V=cells_V)


def _armed(name: str, fields: Mapping[str, Value], before: bool | None) -> bool | None:
    if name == "ARM":
        return bool(_number(fields["ArmState"])) if "ArmState" in fields else before
    event = _number(fields.get("Id", NAN))
    return _EV_ARMED.get(int(event), before) if event == event else before
