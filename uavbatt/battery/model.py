"""The cell model: its parameters, its state, one step, one voltage.

    soc'  = -c g (1 + g_c |c|)/3600                      coulomb counting
    R     = r R0(soc) exp(E (1/T - 1/T_ref))             resistance at once [ohm·Ah]
    v_f'  = (c R k_f + OCV(soc) - OCV(soc - c h_s) - v_f)/tau_f    polarisation (seconds)
    v_s'  = (c R k_s exp(E_s (1/T - 1/T_ref)) - v_s)/tau_s         slow diffusion (minutes)
    T'    = (g_T c U - h (1 + g_a |c|) (T - T_ambient))/C_th       self heating
    U     = v_f + v_s + c (R + R_t)                      what is lost of the voltage to heat
    V     = OCV(soc) - V_h (1 - exp(-(1 - soc)/0.03)) - v_f - v_s - c (R + R_t)
    R_t   = V_t/(|c| + c_t)                              charge transfer that has become sluggish

V_h is the hysteresis: a pack is charged to full and then flown, so that its current changed sign at soc = 1 and the
charge drawn since is 1 - soc. So it needs no state of its own; a partly charged pack is not treated differently.
h_s is the charge that the surface of the particles lacks per C of load, beyond what the rest of the model contains.
k_f and k_s are the polarisations as multiples of R0: like R0 they grow in an empty or cold cell. An effect that is off
has the neutral defaults of `Parameters`: there is one model and no second code path.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavbatt.battery import equations as eq
from uavbatt.battery.equations import Number

Array = NDArray[np.float64]

SOC_GRID = np.linspace(-0.05, 1.05, 221)  # tables are dense and uniform so that a look-up is an index
LOWEST_SOC, GRID_STEP = float(SOC_GRID[0]), float(SOC_GRID[1] - SOC_GRID[0])
SEGMENTS = SOC_GRID.size - 1.0
TURN_CHARGE = 0.03  # share of the charge after which the voltage is two thirds of the way to its discharge branch
LONGEST_STEP_S = 5.0  # temperature and resistance are held over a step; beyond this the error shows
# Typical time constants, from which a fit begins too. Without the polarisations they have no effect on the model, but
# `surface_h` alone needs the first one.
POLARISATION_TAU_S, DIFFUSION_TAU_S = 12.0, 400.0
MOST_STEPS = 720  # after more than an hour of silence a pack rests: longer steps do no harm


class Parameters(NamedTuple):
    """Parameters holds the parameters of one cell, normalised by capacity; the defaults are neutral ("effect off")."""

    ocv_V: Array  # on SOC_GRID, or [batch, grid]
    r0_ohmAh: Array  # on SOC_GRID, or [batch, grid]; at 25 °C
    resistance_gain: Number = 1.0
    polarisation_ratio: Number = 0.0
    polarisation_tau_s: Number = POLARISATION_TAU_S
    diffusion_ratio: Number = 0.0
    diffusion_tau_s: Number = DIFFUSION_TAU_S
    activation_K: Number = 0.0
    diffusion_activation_K: Number = 0.0  # on top of activation_K
    surface_h: Number = 0.0  # charge that the surface of the particles lacks per C of load
    heat_gain: Number = 0.0  # 1 with self_heating; 0 leaves only the exchange with the ambient
    heat_capacity_JpKAh: Number = 40.0
    cooling_WpKAh: Number = 0.1
    airflow_gain_h: Number = 0.0  # cooling grows by this share per C of load: more power, more draught
    charge_gain: Number = 1.0  # charge taken per charge counted: capacity fade, rate capacity
    rate_gain_h: Number = 0.0
    sensor_lag_s: Number = 1.0
    transfer_V: Number = 0.0  # drop of a sluggish reaction at a large load
    transfer_half_rate: Number = 0.3  # C-rate at which half of it shows
    hysteresis_V: Number = 0.0  # from the charge branch, which the table of the OCV then is, to the discharge branch


class State(NamedTuple):
    """A cell's state is its soc [-], polarisation and diffusion overpotential [V], core and sensor temperature [°C]."""

    soc: Number
    polarisation_V: Number
    diffusion_V: Number
    core_C: Number
    sensor_C: Number


def rested(soc: Number, temp_C: Number) -> State:
    """Return the state of a cell at rest at `soc`, with one temperature throughout [°C]."""
    zero = np.zeros(np.broadcast_shapes(np.shape(soc), np.shape(temp_C)))
    return State(soc + zero, zero, zero, temp_C + zero, temp_C + zero)


