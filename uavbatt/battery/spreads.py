"""Standard deviations by which a pack in service may differ from its battery file.

A pack in service is not the tested pack, and an untested make is no pack that anybody tested. What a file states of its
own error is widened by its status, and the numbers of `TESTED_MAKE` or `UNKNOWN_MAKE` are added.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.model import SOC_GRID, Array
from uavbatt.battery.tables import slope_below

# The status of the file widens the belief: a file that was not gated may describe another battery. A generic file has
# wide spreads by itself; the numbers of an edited file may come from anywhere.
WIDENING = {"certified": 1.0, "fitted": 1.25, "generic": 1.25, "edited": 1.5}
# The standard error of a parameter ignores correlations: an OCV that is too high at every charge comes with too little
# resistance, and the voltage of a flight is known far better than either. For three makes with a known curve 11 mV were
# stated, of which 4 mV changed with the charge. A certified file may come from tests with an unmeasured load, as in the
# study: its standard errors include that.
ALONE_SHARE = {"fitted": 0.4}
SERVICE_RESISTANCE_SD = 0.15  # contacts and leads of a pack in service; what ages the electrodes is no resistance
# A file that was fitted to so many flights, of packs whose resistances differ so much, was fitted to packs in service:
# their scatter is measured, and only half of the reaction remains beside it.
FLEET_FLIGHTS, FLEET_RESISTANCE_SD, FLEET_REACTION_SD_V = 8, 0.12, 0.025
DOUBT_LENGTH = 1.0  # over a change of the charge by this, an error of the OCV that depends on it becomes another one
SEEN_V = 0.06  # a larger standard error of the OCV is that of a charge which no record reached
EMPTY_CELL_V = 3.3  # open-circuit voltage of an emptied LiPo cell; a slow discharge ends there

# Voltage and current of a row are not read at the same instant: the error grows with the change of the current since
# the row before. On flights with a row every 12 s it was 14 mV, and 10 mohm times the change, for a pack of 90 mohm.
ROW_SHARE = 0.12  # part of a change of current between rows that a row's voltage does not show


class Spread(NamedTuple):
    """Spread holds by how much a pack and its readings may differ from what its battery file says.

    Standard deviations are of one cell; those of resistance and capacity are of ln of the scale.
    """

    resistance_scale_sd: float
    capacity_scale_sd: float
    capacity_short_sd: float  # added for less than is stated: few packs hold more than is printed
    bias_sd_V: float  # discrepancy of the model
    bias_tau_s: float
    reaction_sd_V: float  # of the drop that its electrodes take beyond those of its type at a large load
    ocv_sd_V: Array  # on SOC_GRID: how far the file's own open-circuit voltage may be off
    ocv_drift_sd_V: Array  # the part of it that changes with the charge
    temperature_sd_K: float
    drop_share: float  # relative error of the drop under load, from reading to reading
    lag_share: tuple[float, float]  # relative error of the polarisation and of the diffusion overpotential
    rested_share: tuple[float, float]  # of the discrepancy in a first row at rest; and what of that is left when full
    evidence_share: float  # share of a reading that counts when capacities are compared
    empty_soc_sd: float  # of the charge left at the knee, as a share of the charge drawn by then
    guess_sd: float = 0.0  # relative sd of a current that is not measured, around its unknown mean


class MakeSpread(NamedTuple):
    """MakeSpread holds what is added to the error that a file states of itself; the fields are those of `Spread`.

    stated_share : the share of the stated discrepancy that is the model's own.
    """

    capacity_short_sd: float
    stated_share: float
    bias_sd_V: float
    bias_tau_s: float
    reaction_sd_V: float
    drop_share: float
    rested_share: tuple[float, float]
    evidence_share: float
    empty_soc_sd: float


TESTED_MAKE = MakeSpread(
    capacity_short_sd=0.0,
    stated_share=1.0,
    # Beside the reaction, the error changes by 5 to 15 mV within some minutes as the cell warms and empties.
    bias_sd_V=0.010,
    bias_tau_s=2000.0,
    # Aged electrodes, or those of another batch, react more slowly. This lowers the voltage as soon as the load begins,
    # by the same amount at every charge and temperature: 0.05 V a cell at 0.6 of the exchange current, which a pack
    # that has lost a sixth of its charge may have. With a smaller sd the filter would explain this drop by resistance,
    # which grows in the cold and at the knee, and correct the charge for it.
    reaction_sd_V=0.04,
    drop_share=0.075,  # errors that all readings share are in the discrepancy
    rested_share=(1.0, 0.5),  # a fit has seen packs at rest mostly when full
    evidence_share=1.0,
    empty_soc_sd=0.0,
)
UNKNOWN_MAKE = MakeSpread(
    capacity_short_sd=0.45,  # the printed capacity is no measurement either
    stated_share=0.45,  # the discrepancy of a prior includes the errors of its knots
    bias_sd_V=0.02,
    bias_tau_s=3000.0,
    # Its resistance has a wide spread already. With more spread for the reaction, rounding of the readings does more
    # harm in a log that begins in the air.
    reaction_sd_V=0.02,
    drop_share=0.06,  # the wide discrepancy covers the rest
    rested_share=(0.5, 1.0),  # a mean over makes is equally good at rest at any charge
    # Its curve is a mean over makes, whose error stays the same for minutes: a tenth of the readings is independent.
    evidence_share=0.1,
    # A mean over makes does not tell how much charge a make leaves in its cells at the knee: 0.5 to 5 % at 2 to 5 C in
    # three makes, 0 to 24 % in a fourth, which diffuses slowly.
    empty_soc_sd=0.05,
)


def spread_of(file: BatteryFile) -> Spread:
    """Return the spread of packs in service of the file's type; a generic file is of no make in particular."""
    make = UNKNOWN_MAKE if file.status == "generic" else TESTED_MAKE
    resistance_scale_sd, reaction_sd_V = _resistance_spread(file, make)
    ocv_sd_V = _ocv_sd_V(file)
    drift_sd_V = _ocv_drift_sd_V(ocv_sd_V, ALONE_SHARE.get(file.status, 1.0))
    return Spread(
        resistance_scale_sd=resistance_scale_sd,
        capacity_scale_sd=file.parameters.capacity_scale_sd * WIDENING[file.status],
        capacity_short_sd=make.capacity_short_sd,
        bias_sd_V=math.hypot(_stated_sd_V(file) * make.stated_share, make.bias_sd_V),
        bias_tau_s=max(file.discrepancy.voltage_autocorrelation_s, make.bias_tau_s),
        reaction_sd_V=reaction_sd_V,
        ocv_sd_V=ocv_sd_V,
        # No record lies behind a generic file: its errors are those between makes.
        ocv_drift_sd_V=drift_sd_V if file.status == "generic" else _met_when_sinking(drift_sd_V),
        temperature_sd_K=max(file.discrepancy.temperature_rmse_K, 0.2),
        drop_share=make.drop_share,
        lag_share=(_lag_share(file, "polarisation_ratio"), _lag_share(file, "diffusion_ratio")),
        rested_share=make.rested_share,
        evidence_share=make.evidence_share,
        empty_soc_sd=max(make.empty_soc_sd, _charge_left(file)),
    )


