"""Flights of packs whose health is known, as the ledger takes them."""

from __future__ import annotations

import math

from uavbatt.packs.records import FlightEvidence, FlightRecord

TYPE_OHM, RATED_AH = 0.013, 5.0
DAY_S, DURATION_S, FIRST_UTC_S = 86_400.0, 900.0, 1.79e9


def flight(
    number: int, ohm: float = 1.0, charge: float = 1.0, ohm_sd: float = 0.04, charge_sd: float = 0.04, **others: object
) -> FlightRecord:
    """Flight `number` of a pack with so many times the ohms and the charge of its type, three days after the last."""
    told = FlightEvidence(math.log(ohm * TYPE_OHM), math.log(charge * RATED_AH), ohm_sd**2, charge_sd**2, 0.0)
    stated = {
        "key": f"{number:016x}",
        "start_utc_s": FIRST_UTC_S + 3.0 * DAY_S * number,
        "duration_s": DURATION_S,
        "source": f"flight_{number:02d}.tlog",
        "temp_mean_C": 25.0,
    }
    return FlightRecord(
        told=told, cells=4, rated_Ah=RATED_AH, type_ohm=TYPE_OHM, battery_sha256="0" * 64,
        **{"battery": "test", **stated, **others},
    )  # fmt: skip
