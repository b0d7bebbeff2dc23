"""Open-loop simulation of records through sensors and wiring: [variants × records] side by side in one pass.

Current in as metered, voltage and temperature out as metered; the state is never corrected on the way. The time loop
only steps the states; voltages of all rows and columns follow in one set of array operations.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uavbatt.battery import model, openloop, pack
from uavbatt.battery.initial_state import state_under_load
from uavbatt.battery.model import Array, Parameters, State
from uavbatt.battery.openloop import States
from uavbatt.battery.pack import Installation
from uavbatt.battery.scaling import Pack
from uavbatt.diagnosis.refit.candidates import INDEX, QUANTITIES
from uavbatt.diagnosis.refit.evidence import Evidence
from uavbatt.diagnosis.refit.late_current import metered_current
from uavbatt.fitting.observed import Stack

MAY_DRIFT = ("gain_I", "offset_A", "unmetered_W", "gain_V", "offset_V", "harness_ohm")


class OwnValues(NamedTuple):
    """OwnValues holds the start soc and the shifts [K] of start and air of each record, [variants, records]."""

    soc: Array
    start_K: Array
    ambient_K: Array


class Simulated(NamedTuple):
    """Simulated holds the simulated readings of the sensors, [rows, variants, records], and the soc for reports."""

    voltage_V: Array
    temp_C: Array
    soc: Array


def _cell_of(base: Parameters, x: Array) -> Parameters:
    fields = {q.name: x[..., i] for i, q in enumerate(QUANTITIES) if q.name in Parameters._fields}
    return base._replace(**fields)


def _installation_of(base: Pack, evidence: Evidence, x: Array, drift: Array | None) -> Installation:
    records = len(evidence.names)
    variants = x.shape[0] // records
    fields = {q.name: x[..., i] for i, q in enumerate(QUANTITIES) if q.name in Installation._fields}
    if drift is not None:
        along = np.tile(_courses(evidence.stack), (1, 1, variants))
        fields |= {name: fields[name] + np.einsum("krj,jk->rj", along, drift[..., INDEX[name]]) for name in MAY_DRIFT}
    capacity = np.tile(evidence.stack.capacity_Ah, variants)
    return Installation(cells=base.installation.cells, capacity_Ah=capacity, **fields)


def _courses(stack: Stack) -> Array:
    """Return the courses along which a sensor may drift (`COURSES`), [courses, rows, records], each from -1/2 to 1/2.

    Time runs from the beginning to the end of each record, temperature from the coldest to the warmest reading of all
    records.
    """
    length_s = np.max(np.where(stack.compare, stack.time_s, 0.0), axis=0)
    return np.stack([np.clip(stack.time_s / length_s, 0.0, 1.0) - 0.5, _warmth(stack)])


def _warmth(stack: Stack) -> Array:
    """Return the place of each row between the coldest and the warmest reading, -1/2 to 1/2; 0 without a reading."""
    measured = np.isfinite(stack.temp_C)
    if not np.any(measured):
        return np.zeros_like(stack.temp_C)
    coldest_C, warmest_C = np.min(stack.temp_C[measured]), np.max(stack.temp_C[measured])
    middle_C = 0.5 * (coldest_C + warmest_C)
    place = np.zeros_like(stack.temp_C)
    for j in np.flatnonzero(np.any(measured, axis=0)):
        rows = measured[:, j]
        temp_C = np.interp(stack.time_s[:, j], stack.time_s[rows, j], stack.temp_C[rows, j])
        place[:, j] = (temp_C - middle_C) / (float(warmest_C - coldest_C) or 1.0)
    return place


def simulate(
    base: Pack,
    evidence: Evidence,
    x: Array,
    own: OwnValues,
    walk: States = openloop.states,
    drift: Array | None = None,
) -> Simulated:
    """Simulate the records with quantities x [variants, records, quantities] and with their own values.

    walk : the function that steps the states of many columns (`openloop.states` or its compiled twin); drift :
    [variants, records, courses, quantities], the change along each course of the quantities that may drift; x is then
    their value in the middle of the course.
    """
    stack = evidence.stack
    variants, records = own.soc.shape
    flat = x.reshape(variants * records, -1)
    cell = _cell_of(base.cell, flat)
    drift = None if drift is None else drift.reshape(len(flat), *drift.shape[2:])
    installation = _installation_of(base, evidence, flat, drift)
    cell = pack.grown(cell, installation)
    metered_A = metered_current(stack.current_A, evidence.shifted_A, flat[:, INDEX["delay_s"]])
    current_A = pack.true_current(installation, metered_A, np.tile(stack.voltage_V, (1, variants)))
    rate = pack.c_rate(installation, current_A)
    start_C = np.tile(stack.start_temp_C, variants) - installation.offset_K + own.start_K.ravel()
    ambient_C = np.where(np.tile(evidence.known_ambient, variants), np.tile(stack.ambient_C, variants), start_C)
    ambient_C = ambient_C + own.ambient_K.ravel()
    start = state_under_load(cell, own.soc.ravel(), start_C, rate[0])
    states = walk(cell, start, _between(rate), np.tile(stack.dt_s, (1, variants)), ambient_C)
    true_V = _voltages(cell, installation, states, rate, current_A)
    metered_V = pack.metered_voltage(installation, true_V)
    shape = (*stack.time_s.shape[:1], variants, records)
    return Simulated(
        pack.compensated_voltage(installation, metered_V, current_A).reshape(shape),
        (states.sensor_C + installation.offset_K).reshape(shape),
        states.soc.reshape(shape),
    )


def _between(rate: Array) -> Array:
    """Return the rates [rows, columns] in the step before each row: the mean of the row and the one before it."""
    between = rate.copy()
    between[1:] = 0.5 * (rate[1:] + rate[:-1])
    return between


def _voltages(cell: Parameters, installation: Installation, states: State, rate: Array, current_A: Array) -> Array:
    """Return the true voltage at the sensor; the weak cell is computed only for columns that have one."""
    strong = model.cell_voltage(cell, states, rate)
    out: Array = installation.cells * strong - current_A * installation.harness_ohm
    weak = np.flatnonzero(np.asarray(installation.deficit))
    if weak.size:
        columns = {k: v for k, v in cell._asdict().items() if k not in TABLES and np.ndim(v) == 1}
        part = cell._replace(**{k: v[weak] for k, v in columns.items()})
        few = State(*(column[:, weak] for column in states))
        weak_cell = installation._replace(deficit=np.asarray(installation.deficit)[weak])
        out[:, weak] += pack.weak_voltage(weak_cell, part, few, rate[:, weak]) - strong[:, weak]
    return out


TABLES = ("ocv_V", "r0_ohmAh")
