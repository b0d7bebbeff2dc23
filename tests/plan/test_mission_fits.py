"""Does a mission fit: the plan of a route before take-off."""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from factories import generic_pack
from route_rig import SETTINGS, planned, to

from uavbatt.battery.powers import UNKNOWN
from uavbatt.battery.remembered import PackHealth
from uavbatt.errors import UsageError
from uavbatt.navigation import Action, MissionItem, ReturnSettings, Wind
from uavbatt.plan.endurance import rested
from uavbatt.plan.mission import MissionPlan
from uavbatt.plan.words import speed_words
from uavbatt.prediction.simulation import sampling
from uavbatt.prediction.simulation.draws import Flying
from uavbatt.prediction.simulation.long_steps import fly_draws


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


@pytest.mark.parametrize(
    ("risk", "text", "fits"),
    [(0.37, "37%", False), (0.051, "5.1%", False), (0.0503, "5.03%", False), (0.05, "5%", True), (0.046, "5%", True)],
)
def test_the_risk_is_told_so_that_it_is_seen_why_a_mission_fits_or_not(
    long: MissionPlan, risk: float, text: str, fits: bool
) -> None:
    """It said "does NOT fit: 5%", and that 5 % is allowed."""
    fit = replace(long.here, route=replace(long.here.route, risk=risk))
    assert (fit.risk_text, fit.fits) == (text, fits)


def test_the_charge_falls_from_leg_to_leg_to_that_of_touchdown() -> None:
    found = planned(to(1, 0.0, 400.0, 40.0), to(2, 400.0, 400.0, 40.0), to(3, 400.0, 0.0, 40.0))
    charges = [leg.soc for leg in found.legs]
    assert charges == sorted(charges, reverse=True)
    assert [leg.item for leg in found.legs] == [1, 2, 3, -1, -1, -1]
    assert found.legs[-1].end_s == pytest.approx(found.here.route.left_s, rel=0.02)
    last, route = found.legs[-1], found.here.route
    assert (last.soc, last.soc_lo, last.soc_hi) == (route.soc, route.soc_lo, route.soc_hi)
    assert all(leg.soc_lo <= leg.soc <= leg.soc_hi for leg in found.legs)


def test_turns_end_on_their_circle_and_a_leg_says_what_is_flown() -> None:
    """The centre of a circle stood in the plan as a place that the aircraft flies to."""
    found = planned(
        MissionItem(1, Action.TAKEOFF, alt_m=40.0),
        to(2, 0.0, 400.0, 40.0, action=Action.LOITER_TURNS, turns=2.5, radius_m=100.0),
        to(3, 300.0, 400.0, 40.0, hold_s=20.0),
        MissionItem(4, Action.RETURN),
    )
    to_circle, turns = (leg for leg in found.legs if leg.item == 2)
    assert (to_circle.place.north_m, to_circle.place.east_m) == pytest.approx((0.0, 300.0), abs=0.5)
    assert (turns.place.north_m, turns.place.east_m) == pytest.approx((0.0, 500.0), abs=0.5)
    assert [leg.what for leg in found.legs] == [
        "takes off", "flies", "2.5 turns of 100 m radius", "flies, waits 20 s", "flies home", "descends", "lands"
    ]  # fmt: skip


def test_a_pack_flown_far_beyond_empty_gets_no_charge_back() -> None:
    """Four times as long as the pack lasts: the draws' voltage turns round, the charge they have left does not."""
    pack = generic_pack()
    x = sampling.samples(rested(pack, 1.0, 25.0))
    edges_s = np.arange(0.0, 7200.0, 20.0)
    passed = fly_draws(Flying(pack, x, np.full((1, x.shape[1]), 180.0), 25.0, np.array([7200.0])), edges_s)
    assert (np.diff(passed.state.soc, axis=0) <= 0.0).all()
    assert np.isfinite(passed.state.soc).all() and passed.state.soc[-1].max() < 0.01


def test_a_charge_is_told_only_where_most_flights_come_and_is_never_above_full(long: MissionPlan) -> None:
    told = [math.isfinite(leg.soc) for leg in long.legs]
    assert told == sorted(told, reverse=True) and not told[-1]
    assert math.isnan(long.here.route.soc) and math.isnan(long.here.route.soc_hi)
    short = planned(to(1, 0.0, 20.0, 5.0))
    assert max(leg.soc_hi for leg in short.legs) <= 1.0 and short.here.route.soc_hi <= 1.0
    assert short.here.route.soc > 0.9


def test_a_pack_that_is_too_cold_to_fly_has_no_charge_at_touchdown() -> None:
    frozen = planned(to(1, 0.0, 300.0, 40.0), ambient_C=-60.0)
    assert frozen.here.route.risk > 0.5
    assert math.isnan(frozen.here.route.soc)


