"""Standard deviations by which a pack in service may differ from its battery file, for `scaling.Pack`.

A pack in service is not the tested pack, and an untested make is no pack that anybody tested. What a file states of its
own error is widened by its status, and the numbers of `TESTED_MAKE` or `UNKNOWN_MAKE` are added.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.model import SOC_GRID, Array

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


class MakeSpread(NamedTuple):
    """MakeSpread holds what is added to the error that a file states of itself; the fields are those of `Pack`.

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


def make_spread(file: BatteryFile) -> MakeSpread:
    """Return the spread of the file's make: a generic file is of no make in particular."""
    return UNKNOWN_MAKE if file.status == "generic" else TESTED_MAKE


def stated_sd_V(file: BatteryFile) -> float:
    """Return the error of the model per cell that the file states [V], widened by its status."""
    cell_V = max(file.discrepancy.voltage_rmse_V / file.battery.cells_series, 1e-3)
    return cell_V * WIDENING[file.status] * make_spread(file).stated_share


def resistance_spread(file: BatteryFile) -> tuple[float, float]:
    """Return the sds of ln of the resistance scale and of the reaction's drop [V] over packs in service."""
    table = file.parameters
    has_fleet = (table.spread_flights or 0) >= FLEET_FLIGHTS and table.resistance_scale_sd >= FLEET_RESISTANCE_SD
    if file.status == "fitted" and has_fleet:
        return table.resistance_scale_sd, FLEET_REACTION_SD_V
    scale_sd = math.hypot(table.resistance_scale_sd * WIDENING[file.status], SERVICE_RESISTANCE_SD)
    return scale_sd, make_spread(file).reaction_sd_V


def ocv_sd_V(file: BatteryFile) -> Array:
    """Return the standard error of the OCV [V] on SOC_GRID, from those of its knots; 0 where none is stated."""
    table = file.parameters
    errors = [table.standard_error.get(f"ocv_{soc:g}", 0.0) for soc in table.ocv_soc]
    return np.asarray(np.interp(SOC_GRID, np.array(table.ocv_soc), np.array(errors)))


def ocv_drift_sd_V(file: BatteryFile) -> Array:
    """Return the part of `ocv_sd_V` that differs between charges; at least ALONE_SHARE of it."""
    stated_V = ocv_sd_V(file)
    alike_V2 = np.median(stated_V) ** 2
    alone_V2 = (ALONE_SHARE.get(file.status, 1.0) * stated_V) ** 2
    return np.asarray(np.sqrt(np.maximum(stated_V**2 - alike_V2, alone_V2)))


def lag_share(file: BatteryFile, quantity: str) -> float:
    """Return the relative error of an effect's quantity, 0.1 to 0.8: its own part, not what it shares with others."""
    share = ALONE_SHARE.get(file.status, 1.0)
    for entry in file.effects:
        if entry.parameters.get(quantity):
            error = share * entry.standard_error.get(quantity, 0.0)
            return float(np.clip(error / entry.parameters[quantity], 0.1, 0.8))
    return 0.1
