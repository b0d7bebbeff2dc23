"""A file that splits the drop of a load wrongly into an instant and a slow part, as fits of slow rows do."""

from __future__ import annotations

import msgspec
import pytest
from planted_flights import FILE, MISSIONS, fly

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing.pack_size import PackOptions, pack_from
from uavbatt.diagnosis.diagnosis import INSTANT_SD, INSTANT_SHARE, Diagnosis, diagnose, instant_sd
from uavbatt.fitting.observed import ObservedRecord
from uavbatt.log_replay.run import engine_for

SIZE = PackOptions(4, 5.0, 13.2)
MOVED = 0.5  # of R0, given to the polarisation


@pytest.fixture(scope="module")
def sound() -> list[ObservedRecord]:
    return [fly(ambient_C, power_W, seed) for ambient_C, power_W, seed in MISSIONS]


def split_wrongly(stated_sd: float) -> BatteryFile:
    """The file of the flights with a smaller R0 and as much more polarisation, and the error stated for the latter."""
    table = FILE.parameters
    effects = []
    for entry in FILE.effects:
        values, errors = dict(entry.parameters), dict(entry.standard_error)
        if entry.name == "polarisation":
            values["polarisation_ratio"] = (values["polarisation_ratio"] + MOVED) / (1.0 - MOVED)
            errors["polarisation_ratio"] = stated_sd
        if entry.name == "slow_diffusion":
            values["diffusion_ratio"] /= 1.0 - MOVED
        effects.append(msgspec.structs.replace(entry, parameters=values, standard_error=errors))
    less = [(1.0 - MOVED) * ohm for ohm in table.resistance_ohmAh]
    return msgspec.structs.replace(
        FILE, parameters=msgspec.structs.replace(table, resistance_ohmAh=less), effects=effects
    )


def judged(flown: list[ObservedRecord], file: BatteryFile) -> Diagnosis:
    return diagnose(flown, file, pack_from(file, SIZE), engine=engine_for(is_long=True))


def test_what_a_fit_could_not_split_is_no_resistance_of_the_leads(sound: list[ObservedRecord]) -> None:
    unsure, sure = split_wrongly(stated_sd=3.0 * MOVED), split_wrongly(stated_sd=0.0)
    assert judged(sound, unsure).verdict == "no_missing_effect"
    found = judged(sound, sure)  # the same flights, if the file says that it is sure
    assert found.verdict != "no_missing_effect"


def test_a_lead_that_is_larger_than_the_doubt_is_found(sound: list[ObservedRecord]) -> None:
    unsure = split_wrongly(stated_sd=3.0 * MOVED)
    flown = [fly(ambient_C, power_W, seed, harness=0.025) for ambient_C, power_W, seed in MISSIONS]
    found = judged(flown, unsure)
    assert found.verdict == "effect_found" and "harness_resistance" in found.classes[0].members


def test_the_doubt_follows_the_error_that_the_file_states() -> None:
    assert instant_sd(split_wrongly(0.3)) == pytest.approx(0.3 * INSTANT_SHARE)
    unstated = [msgspec.structs.replace(e, standard_error={}) for e in FILE.effects]
    assert instant_sd(msgspec.structs.replace(FILE, effects=unstated)) == INSTANT_SD
