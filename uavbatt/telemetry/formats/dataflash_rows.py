"""The meaning of ArduPilot's DataFlash records, shared by the binary and the text form.

Fields are found by the labels of the log's own FMT records, never by position; the integer
character `h` of old `CURR` records means centivolts and centiamps, `f` volts and amps.
    CURR, CUR2              until Copter 3.6: battery 0 and 1
    BAT, BAT2 .. BAT9       4.0: one message a battery; later BAT with a field Instance or Inst
    BCL, BCL2 ..            cell millivolts, written right after BAT with the same time
    PARM, ARM, EV           parameters, arming (EV 10 armed, 11 disarmed)
CurrTot is in mAh. VoltR is the autopilot's estimate of the resting voltage and is not read. Temp 0 means that there is
no sensor.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.telemetry.builder import LogBuilder
from uavbatt.telemetry.column_rules import add_rows, times_s
from uavbatt.telemetry.columns import UNKNOWN, Column, Columns, Order, distinct, latest_before
from uavbatt.telemetry.parameters import VOLTAGE_ONLY, monitor_parameter

WANTED = re.compile(r"(CURR|CUR\d|BAT\d?|BCL\d?|PARM|ARM|EV)$")
# Labels that are read of any record, by this module, `dataflash_identity` and `dataflash_route`.
USED = re.compile(
    r"(Time[UM]S|Volt|Curr|CurrTot|Temp|RemPct|Inst|Instance|V\d+|Name|Value|ArmState|Id|G?Wk|Week|GMS|Message"
    r"|CTot|CNum|CId|Prm\d|Lat|Lng|Alt|Frame|Mode|ModeNum|Type|RelHomeAlt|RelAlt|Status|Spd|GCrs|VZ|VWN|VWE|C)$"
)
_BATTERY = re.compile(r"(CURR|CUR\d|BAT\d?)$")
_CELL = re.compile(r"V\d+$")
_TICKS_PER_S = {"TimeUS": 1e6, "TimeMS": 1e3}
_EV_ARMED, _EV_DISARMED = 10, 11
_SAME_INSTANT_S = 1e-3
LAST_INSTANCE, NO_INSTANCE = 255, -1


@dataclass(frozen=True, slots=True)
class RowLayout:
    """A RowLayout holds one FMT record: the message's name, one format character and one label for each field."""

    name: str
    chars: str
    labels: tuple[str, ...]

    @property
    def ticks_per_s(self) -> float:
        """Return the ticks of the time field per second; 0 if there is none.

        Only a first field counts: the `TimeMS` inside old GPS records is the time of week.
        """
        return _TICKS_PER_S.get(self.labels[0], 0.0) if self.labels else 0.0


@dataclass(frozen=True, slots=True)
class Table:
    """A Table holds the records of one layout as columns by label; `order` is their place in the log, in any unit."""

    layout: RowLayout
    order: Order
    numbers: Mapping[str, Column]
    texts: Mapping[str, Sequence[str]]

    def column(self, label: str) -> Column:
        """Return a column of numbers; NaN throughout if there is none of this label, NaN for what is infinite."""
        found = self.numbers.get(label)
        if found is None:
            return np.full(len(self.order), np.nan)
        return np.where(np.isfinite(found), found, np.nan)


class Moment(NamedTuple):
    """A Moment is a record that tells the time: its place in the log, and the log's own clock [s]."""

    order: int
    raw_s: float


class DataflashClock(NamedTuple):
    """DataflashClock holds the records that tell the log's time: place, the log's own clock [s], time [s]."""

    order: Order
    raw_s: Column
    time_s: Column

    def times_s(self, table: Table) -> Column:
        """Return the times of a table's records [s].

        A record without a stamp of its own has the time of the clock's record before it.
        """
        if not len(self.order):
            return np.zeros(len(table.order))
        last = np.maximum(latest_before(table.order, self.order), 0)
        if not table.layout.ticks_per_s:
            return self.time_s[last]
        raw_s = table.column(table.layout.labels[0]) / table.layout.ticks_per_s
        own_s: Column = np.fmax(self.time_s[last] + raw_s - self.raw_s[last], 0.0)
        return np.round(own_s, 6)


class _TimedTable(NamedTuple):
    """_TimedTable is a table with the time of each record [s]."""

    table: Table
    time_s: Column


class _Change(NamedTuple):
    """_Change holds values that are in force from their place in the log on."""

    order: Order
    value: NDArray[np.float64]

    def at(self, order: Order, before: float) -> NDArray[np.float64]:
        """Return the value in force at each place, `before` if there is none yet."""
        return np.append(self.value, before)[latest_before(order, self.order)]


