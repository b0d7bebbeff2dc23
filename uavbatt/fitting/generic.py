"""The battery file for users who know only cells and capacity: the prior itself, with wide spreads."""

from __future__ import annotations

import numpy as np

from uavbatt.battery.battery_file import GENERIC, Battery, BatteryFile, Certificate, Discrepancy
from uavbatt.fitting import assemble, prior

# Between makes and ages of LiPo packs: total resistance differs by a factor of 1.5, usable capacity by 6 %.
RESISTANCE_SCALE_SD = 0.4
CAPACITY_SCALE_SD = 0.05
CUTOFF_CELL_V, LOW_CELL_V = 3.3, 3.5  # under load; 10.5 V for a warning is the usual setting of a 3S pack


def generic_lipo() -> BatteryFile:
    """Return the battery file `lipo-generic`: a LiPo cell with every base effect at its prior."""
    slots = prior.cell_slots()
    x = prior.values(slots, np.zeros(len(slots)))
    error = {s.name: s.sd * (s.prior if s.log else 1.0) for s in slots}
    return BatteryFile(
        battery=Battery(
            name=GENERIC,
            chemistry="LiPo",
            cells_series=1,
            cutoff_V=CUTOFF_CELL_V,
            low_V=LOW_CELL_V,
            source="prior of a LiPo cell; no data of any one pack",
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
            source="assumed: the OCV of a make (4.20 or 4.35 V cells) differs from the prior for a whole flight",
        ),
        certificate=Certificate(status="generic"),
    )
