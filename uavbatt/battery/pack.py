"""A pack in an aircraft: cells in series behind a harness, seen through its sensors.

    I_true = (I_meas - offset)/gain + P_unmetered/V_meas
    c      = I_true / (Q (1 - fade))
    r      = r_type (1 + growth)
    V_meas = gain_V ((n-1) V(soc) + V(soc_weak) - I_true R_harness) + offset_V + I_true R_compensation

Charge is normalised by the pack's present capacity: a faded pack draws a higher C-rate at the same current, so that
it also shows more ohms (the ohm·Ah stay).
"""

from __future__ import annotations

from typing import NamedTuple

from uavbatt.battery import equations as eq
from uavbatt.battery import model
from uavbatt.battery.equations import Number
from uavbatt.battery.model import Parameters, State

FULL_CELL_V = 4.0  # of a cell; the mean of a gentle discharge is less
TYPICAL_C_RATE, TYPICAL_CELL_V = 2.5, 3.8  # hovers of 12 to 30 minutes draw 2 to 4 C; mean voltage of a cell on the way


class Installation(NamedTuple):
    """Installation holds the pack's size and all between its cells and the telemetry; the defaults are neutral."""

    cells: Number
    capacity_Ah: Number
    fade: Number = 0.0
    growth: Number = 0.0
    deficit: Number = 0.0
    harness_ohm: Number = 0.0
    gain_I: Number = 1.0
    offset_A: Number = 0.0
    unmetered_W: Number = 0.0
    gain_V: Number = 1.0
    offset_V: Number = 0.0
    compensation_ohm: Number = 0.0  # what is reported is the voltage with I·R of this resistance added
    offset_K: Number = 0.0
    delay_s: Number = 0.0  # the current is reported this much later than the voltage
    start_soc_shift: Number = 0.0  # true charge at the start less the one believed

    @property
    def present_capacity_Ah(self) -> Number:
        """Return the capacity that the pack has today [Ah]."""
        return self.capacity_Ah * (1.0 - self.fade)


def most_energy_Wh(pack: Installation) -> Number:
    """Return an upper bound of the energy of a full pack [Wh]: every cell at FULL_CELL_V to the end."""
    return pack.present_capacity_Ah * pack.cells * FULL_CELL_V


def typical_power_W(cells: int, capacity_Ah: float) -> float:
    """Return the power [W] that a typical multirotor draws from a pack of `cells` in series and `capacity_Ah` [Ah]."""
    return TYPICAL_C_RATE * capacity_Ah * cells * TYPICAL_CELL_V


def true_current(pack: Installation, current_A: Number, voltage_V: Number) -> Number:
    """Return the current that leaves the cells [A], from the metered one [A] and the metered voltage [V]."""
    return (current_A - pack.offset_A) / pack.gain_I + pack.unmetered_W / voltage_V


def c_rate(pack: Installation, current_A: Number) -> Number:
    """Return the C-rate [1/h] of a true pack current [A]."""
    return current_A / pack.present_capacity_Ah


def grown(p: Parameters, pack: Installation) -> Parameters:
    """Return the cell's parameters with the pack's resistance growth in them."""
    return p._replace(resistance_gain=p.resistance_gain * (1.0 + pack.growth))


def weak_soc(pack: Installation, soc: Number) -> Number:
    """Return the state of charge of the weakest cell: it gives the same charge out of (1 - deficit) of the capacity."""
    return 1.0 - (1.0 - soc) / (1.0 - pack.deficit)


def weak_voltage(pack: Installation, p: Parameters, s: State, c_rate: Number) -> Number:
    """Return the terminal voltage of the weakest cell [V] where the others are in state `s` under `c_rate` [1/h].

    It is a smaller cell under the same current: its C-rate is higher, and with it every drop.
    """
    more = 1.0 / (1.0 - pack.deficit)
    weak = State(weak_soc(pack, s.soc), s.polarisation_V * more, s.diffusion_V * more, s.core_C, s.sensor_C)
    return model.cell_voltage(p, weak, c_rate * more)


def weak_lag(pack: Installation, p: Parameters, s: State, c_rate: Number, strong_V: Number) -> Number:
    """Return the mean voltage of all cells less `strong_V` of the other cells [V]: the effect of the weakest cell."""
    if not eq.is_on(pack.deficit):
        return 0.0
    return (weak_voltage(pack, p, s, c_rate) - strong_V) / pack.cells


def series_resistance(pack: Installation, r_ohmAh: Number) -> Number:
    """Return a cell's resistance with its share of the harness [ohm·Ah]."""
    return r_ohmAh + pack.harness_ohm * pack.present_capacity_Ah / pack.cells


def terminal_voltage(pack: Installation, p: Parameters, s: State, current_A: Number) -> Number:
    """Return the true voltage at the sensor's place [V] under a true current [A]."""
    rate = c_rate(pack, current_A)
    strong_V = model.cell_voltage(p, s, rate)
    return pack.cells * (strong_V + weak_lag(pack, p, s, rate, strong_V)) - current_A * pack.harness_ohm


def metered_voltage(pack: Installation, true_V: Number) -> Number:
    """Return the voltage that the sensor reads [V]; an end of flight is judged by it."""
    return pack.gain_V * true_V + pack.offset_V


def compensated_voltage(pack: Installation, metered_V: Number, current_A: Number) -> Number:
    """Return the voltage that the telemetry reports [V]: the metered one, with the sag of a true current [A] added."""
    return metered_V + pack.compensation_ohm * current_A


def true_voltage(pack: Installation, voltage_V: Number, current_A: Number) -> Number:
    """Return the voltage at the sensor's place [V] from the reported one [V] under a true current [A].

    It is `metered_voltage` and `compensated_voltage` backwards.
    """
    return (voltage_V - pack.compensation_ohm * current_A - pack.offset_V) / pack.gain_V


def true_power(pack: Installation, voltage_V: Number, current_A: Number) -> Number:
    """Return the power that leaves the pack [W] from reported voltage [V] and current [A]."""
    drawn_A = true_current(pack, current_A, voltage_V)
    return true_voltage(pack, voltage_V, drawn_A) * drawn_A
