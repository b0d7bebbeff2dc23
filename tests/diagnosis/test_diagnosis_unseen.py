"""Flights that go deeper than the records behind the battery file: there its curve is a guess, and no evidence."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from planted_flights import CAPACITY_AH, CELLS, CUTOFF_V, FILE, MISSIONS, fly

from uavbatt.battery.sizing.pack_size import PackOptions, pack_from
from uavbatt.diagnosis.diagnosis import Diagnosis, diagnose
from uavbatt.diagnosis.refit.residual import size_V
from uavbatt.log_replay.run import engine_for

SEEN_SOC, SHORT, GUESS_SD_V = 0.15, 0.1, 0.4


def guessed(soc: float, ocv_V: float) -> float:
    """Return the OCV of a pack that holds a tenth less than the planted one, below the charge that was seen."""
    table = FILE.parameters
    short = SHORT * max(1.0 - soc / SEEN_SOC, 0.0)
    below_V = 10.0 * min(soc - short, 0.0)  # a pack that is empty falls steeply
    return float(np.interp(soc - short, table.ocv_soc, table.ocv_V)) + below_V if short else ocv_V


TABLE = FILE.parameters
GUESSES = msgspec.structs.replace(
    TABLE,
    ocv_V=[guessed(soc, ocv_V) for soc, ocv_V in zip(TABLE.ocv_soc, TABLE.ocv_V, strict=True)],
    standard_error={f"ocv_{soc:g}": GUESS_SD_V for soc in TABLE.ocv_soc if soc < SEEN_SOC},
)


def found(standard_error: dict[str, float], **effect: float) -> Diagnosis:
    file = msgspec.structs.replace(FILE, parameters=msgspec.structs.replace(GUESSES, standard_error=standard_error))
    records = [fly(*mission, **effect) for mission in MISSIONS[:3]]
    return diagnose(
        records, file, pack_from(file, PackOptions(CELLS, CAPACITY_AH, CUTOFF_V)), engine=engine_for(is_long=True)
    )


def test_a_wrong_guess_of_the_file_is_no_effect_of_the_pack() -> None:
    diagnosis = found(GUESSES.standard_error)
    assert diagnosis.verdict == "no_missing_effect"
    assert diagnosis.guess_below_soc == SEEN_SOC


def test_what_the_file_claims_to_have_seen_must_be_right() -> None:
    diagnosis = found({})
    assert diagnosis.verdict != "no_missing_effect"
    assert diagnosis.guess_below_soc is None


@pytest.mark.parametrize(
    ("planted", "effect", "quantity", "size"),
    [({"offset_V": 0.1}, "voltage_offset", "offset_V", 0.1), ({"gain": 1.1}, "current_gain", "gain_I", 1.1)],
)
def test_an_effect_is_found_and_sized_beside_the_guess(
    planted: dict[str, float], effect: str, quantity: str, size: float
) -> None:
    diagnosis = found(GUESSES.standard_error, **planted)
    assert diagnosis.verdict == "effect_found"
    one = diagnosis.classes[0]
    assert one.members[0] == effect
    assert one.parameters[quantity].value == pytest.approx(size, abs=0.02)


def test_the_residual_shown_is_less_the_corrected_guess() -> None:
    diagnosis = found(GUESSES.standard_error)
    assert size_V(diagnosis.residual_before) < 0.06 < size_V(found({}).residual_before)
