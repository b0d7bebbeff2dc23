"""About when a flight ends, before it is simulated: bounds of the simulation, and where a surge of power may begin."""

from __future__ import annotations

import math

import numpy as np

from uavbatt.battery import model
from uavbatt.battery.equations import SECONDS_PER_HOUR
from uavbatt.battery.pack import most_energy_Wh, series_resistance
from uavbatt.battery.scaling import Pack
from uavbatt.battery.state_space import Belief, X, unpack

PIECES = 60  # of the charge that is left


def longest_s(pack: Pack, belief: Belief, power_W: float) -> float:
    """Return the time until the pack is empty [s], rather too long: with two sds more charge than believed.

    power_W : true power that the flight takes [W].
    """
    soc = max(float(belief.mean[X.SOC]), 0.0) + 2.0 * math.sqrt(belief.covariance[X.SOC, X.SOC]) + 0.01
    capacity = math.exp(float(belief.mean[X.LOG_CAPACITY]))
    energy_Wh = float(soc * capacity * most_energy_Wh(pack.installation))
    return max(energy_Wh * SECONDS_PER_HOUR / power_W, 1.0)


def steady_s(pack: Pack, belief: Belief, power_W: float) -> float:
    """Return the time [s] until a steady power takes the believed pack to its cut-off, with its lags as they are now.

    power_W : true power that the flight takes [W]. A pack at its cut-off has one piece of its charge left. Too long for
    a pack that has just begun its flight: its lags will grow.
    """
    x = belief.mean
    cell, installation, now = unpack(pack, x)
    soc = np.linspace(max(float(x[X.SOC]), 0.01), 0.0, PIECES + 1)
    emf_V, r_ohmAh = model.source(cell, now._replace(soc=soc))
    emf_V, series_ohmAh = emf_V + x[X.BIAS], r_ohmAh + series_resistance(installation, 0.0)
    capacity_Ah = installation.present_capacity_Ah
    under = model.under_power(cell, emf_V, series_ohmAh, power_W / (installation.cells * capacity_Ah))
    above = installation.cells * model.voltage_under(emf_V, series_ohmAh, under) > pack.cutoff_V
    pieces = PIECES if above.all() else max(int(np.argmin(above)), 1)
    hours = (soc[0] - soc[1]) * np.sum(1.0 / under.c_rate[:pieces])
    return float(hours * SECONDS_PER_HOUR)
