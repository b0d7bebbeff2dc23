"""Flights of lithium-ion packs of three makes, of which only cells, capacity and cut-off are stated."""

from __future__ import annotations

import numpy as np

from scoring.other_pack import CELLS, FULL_AH, Make, Power
from scoring.wrong_cases import Case

NMC = Make(
    "NMC",
    (2.3, 2.7, 2.88, 3.08, 3.25, 3.36, 3.44, 3.49, 3.57, 3.63, 3.70, 3.80, 3.90, 4.0, 4.08, 4.11, 4.19),
    ohmAh=0.045, rise=0.7, lag_ohmAh=0.012, lag_s=20.0, share=0.8, exchange_s=45.0,
)  # fmt: skip
NCA = Make(
    "NCA",
    (2.2, 2.6, 2.75, 2.95, 3.12, 3.25, 3.36, 3.43, 3.53, 3.60, 3.67, 3.78, 3.88, 3.98, 4.06, 4.09, 4.17),
    ohmAh=0.045, rise=1.0, lag_ohmAh=0.015, lag_s=25.0, share=0.75, exchange_s=50.0,
)  # fmt: skip
SILICON = Make(
    "NMC with silicon",
    (2.2, 2.55, 2.68, 2.87, 3.04, 3.19, 3.31, 3.40, 3.50, 3.58, 3.66, 3.77, 3.87, 3.97, 4.06, 4.10, 4.18),
    ohmAh=0.09, rise=1.0, lag_ohmAh=0.03, lag_s=30.0, share=0.7, exchange_s=70.0,
)  # fmt: skip
MAKES = (NCA, NMC, SILICON)
CUTOFFS_CELL_V = (2.8, 3.0, 3.2)


def case(battery: str, number: int) -> Case:
    """Return flight `number`, of a drawn pack, to be read with a packaged battery file of this name."""
    dice = np.random.default_rng(number)
    make, capacity_Ah = MAKES[number % len(MAKES)], FULL_AH * dice.uniform(0.7, 1.03)
    start_soc = dice.uniform(0.85, 1.0) if number % 2 else 1.0
    power = Power(dice.uniform(70.0, 220.0), climb=float(dice.choice((0.0, 0.3))))
    cutoff_V = CELLS * float(dice.choice(CUTOFFS_CELL_V))
    return Case(
        f"{make.name}-{number}",
        battery,
        capacity_class="70..103 %",
        charge_class="85..100 %",
        make=make,
        capacity_Ah=capacity_Ah,
        start_soc=start_soc,
        resistance=dice.uniform(0.8, 1.8),
        air_C=dice.uniform(5.0, 30.0),
        power=power,
        seed=number,
        cutoff_V=cutoff_V,
    )
