"""How long packs last under power to come: the simulation behind every forecast.

Constant power, not constant current: a sinking voltage draws more current, which is what empties a pack sooner than
charge counting says. Each step solves V I = P and advances the model exactly; the crossing of the cut-off is
interpolated between steps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uavbatt.battery import equations as eq
from uavbatt.battery import model
from uavbatt.battery.belief import C, unpack
from uavbatt.battery.build import Pack
from uavbatt.battery.model import Array
from uavbatt.battery.pack import metered_voltage, terminal_voltage


class EndTimes(NamedTuple):
    """Seconds until the end of flight and until the low-voltage warning, per column; inf = beyond the horizon."""

    end_s: Array
    low_s: Array


def time_to_end(
    pack: Pack,
    x: Array,
    power_W: Array,
    ambient_C: float,
    dt_s: float,
    reserve_soc: float = 0.0,
    bias_walk: Array | None = None,
) -> EndTimes:
    """Run belief columns x [8, batch] under true pack power `power_W` [steps, batch], `dt_s` a step.

    The end is the first of: metered voltage below pack.cutoff_V, soc below `reserve_soc`. `bias_walk` [steps, batch]
    are the standard normals of the discrepancy's way (Ornstein-Uhlenbeck); without them it decays.
    """
    memory = np.exp(-dt_s / pack.bias_tau_s)
    kick_V = pack.bias_sd_V * np.sqrt(1.0 - memory**2)
    bias_V = x[C.BIAS]
    cell, installation, state = unpack(pack, x)
    size = installation.cells * installation.present_capacity_Ah
    harness_ohmAh = installation.harness_ohm * installation.present_capacity_Ah / installation.cells
    batch = x.shape[1]
    end_s, low_s = np.full(batch, np.inf), np.full(batch, np.inf)
    above_end, above_low = np.full(batch, np.inf), np.full(batch, np.inf)
    for k, power in enumerate(power_W):
        series_ohmAh = model.resistance(cell, state.soc, state.core_C) + harness_ohmAh
        rate = eq.current_at_power(model.electromotive_force(cell, state) + bias_V, series_ohmAh, power / size)
        true_V = terminal_voltage(installation, cell, state, rate * installation.present_capacity_Ah)
        volts = metered_voltage(installation, true_V + installation.cells * bias_V)
        margin_end = volts - pack.cutoff_V
        if reserve_soc > 0.0:  # both margins in volts, so that one crossing rule serves: 1 % soc ~ 0.1 V
            margin_end = np.minimum(margin_end, (state.soc - reserve_soc) * 10.0)
        margin_low = volts - pack.low_V
        end_s = _crossed(end_s, above_end, margin_end, k, dt_s)
        low_s = _crossed(low_s, above_low, margin_low, k, dt_s)
        above_end, above_low = margin_end, margin_low
        if np.isfinite(end_s).all():
            break
        state = model.step(cell, state, rate, ambient_C, dt_s)
        bias_V = memory * bias_V + (0.0 if bias_walk is None else kick_V * bias_walk[k])
    return EndTimes(end_s, np.minimum(low_s, end_s))


def _crossed(time_s: Array, before: Array, now: Array, k: int, dt_s: float) -> Array:
    """First downward crossing of zero, linear between steps k-1 and k; 0 when it was below from the start."""
    fresh = np.isinf(time_s) & (now < 0.0)
    with np.errstate(invalid="ignore"):
        share = np.where(np.isfinite(before), before / (before - now), 0.0)
    return np.where(fresh, max(k - 1, 0) * dt_s + share * dt_s, time_s)
