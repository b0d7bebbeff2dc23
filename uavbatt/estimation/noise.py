"""Uncertainty of the start, of the model's steps and of the readings: every number with its reason.

All numbers are per cell and per C, so that they hold for any pack. The functions return variances for the filter.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uavbatt.battery import initial_state, model
from uavbatt.battery import state_space as b
from uavbatt.battery.capacity_prior import Capacities
from uavbatt.battery.equations import Number
from uavbatt.battery.initial_state import IDLE_C_RATE
from uavbatt.battery.model import Array, State
from uavbatt.battery.pack import c_rate, grown, series_resistance, weak_lag
from uavbatt.battery.scaling import Pack
from uavbatt.battery.spreads import ROW_SHARE
from uavbatt.battery.state_space import SIZE, X
from uavbatt.limits import AMBIENT_C

# A rested reading: 5 mV a cell for scale and calibration of the sensor, 5 mV for a pack that has not fully relaxed.
RESTED_VOLTAGE_SD_V = 0.010
# Under load, in the first row, the voltage drop is known to half of its size.
UNSEEN_SHARE, OVERPOTENTIAL_SD_V, LOADED_SOC_SD = 0.5, 0.003, 0.15
ROUNDS = 6
UNKNOWN_TEMP_SD_K = 10.0
# The current of a row stands for an interval in which the load changed: the charge is uncertain by 6 % for rows 1 s
# apart or less (averaging logger), by 15 % for rows 10 s apart or more (snapshots of a gusty load).
AVERAGED_SHARE, SNAPSHOT_SHARE = 0.06, 0.15
# The scales of resistance and capacity wander by 1 % in ten minutes. The state of health does not change in a flight,
# but the error of the model's R(soc, T) and OCV does.
RESISTANCE_WALK_PER_S = 0.01**2 / 600.0
CAPACITY_WALK_PER_S = 0.01**2 / 600.0
LONGEST_GAP_S = 60.0
OVERPOTENTIAL_WALK_V2PS = 0.0005**2
CORE_WALK_K2PS = 0.02**2
# Worn packs, and simulated missions whose air has the pack's first temperature, reach 0.8 sds (one of 44: 1.02). Packs
# that are 10 K warmer than the air at take-off reach 1.3 and more.
AIR_OFF_SDS, AIR_TAU_S = 1.1, 30.0
# Change of the air temperature per second and per kelvin of error. With a quarter of this gain, warm packs in cold air
# are still predicted twice their remaining time; with twice the gain the temperature oscillates by 15 K.
AIR_GAIN_PS, LONGEST_AIR_STEP_S = 0.2, 10.0

# The part of the discrepancy that a load causes disappears after the load, like overpotentials. They decay faster or
# slower than in the battery file, so that the voltage says nothing about the capacity in this time. Without this rule a
# pack that landed nearly empty is believed to be three times as full.
SETTLING_S, SETTLED_AFTER_S = 30.0, 60.0
# A load is over, too, if a small share of it is left: a glider draws 0.4 C after 8 C. The share is of the highest load
# of the last minute, which fades. A VTOL that cruises at 1 C after its lift is no pack at rest.
LIGHT_SHARE, LIGHT_C_RATE, LOAD_TAU_S = 0.25, 0.5, 60.0

VOLTAGE_SD_V = 0.004
# Noise as a multiple of the increase of the reaction's voltage drop since the last block. The curvature of that drop is
# a third of it, and in the first seconds of a load a cell does not follow a single lag (10 to 20 mV a cell at 2.7 C for
# 5 s). With less noise the drop of the reaction is taken for resistance; twice the noise brings no gain.
JUMP_SHARE = 2.0
# The compensation of an autopilot is as good as its estimate of the resistance.
COMPENSATED_SHARE = 0.35


def charge_share(dt_s: float) -> float:
    """Return the relative sd of the charge drawn in a step of `dt_s` [s]; linear in the logarithm of the step."""
    weight = min(max(math.log10(max(dt_s, 1e-3)), 0.0), 1.0)
    return AVERAGED_SHARE + (SNAPSHOT_SHARE - AVERAGED_SHARE) * weight


class FirstBelief(NamedTuple):
    """FirstBelief holds a cell's state at the start, and mean and covariance of (charge, discrepancy [V])."""

    state: State
    mean: Array
    covariance: Array