def fold(tables: Sequence[Table], first: Moment | None, last: Moment | None, log: LogBuilder) -> DataflashClock:
    """Push every battery row, parameter and arming change of `tables` into `log`, in order; return the log's clock.

    first, last: of the records of any kind, wanted or not, that carry a time.
    """
    clock, timed = _with_times(tables, first, last, log)
    parameters = _tables_named(timed, "PARM")
    _add_parameters(parameters, log)
    batteries = [t for t in timed if _BATTERY.match(t.table.layout.name)]
    if not batteries:
        return clock
    merged = _merged([(b.table.order, b.time_s, _instance(b.table), *_battery_columns(b.table)) for b in batteries])
    is_known = merged[2] != NO_INSTANCE
    if not is_known.all():
        log.counts["rows of an impossible battery instance dropped"] += int(np.count_nonzero(~is_known))
    order, time_s, instance, voltage_V, current_A, temp_C, consumed_Ah, reported_soc = (c[is_known] for c in merged)
    instance = instance.astype(np.int64)
    blind = _without_current(order, instance, parameters)
    rows = Columns(
        time_s=time_s,
        voltage_V=voltage_V,
        current_A=np.where(blind, np.nan, current_A),
        temp_C=temp_C,
        consumed_Ah=np.where(blind, np.nan, consumed_Ah),
        reported_soc=reported_soc,
        armed=_armed(timed).at(order, UNKNOWN).astype(np.int8),
        cells_V=_cells(order, instance, time_s, _tables_named(timed, "BCL")),
    )
    add_rows(log, instance, rows)
    if any(not b.table.layout.ticks_per_s for b in batteries):
        log.notes.append("battery records carry no time: one second a record assumed")
    return clock


def _tables_named(timed: Sequence[_TimedTable], start: str) -> list[_TimedTable]:
    return [t for t in timed if t.table.layout.name.startswith(start)]


def _merged(parts: Sequence[Sequence[Column | Order]]) -> list[NDArray[Any]]:
    """Return columns of several tables as one, in the order of the log, which is their first column."""
    columns = [np.concatenate(same) for same in zip(*parts, strict=True)]
    in_order = np.argsort(columns[0], kind="stable")
    return [column[in_order] for column in columns]


def _change(parts: Sequence[tuple[Order, NDArray[Any]]]) -> _Change:
    """Return the changes in several tables as one, in the order of the log."""
    return _Change(*_merged([(np.zeros(0, np.int64), np.zeros(0)), *parts]))


def _with_times(
    tables: Sequence[Table], first: Moment | None, last: Moment | None, log: LogBuilder
) -> tuple[DataflashClock, list[_TimedTable]]:
    """Return every table with its times; a record without a time gets that of the latest record before it."""
    moments = [(np.array([m.order]), np.array([m.raw_s])) for m in (first, last) if m is not None]
    clocks = [(t.order, t.column(t.layout.labels[0]) / t.layout.ticks_per_s) for t in tables if t.layout.ticks_per_s]
    told = _change(moments + clocks)
    clock = DataflashClock(told.order, told.value, times_s(log, told.value))
    told = told._replace(value=clock.time_s)
    counted = _counted([t for t in tables if _BATTERY.match(t.layout.name) and not t.layout.ticks_per_s])
    log.now_s = max(log.now_s, float(np.max(counted.value, initial=0.0)))
    if not len(told.order):
        clock = DataflashClock(*counted, np.maximum.accumulate(counted.value))
    both = _change([told, counted])
    now = both._replace(value=np.maximum.accumulate(both.value))

    def times(table: Table) -> Column:
        if not table.layout.ticks_per_s and not _BATTERY.match(table.layout.name):
            return now.at(table.order, 0.0)
        own = told if table.layout.ticks_per_s else counted
        return own.value[own.order.searchsorted(table.order)]

    return clock, [_TimedTable(t, times(t)) for t in tables]


def _counted(tables: Sequence[Table]) -> _Change:
    """Return times for battery records without a time: one second for each record of a battery."""
    order, instance = _change([(t.order, _instance(t)) for t in tables])
    count = np.zeros(len(order))
    for number in distinct(instance):
        own = instance == number
        count[own] = np.arange(np.count_nonzero(own))
    return _Change(order, count)


