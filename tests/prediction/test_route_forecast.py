"""The forecast with a route: what lies ahead counts, what is not known falls back, home is never further than it is."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from factories import generic_pack, with_spread
from route_rig import HOME, POWERS, SETTINGS, mission, to

from uavbatt.battery import battery_file
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.estimation.filter import SocFilter
from uavbatt.estimator import Estimator, EstimatorMemory
from uavbatt.navigation import (
    METRES_PER_DEGREE,
    UNSTATED,
    Action,
    Frame,
    Mission,
    MissionItem,
    Mode,
    Navigation,
    Position,
    Wind,
)
from uavbatt.notice import Kind, kind_of
from uavbatt.output import COLUMNS, ROUTE_COLUMNS, line
from uavbatt.prediction.batch import end_times
from uavbatt.prediction.forecaster import Forecaster, ForecastSettings
from uavbatt.prediction.load.library import LearnedLoad
from uavbatt.prediction.load.scenarios import ConstantLoad
from uavbatt.prediction.route import flight_lessons
from uavbatt.prediction.route.flight_lessons import FlightLessons
from uavbatt.records import Estimate, PackFacts, Remaining, Route, Sample

ROWS = 60
FAR_M = 1000.0


def known(
    *items: MissionItem, mode: Mode = Mode.MISSION, wind: Wind | None = None, height_m: float = 350.0
) -> Navigation:
    """An aircraft that waits FAR_M east of home on its way to item 1."""
    return Navigation(
        mode=mode,
        mission=mission(*items),
        current=1,
        current_since_s=0.0,
        home=HOME,
        settings=SETTINGS,
        wind=wind,
        position=at(FAR_M, height_m),
    )


def at(east_m: float, height_m: float, time_s: float = 0.0) -> Position:
    lon = HOME.lon_deg + east_m / METRES_PER_DEGREE / math.cos(math.radians(HOME.lat_deg))
    return Position(time_s, HOME.lat_deg, lon, height_m, 0.0, 0.0, 0.0)


def waiting_at(east_m: float, wind: Wind | None = None) -> Navigation:
    """An aircraft that waits 50 m high so far east of home."""
    waits = known(to(1, 0.0, east_m, 50.0, hold_s=3000.0), wind=wind)
    return replace(waits, position=at(east_m, 50.0))


def row(k: int, now: Navigation) -> tuple[Sample, Navigation]:
    """Row `k` under 180 W, a second after the last one, with what is known then; row ROWS is at the place of `now`."""
    heard, here = replace(now, time_s=float(k), current_heard_s=float(k)), now.position
    if here is not None:
        east_m = here.east_ms * (k + 1 - ROWS)
        north_deg = here.north_ms * (k + 1 - ROWS) / METRES_PER_DEGREE
        east_deg = east_m / METRES_PER_DEGREE / math.cos(math.radians(here.lat_deg))
        moved = replace(here, time_s=float(k), lat_deg=here.lat_deg + north_deg, lon_deg=here.lon_deg + east_deg)
        heard = replace(heard, position=moved)
    return Sample(float(k), 15.0, 12.0, temp_C=25.0), heard


def run(estimator: Estimator, told: list[tuple[Sample, Navigation]]) -> list[tuple[Estimate, Remaining]]:
    """What is said at each row, with what is known of the way then: their forecasts are worked out side by side."""
    heard = {sample.time_s: now for sample, now in told}
    return list(estimator.run([sample for sample, _ in told], heard.__getitem__))


@cache
def flown(navigation: Navigation, later: Navigation | None = None, rows: int = ROWS) -> tuple[Remaining, ...]:
    """The remaining time after each row of a hover under 180 W, with `later` known from half time on."""
    estimator = Estimator.from_battery("lipo-generic", cells=4, capacity_Ah=5.0, cutoff_V=13.2)
    told = [row(k, later if later is not None and 2 * k >= rows else navigation) for k in range(rows)]
    return tuple(said for _, said in run(estimator, told))


def route(navigation: Navigation, later: Navigation | None = None) -> Route:
    found = flown(navigation, later)[-1].route
    assert found is not None
    return found


def leg_to(alt_m: float) -> MissionItem:
    return to(1, 0.0, 3000.0, alt_m)


def test_a_climb_ahead_shortens_and_a_descent_ahead_lengthens() -> None:
    climb, level, descent = (flown(known(leg_to(height_m)))[-1] for height_m in (650.0, 350.0, 50.0))
    assert climb.route is not None and climb.route.load == "route"
    assert climb.remaining_s < level.remaining_s - 5.0
    assert descent.remaining_s > level.remaining_s + 2.0  # what was expected at take-off still counts


def test_a_headwind_on_the_way_home_brings_the_turn_back_forward() -> None:
    wait = to(1, 0.0, FAR_M, 350.0, hold_s=3000.0)
    head, tail = (route(known(wait, wind=Wind(0.0, east_ms))) for east_ms in (8.0, -8.0))
    assert head.turn_back_s < tail.turn_back_s - 5.0


def test_a_wind_that_is_not_known_exactly_makes_the_turn_back_less_sure(monkeypatch: pytest.MonkeyPatch) -> None:
    said = []
    for sd_ms in (0.0, 4.0):
        monkeypatch.setattr(flight_lessons, "WIND_SD_MS", sd_ms)
        told = flown.__wrapped__(waiting_at(1500.0, Wind(0.0, 8.0)))[-1].route  # not from the cache
        assert told is not None
        said.append(told)
    assert said[1].turn_back_hi_s > said[0].turn_back_hi_s + 20.0
    assert said[1].turn_back_s < said[0].turn_back_s - 5.0  # a head wind costs more than a tail wind saves


def test_a_way_home_that_ends_below_the_reserve_is_no_way_home() -> None:
    """The reserve ends a flight: who would land with less of it has to have turned already."""
    waiting = known(to(1, 0.0, FAR_M, 350.0, hold_s=3000.0))
    home_soc = route(waiting).home_soc

    def turn_back_with(reserve_soc: float) -> float:
        estimator = Estimator.from_battery(
            "lipo-generic", cells=4, capacity_Ah=5.0, cutoff_V=13.2, reserve_soc=reserve_soc
        )
        run(estimator, [row(k, waiting) for k in range(ROWS)])
        return turn_back_s(estimator, waiting)

    assert turn_back_with(home_soc + 0.03) == 0.0
    assert 0.0 < turn_back_with(home_soc - 0.1) < turn_back_with(0.0)


def test_a_way_home_that_empties_the_pack_is_no_way_home_however_low_the_cut_off_is() -> None:
    """With 2.8 V a cell the way home went on below a charge of 0: the turn-back came 10 to 30 s late."""
    waiting = known(to(1, 0.0, FAR_M, 350.0, hold_s=3000.0))
    pack = with_spread(generic_pack(), empty_soc_sd=0.0)  # a make that was tested

    def turn_back_with(cutoff_V: float) -> float:
        forecaster = Forecaster(pack._replace(cutoff_V=cutoff_V), ForecastSettings(ConstantLoad(180.0, 0.04)))
        estimator = SocFilter(pack)
        for k in range(ROWS):
            sample, heard = row(k, waiting)
            estimate = estimator.step(sample)
            refusal, question = forecaster.update(sample, estimate, estimator.belief, heard)
            answered = None if question is None else (question, end_times(question.flying))
            said = forecaster.finish(estimate, refusal, answered)
        assert said.route is not None
        return said.route.turn_back_s

    assert turn_back_with(13.2) + 5.0 < turn_back_with(11.2)
    assert turn_back_with(11.2) == pytest.approx(turn_back_with(10.4), abs=1.0)


def test_the_same_route_in_another_frame_with_a_jump_or_uploaded_twice_gives_the_same_numbers() -> None:
    items = (leg_to(350.0), to(2, 100.0, 3000.0, 350.0), to(3, 0.0, 3000.0, 350.0), to(4, 100.0, 3000.0, 350.0))
    plain = flown(known(*items))[-1]
    sea = tuple(replace(item, alt_m=item.alt_m + HOME.alt_m, frame=Frame.SEA) for item in items)
    jump = (leg_to(350.0), items[1], items[2], MissionItem(4, Action.JUMP, jump_to=2, repeats=1))
    twice = known(*items)
    again = (
        replace(twice, mission=Mission(tuple(twice.mission.items), "link"), mission_since_s=20.0)
        if twice.mission
        else twice
    )
    assert flown(known(*sea))[-1].remaining_s == pytest.approx(plain.remaining_s, abs=0.1)
    assert flown(twice, again)[-1].remaining_s == pytest.approx(plain.remaining_s, abs=0.1)
    jumped = flown(known(*jump))[-1]
    assert jumped.route is not None and plain.route is not None
    longer_s = 100.0 / 5.0 * 1.4  # the jump flies item 3 once more
    assert plain.route.left_s - 5.0 < jumped.route.left_s < plain.route.left_s + 2.0 * longer_s


def test_a_mission_changed_in_flight_changes_the_forecast_at_once() -> None:
    before, after = known(leg_to(350.0)), known(to(1, 0.0, FAR_M + 50.0, 350.0))
    said = flown(before, after)
    first, last = said[ROWS // 2 - 1].route, said[ROWS // 2 + 5].route
    assert first is not None and last is not None
    assert last.left_s < first.left_s - 100.0


@pytest.mark.parametrize(("volts", "period"), [(14.0, 4), (16.4, 10)], ids=["near the end", "far from it"])
def test_not_every_forecast_asks_about_the_ways_and_the_others_count_down(volts: float, period: int) -> None:
    forecaster = Forecaster(generic_pack(), ForecastSettings(forecast_period_s=1.0))
    estimator = SocFilter(generic_pack())
    asked, told, changed = [], 21, 50  # from the one row on the power is known, at the other the mission changes
    for k in range(ROWS):
        now = known(leg_to(350.0)) if k < changed else known(to(1, 0.0, FAR_M + 50.0, 350.0))
        sample, heard = row(k, now)
        sample = replace(sample, voltage_V=volts)
        estimate = estimator.step(sample)
        refusal, question = forecaster.update(sample, estimate, estimator.belief, heard)
        answered = None if question is None else (question, end_times(question.flying))
        said = forecaster.finish(estimate, refusal, answered)
        if question is not None and question.route is not None:
            asked.append(k)
        assert said.route is not None or question is None
    assert [k for k in asked if told <= k < changed] == [*range(told, changed, period)]
    assert changed in asked  # another mission: at once


def test_stale_progress_falls_back_to_the_learned_load_with_its_reason() -> None:
    estimator = Estimator.from_battery("lipo-generic", cells=4, capacity_Ah=5.0, cutoff_V=13.2)
    navigation = replace(known(to(1, 0.0, FAR_M, 350.0)), current_heard_s=0.0)
    position = navigation.position
    assert position is not None
    told = [
        (Sample(float(k), 15.0, 12.0, temp_C=25.0), replace(navigation, position=replace(position, time_s=float(k))))
        for k in range(0, 120, 2)
    ]
    said = run(estimator, told)[-1][1]
    assert said.route is not None
    assert said.route.load == "unknown"
    assert "has not said" in said.route.reason
    assert math.isfinite(said.remaining_s)
    assert math.isfinite(said.route.home_soc)


def test_garbage_items_refuse_the_route_and_nothing_else() -> None:
    said = flown(known(MissionItem(1, Action.UNKNOWN, command=31010)))[-1]
    plain = flown(replace(known(leg_to(350.0)), mode=Mode.MANUAL))[-1]
    assert said.route is not None
    assert "31010" in said.route.reason
    assert math.isnan(said.route.left_s)
    assert said.remaining_s == pytest.approx(plain.remaining_s)


@pytest.mark.parametrize("mode", [Mode.MANUAL, Mode.HOLD, Mode.UNKNOWN])
def test_a_flight_in_no_mode_of_a_mission_has_exactly_the_learned_load(mode: Mode) -> None:
    manual = flown(replace(known(leg_to(350.0)), mode=mode))
    without = flown(Navigation())
    assert [r.remaining_s for r in manual if math.isfinite(r.remaining_s)] == [
        r.remaining_s for r in without if math.isfinite(r.remaining_s)
    ]


def test_on_the_way_home_the_route_is_the_way_home() -> None:
    said = route(replace(known(leg_to(350.0)), mode=Mode.RETURN))
    assert said.left_s == pytest.approx(FAR_M / 8.0 + 340.0 / 1.5 + 10.0 / 0.5, rel=0.1)
    assert said.soc == pytest.approx(said.home_soc, abs=0.01)


@pytest.mark.parametrize(
    ("mode", "action", "said"),
    [
        (Mode.MISSION, Action.WAYPOINT, Kind.TURN_BACK),
        (Mode.MISSION, Action.RETURN, Kind.MAY_NOT_LAND),
        (Mode.RETURN, Action.WAYPOINT, Kind.MAY_NOT_LAND),
        (Mode.LAND, Action.WAYPOINT, None),
    ],
)
def test_an_aircraft_that_flies_home_or_lands_is_not_told_to_turn_back(
    mode: Mode, action: Action, said: Kind | None
) -> None:
    item = leg_to(350.0) if action is Action.WAYPOINT else MissionItem(1, action)
    too_far = replace(known(item, mode=mode), position=at(9000.0, 350.0))
    estimator = Estimator.from_battery("lipo-generic", cells=4, capacity_Ah=5.0, cutoff_V=13.2)
    estimate, remaining = run(estimator, [row(k, too_far) for k in range(ROWS)])[-1]
    assert remaining.route is not None and remaining.route.turn_back_lo_s == 0.0
    kinds = {kind_of(warning) for warning in estimate.warnings}
    assert kinds & {Kind.TURN_BACK, Kind.MAY_NOT_LAND} == ({said} if said is not None else set())


@pytest.mark.parametrize(("north_ms", "east_ms", "is_known"), [(0.0, -8.0, True), (8.0, 0.0, False), (0.0, 0.0, False)])
def test_a_return_along_the_own_track_is_known_where_it_is_straight(
    north_ms: float, east_ms: float, is_known: bool
) -> None:
    """It was taken for a straight way home: "the route comes home in time" of one that was 2.5 times as long."""
    now = replace(known(leg_to(350.0)), mode=Mode.RETURN_BY_TRACK)
    assert now.position is not None
    said = route(replace(now, position=replace(now.position, north_ms=north_ms, east_ms=east_ms)))
    assert math.isfinite(said.left_s) is is_known
    assert math.isfinite(said.home_soc) is is_known
    assert is_known or "own track" in said.reason


def test_without_a_position_and_without_home_nothing_is_invented() -> None:
    said = route(replace(known(leg_to(350.0)), home=None))
    assert "home is not known" in said.reason
    assert math.isnan(said.turn_back_s)


def test_a_home_out_of_all_reach_is_told_and_not_flown_to() -> None:
    """It was heard before the first position. The way there took twelve seconds to simulate, at every forecast."""
    said = route(replace(known(leg_to(350.0)), home=replace(HOME, lat_deg=0.0)))
    assert "home lies 5" in said.reason and said.reason.endswith("km away")
    assert math.isnan(said.turn_back_s) and math.isnan(said.home_soc)


def test_an_empty_pack_brings_no_charge_home() -> None:
    """Seventy kilometres from home: every draw is empty long before it is there."""
    said = route(waiting_at(70_000.0))
    assert (said.home_soc, said.home_soc_lo, said.turn_back_s, said.must_turn_back_now) == (0.0, 0.0, 0.0, True)


def test_a_return_that_the_vehicle_does_not_state_is_less_sure_and_said_to_be_assumed() -> None:
    """Of a return at 15 to 60 m, no turn-back is later than that of the lowest, or earlier than that of the highest."""
    waiting = known(to(1, 0.0, FAR_M, 12.0, hold_s=3000.0), height_m=12.0)
    waiting = replace(waiting, position=at(FAR_M, 12.0))

    def said(**settings: float) -> Route:
        return route(replace(waiting, settings=replace(SETTINGS, **settings)))

    low, high, unstated = said(return_height_m=15.0), said(return_height_m=60.0), said(return_height_m=math.nan)
    assert high.turn_back_lo_s <= unstated.turn_back_lo_s < unstated.turn_back_s < low.turn_back_s
    assert high.turn_back_s < unstated.turn_back_s
    assert high.home_soc < unstated.home_soc < low.home_soc
    assert "return at 15 to 60 m assumed: the vehicle has not stated its own" in unstated.assumed
    assert "return at" not in low.assumed + high.assumed


def test_the_vehicle_file_states_what_the_vehicle_does_not() -> None:
    """Two roads to one number: the parameters on the link, and those of the flights that the vehicle file learned."""
    unstated = replace(known(to(1, 0.0, FAR_M, 350.0, hold_s=3000.0)), settings=UNSTATED)
    flights = LearnedLoad(*(np.full(shape, value) for shape, value in (
        ((1, 721), 180.0), ((1, 721), 0.5), (1, 1200.0), ((1, 721), 180.0), ((1, 722), 180.0)
    )), POWERS)  # fmt: skip

    def said(load: LearnedLoad, navigation: Navigation) -> Route | None:
        battery = battery_file.read_battery("lipo-generic")
        options = PackOptions(cells=4, capacity_Ah=5.0, cutoff_V=13.2)
        estimator = Estimator(battery, options, ForecastSettings(load))
        return run(estimator, [row(k, navigation) for k in range(ROWS)])[-1][1].route

    by_file = said(replace(flights, usual=SETTINGS), unstated)
    assert by_file is not None and by_file.load == "route"
    assert by_file == said(flights, replace(unstated, settings=SETTINGS))
    assert by_file != said(flights, unstated)


def test_a_line_says_that_the_flight_home_is_assumed() -> None:
    ends_there, returns = known(leg_to(350.0)), known(leg_to(350.0), MissionItem(2, Action.RETURN))
    estimator = Estimator.from_battery("lipo-generic", cells=4, capacity_Ah=5.0, cutoff_V=13.2)
    estimate, _ = estimator.step(Sample(0.0, 15.0, 12.0))
    said = [line(estimate, flown(now)[-1])["route_reason"] for now in (ends_there, returns)]
    assert "flight home assumed" in str(said[0]) and "flight home assumed" not in str(said[1])
    assert "flight home" not in route(replace(ends_there, mode=Mode.RETURN)).assumed  # it flies home already


def test_a_return_that_has_begun_is_flown_on_as_it_is_seen() -> None:
    """At 12 m and 9 m/s: it was said to climb to its usual height first, and to fly at its usual speed."""
    position = at(FAR_M, 12.0)
    moving = replace(position, east_ms=-9.0)
    unstated = replace(SETTINGS, return_height_m=math.nan, return_ms=math.nan, cruise_ms=math.nan)
    now = replace(waiting_at(FAR_M), mode=Mode.RETURN, position=moving, settings=unstated)
    seen, stated = route(now), route(replace(now, settings=replace(SETTINGS, return_height_m=12.0, return_ms=9.0)))
    assert (seen.left_s, seen.home_soc) == pytest.approx((stated.left_s, stated.home_soc), rel=1e-3)
    assert "return at" not in seen.assumed
    climbing = route(replace(now, position=position, settings=SETTINGS))  # to 30 m
    assert climbing.left_s > route(replace(now, settings=SETTINGS)).left_s + 10.0


def test_a_wind_that_the_vehicle_does_not_tell_is_said_and_allowed_for() -> None:
    """In still air the turn-back of an aircraft that had to come home against 7 m/s was 95 s late."""
    untold, calm = route(waiting_at(3000.0)), route(waiting_at(3000.0, Wind(0.0, 0.01)))
    assert untold.turn_back_s < calm.turn_back_s - 20.0
    assert untold.home_soc < calm.home_soc - 0.01
    assert "still air assumed: the vehicle has not told its wind" in untold.assumed
    assert "wind" not in calm.assumed


def test_a_home_that_only_the_mission_tells_is_said_to_be_assumed() -> None:
    told = waiting_at(FAR_M, Wind(0.0, 3.0))
    assumed = replace(told, home=replace(HOME, is_of_mission=True))
    assert route(assumed) == replace(route(told), assumed=route(assumed).assumed)
    assert "home assumed where the autopilot's mission has it" in route(assumed).assumed
    assert "home assumed where" not in route(told).assumed


def test_a_line_has_the_keys_of_the_route_only_where_one_is_known() -> None:
    estimator = Estimator.from_battery("lipo-generic", cells=4, capacity_Ah=5.0, cutoff_V=13.2)
    estimate, remaining = estimator.step(Sample(0.0, 15.0, 12.0))
    assert tuple(line(estimate, remaining)) == tuple(COLUMNS)
    with_route = line(estimate, replace(remaining, route=Route("route", left_s=12.34, reason="words")))
    assert tuple(with_route) == (*COLUMNS, *ROUTE_COLUMNS)
    assert with_route["route_left_s"] == 12.3
    assert with_route["turn_back_s"] is None
    assert with_route["route_reason"] == "words"


def test_a_flight_cut_short_says_the_same_up_to_there() -> None:
    samples = [Sample(float(k), 15.0 - 0.002 * k, 12.0, temp_C=25.0) for k in range(48)]
    base = known(leg_to(350.0))

    def navigation_at(time_s: float) -> Navigation:
        here = replace(at(FAR_M + 5.0 * time_s, 350.0, time_s), east_ms=5.0)
        return replace(base, time_s=time_s, current_heard_s=time_s, position=here)

    def lines(count: int) -> list[object]:
        estimator = Estimator.from_battery("lipo-generic", cells=4, capacity_Ah=5.0, cutoff_V=13.2)
        return [line(*row) for row in estimator.run(samples[:count], navigation_at)]

    whole = lines(48)
    assert lines(37) == whole[:37]
    assert "route" in {row["load"] for row in whole if isinstance(row, dict) and "load" in row}


def test_a_restart_in_flight_keeps_what_the_legs_have_taught() -> None:
    """The wind and the power level are there before the autopilot has told them again, and so is the forecast."""
    waiting = known(to(1, 0.0, FAR_M, 350.0, hold_s=3000.0), wind=Wind(0.0, 8.0))
    before = Estimator.from_battery("lipo-generic", cells=4, capacity_Ah=5.0, cutoff_V=13.2)
    run(before, [row(k, waiting) for k in range(ROWS)])
    assert before.past is not None
    forgetful = before.past._replace(forecaster=before.past.forecaster._replace(route=FlightLessons()))
    unheard = replace(waiting, wind=None)
    resumed, begun_anew = (turn_back_s(restarted(before, past), unheard) for past in (before.past, forgetful))
    went_on = turn_back_s(before, waiting)
    assert resumed == pytest.approx(went_on, abs=5.0)
    assert abs(begun_anew - went_on) > 15.0


def restarted(before: Estimator, past: EstimatorMemory) -> Estimator:
    """Another process that goes on from the belief of the first, with this past."""
    assert before.belief is not None and before.pack_size is not None
    after = Estimator(before.battery, before.options)
    after.restore(before.belief, past, before.pack_size, PackFacts(), 12.0)
    return after


def turn_back_s(one: Estimator, now: Navigation) -> float:
    """Seconds until the turn-back at the next row; ∞ where the forecast knows none."""
    found = one.step(*row(ROWS, now))[1].route
    return found.turn_back_s if found is not None and math.isfinite(found.turn_back_s) else math.inf


def test_an_aircraft_that_stands_at_home_has_no_way_home_left() -> None:
    """With a cone it does not climb there, and a way home without any leg ended the replay."""
    load = ForecastSettings(ConstantLoad(180.0, 0.04))
    options = PackOptions(cells=4, capacity_Ah=5.0, cutoff_V=13.2)
    estimator = Estimator(battery_file.read_battery("lipo-generic"), options, load)
    above = replace(known(), mode=Mode.MANUAL, settings=replace(SETTINGS, return_cone_slope=3.0))
    told = [row(k, replace(above, position=at(0.0, 20.0 if k < ROWS else 0.0))) for k in range(ROWS + 20)]
    landed = [
        (replace(s, current_A=0.3, voltage_V=15.6, armed=False) if k >= ROWS else s, n) for k, (s, n) in enumerate(told)
    ]
    estimate, remaining = run(estimator, landed)[-1]
    assert remaining.route is not None and remaining.route.home_soc > estimate.soc - 0.05
