"""From a battery file to the numbers that the model runs on, for a pack of any size of the type."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.effects import EFFECTS
from uavbatt.battery.equations import Number
from uavbatt.battery.high_voltage import ORDINARY_FULL_V, ocv_of_fuller
from uavbatt.battery.model import Parameters
from uavbatt.battery.pack import Installation
from uavbatt.battery.spreads import Spread, spread_of
from uavbatt.battery.tables import dense, dense_resistance


class Pack(NamedTuple):
    """Pack is a battery file applied to one aircraft's pack: its parameters, its limits [V], and how sure they are."""

    cell: Parameters
    installation: Installation
    cutoff_V: Number
    low_V: Number
    spread: Spread
    sag_compensated: bool = False  # the autopilot has added its own guess of I·R to the voltage it reports

    def at_weakest_cell(self, below_V: float) -> Pack:
        """Return the pack with its limits where its weakest cell meets them, `below_V` [V] below the mean cell."""
        raised_V = self.installation.cells * below_V
        return self._replace(cutoff_V=self.cutoff_V + raised_V, low_V=self.low_V + raised_V)


def pack_of(
    file: BatteryFile, cells: int, capacity_Ah: float, cutoff_V: float, low_V: float, fullest_V: float = ORDINARY_FULL_V
) -> Pack:
    """Return the file scaled to `cells` in series of `capacity_Ah`, with its cut-off and low-voltage warning [V].

    fullest_V : at which a full cell rests [V]; above ORDINARY_FULL_V it is another kind of cell (`high_voltage`).
    """
    own_curve = file.status != "generic"  # the file of one make shows how full its cells are charged
    cell = cell_parameters(file, ORDINARY_FULL_V if own_curve else fullest_V)
    return Pack(cell, installation_of(file, cells, capacity_Ah), cutoff_V, low_V, spread_of(file))


def cell_parameters(file: BatteryFile, fullest_V: float = ORDINARY_FULL_V) -> Parameters:
    """Return the parameters of the file's cell with its effects on; `fullest_V` as in `pack_of`."""
    table = file.parameters
    ocv_soc = np.array(table.ocv_soc)
    return Parameters(
        ocv_V=dense(ocv_soc, ocv_of_fuller(ocv_soc, np.array(table.ocv_V), fullest_V)),
        r0_ohmAh=dense_resistance(np.array(table.resistance_soc), np.array(table.resistance_ohmAh)),
        **_quantities(file, "cell"),
    )


def installation_of(file: BatteryFile, cells: int, capacity_Ah: float) -> Installation:
    """Return wiring and sensors as the file's effects have them, for `cells` in series of `capacity_Ah`."""
    return Installation(cells=cells, capacity_Ah=capacity_Ah, **_quantities(file, "installation"))


def _quantities(file: BatteryFile, acts_on: str) -> dict[str, float]:
    """Return the quantities of the file's effects that act on the cell, or on the installation."""
    effects = [entry.parameters for entry in file.effects if EFFECTS[entry.name].acts_on == acts_on]
    return {name: value for quantities in effects for name, value in quantities.items()}
