"""Faults of sensors and links, put into the rows of a flight; each draws its own size and its own moment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from peers.columns import FloatArray

from uavbatt.records import Sample

FIRST_ROW, LAST_ROWS = 30, 60  # a fault begins no earlier, and no later before the end
NAN = float("nan")


@dataclass(slots=True)
class Readings:
    """Readings holds the columns of a flight, to be changed in place; `begins` is the row at which the fault begins."""

    time_s: FloatArray
    voltage_V: FloatArray
    current_A: FloatArray
    temp_C: FloatArray
    begins: int
    dice: np.random.Generator

    @property
    def later(self) -> slice:
        """Return the rows from the fault's begin on."""
        return slice(self.begins, None)

    def either(self, *sizes: float) -> float:
        """Return one of some sizes, drawn."""
        return float(self.dice.choice(sizes))


Fault = Callable[[Readings], None]


def _two_batteries(of: Readings) -> None:
    second = slice(of.begins, None, 2)
    of.voltage_V[second] = of.dice.uniform(12.0, 16.7)
    of.current_A[second] = of.either(0.0, 0.3, float(np.median(of.current_A)))


def _reads_more(of: Readings) -> None:
    of.voltage_V[of.later] *= of.dice.uniform(1.012, 1.05)


def _reads_less(of: Readings) -> None:
    of.voltage_V[of.later] *= of.dice.uniform(0.95, 0.988)


def _drifts(of: Readings) -> None:
    of.voltage_V += of.dice.uniform(-0.8, 0.8) * np.linspace(0.0, 1.0, of.voltage_V.size)


def _coarse(of: Readings) -> None:
    step_V = of.either(0.1, 0.2, 0.5)
    of.voltage_V[:] = np.round(of.voltage_V / step_V) * step_V


def _noisy(of: Readings) -> None:
    of.voltage_V += of.dice.normal(0.0, of.either(0.05, 0.1, 0.3), of.voltage_V.size)


def _stuck_voltage(of: Readings) -> None:
    of.voltage_V[of.later] = of.voltage_V[of.begins]


def _stuck_current(of: Readings) -> None:
    of.current_A[of.later] = of.current_A[of.begins]


def _dead_current(of: Readings) -> None:
    of.current_A[of.later] = of.either(0.0, 0.3)


def _other_gain(of: Readings) -> None:
    of.current_A[of.later] *= of.dice.uniform(0.4, 1.6)


def _unmetered(of: Readings) -> None:
    of.current_A[of.later] = np.maximum(of.current_A[of.later] - of.either(1.0, 3.0, 5.0), 0.0)


def _saturates(of: Readings) -> None:
    of.current_A[:] = np.minimum(of.current_A, of.either(1.1, 1.3) * np.median(of.current_A))


def _limited_at_top(of: Readings) -> None:
    of.voltage_V[:] = np.minimum(of.voltage_V, of.either(15.5, 16.0, 16.4))


def _bad_contact(of: Readings) -> None:
    of.voltage_V[of.later] -= of.either(0.005, 0.01, 0.02, 0.04) * of.current_A[of.later]


def _late(column: FloatArray, rows: int) -> None:
    column[rows:] = column[:-rows].copy()


def _late_voltage(of: Readings) -> None:
    _late(of.voltage_V, int(of.either(2, 8)))


def _late_current(of: Readings) -> None:
    _late(of.current_A, int(of.either(2, 8)))


def _wrong_temperature(of: Readings) -> None:
    of.temp_C[of.later] = of.either(-25.0, -10.0, 55.0, 80.0)


def _spikes(of: Readings) -> None:
    struck = of.dice.random(of.voltage_V.size) < of.either(0.005, 0.02, 0.1)
    of.voltage_V[struck] *= of.dice.choice((0.3, 0.8, 1.2, 2.0), struck.sum())