def open_circuit_voltage(p: Parameters, soc: Number) -> Number:
    """Return OCV(soc) [V] of one cell on its way down from full; straight beyond the ends of its table."""
    index, share = eq.segment(soc, LOWEST_SOC, GRID_STEP, SEGMENTS)
    return _ocv_V(p, soc, eq.interpolated(p.ocv_V, index, share))


def resistance(p: Parameters, soc: Number, core_C: Number) -> Number:
    """Return R0(soc, T) [ohm·Ah], the resistance at once of one cell; flat beyond the ends of its table."""
    index, share = eq.segment(soc, LOWEST_SOC, GRID_STEP, SEGMENTS)
    return _r0_ohmAh(p, eq.interpolated(p.r0_ohmAh, index, eq.held(share)), core_C)


def _ocv_V(p: Parameters, soc: Number, charged_V: Number) -> Number:
    """Return OCV(soc) [V] from `charged_V`, its value in the table."""
    if not eq.is_on(p.hysteresis_V):
        return charged_V
    return charged_V - p.hysteresis_V * eq.hysteresis_fraction(1.0 - soc, TURN_CHARGE)


def _r0_ohmAh(p: Parameters, new_ohmAh: Number, core_C: Number) -> Number:
    """Return R0(soc, T) [ohm·Ah] from `new_ohmAh`, its value in the table."""
    return p.resistance_gain * new_ohmAh * eq.arrhenius(core_C, p.activation_K)


def source(p: Parameters, s: State) -> tuple[Number, Number]:
    """Return the electromotive force [V] and the `resistance` [ohm·Ah], looked up once for both.

    The electromotive force is the voltage that the terminals would show with the current cut off this instant.
    """
    index, share = eq.segment(s.soc, LOWEST_SOC, GRID_STEP, SEGMENTS)
    charged_V = eq.interpolated(p.ocv_V, index, share)
    return source_from(p, s, charged_V, eq.interpolated(p.r0_ohmAh, index, eq.held(share)))


def source_from(p: Parameters, s: State, charged_V: Number, new_ohmAh: Number) -> tuple[Number, Number]:
    """Return `source` from `charged_V` and `new_ohmAh`, the values of tables `ocv_V` and `r0_ohmAh` at this charge."""
    emf_V = _ocv_V(p, s.soc, charged_V) - s.polarisation_V - s.diffusion_V
    return emf_V, _r0_ohmAh(p, new_ohmAh, s.core_C)


def cell_voltage(p: Parameters, s: State, c_rate: Number) -> Number:
    """Return the terminal voltage of one cell [V] under `c_rate` [1/h]."""
    emf_V, r_ohmAh = source(p, s)
    return voltage_under(emf_V, r_ohmAh, UnderLoad(c_rate, transfer_drop(p, c_rate)))


def voltage_under(emf_V: Number, series_ohmAh: Number, under: UnderLoad) -> Number:
    """Return the voltage [V] under a load of `emf_V` behind `series_ohmAh`, the cell's own resistance included."""
    return emf_V - under.c_rate * series_ohmAh - under.transfer_V


def transfer_drop(p: Parameters, c_rate: Number) -> Number:
    """Return c R_t [V], the immediate drop of a slow reaction."""
    return c_rate * eq.transfer_resistance(c_rate, p.transfer_V, p.transfer_half_rate)


class UnderLoad(NamedTuple):
    """UnderLoad holds the load of a cell: its C-rate [1/h], and the drop of a slow reaction [V]."""

    c_rate: Number
    transfer_V: Number


def under_power(p: Parameters, emf_V: Number, series_ohmAh: Number, power_WpAh: Number) -> UnderLoad:
    """Return the C-rate and the drop of a slow reaction at which a cell gives a power [W/Ah].

    `emf_V` stands behind `series_ohmAh`, the cell's own resistance included. The drop of the reaction hardly changes
    with the load: its value at the rate that a cell without resistance would have is good to 1 mV.
    """
    transfer_V = transfer_drop(p, power_WpAh / np.maximum(emf_V, eq.LEAST_EMF_V))
    return UnderLoad(eq.current_at_power(emf_V - transfer_V, series_ohmAh, power_WpAh), transfer_V)


def depletion(p: Parameters, soc: Number, c_rate: Number) -> Number:
    """Return the voltage drop [V] by lack of charge at the surface of the particles: OCV(soc) - OCV(soc - c h).

    Diffusion in the particles carries the current from a surface that is emptier than their mean (Newman & Balsara
    2021, chapter 22); where the OCV is steep that costs most.
    """
    if not eq.is_on(p.surface_h):
        return 0.0
    surface = np.maximum(soc - c_rate * p.surface_h, np.minimum(soc, LOWEST_SOC))  # not below the end of the table
    return open_circuit_voltage(p, soc) - open_circuit_voltage(p, surface)


