"""The wind of `--wind` and the home of a mission file."""

from __future__ import annotations

from pathlib import Path

import pytest

from uavbatt.cli.missions import check_wind, mission_from_home, stated_wind
from uavbatt.errors import UsageError


@pytest.mark.parametrize(
    ("text", "north_ms", "east_ms"),
    [
        ("6@270", 0.0, 6.0),  # from the west: it blows to the east
        ("10@0", -10.0, 0.0),
        ("10@30", -8.660254, -5.0),
        ("100@180", 100.0, 0.0),
        (None, 0.0, 0.0),
    ],
)
def test_the_wind_blows_away_from_where_it_comes(text: str | None, north_ms: float, east_ms: float) -> None:
    wind = stated_wind(text)
    assert (wind.north_ms, wind.east_ms) == pytest.approx((north_ms, east_ms), abs=1e-6)


@pytest.mark.parametrize("text", ["", "6", "@270", "6@", "6@west", "-1@0", "100.1@0", "nan@0", "6@inf", "6@nan"])
def test_a_text_that_is_no_wind_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="expected SPEED@FROM_DEG"):
        stated_wind(text)


def test_a_wind_needs_a_mission() -> None:
    check_wind("6@270", Path("survey.waypoints"))
    check_wind(None, None)
    with pytest.raises(UsageError, match="--wind: expected --mission FILE"):
        check_wind("6@270", None)


def test_a_mission_without_home_is_refused(tmp_path: Path) -> None:
    plan = tmp_path / "no_home.plan"
    plan.write_text(
        '{"fileType": "Plan", "mission": {"items": [{"command": 16, "frame": 3, "params": [0,0,0,0,47,8,30]}]}}'
    )
    with pytest.raises(UsageError, match="expected the place of home"):
        mission_from_home(plan)
