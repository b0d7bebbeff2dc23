"""The battery files for users who know only cells and capacity: the priors themselves, with wide spreads."""

from __future__ import annotations

import numpy as np

from uavbatt.battery.battery_file import (
    GENERIC,
    GENERIC_LITHIUM_ION,
    Battery,
    BatteryFile,
    Certificate,
    Discrepancy,
)
from uavbatt.fitting import assemble, prior
from uavbatt.fitting.prior import LIPO, LITHIUM_ION, Chemistry

# Between makes and ages of packs: total resistance differs by a factor of 1.5, usable capacity by 6 %.
RESISTANCE_SCALE_SD = 0.4
CAPACITY_SCALE_SD = 0.05


def generic_lipo() -> BatteryFile:
    """Return the battery file `lipo-generic`: a LiPo cell with every base effect at its prior."""
    return _generic(GENERIC, LIPO, makes="4.20 or 4.35 V cells")


def generic_lithium_ion() -> BatteryFile:
    """Return the battery file `liion-generic`: a cylindrical lithium-ion cell with every base effect at its prior."""
    return _generic(GENERIC_LITHIUM_ION, LITHIUM_ION, makes="NMC or NCA, with or without silicon")


def _generic(name: str, chemistry: Chemistry, makes: str) -> BatteryFile:
    """Return the prior of a kind of cell as a battery file of this name; makes : in what its makes differ."""
    slots = prior.cell_slots(chemistry=chemistry)
    x = prior.values(slots, np.zeros(len(slots)))
    error = {s.name: s.sd * (s.prior if s.log else 1.0) for s in slots}
    return BatteryFile(
        battery=Battery(
            name=name,
            chemistry=chemistry.name,
            cells_series=1,
            cutoff_V=chemistry.cutoff_V,
            low_V=chemistry.low_V,
            source=f"prior of a {chemistry.name} cell; no data of any one pack",
            remarks=["per cell: give --capacity-ah, or let the vehicle state it"],
        ),
        parameters=assemble.parameter_table(slots, x, error, RESISTANCE_SCALE_SD, CAPACITY_SCALE_SD),
        effects=assemble.effect_entries(slots, x, error, prior.BASE_EFFECTS),
        discrepancy=Discrepancy(
            voltage_bias_V=0.0,
            voltage_rmse_V=0.07,
            voltage_autocorrelation_s=2000.0,
            temperature_rmse_K=1.5,
            held_out=False,
            source=f"assumed: the OCV of a make ({makes}) differs from the prior for a whole flight",
        ),
        certificate=Certificate(status="generic"),
    )