def _stated_sd_V(file: BatteryFile) -> float:
    """Return the error of the model per cell that the file states [V], widened by its status."""
    return max(file.discrepancy.voltage_rmse_V / file.battery.cells_series, 1e-3) * WIDENING[file.status]


def _resistance_spread(file: BatteryFile, make: MakeSpread) -> tuple[float, float]:
    """Return the sds of ln of the resistance scale and of the reaction's drop [V] over packs in service."""
    table = file.parameters
    has_fleet = (table.spread_flights or 0) >= FLEET_FLIGHTS and table.resistance_scale_sd >= FLEET_RESISTANCE_SD
    if file.status == "fitted" and has_fleet:
        return table.resistance_scale_sd, FLEET_REACTION_SD_V
    scale_sd = math.hypot(table.resistance_scale_sd * WIDENING[file.status], SERVICE_RESISTANCE_SD)
    return scale_sd, make.reaction_sd_V


def _ocv_sd_V(file: BatteryFile) -> Array:
    """Return the standard error of the OCV [V] on SOC_GRID, from those of its knots; 0 where none is stated."""
    table = file.parameters
    errors = [table.standard_error.get(f"ocv_{soc:g}", 0.0) for soc in table.ocv_soc]
    return np.asarray(np.interp(SOC_GRID, np.array(table.ocv_soc), np.array(errors)))


def _charge_left(file: BatteryFile) -> float:
    """Return the charge below the 0 of a file's curve, as a share of its capacity; 0 if its tests emptied the cells.

    A test under a large load is over while a cell still has charge: the study's ends at an open-circuit voltage of
    3.53 V. A flight that draws less goes on.
    """
    soc, ocv_V = np.array(file.parameters.ocv_soc), np.array(file.parameters.ocv_V)
    slope_V = float(slope_below(soc, ocv_V)[0])
    return max(float(ocv_V[0]) - slope_V * float(soc[0]) - EMPTY_CELL_V, 0.0) / slope_V


def _ocv_drift_sd_V(stated_V: Array, alone_share: float) -> Array:
    """Return the part of the OCV's standard error [V] that differs between charges; at least `alone_share` of it."""
    alike_V2 = np.median(stated_V) ** 2
    return np.asarray(np.sqrt(np.maximum(stated_V**2 - alike_V2, (alone_share * stated_V) ** 2)))


def _met_when_sinking(drift_sd_V: Array) -> Array:
    """Return the error that differs between charges [V] with its growth towards a charge that no record reached.

    A pack that has sunk to such a charge must have gained the whole error that is stated there, however fast it sank.
    """
    unseen_V2 = np.maximum(drift_sd_V**2 - SEEN_V**2, 0.0)
    growth_V2 = np.maximum(-np.gradient(unseen_V2, SOC_GRID), 0.0)
    return np.asarray(np.sqrt(drift_sd_V**2 + 0.5 * DOUBT_LENGTH * growth_V2))


def _lag_share(file: BatteryFile, quantity: str) -> float:
    """Return the relative error of an effect's quantity, 0.1 to 0.8: its own part, not what it shares with others."""
    share = ALONE_SHARE.get(file.status, 1.0)
    for entry in file.effects:
        if entry.parameters.get(quantity):
            error = share * entry.standard_error.get(quantity, 0.0)
            return float(np.clip(error / entry.parameters[quantity], 0.1, 0.8))
    return 0.1
