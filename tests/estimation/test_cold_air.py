"""A pack that was kept warm flies in cold air: the thermometer tells of the air, and speaks against nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import pytest
from cases import first_quick
from scoring.other_pack import CELLS, CUTOFF_V, FULL_AH, Pack, flown, rested

from uavbatt.battery import battery_file
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.battery.state_space import Belief
from uavbatt.estimator import Estimator
from uavbatt.log_replay.run import engine_for
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.records import NAN, Estimate, Remaining, Sample, Status

FALSE = ("do not fit", "have not fitted", "holds less than stated", "is far off")


@cache
def rows(pack_C: float, air_C: float) -> tuple[Sample, ...]:
    """Twenty seconds on the ground and a flight to its end, from a pack as warm as that."""
    pack = Pack(air_C=air_C)
    pack.temp_C = pack_C
    ground = rested(pack, 20, 0.0)
    return (*ground, *flown(pack, 20.0))


@cache
def run(pack_C: float, air_C: float, ambient_C: float = NAN) -> list[tuple[Estimate, Remaining]]:
    options = PackOptions(cells=CELLS, capacity_Ah=FULL_AH, cutoff_V=CUTOFF_V, ambient_C=ambient_C)
    generic, settings = battery_file.read_battery("lipo-generic"), ForecastSettings(forecast_period_s=10.0)
    return list(Estimator(generic, options, settings, engine_for(is_long=True)).run(rows(pack_C, air_C)))


@pytest.mark.parametrize(
    ("pack_C", "air_C"), first_quick(2, [(20.0, -10.0), (10.0, 30.0), (25.0, 0.0), (20.0, 5.0), (25.0, 25.0)])
)
def test_a_number_is_said_all_along_and_nothing_is_blamed(pack_C: float, air_C: float) -> None:
    end_s = rows(pack_C, air_C)[-1].time_s
    said = [pair for pair in run(pack_C, air_C) if 60.0 < pair[0].time_s < end_s - 5.0]
    assert all(remaining.status is not Status.REFUSED for _, remaining in said)
    assert not [w for estimate, _ in said for w in estimate.warnings if any(words in w for words in FALSE)]
    alarm_s = next(r.time_s for _, r in said if r.remaining_alarm_s <= 120.0)
    assert end_s - alarm_s >= 45.0
    assert max(r.remaining_lo_s - (end_s - r.time_s) for _, r in said) < 25.0


def believed(samples: Sequence[Sample], ambient_C: float = NAN) -> Belief:
    """What is believed after these rows."""
    size = PackOptions(cells=CELLS, capacity_Ah=FULL_AH, cutoff_V=CUTOFF_V, ambient_C=ambient_C)
    generic = battery_file.read_battery("lipo-generic")
    estimator = Estimator(generic, size, engine=engine_for(is_long=True))
    list(estimator.run(samples))
    assert estimator.belief is not None
    return estimator.belief


def test_the_air_is_found_out() -> None:
    """Of a pack of 25 °C in air of 0 °C: the forecast goes on with the air, not with the pack's own warmth."""
    assert believed(rows(25.0, 0.0)[:400]).ambient_C < 12.0


def test_an_air_that_somebody_states_is_believed() -> None:
    assert believed(rows(25.0, 0.0)[:200], ambient_C=5.0).ambient_C == 5.0


def test_without_a_thermometer_the_air_stays_what_it_was() -> None:
    bare = [replace(sample, temp_C=NAN) for sample in rows(25.0, 0.0)[:200]]
    assert believed(bare).ambient_C == 22.0
