"""Effects planted into the recorded telemetry of effect-free flights, by arithmetic that diagnosis does not use.

Each function takes a flight of the simulated truth (what its sensors reported, with the true charge and current beside
it at every row) and returns it as it would have been reported with something wrong. Sensor effects are exact. Effects
of the cell move the recorded voltage by what the change does to it: a charge that is lower shows the voltage of that
charge (through the OCV), more ohms show more of the sag that was recorded.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.fitting.observed import ObservedRecord
from uavbatt.telemetry import read_log

Array = NDArray[np.float64]
CELLS, CAPACITY_AH, CUTOFF_V = 4, 5.016, 13.2
AFTER_END_V, BELOW_S = 12.9, 4.0
ACTIVATION_K = 1500.0
HEAT_JPK, COOLING_WPK = 28.0 * CAPACITY_AH, 0.074 * CAPACITY_AH  # one cell of this size


@dataclass(frozen=True)
class Flown:
    """A Flown holds one flight: reported voltage, current and temperature, true charge and current, OCV of the cell."""

    name: str
    time_s: Array
    voltage_V: Array
    current_A: Array
    temp_C: Array
    true_soc: Array
    true_A: Array
    ocv: tuple[Array, Array]
    ohm: tuple[Array, Array]  # how resistance goes with charge

    def sag_V(self) -> Array:
        """Return the voltage [V] that the load takes from the pack, without the sensor's noise."""
        return follow(np.maximum(CELLS * self.open_V(self.true_soc) - self.voltage_V, 0.0), self.time_s, 2.0, 0.0)

    def open_V(self, soc: Array) -> Array:
        """Return the OCV of one cell [V] at a state of charge, straight on below empty."""
        knots, volts = self.ocv
        low = (volts[1] - volts[0]) / (knots[1] - knots[0])
        inside: Array = np.interp(soc, knots, volts) + low * np.minimum(soc - knots[0], 0.0)
        return inside

    def observed(self) -> ObservedRecord:
        """Return the flight as diagnosis takes it, up to the end of flight."""
        width = int(BELOW_S / np.median(np.diff(self.time_s)))
        mean_V = np.convolve(self.voltage_V, np.ones(width) / width, mode="same")
        under = np.flatnonzero((mean_V < AFTER_END_V) & (self.time_s > 60.0))
        end = under[0] if under.size and under[0] < self.time_s.size - 2 * width else self.time_s.size
        columns = (self.time_s, self.voltage_V, self.current_A, self.temp_C)
        time_s, voltage_V, current_A, temp_C = (c[:end] for c in columns)
        return ObservedRecord(self.name, time_s, voltage_V, current_A, temp_C, float("nan"), CELLS, CAPACITY_AH)


Change = Callable[[Flown], Flown]


def flights(log_folder: Path, answer_folder: Path, battery: BatteryFile) -> list[Flown]:
    """Read the flights of one case with their truth at every row."""
    table = battery.parameters
    ocv = (np.array(table.ocv_soc), np.array(table.ocv_V))
    ohm = (np.array(table.resistance_soc), np.array(table.resistance_ohmAh))
    found = []
    for path in sorted(log_folder.glob("*.tlog")):
        rows = [s for s in read_log(path).samples if np.isfinite(s.voltage_V) and np.isfinite(s.current_A)]
        time_s, volts, amps, temps = (
            np.array([getattr(s, n) for s in rows]) for n in ("time_s", "voltage_V", "current_A", "temp_C")
        )
        with (answer_folder / f"{path.stem}.csv").open() as stream:
            truth = np.array([[float(x) for x in row] for row in list(csv.reader(stream))[1:]])
        soc, true_A = (np.interp(time_s, truth[:, 0], truth[:, k]) for k in (1, 3))
        found.append(Flown(f"{log_folder.name} {path.stem}", time_s, volts, amps, temps, soc, true_A, ocv, ohm))
    return found


def follow(target: Array, time_s: Array, tau_s: float, start: float) -> Array:
    """Return what follows a target with the time constant `tau_s` [s], from `start` on."""
    out, value = np.empty_like(target), start
    for k, step_s in enumerate(np.diff(time_s, prepend=time_s[0])):
        value += (target[k] - value) * (1.0 - np.exp(-step_s / tau_s))
        out[k] = value
    return out


def current_gain(size: float) -> Change:
    """Return a change: the current sensor reads `size` times the current."""
    return lambda f: replace(f, current_A=f.current_A * size)


def current_offset(size_A: float) -> Change:
    """Return a change: the current sensor adds a constant [A], also on the ground; it shows nothing below zero."""
    return lambda f: replace(f, current_A=np.maximum(f.current_A + size_A, 0.0))


def unmetered(size_W: float) -> Change:
    """Return a change: the sensor misses what a load of constant power [W] draws."""
    return lambda f: replace(f, current_A=np.maximum(f.current_A - size_W / f.voltage_V, 0.0))


def voltage_gain(size: float) -> Change:
    """Return a change: the voltage sensor reads `size` times the voltage."""
    return lambda f: replace(f, voltage_V=f.voltage_V * size)


def voltage_offset(size_V: float) -> Change:
    """Return a change: the voltage sensor adds a constant [V]."""
    return lambda f: replace(f, voltage_V=f.voltage_V + size_V)


def temperature_offset(size_K: float) -> Change:
    """Return a change: the temperature sensor adds a constant [K]."""
    return lambda f: replace(f, temp_C=f.temp_C + size_K)