def first_state(pack: Pack, cell_V: float, temp_C: float, rate_c: float) -> FirstBelief:
    """Return the first belief about a cell, from its voltage `cell_V` [V] under `rate_c` [1/h] in the first row.

    The drop depends on the charge, which depends on the drop: a few rounds settle it. Harness, grown resistance and a
    weak cell are part of it, as they are of every voltage that the filter expects (`pack.terminal_voltage`).
    """
    installation, cell = pack.installation, grown(pack.cell, pack.installation)
    idle = abs(rate_c) < IDLE_C_RATE
    drop_share = float(np.hypot(UNSEEN_SHARE, pack.spread.resistance_scale_sd))
    model_sd_V = pack.spread.bias_sd_V * (pack.spread.rested_share[0] if idle else 1.0)
    reaction_V = float(_reaction_V(pack, pack.spread.reaction_sd_V, rate_c))
    read = initial_state.charge_at(cell, cell_V, float(np.hypot(RESTED_VOLTAGE_SD_V, model_sd_V)))
    for _ in range(ROUNDS):
        state = initial_state.state_under_load(cell, read.soc, temp_C, rate_c)
        series_ohmAh = series_resistance(installation, model.resistance(cell, read.soc, temp_C))
        ohmic_V = max(rate_c, 0.0) * float(series_ohmAh)
        lag_V = weak_lag(installation, cell, state, rate_c, model.cell_voltage(cell, state, rate_c))
        other_V = float(state.polarisation_V + state.diffusion_V + model.transfer_drop(cell, rate_c) - lag_V)
        drop_V = other_V + (0.0 if pack.sag_compensated else ohmic_V)
        bias_sd_V = math.hypot(model_sd_V, float(np.interp(read.soc, model.SOC_GRID, pack.spread.ocv_sd_V)))
        reading_sd_V = math.hypot(RESTED_VOLTAGE_SD_V, drop_share * drop_V, reaction_V)
        read = initial_state.charge_at(cell, cell_V + drop_V, math.hypot(reading_sd_V, bias_sd_V))
    emf_V, full_share = cell_V + drop_V, pack.spread.rested_share[1]
    mean, covariance = initial_state.joint(cell, emf_V, reading_sd_V, bias_sd_V, idle, full_share)
    if covariance[0, 0] > LOADED_SOC_SD**2:  # a voltage tells something, however large the drop
        covariance = covariance * (LOADED_SOC_SD**2 / covariance[0, 0])
    return FirstBelief(initial_state.state_under_load(cell, float(mean[0]), temp_C, rate_c), mean, covariance)


def start_covariances(pack: Pack, state: State, charge: Array, temp_sd_K: float, members: Capacities) -> Array:
    """Return the covariances [members, 9, 9] of the first belief around `state`.

    `charge` [2, 2] is the covariance of (soc, discrepancy), `members` the prior of the pack's scales.
    """
    sd = np.zeros(SIZE)
    sd[X.POLARISATION] = max(UNSEEN_SHARE * abs(state.polarisation_V), OVERPOTENTIAL_SD_V)
    sd[X.DIFFUSION] = max(UNSEEN_SHARE * abs(state.diffusion_V), OVERPOTENTIAL_SD_V)
    sd[X.CORE] = sd[X.SENSOR] = temp_sd_K
    sd[X.REACTION] = pack.spread.reaction_sd_V
    covariance = np.diag(sd**2)
    covariance[np.ix_((X.SOC, X.BIAS), (X.SOC, X.BIAS))] = charge
    bank = np.tile(covariance, (members.sd.size, 1, 1))
    bank[:, X.LOG_RESISTANCE, X.LOG_RESISTANCE] = members.resistance_sd**2
    bank[:, X.LOG_CAPACITY, X.LOG_CAPACITY] = members.sd**2
    return bank


