"""Pack voltage of a telemetry log whose BATTERY_STATUS lacks cells: corrected row by row, as in flight."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.mavlink import fields
from uavbatt.telemetry.cleaning.pack_voltage import (
    AGREE,
    HIGHEST_IN_FLIGHT_V,
    LOWEST_IN_FLIGHT_V,
    PackVoltages,
    is_in_sys_status,
)
from uavbatt.telemetry.columns import UNKNOWN, Column, distinct, latest_before
from uavbatt.telemetry.formats.chain import Mask
from uavbatt.telemetry.formats.tlog_payloads import BatteryMessages


class HeardMessages(NamedTuple):
    """HeardMessages holds the messages of one type: their places among the vehicle's frames, and one value of each."""

    place: NDArray[np.int64]
    value: Column


class BatteryStatusRows(NamedTuple):
    """BatteryStatusRows holds place and time [s] of each BATTERY_STATUS, `armed` (or UNKNOWN), and if PX4 sent it."""

    place: NDArray[np.int64]
    time_s: Column
    armed: NDArray[np.int8]
    is_px4: Mask


def with_all_cells(
    said: BatteryMessages, row: BatteryStatusRows, sys_status: HeardMessages, sys_time_s: Column
) -> BatteryMessages:
    """Return the messages with the voltage of the whole pack; cell voltages are removed if some cells are missing.

    sys_status : the voltages [V] of SYS_STATUS, received at `sys_time_s` [s].
    """
    if said.cells_V is None or _are_sound(said, row, sys_status):
        return said
    voltages, ids = PackVoltages(), set(distinct(said.instance))
    latest = latest_before(row.place, sys_status.place).tolist()
    volts, cells_V = said.voltage_V.copy(), said.cells_V.copy()
    armed, numbers = row.armed.tolist(), said.instance.tolist()
    seen: dict[int, int] = {}  # rows of each battery
    for k, (number, heard) in enumerate(zip(numbers, latest, strict=True)):
        if heard >= 0:
            voltages.hear(float(sys_status.value[heard]), float(sys_time_s[heard]))
        told = said.cells_V[k]
        battery = fields.BatteryFields(
            number, float(said.voltage_V[k]), cell_voltages_V=tuple(told[np.isfinite(told)].tolist())
        )
        is_armed = None if armed[k] == UNKNOWN else bool(armed[k])
        now = voltages.of(battery, float(row.time_s[k]), is_armed, is_in_sys_status(number, bool(row.is_px4[k]), ids))
        seen[number] = seen.get(number, 0) + 1
        if now is not battery:
            volts[k], cells_V[k] = now.voltage_V, np.nan
            if seen[number] == 2 and np.isfinite(cells_V[:k]).any():
                _forget_first(said.instance, number, volts)
    return said._replace(voltage_V=volts, cells_V=cells_V)


def _forget_first(instance: NDArray[np.int64], number: int, volts: Column) -> None:
    """Leave out a first row whose sum lacks cells: the SYS_STATUS that shows it came before the second row only."""
    volts[int(np.flatnonzero(instance == number)[0])] = np.nan


def _are_sound(said: BatteryMessages, row: BatteryStatusRows, sys_status: HeardMessages) -> bool:
    """Return True if no cell can be missing, so that the rows need no check one by one."""
    assert said.cells_V is not None
    told = np.isfinite(said.cells_V)
    counts = np.count_nonzero(told, axis=1)
    if not np.all((said.cells_V[told] > LOWEST_IN_FLIGHT_V) & (said.cells_V[told] < HIGHEST_IN_FLIGHT_V)):
        return False
    for number in distinct(said.instance):
        if len(distinct(counts[said.instance == number])) > 1:
            return False
    last = latest_before(row.place, sys_status.place)
    is_compared = (said.instance == 0) & (counts > 1) & (last >= 0)
    sums_V = said.voltage_V[is_compared]
    difference = (sys_status.value[last[is_compared]] - sums_V) * counts[is_compared] / sums_V
    return not np.any(np.abs(difference) > 1.0 - AGREE)