def temperature_lag(tau_s: float) -> Change:
    """Return a change: the temperature sensor follows late, with the time constant `tau_s` [s]."""
    return lambda f: replace(f, temp_C=follow(f.temp_C, f.time_s, tau_s, float(np.mean(f.temp_C[:5]))))


def current_delay(size_s: float) -> Change:
    """Return a change: the current is that of `size_s` [s] ago."""
    return lambda f: replace(f, current_A=np.interp(f.time_s - size_s, f.time_s, f.current_A))


def harness(size_ohm: float) -> Change:
    """Return a change: there are leads of `size_ohm` [ohm] between the pack and the voltage sensor."""
    return lambda f: replace(f, voltage_V=f.voltage_V - f.true_A * size_ohm)


def sag_compensation(size_ohm: float) -> Change:
    """Return a change: the autopilot reports the voltage with its own current times `size_ohm` added."""
    return lambda f: replace(f, voltage_V=f.voltage_V + f.current_A * size_ohm)


def fade(share: float) -> Change:
    """Return a change: the pack holds less charge.

    The same cells, smaller, flown at the same C-rate, give the same voltage exactly.
    """
    return lambda f: replace(f, current_A=f.current_A * (1.0 - share), true_A=f.true_A * (1.0 - share))


def resistance_growth(share: float) -> Change:
    """Return a change: more of the sag that was recorded, by `share`, and its heat in the core."""

    def grown(f: Flown) -> Flown:
        sag_V = f.sag_V()
        heat_W = share * sag_V / CELLS * f.true_A
        warmer = follow(heat_W / COOLING_WPK, f.time_s, HEAT_JPK / COOLING_WPK, 0.0)
        return replace(f, voltage_V=f.voltage_V - share * sag_V, temp_C=f.temp_C + warmer)

    return grown


def lower_charge(of: Callable[[Flown], Array], cells: int = CELLS) -> Change:
    """Return a change: `cells` of the series are at the charge that `of` gives, the others as they were."""

    def lowered(f: Flown) -> Flown:
        soc = of(f)
        more = np.interp(soc, *f.ohm) / np.interp(f.true_soc, *f.ohm) - 1.0
        change_V = f.open_V(soc) - f.open_V(f.true_soc) - more * f.sag_V() / CELLS
        return replace(f, voltage_V=f.voltage_V + cells * change_V)

    return lowered


def weak_cell(deficit: float) -> Change:
    """Return a change: one cell holds less charge by the share `deficit`, full when the others are."""
    return lower_charge(lambda f: 1.0 - (1.0 - f.true_soc) / (1.0 - deficit), cells=1)


def initial_charge(missing: float) -> Change:
    """Return a change: the pack was charged to less than full, by `missing` of its charge."""
    return lower_charge(lambda f: f.true_soc - missing)


def rate_capacity(gain_h: float) -> Change:
    """Return a change: a share of the current, growing with it, does no work."""

    def drained(f: Flown) -> Array:
        rate = f.true_A / CAPACITY_AH
        lost: Array = np.cumsum(gain_h * rate * np.abs(rate) * np.diff(f.time_s, prepend=f.time_s[0])) / 3600.0
        return f.true_soc - lost

    return lower_charge(drained)


def hysteresis(size_V: float) -> Change:
    """Return a change: a voltage branch `size_V` [V] lower is reached after 6 % of the charge, in a straight line."""
    return lambda f: replace(
        f, voltage_V=f.voltage_V - CELLS * size_V * np.clip((f.true_soc[0] - f.true_soc) / 0.06, 0.0, 1.0)
    )


def charge_transfer(factor: float) -> Change:
    """Return a change: the reaction of both electrodes is `factor` times as fast.

    By Butler and Volmer's law, not our approximation.
    """

    def slower(f: Flown) -> Flown:
        share = f.true_A / CAPACITY_AH / 0.8
        change_V = 2.0 * 0.0514 * (np.arcsinh(share / factor) - np.arcsinh(share))
        warmer = follow(change_V * f.true_A / COOLING_WPK, f.time_s, HEAT_JPK / COOLING_WPK, 0.0)
        return replace(f, voltage_V=f.voltage_V - CELLS * change_V, temp_C=f.temp_C + warmer)

    return slower


def slow_voltage(ohm: float, tau_s: float = 150.0) -> Change:
    """Return a change: the voltage gives way over minutes beyond what the file says."""
    return lambda f: replace(f, voltage_V=f.voltage_V - CELLS * follow(ohm * f.true_A, f.time_s, tau_s, 0.0))


def cooled(share: float) -> Change:
    """Return a change: the air in flight takes `share` more heat than the bench did."""

    def cooler(f: Flown) -> Flown:
        rise, out, cold = f.temp_C - np.mean(f.temp_C[:5]), np.empty_like(f.temp_C), 0.0
        for k, step_s in enumerate(np.diff(f.time_s, prepend=f.time_s[0])):
            cold += step_s * COOLING_WPK / HEAT_JPK * (share * (rise[k] - cold) * (f.true_A[k] > 1.0) - cold)
            out[k] = f.temp_C[k] - cold
        more = np.exp(ACTIVATION_K * (1.0 / (out + 273.15) - 1.0 / (f.temp_C + 273.15))) - 1.0
        return replace(f, temp_C=out, voltage_V=f.voltage_V - more * f.sag_V())

    return cooler


def both(first: Change, second: Change) -> Change:
    """Return two changes, one after the other: the sensor's after the cell's."""
    return lambda f: second(first(f))
