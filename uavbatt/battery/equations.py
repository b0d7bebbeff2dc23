"""The equations of the battery model: one equation, one function, nothing else.

Everything is per cell and normalised by capacity, so that one set of numbers serves any pack of the type:

    symbol       unit              meaning
    soc          -                 state of charge, 0..1 of the pack's present capacity
    c_rate       1/h               current divided by capacity; positive discharges
    R            ohm·Ah            resistance times capacity
    T            °C                temperatures in the interface, kelvin inside the exponent
    C_th, h      J/(K·Ah), W/(K·Ah)   heat capacity and cooling per ampere-hour and cell

All functions are elementwise: floats or numpy arrays that broadcast, and they return the same. Every step is
the exact solution for inputs held over the step, so its length is free (Plett, "Battery Management Systems"
vol. 1, 2015, sections 2.4-2.8, for the circuit; Bernardi 1985 without the entropic term for the heat).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Number = Any  # a float or an array of them: numpy's stubs cannot say "the same as came in"

KELVIN = 273.15  # 0 °C in K
REFERENCE_TEMP_C = 25.0  # of resistance and reactions; the study's tests are repeated there
SECONDS_PER_HOUR = 3600.0
LEAST_EMF_V = 1e-3  # keeps a division by the EMF finite where a fit tries an empty cell


def is_on(value: Number) -> bool:
    """Return True if a parameter whose neutral value is 0 differs from it in any column."""
    return bool(np.count_nonzero(value)) if isinstance(value, np.ndarray) else bool(value != 0.0)


def charge_step(soc: Number, c_rate: Number, dt_s: Number) -> Number:
    """Return the state of charge after `dt_s` [s] at `c_rate` [1/h], by coulomb counting: soc' = -c/3600."""
    return soc - c_rate * (dt_s / SECONDS_PER_HOUR)


def decay(dt_s: Number, tau_s: Number) -> Number:
    """Return the share of a deviation that a first-order lag has left after `dt_s`: exp(-dt/tau), for tau > 0."""
    return np.exp(-dt_s / tau_s)


def relax_to(value: Number, target: Number, share: Number) -> Number:
    """Return the value after its deviation from a held target has decayed to `share`."""
    return target + (value - target) * share


def relax(value: Number, target: Number, dt_s: Number, tau_s: Number) -> Number:
    """Return the value of a first-order lag after `dt_s`, target held, exact: x' = (target - x)/tau, for tau > 0."""
    return relax_to(value, target, decay(dt_s, tau_s))


def arrhenius(temp_C: Number, activation_K: Number) -> Number:
    """Return the factor on a resistance at `temp_C` [°C]: exp(E (1/T - 1/T_ref)), 1 at 25 °C.

    E = `activation_K` [K] is the activation energy over the gas constant.
    """
    return np.exp(activation_K * (1.0 / (temp_C + KELVIN) - 1.0 / (REFERENCE_TEMP_C + KELVIN)))


def load_factor(gain_h: Number, c_rate: Number) -> Number:
    """Return the factor on a quantity that grows with the load in either direction: 1 + g |c|."""
    return 1.0 + gain_h * np.abs(c_rate) if is_on(gain_h) else 1.0


def settled_temperature(heat_W: Number, ambient_C: Number, cooling_WpK: Number) -> Number:
    """Return the steady temperature [°C] of a lumped core: C T' = q - h (T - T_ambient) = 0, for h > 0, per Ah."""
    return ambient_C + heat_W / cooling_WpK


def transfer_resistance(c_rate: Number, full_V: Number, half_rate: Number) -> Number:
    """Return the resistance [ohm·Ah] of a sluggish reaction: its drop tends to `full_V`, half of it at `half_rate`.

    Butler and Volmer's overpotential is ohmic at small currents and a logarithm at large ones (Newman & Balsara 2021,
    section 8.3); of a reaction k times as slow, what comes on top therefore ends in a constant, (2RT/F) ln k.
    """
    return full_V / (np.abs(c_rate) + half_rate)


def hysteresis_fraction(drawn: Number, charge: Number) -> Number:
    """Return the hysteresis fraction, from the charge branch (0) to the discharge branch (1), after `drawn` charge.

    It is 1 - 1/e after `charge`. Plett's one-state hysteresis (2015, eq. 2.33) for a current that never changes its
    sign: h' = (1 - h) / charge.
    """
    return -np.expm1(-np.maximum(drawn, 0.0) / charge)


def current_at_power(emf_V: Number, resistance_ohm: Number, power_W: Number) -> Number:
    """Return the current [A] that draws `power_W` from behind an inner resistance: the smaller root of (E - R I) I = P.

    Beyond the largest power that the source can give, E²/4R, it is the current of that largest power, E/2R. If the
    source voltage is negative, far beyond empty, the current is nearly 0.
    """
    emf_V = np.maximum(emf_V, LEAST_EMF_V)
    square_V2, four_ohm = emf_V * emf_V, 4.0 * resistance_ohm
    root = np.sqrt(np.maximum(square_V2 - four_ohm * power_W, 0.0))
    reachable = np.minimum(power_W, square_V2 / four_ohm)
    return 2.0 * reachable / (emf_V + root)


def segment(value: Number, first: float, step: float, segments: float) -> tuple[Number, Number]:
    """Return the index of the segment that a value falls into, and the share (0 to 1) of the way through it.

    The grid is uniform: `segments` of length `step` from `first` on. Beyond its ends the index is that of the end
    segment, and the share is below 0 or above 1.
    """
    position = (value - first) / step
    index = np.intp(np.minimum(np.maximum(position, 0.0), segments - 1.0))  # cut off: the floor of what is positive
    return index, position - index


def held(share: Number) -> Number:
    """Return the share of the way through a segment kept within 0..1, for tables that are flat beyond their ends."""
    return np.minimum(np.maximum(share, 0.0), 1.0)


def interpolated(table: NDArray[np.float64], index: Number, share: Number) -> Number:
    """Return a table's value at a `share` (0 to 1) of the way through its segment `index`; beyond it goes on straight.

    One table [G] serves any shape; tables [batch, G] need indices [batch].
    """
    if table.ndim == 1:
        left, right = table[index], table[index + 1]
    else:
        rows = np.arange(table.shape[0])
        left, right = table[rows, index], table[rows, index + 1]
    return left + (right - left) * share
