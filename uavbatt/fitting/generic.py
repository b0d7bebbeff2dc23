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
CUTOFF_CELL_V, LOW_CELL_V = 3.3, 3.5  # under load; 10.5 V for a warning is the usual setting of a 3S pack
LITHIUM_ION_CUTOFF_CELL_V, LITHIUM_ION_LOW_CELL_V = 3.0, 3.2  # makers allow 2.5 V, where the knee is over


def generic_lipo() -> BatteryFile:
    """Return the battery file `lipo-generic`: a LiPo cell with every base effect at its prior."""
    why = "the OCV of a make (4.20 or 4.35 V cells) differs from the prior for a whole flight"
    return _generic(GENERIC, LIPO, (CUTOFF_CELL_V, LOW_CELL_V), why)


def generic_lithium_ion() -> BatteryFile:
    """Return the battery file `liion-generic`: a cylindrical lithium-ion cell with every base effect at its prior."""
    why = "the OCV of a make (NMC, NCA, with or without silicon) differs from the prior for a whole flight"
    return _generic(GENERIC_LITHIUM_ION, LITHIUM_ION, (LITHIUM_ION_CUTOFF_CELL_V, LITHIUM_ION_LOW_CELL_V), why)


def _generic(name: str, chemistry: Chemistry, endings_V: tuple[float, float], why: str) -> BatteryFile:
    """Return the prior of a kind of cell as a battery file; endings_V : cut-off and low-voltage warning of a cell."""
    slots = prior.cell_slots(chemistry=chemistry)
    x = prior.values(slots, np.zeros(len(slots)))
    error = {s.name: s.sd * (s.prior if s.log else 1.0) for s in slots}
    return BatteryFile(
        battery=Battery(
            name=name,
            chemistry=chemistry.name,
            cells_series=1,
            cutoff_V=endings_V[0],
            low_V=endings_V[1],
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
            source=f"assumed: {why}",
        ),
        certificate=Certificate(status="generic"),
    )
