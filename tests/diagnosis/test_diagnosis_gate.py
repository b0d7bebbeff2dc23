"""An extended file goes through the gate again: what it needs to be certified, and what bench tests cannot say."""

from __future__ import annotations

from dataclasses import replace
from importlib import resources
from pathlib import Path
from unittest.mock import patch

import msgspec
import numpy as np
import pytest
from command import Judged

from uavbatt import dataset
from uavbatt.battery import battery_file
from uavbatt.battery.battery_file import BatteryFile, EffectEntry
from uavbatt.battery.scaling import pack_of
from uavbatt.battery.sizing.pack_size import PackOptions, pack_from
from uavbatt.diagnosis import close, gate
from uavbatt.diagnosis.diagnosis import Diagnosis, diagnose
from uavbatt.fitting.observed import from_flight
from uavbatt.log_replay.run import engine_for
from uavbatt.records import Flight
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, with_effects, write_log
from uavbatt.telemetry import read_log
from uavbatt.validation.gating import heldout

CELLS, CAPACITY_AH, CUTOFF_V, LOW_V = 3, 1.5, 9.6, 10.5
STUDY = Path(str(resources.files("uavbatt") / "data" / "study"))
FADED = EffectEntry(name="capacity_fade", parameters={"fade": 0.2})
SLUGGISH = EffectEntry(name="charge_transfer", parameters={"transfer_V": 0.1, "transfer_half_rate": 0.3})


@pytest.fixture(scope="module")
def file() -> BatteryFile:
    return battery_file.read_battery("lpab-3s")


@pytest.fixture(scope="module")
def found(file: BatteryFile, tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    """Three flights on the certified battery, with a current sensor that reads a third too much."""
    folder = tmp_path_factory.mktemp("logs")
    pack = with_effects(pack_of(file, CELLS, CAPACITY_AH, CUTOFF_V, LOW_V), {"current_gain": 1.3})
    flights: list[Flight] = []
    for i, (power_W, ambient_C) in enumerate([(75.0, 25.0), (90.0, 15.0), (60.0, 30.0)]):
        path = folder / f"flight_{i}.csv"
        write_log(path, simulate_flight(pack, SimulatedFlight(power_W, ambient_C, rate_Hz=1.0, seed=i)), pack)
        flights.append(read_log(path))
    records = [from_flight(f, CELLS, CAPACITY_AH) for f in flights]
    return diagnose(
        records, file, pack_from(file, PackOptions(CELLS, CAPACITY_AH, CUTOFF_V)), engine=engine_for(is_long=True)
    )


def test_a_sensor_effect_leaves_the_bench_tests_as_they_are_so_that_the_file_is_certified(
    file: BatteryFile, found: Diagnosis, judged_study: Judged
) -> None:
    assert found.verdict == "effect_found" and "current_gain" in found.classes[0].members
    new = close.extended(file, found)
    assert new.status == "fitted"  # flights alone do not certify
    with patch.object(heldout, "circuit", return_value=judged_study.found.held):  # fitted there already
        verdicts = gate.verdicts(dataset.load(STUDY), new)
    gated = close.gated(new, found, verdicts)
    assert {v.verdict for v in verdicts} == {"pass"}
    assert gated.status == "certified" and gated.certificate.validated_ambient_C == [25.0]


def test_tests_of_a_new_pack_do_not_certify_an_aged_one(file: BatteryFile, found: Diagnosis) -> None:
    aged = msgspec.structs.replace(file, effects=[*file.effects, FADED])
    verdicts = gate.verdicts(dataset.load(STUDY), aged)
    assert [v.verdict for v in verdicts] == ["not enough data"] and "capacity_fade" in verdicts[0].reason
    assert close.gated(aged, found, verdicts).status == "fitted"


def test_an_extended_cell_moves_the_predictions_that_the_gate_judges(file: BatteryFile) -> None:
    slower = msgspec.structs.replace(
        file,
        effects=[*file.effects, SLUGGISH],
    )
    tests = dataset.load(STUDY)
    metered = dataset_with_current(tests)
    time_s, change_V = gate._difference(metered, 25.0, file, slower)
    assert time_s[-1] > 300.0
    loaded = change_V[time_s > 10.0]
    assert np.all((loaded < -0.2) & (loaded > -0.31))  # three cells of up to 0.1 V


def dataset_with_current(tests: dataset.DataSet) -> dataset.DataSet:
    """The study's runs as if 12 A had been metered."""
    runs = tuple(replace(r, current_A=np.full_like(r.time_s, 12.0)) for r in tests.runs)
    return replace(tests, runs=runs, capacity_Ah=1.5)