def _bursts(of: Readings, column: FloatArray, gains: tuple[float, ...]) -> None:
    """Let some bursts of seconds read too much or too little."""
    for _ in range(int(of.either(1, 3, 10))):
        begin, rows = int(of.dice.integers(FIRST_ROW, column.size)), int(of.either(3, 6))
        column[begin : begin + rows] *= of.either(*gains)


def _bursts_of_current(of: Readings) -> None:
    _bursts(of, of.current_A, (0.0, 3.0, 10.0))


def _bursts_of_voltage(of: Readings) -> None:
    _bursts(of, of.voltage_V, (0.5, 0.9, 1.05, 1.1))


def _lost_rows(of: Readings) -> None:
    of.voltage_V[of.dice.random(of.voltage_V.size) < of.either(0.3, 0.6, 0.9)] = NAN


def _silence(of: Readings) -> None:
    of.voltage_V[of.begins : of.begins + int(of.either(10, 60, 300))] = NAN


def _out_of_order(of: Readings) -> None:
    rows = int(of.either(2, 5))
    order = np.arange(of.time_s.size)
    for begin in range(0, order.size, rows):
        of.dice.shuffle(order[begin : begin + rows])
    for column in (of.time_s, of.voltage_V, of.current_A, of.temp_C):
        column[:] = column[order]


FAULTS: dict[str, Fault] = {
    "none": lambda of: None,
    "two batteries under one id": _two_batteries,
    "voltage reads 1.2 to 5 % more from then on": _reads_more,
    "voltage reads 1.2 to 5 % less from then on": _reads_less,
    "voltage drifts by up to 0.8 V": _drifts,
    "voltage in steps of 0.1, 0.2 or 0.5 V": _coarse,
    "voltage with noise of 0.05, 0.1 or 0.3 V": _noisy,
    "voltage is stuck": _stuck_voltage,
    "current is stuck": _stuck_current,
    "current is dead": _dead_current,
    "current reads 0.4 to 1.6 times as much": _other_gain,
    "a load of 1, 3 or 5 A is not metered": _unmetered,
    "current saturates at 1.1 or 1.3 times its median": _saturates,
    "voltage is limited at the top": _limited_at_top,
    "a contact of 5 to 40 mohm more": _bad_contact,
    "voltage is 2 or 8 s late": _late_voltage,
    "current is 2 or 8 s late": _late_current,
    "temperature is wrong": _wrong_temperature,
    "voltage has spikes": _spikes,
    "current is 0, 3 or 10 times as much for 3 or 6 s": _bursts_of_current,
    "voltage is 0.5 to 1.1 times as much for 3 or 6 s": _bursts_of_voltage,
    "30, 60 or 90 % of the rows are lost": _lost_rows,
    "a silence of 10, 60 or 300 s": _silence,
    "rows out of order within 2 or 5 s": _out_of_order,
}


def with_fault(rows: tuple[Sample, ...], fault: Fault, seed: int) -> tuple[tuple[Sample, ...], float]:
    """Return the rows with a fault of drawn size and begin, and the time at which it begins [s].

    A row whose voltage is NaN is left out. There is no counter of the autopilot: it would not share the fault.
    """
    dice = np.random.default_rng(seed)
    begins = int(dice.integers(FIRST_ROW, max(len(rows) - LAST_ROWS, FIRST_ROW + 1)))
    time_s, volts, amps, temp_C = (
        np.array([getattr(s, name) for s in rows]) for name in ("time_s", "voltage_V", "current_A", "temp_C")
    )
    of = Readings(time_s, volts, amps, temp_C, begins, dice)
    fault(of)
    columns = (of.time_s, of.voltage_V, of.current_A, of.temp_C)
    found = [
        replace(row, time_s=float(t), voltage_V=float(v), current_A=float(i), temp_C=float(c), consumed_Ah=NAN)
        for row, t, v, i, c in zip(rows, *columns, strict=True)
        if np.isfinite(v)
    ]
    return tuple(found), rows[begins].time_s