class Lags(NamedTuple):
    """Lags holds the share of a deviation that is left after one step, `equations.decay` for each lag."""

    polarisation: Number
    diffusion: Number
    core: Number  # without airflow
    sensor: Number


def lags(p: Parameters, dt_s: Number) -> Lags:
    """Return the decay of each lag over a step of `dt_s` [s]."""
    return Lags(
        eq.decay(dt_s, p.polarisation_tau_s),
        eq.decay(dt_s, p.diffusion_tau_s),
        eq.decay(dt_s, p.heat_capacity_JpKAh / p.cooling_WpKAh),
        eq.decay(dt_s, p.sensor_lag_s),
    )


def step(p: Parameters, s: State, c_rate: Number, ambient_C: Number, dt_s: Number, lags: Lags) -> State:
    """Return the state after one step with the current held; `lags` are those of `dt_s` [s].

    Keep the step under LONGEST_STEP_S (see `advance`).
    """
    return step_with_resistance(p, s, c_rate, resistance(p, s.soc, s.core_C), ambient_C, dt_s, lags)


def step_with_resistance(
    p: Parameters, s: State, c_rate: Number, r_ohmAh: Number, ambient_C: Number, dt_s: Number, lags: Lags
) -> State:
    """Return `step` with a known resistance [ohm·Ah]."""
    later = step_cell(p, s, UnderLoad(c_rate, transfer_drop(p, c_rate)), r_ohmAh, ambient_C, dt_s, lags)
    sensor_C = eq.relax_to(s.sensor_C, later.core_C, lags.sensor)
    return State(later.soc, later.polarisation_V, later.diffusion_V, later.core_C, sensor_C)


def step_cell(
    p: Parameters, s: State, under: UnderLoad, r_ohmAh: Number, ambient_C: Number, dt_s: Number, lags: Lags
) -> State:
    """Return `step_with_resistance` without the sensor temperature, which a forecast does not need."""
    c_rate = under.c_rate
    drop_V = c_rate * r_ohmAh
    lost_V = drop_V + s.polarisation_V + s.diffusion_V + under.transfer_V
    slow_V = drop_V * p.diffusion_ratio
    if eq.is_on(p.diffusion_activation_K):
        slow_V = slow_V * eq.arrhenius(s.core_C, p.diffusion_activation_K)
    fast_V = drop_V * p.polarisation_ratio
    if eq.is_on(p.surface_h):
        fast_V = fast_V + depletion(p, s.soc, c_rate)
    drained = c_rate * (p.charge_gain * eq.load_factor(p.rate_gain_h, c_rate))
    return State(
        soc=eq.charge_step(s.soc, drained, dt_s),
        polarisation_V=eq.relax_to(s.polarisation_V, fast_V, lags.polarisation),
        diffusion_V=eq.relax_to(s.diffusion_V, slow_V, lags.diffusion),
        core_C=_core_C(p, s.core_C, p.heat_gain * c_rate * lost_V, c_rate, ambient_C, dt_s, lags.core),
        sensor_C=s.sensor_C,
    )


def _core_C(
    p: Parameters, core_C: Number, heat_W: Number, c_rate: Number, ambient_C: Number, dt_s: Number, still: Number
) -> Number:
    """Return the core temperature after a step with held `heat_W` [W/Ah]; `still` : its decay without airflow."""
    cooling = p.cooling_WpKAh * eq.load_factor(p.airflow_gain_h, c_rate)
    share = eq.decay(dt_s, p.heat_capacity_JpKAh / cooling) if eq.is_on(p.airflow_gain_h) else still
    return eq.relax_to(core_C, eq.settled_temperature(heat_W, ambient_C, cooling), share)


class Stride(NamedTuple):
    """A stride divides a step of any length into equal steps of at most LONGEST_STEP_S, or into MOST_STEPS of them."""

    steps: int
    dt_s: float
    lags: Lags


def stride(p: Parameters, dt_s: float) -> Stride:
    """Return the equal steps that make `dt_s` [s]."""
    steps = min(max(1, int(np.ceil(dt_s / LONGEST_STEP_S - 1e-9))), MOST_STEPS)
    return Stride(steps, dt_s / steps, lags(p, dt_s / steps))


def advance(p: Parameters, s: State, c_rate: Number, ambient_C: Number, dt_s: float) -> State:
    """Return the state after `dt_s` seconds at constant current, in the equal steps of `stride`."""
    return advance_by(p, s, c_rate, ambient_C, stride(p, dt_s))


def advance_by(p: Parameters, s: State, c_rate: Number, ambient_C: Number, over: Stride) -> State:
    """Return `advance` with a known stride."""
    for _ in range(over.steps):
        s = step(p, s, c_rate, ambient_C, over.dt_s, over.lags)
    return s