def test_a_mission_many_times_as_long_as_the_flight_does_not_fit(long: MissionPlan) -> None:
    """Steps of minutes carry a draw from its last charge to far beyond empty: it ends there, and nothing overflows."""
    for items in ((to(1, 0.0, 50_000.0, 40.0),), (to(1, 0.0, 100.0, 40.0, hold_s=40_000.0),)):
        found = planned(*items)
        assert not found.here.fits and not any(row.fits for row in found.rows)
        assert math.isnan(found.legs[-1].soc_hi)
    crawled = (MissionItem(1, Action.SPEED, speed_ms=1e-9), to(2, 0.0, 50_000.0, 40.0))  # 1.6 million years
    assert math.isnan(planned(*crawled).legs[-1].soc_hi)
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


def test_a_plan_knows_no_turn_back_where_the_way_home_is_not_known() -> None:
    """The mission lands by itself, so that the rest is known all the same."""
    items, why = (to(1, 0.0, 6000.0, 40.0), to(2, 0.0, 0.0, math.nan, action=Action.LAND)), "rally points (2)"
    plain, elsewhere = (planned(*items, settings=replace(SETTINGS, return_reason=reason)) for reason in ("", why))
    assert math.isfinite(plain.here.route.turn_back_lo_s) and plain.turning is not None
    assert math.isnan(elsewhere.here.route.turn_back_lo_s) and elsewhere.turning is None
    assert math.isnan(elsewhere.here.route.home_soc)
    assert elsewhere.here.route.risk == plain.here.route.risk and f"no turn-back: {why}" in elsewhere.warnings


def test_a_headwind_home_brings_the_turning_point_nearer() -> None:
    far = to(1, 0.0, 6000.0, 40.0)
    head, tail = (planned(far, wind=Wind(0.0, east_ms)) for east_ms in (6.0, -6.0))
    assert head.here.route.turn_back_s < tail.here.route.turn_back_s


def test_a_mission_without_end_is_refused_with_its_name() -> None:
    with pytest.raises(UsageError, match="loiters without end"):
        planned(MissionItem(1, Action.LOITER_UNLIMITED))


def test_a_mission_that_only_lands_is_refused_with_its_name() -> None:
    with pytest.raises(UsageError, match="test: the mission flies nowhere"):
        planned(MissionItem(1, Action.LAND))


def test_the_hover_that_is_left_is_the_pack_s_and_not_the_mission_s() -> None:
    """Two missions of a minute or two: with the hover after them they empty the same pack."""
    near, far = planned(to(1, 0.0, 20.0, 40.0)).here, planned(to(1, 0.0, 300.0, 40.0)).here
    assert near.route.left_s + near.spare_s == pytest.approx(far.route.left_s + far.spare_s, rel=0.1)
    assert near.spare_lo_s > 3.0 * near.route.left_s


def test_a_plan_of_a_mission_without_a_landing_says_that_it_flies_home() -> None:
    open_end, closed = planned(to(1, 0.0, 300.0, 40.0)), planned(to(1, 0.0, 300.0, 40.0), MissionItem(2, Action.RETURN))
    assert "the mission has no landing: flight home assumed" in open_end.warnings
    assert not any("no landing" in warning for warning in closed.warnings)
    assert open_end.here.route.left_s == pytest.approx(closed.here.route.left_s)


def test_an_aircraft_without_a_vehicle_file_has_a_wider_interval_and_says_so() -> None:
    there = to(1, 0.0, 2000.0, 40.0)
    known, unknown = planned(there), planned(there, powers=msgspec.structs.replace(UNKNOWN, hover_W=180.0))
    width, wider = (plan.here.route.soc_hi - plan.here.route.soc_lo for plan in (known, unknown))
    assert wider > width
    said = "only the hover of 180 W is stated: other powers as of usual multirotors; give --vehicle"
    assert said in unknown.warnings and said not in known.warnings


def test_the_speeds_of_the_route_and_of_the_way_home_are_told_apart() -> None:
    there_and_home = planned(to(1, 0.0, 300.0, 40.0), to(2, 200.0, 300.0, 40.0), MissionItem(3, Action.RETURN))
    assert speed_words(there_and_home.planned.path.legs).startswith("route 5 m/s, way home 8 m/s, climb 2.5 m/s")


def test_a_plan_names_the_autopilot_whose_defaults_it_uses() -> None:
    far = planned(to(1, 0.0, 300.0, 40.0), settings=ReturnSettings(cruise_ms=5.0, is_px4=True))
    assert "PX4's defaults are used for climb, descent, landing" in far.warnings
    assert "return at 30 to 60 m assumed: the vehicle has not stated its own" in far.warnings
    assert max(leg.place.height_m for leg in far.legs) == 60.0