def _add_parameters(parameters: Sequence[_TimedTable], log: LogBuilder) -> None:
    said: list[tuple[int, float, str, float]] = []
    for t in parameters:
        columns = (t.table.order.tolist(), t.time_s.tolist(), _names(t.table), t.table.column("Value").tolist())
        said += zip(*columns, strict=True) if _names(t.table) else []
    for _, at_s, name, value in sorted(said, key=lambda one: one[0]):
        log.add_parameter(at_s, name, value)


def _names(table: Table) -> Sequence[str]:
    """Return the names of the parameters; empty if the log's layout has no names."""
    return table.texts.get("Name", ())


def _without_current(order: Order, instance: Order, parameters: Sequence[_TimedTable]) -> NDArray[np.bool_]:
    """Mark the rows of batteries whose monitor, as known by then, measures no current."""
    blind = np.zeros(len(order), np.bool_)
    for number in distinct(instance):
        wanted = monitor_parameter(number)
        parts = []
        for t in parameters:
            chosen = np.array([name == wanted for name in _names(t.table)], np.bool_)
            if chosen.any():
                parts.append((t.table.order[chosen], t.table.column("Value")[chosen]))
        own = instance == number
        blind[own] = _change(parts).at(order[own], np.nan) == VOLTAGE_ONLY
    return blind


def _instance(table: Table) -> Order:
    """Return the battery instances: the records' own field, else the number in their name (BAT2 is instance 1).

    An impossible number, as after a damaged definition of the field, becomes NO_INSTANCE.
    """
    for label in ("Instance", "Inst"):
        if label in table.numbers:
            said = table.column(label)
            with np.errstate(invalid="ignore"):
                is_possible = (said >= 0) & (said <= LAST_INSTANCE) & (said == np.trunc(said))
            return np.where(is_possible, said, NO_INSTANCE).astype(np.int64)
    number = table.layout.name[3:]
    return np.full(len(table.order), max(int(number) - 1, 0) if number.isdigit() else 0, np.int64)


def _battery_columns(table: Table) -> tuple[Column, ...]:
    """Return voltage, current, temperature, charge and state of charge as the autopilot reports them."""
    chars = dict(zip(table.layout.labels, table.layout.chars, strict=False))

    def scaled(label: str) -> Column:
        value = table.column(label)
        return value / 100 if chars.get(label) in ("h", "H") else value

    temp_C, percent = table.column("Temp"), table.column("RemPct")
    return (
        scaled("Volt"),
        scaled("Curr"),
        np.where(temp_C == 0, np.nan, temp_C),
        table.column("CurrTot") / 1000,
        np.where((percent >= 0) & (percent <= 100), percent / 100, np.nan),
    )


def _armed(timed: Sequence[_TimedTable]) -> _Change:
    """Return armed or not, by the records that tell it."""
    parts = []
    for t in _tables_named(timed, "ARM"):
        if "ArmState" in t.table.numbers:
            parts.append((t.table.order, np.where(t.table.column("ArmState") == 0, 0.0, 1.0)))
    for t in _tables_named(timed, "EV"):
        event = np.trunc(t.table.column("Id"))
        says = (event == _EV_ARMED) | (event == _EV_DISARMED)
        parts.append((t.table.order[says], np.where(event[says] == _EV_ARMED, 1.0, 0.0)))
    return _change(parts)


def _cells(order: Order, instance: Order, time_s: Column, cells: Sequence[_TimedTable]) -> NDArray[np.float64] | None:
    """Return the cells [V] of the rows of the same instant, without 0 (none) and 65535; None if the log has none."""
    labels = [[label for label in t.table.layout.labels if _CELL.match(label)] for t in cells]
    if not any(labels):
        return None
    found = np.full((len(order), max(map(len, labels))), np.nan)
    for t, names in zip(cells, labels, strict=True):
        cells_mV = np.column_stack([t.table.column(name) for name in names] or [np.zeros((len(t.time_s), 0))])
        cells_V = np.where((cells_mV > 1) & (cells_mV < 65535), cells_mV / 1000, np.nan)
        said_of = _instance(t.table)
        for number in distinct(said_of):
            rows, own = np.flatnonzero(instance == number), np.flatnonzero(said_of == number)
            before = latest_before(t.table.order[own], order[rows])
            own, rows = own[before >= 0], rows[before[before >= 0]]
            same = (np.abs(time_s[rows] - t.time_s[own]) <= _SAME_INSTANT_S) & np.isfinite(cells_V[own]).any(axis=1)
            found[rows[same]] = np.nan
            found[rows[same], : cells_V.shape[1]] = cells_V[own[same]]
    return found
