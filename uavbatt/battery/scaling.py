"""From a battery file to the numbers that the model runs on, for a pack of any size of the type."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uavbatt.battery import spreads
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.effects import EFFECTS
from uavbatt.battery.equations import Number
from uavbatt.battery.high_voltage import ORDINARY_FULL_V, ocv_of_fuller
from uavbatt.battery.model import Array, Parameters
from uavbatt.battery.pack import Installation
from uavbatt.battery.tables import dense, dense_resistance

# Voltage and current of a row are not read at the same instant: the error grows with the change of the current since
# the row before. On flights with a row every 12 s it was 14 mV, and 10 mohm times the change, for a pack of 90 mohm.
ROW_SHARE = 0.12


class Pack(NamedTuple):
    """Pack is a battery file applied to one aircraft's pack: its parameters, limits [V] and standard deviations."""

    cell: Parameters
    installation: Installation
    cutoff_V: Number
    low_V: Number
    resistance_scale_sd: float
    capacity_scale_sd: float
    capacity_short_sd: float  # added for less than is stated: few packs hold more than is printed
    bias_sd_V: float  # discrepancy of the model, per cell
    bias_tau_s: float
    reaction_sd_V: float  # of the drop that its electrodes take beyond those of its type at a large load, per cell
    ocv_sd_V: Array  # on SOC_GRID: how far the file's own open-circuit voltage may be off, per cell
    ocv_drift_sd_V: Array  # the part of it that changes with the charge
    temperature_sd_K: float
    row_share: float  # part of a change of current between rows that a row's voltage does not show
    drop_share: float  # relative error of the drop under load, from reading to reading
    lag_share: tuple[float, float]  # relative error of the polarisation and of the diffusion overpotential
    rested_share: tuple[float, float]  # of the discrepancy in a first row at rest; and what of that is left when full
    evidence_share: float  # share of a reading that counts when capacities are compared
    empty_soc_sd: float  # of the charge left at the knee, as a share of the charge drawn by then
    sag_compensated: bool = False  # the autopilot has added its own guess of I·R to the voltage it reports
    guess_sd: float = 0.0  # relative sd of a current that is not measured, around its unknown mean

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
    left, make = file.discrepancy, spreads.make_spread(file)
    resistance_scale_sd, reaction_sd_V = spreads.resistance_spread(file)
    own_curve = file.status != "generic"  # the file of one make shows how full its cells are charged
    return Pack(
        cell=cell_parameters(file, ORDINARY_FULL_V if own_curve else fullest_V),
        installation=installation_of(file, cells, capacity_Ah),
        cutoff_V=cutoff_V,
        low_V=low_V,
        resistance_scale_sd=resistance_scale_sd,
        capacity_scale_sd=file.parameters.capacity_scale_sd * spreads.WIDENING[file.status],
        capacity_short_sd=make.capacity_short_sd,
        bias_sd_V=math.hypot(spreads.stated_sd_V(file), make.bias_sd_V),
        bias_tau_s=max(left.voltage_autocorrelation_s, make.bias_tau_s),
        reaction_sd_V=reaction_sd_V,
        ocv_sd_V=spreads.ocv_sd_V(file),
        ocv_drift_sd_V=spreads.ocv_drift_sd_V(file),
        temperature_sd_K=max(left.temperature_rmse_K, 0.2),
        row_share=ROW_SHARE,
        drop_share=make.drop_share,
        lag_share=(spreads.lag_share(file, "polarisation_ratio"), spreads.lag_share(file, "diffusion_ratio")),
        rested_share=make.rested_share,
        evidence_share=make.evidence_share,
        empty_soc_sd=make.empty_soc_sd,
    )


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