def process_variances(pack: Pack, mean: Array, rate_c: float, dt_s: float) -> Array:
    """Return the variances of the process noise Q for a step of `dt_s` [s], [9] or [9, members] as `mean` is.

    mean : the belief before the step; rate_c : C-rate [1/h] of the step. Over a long gap it is not known if the load
    went on; this uncertainty is included.
    """
    share = math.hypot(charge_share(dt_s), pack.spread.guess_sd)
    q = np.zeros(mean.shape)
    q[X.SOC] = (share * max(abs(rate_c), 0.2) * dt_s / 3600.0) ** 2
    if dt_s > LONGEST_GAP_S:
        q[X.SOC] += (0.5 * rate_c * dt_s / 3600.0) ** 2
    drop_V = np.abs(rate_c) * scaled_resistance(pack, mean) * np.exp(-mean[X.LOG_CAPACITY])
    fast_V, slow_V = drop_V * pack.cell.polarisation_ratio, drop_V * pack.cell.diffusion_ratio
    q[X.POLARISATION] = _lagging(
        pack.spread.lag_share[0], mean[X.POLARISATION], fast_V, dt_s, pack.cell.polarisation_tau_s
    )
    q[X.DIFFUSION] = _lagging(pack.spread.lag_share[1], mean[X.DIFFUSION], slow_V, dt_s, pack.cell.diffusion_tau_s)
    q[X.CORE] = CORE_WALK_K2PS * dt_s
    q[X.SENSOR] = CORE_WALK_K2PS * dt_s
    q[X.LOG_RESISTANCE] = RESISTANCE_WALK_PER_S * dt_s
    q[X.LOG_CAPACITY] = CAPACITY_WALK_PER_S * dt_s
    q[X.BIAS] = b.bias_variance(pack, dt_s) + b.ocv_doubt(pack, mean[X.SOC], rate_c * dt_s / 3600.0)
    return q


class LastLoad(NamedTuple):
    """LastLoad holds the time since the last load [s], NaN before the first, and how high it was [1/h], fading."""

    since_s: float = math.nan
    rate_c: float = 0.0


def load_after(last: LastLoad, rate_c: float, dt_s: float) -> LastLoad:
    """Return the last load after `dt_s` [s] at a C-rate."""
    rate = abs(rate_c)
    highest = max(rate, last.rate_c * math.exp(-dt_s / LOAD_TAU_S))
    is_over = rate <= max(IDLE_C_RATE, min(LIGHT_SHARE * highest, LIGHT_C_RATE))
    return LastLoad(last.since_s + dt_s if is_over else 0.0, highest)


def is_settling(last: LastLoad) -> bool:
    """Return True shortly after a load, when unknown overpotentials still move the voltage."""
    return 0.0 < last.since_s < SETTLED_AFTER_S


def rested_variance(pack: Pack, soc: Number) -> Number:
    """Return the variance [V²] of the discrepancy of a cell at rest: the error of its open-circuit voltage."""
    return (pack.spread.rested_share[0] * pack.spread.bias_sd_V) ** 2 + b.at_charge(pack.spread.ocv_sd_V, soc) ** 2


class Air(NamedTuple):
    """Air holds the temperature of the air around the pack [°C], its apparent error, and if it is known to be wrong.

    off_sds : the excess of the pack's temperature over the expected one, in standard deviations, smoothed; NaN if the
    user stated the temperature of the air, which is then used as it is.
    """

    ambient_C: float
    off_sds: float = 0.0
    is_off: bool = False


def first_air(ambient_C: float, is_stated: bool) -> Air:
    """Return the air at a temperature [°C] that is stated, or assumed until the readings contradict it."""
    return Air(ambient_C, math.nan if is_stated else 0.0)


