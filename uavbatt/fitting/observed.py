"""Measured records, prepared for open-loop fitting: bench runs and flights in the same form.

Fine telemetry is averaged over bins of BIN_S (the model is smoother than the noise). Coarse rows are split into steps
of at most LONGEST_STEP_S with interpolated current, and only the real rows are compared with the model.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.initial_state import IDLE_C_RATE
from uavbatt.battery.model import LONGEST_STEP_S, Array
from uavbatt.dataset import DataSet
from uavbatt.errors import NotEnoughData
from uavbatt.fitting.used_rows import used_rows
from uavbatt.output import counted
from uavbatt.records import NAN, Flight
from uavbatt.telemetry.cleaning.cleaner import Cleaner
from uavbatt.telemetry.cleaning.readings import BOARD_START_C

BIN_S = 5.0
FINE_SHARE, SLOW_SHARE = 0.9, 1.1  # of BIN_S: rows every 5 s, more or less, are as good as bins
# The model's residuals stay alike for about a minute: rows closer together share one piece of evidence.
INDEPENDENT_S = 60.0
HELD_WINDOW_S = 30.0  # long enough for the scatter of a voltage that is held, short enough for one load
MAD_TO_SD = 1.4826  # sd of a normal distribution over its median absolute deviation
SCATTERED = 5.0  # robust sds: rows of one load lie within them but for one in a million
SMOOTH_S = 30.0  # of the slope: the model is smoother than the turns of an aircraft
FIRST_READINGS = 8  # temperatures whose median is that of the start: one spike does not move it
BENCH_START_S = 40.0  # of a bench test, whose rows may be a minute apart: later it is warmed by its load
ROOM_C = 22.0  # ambient of a record without any temperature
FLAT_SD_V = 0.008  # error of the model where the voltage is flat, per cell
# A bench holds its load if few rows follow a step: of the upper current (90 % point), and of the rows.
STEP_SHARE, HELD_SHARE = 0.1, 0.25
LEAST_ROWS, LEAST_BINS = 10, 3  # fewer bins have no curvature, and fewer rows no scatter


@dataclass(frozen=True, slots=True)
class ObservedRecord:
    """ObservedRecord holds rows of time [s], pack voltage [V], current [A], temperature [°C] (NaN: unknown)."""

    name: str
    time_s: Array
    voltage_V: Array
    current_A: Array
    temp_C: Array
    ambient_C: float
    cells: int
    capacity_Ah: float


@dataclass(frozen=True, slots=True)
class Stack:
    """Stack holds records side by side, [rows, records]; `compare` marks real rows; sigma and slope are of the pack."""

    names: tuple[str, ...]
    cells: Array
    capacity_Ah: Array
    time_s: Array
    dt_s: Array
    current_A: Array
    voltage_V: Array
    temp_C: Array
    compare: NDArray[np.bool_]
    sigma_V: Array
    slope_Vps: Array
    weight: Array
    start_temp_C: Array
    ambient_C: Array
    rested: Array


def from_dataset(dataset: DataSet, capacity_Ah: float | None = None) -> list[ObservedRecord]:
    """Return the runs of a data set whose current was measured throughout.

    Raises NotEnoughData when neither `capacity_Ah` [Ah] nor the data set states a capacity.
    """
    capacity = capacity_Ah or dataset.capacity_Ah
    if capacity is None:
        raise NotEnoughData(f"{dataset.path}: battery.toml: expected capacity_Ah to scale the measured current")
    return [
        ObservedRecord(
            name=f"{dataset.name} sample {run.sample} run {run.run} at {run.ambient_C:g} °C",
            time_s=run.time_s,
            voltage_V=run.voltage_V,
            current_A=held_load(run.time_s, run.current_A),
            temp_C=run.surface_C,
            ambient_C=run.ambient_C,
            cells=dataset.cells_series,
            capacity_Ah=capacity,
        )
        for run in dataset.runs
        if run.is_metered
    ]


def held_load(time_s: Array, current_A: Array) -> Array:
    """Return the current of a bench test [A] without its sensor's noise: means over the rows near in time and value.

    A bench holds its load between steps, so that the scatter from row to row is noise of the sensor. If that noise were
    kept, the fitted resistance would be too small (errors in variables) and the OCV would compensate. Rows within
    HELD_WINDOW_S that differ by less than SCATTERED robust sd of the scatter are averaged; steps of the load stay.
    """
    scatter = MAD_TO_SD * float(np.median(np.abs(np.diff(current_A)))) / np.sqrt(2.0)
    firsts = np.searchsorted(time_s, time_s - HELD_WINDOW_S)
    behind = np.searchsorted(time_s, time_s + HELD_WINDOW_S, side="right")
    held_A = np.empty_like(current_A)
    for row, (first, last) in enumerate(zip(firsts, behind, strict=True)):
        near_A = current_A[first:last]
        held_A[row] = np.mean(near_A[np.abs(near_A - current_A[row]) <= SCATTERED * scatter])
    return held_A


def from_flight(
    flight: Flight, cells: int, capacity_Ah: float, hottest_start_C: float = BOARD_START_C
) -> ObservedRecord:
    """Return the rows of a flight that have both voltage and current; raises NotEnoughData for fewer than 10.

    Readings that a replay would not use count as not measured (`used_rows`). Rows of the same time are replaced by
    their mean, because a slope between them would divide by zero.

    hottest_start_C : highest first temperature of a sensor in the pack [°C]; a diagnosis allows any cell temperature,
    as the sensor itself may be wrong
    """
    cleaner = Cleaner(hottest_start_C=hottest_start_C).with_facts(flight.facts_at(math.inf))
    rows, temp_C = used_rows(flight.samples, cleaner, cells, capacity_Ah)
    if len(rows) < LEAST_ROWS:
        reason = f"{counted(len(rows), 'row')} with voltage and current: expected at least {LEAST_ROWS}"
        raise NotEnoughData(f"{flight.source}: {reason}")
    record = ObservedRecord(
        name=flight.source,
        time_s=np.array([s.time_s for s in rows]),
        voltage_V=np.array([s.voltage_V for s in rows]),
        current_A=np.array([s.current_A for s in rows]),
        temp_C=np.array(temp_C),
        ambient_C=NAN,
        cells=cells,
        capacity_Ah=capacity_Ah,
    )
    times_s, index = np.unique(record.time_s, return_inverse=True)
    if times_s.size < LEAST_ROWS:
        reason = f"{times_s.size} different times: expected at least {LEAST_ROWS}"
        raise NotEnoughData(f"{flight.source}: {reason}")
    return _merged(record, index) if times_s.size < len(rows) else record


def until(record: ObservedRecord, time_s: float) -> ObservedRecord:
    """Return the record up to `time_s` [s]."""
    keep = record.time_s <= time_s
    return _mapped(record, lambda column: column[keep])


def _mapped(record: ObservedRecord, change: Callable[[Array], Array]) -> ObservedRecord:
    return replace(
        record,
        time_s=change(record.time_s),
        voltage_V=change(record.voltage_V),
        current_A=change(record.current_A),
        temp_C=change(record.temp_C),
    )


def is_fine(record: ObservedRecord) -> bool:
    """Return True if the rows come faster than the bins of BIN_S."""
    return bool(np.median(np.diff(record.time_s)) < FINE_SHARE * BIN_S)


def binned(record: ObservedRecord) -> ObservedRecord:
    """Return the record as means over bins of BIN_S where rows come faster; the record itself otherwise.

    Raises NotEnoughData when its rows lie in fewer than LEAST_BINS bins: they have no slope.
    """
    if not is_fine(record):
        return record
    index = np.floor((record.time_s - record.time_s[0]) / BIN_S).astype(int)
    _, index = np.unique(index, return_inverse=True)
    merged = _merged(record, index)
    count = merged.time_s.size
    if count < LEAST_BINS:
        raise NotEnoughData(
            f"{record.name}: rows within {count} x {BIN_S:g} s: expected at least {LEAST_BINS} x {BIN_S:g} s"
        )
    return merged


def _merged(record: ObservedRecord, index: NDArray[np.intp]) -> ObservedRecord:
    """Return the record as means of rows with the same index; the indices count up from 0 without a gap."""
    count = np.bincount(index)

    def mean(column: Array) -> Array:
        out: Array = np.bincount(index, column) / count
        return out

    return _mapped(record, mean)


def stack(records: list[ObservedRecord], *, timing_sd_s: float = 6.0) -> Stack:
    """Bin, split and pad the records to the same length, side by side.

    The sd of a voltage (`sigma_V`) contains `timing_sd_s` times the slope of the smoothed voltage: near the end a model
    that is late by a few seconds is good, although its error is some volts. `weight` is the share of an independent
    reading in a row.

    timing_sd_s : error of the model's time [s]
    """
    at = _side_by_side([_split(binned(r)) for r in records])
    cells, capacity_Ah = np.array([float(r.cells) for r in records]), np.array([r.capacity_Ah for r in records])
    ambient_C, start_temp_C = np.array([r.ambient_C for r in records]), np.array([_start_temp(r) for r in records])
    resting = np.abs(at.current_A) < IDLE_C_RATE * capacity_Ah
    weight = np.sqrt(np.clip(at.spacing_s / INDEPENDENT_S, 0.0, 1.0))
    weight[0] = np.where(resting[0], 1.0, weight[0])  # one rested voltage shows the OCV at the start
    slope_Vps = np.where(resting, 0.0, at.slope_Vps)
    return Stack(
        names=tuple(r.name for r in records),
        cells=cells,
        capacity_Ah=capacity_Ah,
        time_s=at.time_s,
        dt_s=np.vstack([np.zeros(len(records)), np.diff(at.time_s, axis=0)]),
        current_A=at.current_A,
        voltage_V=at.voltage_V,
        temp_C=at.temp_C,
        compare=at.is_real,
        sigma_V=np.hypot(FLAT_SD_V * cells, timing_sd_s * slope_Vps),
        slope_Vps=slope_Vps,
        weight=weight,
        start_temp_C=start_temp_C,
        ambient_C=np.where(np.isfinite(ambient_C), ambient_C, start_temp_C),
        rested=np.array([abs(r.current_A[0]) / r.capacity_Ah < IDLE_C_RATE for r in records]),
    )


def _start_temp(record: ObservedRecord) -> float:
    known = np.isfinite(record.temp_C)
    readings, times_s = record.temp_C[known][:FIRST_READINGS], record.time_s[known][:FIRST_READINGS]
    if readings.size:
        is_bench = np.isfinite(record.ambient_C)
        return float(np.median(readings[times_s <= times_s[0] + BENCH_START_S] if is_bench else readings))
    return record.ambient_C if np.isfinite(record.ambient_C) else ROOM_C


class _Rows(NamedTuple):
    """_Rows holds the rows of a record with steps filled in between them; `is_real` marks the measured ones."""

    time_s: Array
    is_real: NDArray[np.bool_]
    voltage_V: Array
    current_A: Array
    temp_C: Array
    slope_Vps: Array  # of the smoothed voltage, without its sign
    spacing_s: Array  # since the measured row before


def _side_by_side(records: list[_Rows]) -> _Rows:
    """Return the rows of all records [rows, records]; a shorter one is padded with its last row, which is not real."""
    most, own = max(rows.time_s.size for rows in records), [rows.time_s.size for rows in records]
    padded = [[np.pad(column, (0, most - column.size), mode="edge") for column in rows] for rows in records]
    every = _Rows(*(np.stack(columns, axis=1) for columns in zip(*padded, strict=True)))
    return every._replace(is_real=every.is_real & (np.arange(most)[:, None] < own))


def after_step(record: ObservedRecord) -> NDArray[np.bool_]:
    """Mark the rows of a slow bench test that follow a step of its load: nobody knows how long ago the step was.

    A voltage read at the step shows the resistance alone, one read some seconds later the polarisation, too. Compared
    with a current that is interpolated between the rows, it would make the fitted resistance up to a fifth too small.
    The scatter of the ammeter from row to row is no step.
    """
    steps = np.abs(np.diff(record.current_A, prepend=record.current_A[0]))
    least_A = STEP_SHARE * np.percentile(np.abs(record.current_A), 90)
    marks: NDArray[np.bool_] = steps > max(least_A, SCATTERED * MAD_TO_SD * float(np.median(steps)))
    is_slow_bench = np.isfinite(record.ambient_C) and np.median(np.diff(record.time_s)) > SLOW_SHARE * BIN_S
    return marks if is_slow_bench and np.mean(marks) < HELD_SHARE else np.zeros_like(marks)


def _split(record: ObservedRecord) -> _Rows:
    """Return the rows of a record with steps of at most LONGEST_STEP_S filled in between them."""
    time_s = record.time_s
    spacing = np.diff(time_s, prepend=2 * time_s[0] - time_s[1])
    pieces = [np.array([time_s[0]])]
    for left, right in pairwise(time_s):
        steps = max(1, int(np.ceil((right - left) / LONGEST_STEP_S - 1e-9)))
        pieces.append(left + (right - left) * np.arange(1, steps + 1) / steps)
    grid = np.concatenate(pieces)
    width = max(3, int(SMOOTH_S / np.median(np.diff(time_s))) | 1)
    smooth = np.convolve(np.pad(record.voltage_V, width // 2, mode="edge"), np.ones(width) / width, mode="valid")
    slope = np.abs(np.gradient(smooth, time_s))
    columns = (record.voltage_V, record.current_A, record.temp_C, slope, spacing)
    real = np.isin(grid, time_s[~after_step(record)])
    return _Rows(grid, real, *(np.interp(grid, time_s, column) for column in columns))
