"""Does a mission fit: the plan of a route before take-off."""

from __future__ import annotations

import math

import numpy as np
import pytest
from route_rig import planned, to

from uavbatt.battery.remembered import PackHealth
from uavbatt.errors import UsageError
from uavbatt.navigation import Action, MissionItem, Wind
from uavbatt.plan.mission import MissionPlan


@pytest.fixture(scope="module")
def long() -> MissionPlan:
    """A mission of which the pack flies a part."""
    return planned(to(1, 0.0, 6000.0, 40.0))


def test_a_pack_that_is_remembered_as_faded_brings_less_home() -> None:
    there_and_back = to(1, 0.0, 1500.0, 40.0)
    whole = PackHealth(math.log(0.004), math.log(5.0), np.diag([0.1**2, 0.03**2]), cells=4)
    faded = whole._replace(log_Ah=math.log(0.75 * 5.0))
    drawn = [1.0 - planned(there_and_back, remembered=health).here.route.soc for health in (whole, faded)]
    assert drawn[1] == pytest.approx(drawn[0] / 0.75, rel=0.05)


def test_a_pack_of_other_cells_is_not_the_one_that_is_remembered() -> None:
    far = to(1, 0.0, 1500.0, 40.0)
    other = PackHealth(math.log(0.004), math.log(0.5 * 5.0), np.diag([0.1**2, 0.03**2]), cells=6)
    assert planned(far, remembered=other).here.route.soc == planned(far).here.route.soc


def test_a_short_mission_fits_and_a_long_one_does_not(long: MissionPlan) -> None:
    short = planned(to(1, 0.0, 300.0, 40.0))
    assert short.here.fits
    assert not long.here.fits
    assert math.isnan(short.here.route.turn_back_s)
    assert long.turning is not None
    assert 0.0 < long.turning.east_m < 6000.0


def test_the_charge_falls_from_leg_to_leg_to_that_of_touchdown() -> None:
    found = planned(to(1, 0.0, 400.0, 40.0), to(2, 400.0, 400.0, 40.0), to(3, 400.0, 0.0, 40.0))
    charges = [leg.soc for leg in found.legs]
    assert charges == sorted(charges, reverse=True)
    assert [leg.item for leg in found.legs] == [1, 2, 3, -1, -1, -1]
    assert found.legs[-1].end_s == pytest.approx(found.here.route.left_s, rel=0.02)
    assert found.legs[-1].soc == pytest.approx(found.here.route.soc, abs=0.02)
    assert all(leg.soc_lo <= leg.soc <= leg.soc_hi for leg in found.legs)


def test_a_pack_flown_far_beyond_empty_gets_no_charge_back() -> None:
    """Four times as far as the pack goes: the voltage of the draws turns round, the charge they have left does not."""
    found = planned(to(1, 0.0, 12_000.0, 40.0))
    highest = [leg.soc_hi for leg in found.legs]
    assert highest == sorted(highest, reverse=True)
    assert all(row.route.soc_hi <= 1.0 for row in found.rows)
    assert found.here.route.soc_hi == pytest.approx(0.0, abs=1e-6)


def test_a_mission_many_times_as_long_as_the_flight_does_not_fit(long: MissionPlan) -> None:
    """Steps of minutes carry a draw from its last charge to far beyond empty: it ends there, and nothing overflows."""
    for items in ((to(1, 0.0, 50_000.0, 40.0),), (to(1, 0.0, 100.0, 40.0, hold_s=40_000.0),)):
        found = planned(*items)
        assert not found.here.fits and not any(row.fits for row in found.rows)
        assert found.legs[-1].soc_hi == pytest.approx(0.0, abs=1e-6)
    far = planned(to(1, 0.0, 50_000.0, 40.0)).here.route
    assert far.turn_back_lo_s == pytest.approx(long.here.route.turn_back_lo_s, rel=0.1)


def test_a_reserve_has_to_be_left_at_home_and_not_where_it_turns(long: MissionPlan) -> None:
    """From the latest safe place the aircraft, which flew a straight line there, comes home with more than that."""
    careful = planned(to(1, 0.0, 6000.0, 40.0), reserve_soc=0.3)
    assert careful.turning is not None and long.turning is not None
    there_and_back = planned(to(1, 0.0, careful.turning.east_m, 40.0))
    assert there_and_back.here.route.soc_lo == pytest.approx(0.3, abs=0.05)


def test_a_wind_that_nobody_flies_against_leaves_no_way_home(long: MissionPlan) -> None:
    found = planned(to(1, 0.0, 2000.0, 40.0), wind=Wind(0.0, 35.0))
    assert "do not take off" in found.here.no_way_home
    assert any("m/s through the air" in warning for warning in found.warnings)
    assert long.here.no_way_home == ""
    assert not any("through the air" in warning for warning in long.warnings)


def test_a_headwind_home_brings_the_turning_point_nearer() -> None:
    far = to(1, 0.0, 6000.0, 40.0)
    head, tail = (planned(far, wind=Wind(0.0, east_ms)) for east_ms in (6.0, -6.0))
    assert head.here.route.turn_back_s < tail.here.route.turn_back_s


def test_a_mission_without_end_is_refused_with_its_name() -> None:
    with pytest.raises(UsageError, match="loiters without end"):
        planned(MissionItem(1, Action.LOITER_UNLIMITED))
