"""A lag of the thermometer is an effect only beyond the error that the battery file states of its own lag."""

from __future__ import annotations

import msgspec
import pytest
from planted_flights import CAPACITY_AH, CELLS, CUTOFF_V, FILE, MISSIONS, fly

from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.sizing.pack_size import PackOptions, pack_from
from uavbatt.diagnosis.diagnosis import options_of, problem_of
from uavbatt.diagnosis.refit.candidates import NOTHING
from uavbatt.diagnosis.refit.solver import SETTLED, refit
from uavbatt.diagnosis.search.trial import FIRST_TURNS, trial
from uavbatt.fitting.observed import ObservedRecord

IN_FILE_S = 18.0


@pytest.fixture(scope="module")
def flights() -> list[ObservedRecord]:
    return [fly(*mission, lag_s=1.0) for mission in MISSIONS[:3]]


def with_lag(standard_error_s: float) -> BatteryFile:
    def lag(entry: object) -> object:
        said = {"sensor_lag_s": IN_FILE_S}, {"sensor_lag_s": standard_error_s}
        return msgspec.structs.replace(entry, parameters=said[0], standard_error=said[1])

    return msgspec.structs.replace(FILE, effects=[lag(e) if e.name == "temperature_lag" else e for e in FILE.effects])


@pytest.mark.parametrize(("standard_error_s", "least", "most"), [(17.0, 0.0, 1.1), (2.0, 10.0, 20.0)])
def test_a_thermometer_without_a_lag_is_news_only_to_a_file_that_knows_its_lag(
    flights: list[ObservedRecord], standard_error_s: float, least: float, most: float
) -> None:
    """A fit of a few logs tells 18 s, one standard error 17 s: none is one standard error away, and no news.

    It was named as an effect at 0.5, with an interval from 0.5 s to 300 s.
    """
    file = with_lag(standard_error_s)
    problem = problem_of(flights, file, pack_from(file, PackOptions(CELLS, CAPACITY_AH, CUTOFF_V)))
    (lag,) = [option for option in options_of(problem, file, ()) if option.name == "temperature_lag"]
    tried = trial(problem, refit(problem, [NOTHING], iterations=SETTLED)[0], [lag], FIRST_TURNS)
    assert least <= tried.worths[0].value <= most
