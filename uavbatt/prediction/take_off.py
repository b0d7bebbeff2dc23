"""The load of a flight that has not begun: that of the vehicle's past flights, else of a middling multirotor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uavbatt.battery.scaling import Pack
from uavbatt.battery.typical_power import typical_power_W
from uavbatt.prediction.load import ConstantLoad, Load, Now, Scenarios, equal_levels
from uavbatt.prediction.load_library import FEW_FLIGHTS, FEW_SPREAD, GRID_S, LEVELS, OWN_SPREAD, LearnedLoad

LOWEST_POWER_W = 1.0
SETTLED_S = 60.0
TYPICAL_SPREAD = 0.4  # of the logarithm: nine of ten multirotors are within a factor of two


@dataclass(frozen=True, slots=True)
class FromTakeOff:
    """Past flights flown again from their take-off, each as it was, at levels around it."""

    library: LearnedLoad

    def typical_W(self, now: Now) -> float:
        """Median of the flights' mean powers, or less where one began so gently that the horizon would cut it off."""
        begun = self.library.mean_W[:, int(SETTLED_S / GRID_S) :]
        return float(min(np.median(self.library.mean_W[:, -1]), 1.5 * begun.min()))

    def scenarios(self, now: Now, dt_s: float, steps: int) -> Scenarios:
        """Every flight from its first second, whatever the charge: the pack may start part-used."""
        flown_W = self.library.power_W
        grid_s = GRID_S * np.arange(flown_W.shape[1])
        ahead_s = dt_s * (np.arange(steps) + 0.5)
        traces_W = np.stack([np.interp(ahead_s, grid_s, watts) for watts in flown_W], axis=1)
        levels = equal_levels(OWN_SPREAD if flown_W.shape[0] >= FEW_FLIGHTS else FEW_SPREAD, LEVELS)
        power_W = np.maximum((traces_W[:, :, None] * levels).reshape(steps, -1), LOWEST_POWER_W)
        return Scenarios(power_W, np.full(power_W.shape[1], 1.0 / power_W.shape[1]), np.full(steps, dt_s))


def before_take_off(load: Load, pack: Pack) -> Load:
    """Return the load as it is known on the ground: a stated power, past flights, else one by the pack's size."""
    if isinstance(load, ConstantLoad):
        return load
    if isinstance(load, LearnedLoad):
        return FromTakeOff(load)
    installation = pack.installation
    typical_W = typical_power_W(int(installation.cells), float(installation.present_capacity_Ah))
    return ConstantLoad(typical_W, TYPICAL_SPREAD)