def air_after(air: Air, warmer_K: float, sd_K: float, dt_s: float) -> Air:
    """Return the air after a block of `dt_s` [s] whose pack is `warmer_K` [K] than expected, known to `sd_K`.

    At the start the air is assumed to have the pack's first temperature. For a pack that was kept warm this is wrong:
    the pack cools, and the filter would take that for an error of the voltage. Therefore the readings move the air once
    they have been off for half a minute. Before that they are taken as self-heating of the pack, as a worn pack shows.
    """
    step_s = min(dt_s, LONGEST_AIR_STEP_S)
    keep = math.exp(-step_s / AIR_TAU_S)
    off_sds = keep * air.off_sds + (1.0 - keep) * warmer_K / sd_K
    is_off = air.is_off or abs(off_sds) > AIR_OFF_SDS
    if not is_off:
        return Air(air.ambient_C, off_sds, False)
    ambient_C = air.ambient_C + AIR_GAIN_PS * step_s * warmer_K
    return Air(min(max(ambient_C, AMBIENT_C[0]), AMBIENT_C[1]), off_sds, True)


def scaled_resistance(pack: Pack, mean: Array) -> Number:
    """Return the instantaneous resistance [ohm·Ah] of the believed pack, without the harness."""
    cell = grown(pack.cell, pack.installation)
    return model.resistance(cell, mean[X.SOC], mean[X.CORE]) * np.exp(mean[X.LOG_RESISTANCE])


def _lagging(share: float, overpotential_V: Number, settled_V: Number, dt_s: float, tau_s: float) -> Number:
    """Return the process noise [V²] of an overpotential whose ratio to the resistance is known only to `share`.

    The overpotential is wrong by that share of its size, so that its error grows only while it changes. A constant
    error belongs to the discrepancy. The overpotential counts only as far as the load explains it: otherwise it would
    grow through its own uncertainty and hide the knee of an emptying pack.
    """
    now_V = np.minimum(np.abs(overpotential_V), settled_V)
    moved_V = np.abs(settled_V - now_V) * -np.expm1(-dt_s / tau_s)
    return OVERPOTENTIAL_WALK_V2PS * dt_s + share**2 * moved_V * (2.0 * now_V + moved_V)


def reading_variance(pack: Pack, mean: Array, current_A: float, step_A: float) -> Number:
    """Return the variance of the pack's voltage reading [V²] under `current_A`, of which `step_A` is new.

    mean : the belief, [9] or [9, members]; step_A : increase of the current [A] since the row or block before. The drop
    of a reaction saturates: in the block in which the motors start, the drop at the mean current is not the mean of the
    rows' drops. Therefore JUMP_SHARE of the increase of that drop counts as noise.
    """
    ohm = scaled_resistance(pack, mean) / pack.installation.present_capacity_Ah * (1.0 + pack.cell.polarisation_ratio)
    slow_V = pack.cell.transfer_V + pack.spread.reaction_sd_V
    rate, before = c_rate(pack.installation, current_A), c_rate(pack.installation, current_A - step_A)
    bent_V = JUMP_SHARE * (_reaction_V(pack, slow_V, rate) - _reaction_V(pack, slow_V, before))
    return pack.installation.cells**2 * (voltage_variance(pack, ohm * current_A, ohm * step_A) + bent_V**2)


def _reaction_V(pack: Pack, full_V: float, rate_c: float) -> Number:
    """Return the drop [V] at a C-rate [1/h] of a reaction whose drop is `full_V` [V] at a large load."""
    return model.transfer_drop(pack.cell._replace(transfer_V=full_V), rate_c)


def voltage_variance(pack: Pack, drop_V: Number, step_V: Number) -> Number:
    """Return the variance of a reading per cell [V²] under the ohmic drop `drop_V` [V], of which `step_V` is new."""
    share = math.hypot(COMPENSATED_SHARE if pack.sag_compensated else pack.spread.drop_share, pack.spread.guess_sd)
    return VOLTAGE_SD_V**2 + (share * drop_V) ** 2 + (ROW_SHARE * step_V) ** 2
