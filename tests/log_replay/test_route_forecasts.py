"""What a replay says of its route forecasts as a whole."""

from __future__ import annotations

import pytest

from uavbatt.log_replay.run import RouteForecasts
from uavbatt.records import Route

STILL_AIR, NO_LANDING = "still air assumed", "flight home assumed"


@pytest.mark.parametrize(
    ("assumed", "said"),
    [
        ([STILL_AIR] * 5 + [""] * 95, ""),  # until the first estimate of the wind
        ([STILL_AIR] * 100, STILL_AIR),
        ([STILL_AIR] * 5 + [NO_LANDING] * 60 + [""] * 35, NO_LANDING),  # then it returned
        ([], ""),
    ],
)
def test_what_was_assumed_in_hardly_any_forecast_is_not_said(assumed: list[str], said: str) -> None:
    rows = [(float(k), Route(load="route", assumed=words)) for k, words in enumerate(assumed)]
    assert RouteForecasts(rows).assumed == said
