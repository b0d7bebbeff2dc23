"""The load to come, learned: resampled from where the flight stands, scaled, stitched; few flights are wide."""

from __future__ import annotations

import math

import numpy as np
import pytest
from factories import flown, generic_pack

from uavbatt.battery.state_space import SIZE, Belief, X
from uavbatt.battery.vehicle_file import Phases, Trace, VehicleFile
from uavbatt.prediction.forecast import Forecast
from uavbatt.prediction.forecaster import Forecaster, ForecastSettings
from uavbatt.prediction.load.flight_so_far import FlightSoFar
from uavbatt.prediction.load.library import (
    FEW_FLIGHTS,
    FEW_SPREAD,
    GRID_S,
    OWN_SCALING,
    OWN_SPREAD,
    LearnedLoad,
    UnknownAircraft,
    learned_load,
)
from uavbatt.prediction.load.power_history import MOST_PIECES, PRIOR_MINUTE_SD, PowerHistory, RecentLoad
from uavbatt.prediction.load.scenarios import ConstantLoad, FlightPoint, Load, Scenarios, equal_levels

STEP_S = 5.0


def past(power_W: list[float], start_soc: float = 1.0, end_soc: float = 0.1) -> Trace:
    """A past flight with a row every 10 s; its charge falls evenly."""
    soc = np.linspace(start_soc, end_soc, len(power_W)).tolist()
    return Trace(time_s=[10.0 * k for k in range(len(power_W))], power_W=power_W, soc=soc)


def library(*traces: Trace) -> LearnedLoad:
    phases = Phases(take_off_W=1.0, flight_W=1.0, last_minute_W=1.0)
    return learned_load(VehicleFile(name="a", battery="b", phases=phases, traces=list(traces)))


def now(since_s: float = 0.0, soc: float = 1.0, flight_W: float = 300.0, recent_W: float = 300.0) -> FlightPoint:
    return FlightPoint(since_s, since_s, soc, flight_W, RecentLoad(since_s, recent_W, recent_W))


def middle_W(scenarios: Scenarios) -> np.ndarray:  # type: ignore[type-arg]
    """[steps, flights] at the middle of the three levels."""
    return scenarios.power_W.reshape(scenarios.power_W.shape[0], -1, 3)[:, :, 1]


# --- a flight that goes on ---------------------------------------------------------------------------------------


def test_a_flight_that_goes_on_does_not_land_where_past_ones_did() -> None:
    """Crews land with charge left: from there on, a sixth less power was expected."""
    landed = [past([300.0] * 60 + [240.0] * 6, end_soc=0.3), past([310.0] * 50 + [250.0] * 6, end_soc=0.4)]
    for since_s, soc in ((400.0, 0.55), (590.0, 0.32)):
        made = middle_W(library(*landed).scenarios(now(since_s, soc, 305.0), STEP_S, 120))
        assert made.min() > 290.0


def test_a_flight_that_goes_on_climbs_home_as_past_ones_did() -> None:
    made = library(past([300.0] * 60 + [420.0] * 6)).scenarios(now(590.0, 0.2), STEP_S, 12)
    assert middle_W(made)[4, 0] == pytest.approx(420.0, rel=0.05)


# --- from where the flight stands --------------------------------------------------------------------------------


def test_traces_start_where_the_flight_stands() -> None:
    """A ramp that rises 1 W/s: time and charge agree on the place, so the power to come starts there."""
    ramp = [100.0 + 10.0 * k for k in range(91)]  # 900 s, charge falls 0.001 per s
    load = library(past(ramp))
    for since_s in (0.0, 200.0, 500.0):
        mean_W = 100.0 + since_s / 2.0
        made = load.scenarios(now(since_s, 1.0 - 0.001 * since_s, mean_W), STEP_S, 10)
        expected_W = 100.0 + since_s + STEP_S * (np.arange(10) + 0.5)
        assert middle_W(made)[:, 0] == pytest.approx(expected_W, rel=0.03)


def test_time_and_charge_count_half_each() -> None:
    ramp = [100.0 + 10.0 * k for k in range(91)]
    made = library(past(ramp)).scenarios(now(200.0, 0.6, 100.0 + 300.0 / 2.0), STEP_S, 4)
    assert middle_W(made)[0, 0] == pytest.approx(100.0 + 300.0 + 2.5, rel=0.03)  # between 200 s and 400 s


@pytest.mark.parametrize("ratio", [0.9, 1.0, 1.1])
def test_half_way_to_this_flights_power(ratio: float) -> None:
    made = library(past([300.0] * 60)).scenarios(now(100.0, 0.85, 300.0 * ratio), STEP_S, 5)
    assert middle_W(made)[:, 0] == pytest.approx(300.0 * ratio**OWN_SCALING)
    assert OWN_SCALING == 0.5


@pytest.mark.parametrize("ratio", [0.6, 1.4, 2.0])
def test_another_payload_stays(ratio: float) -> None:
    """Flights of one aircraft differ by a tenth, and half of that is chance; 40 % more is flown to the end."""
    W = 300.0 * ratio
    made = library(past([290.0] * 60), past([310.0] * 60)).scenarios(now(300.0, 0.7, W, min(W, 300.0)), STEP_S, 5)
    assert middle_W(made) == pytest.approx(W, rel=0.01)


def test_a_payload_taken_up_in_flight_is_seen_within_a_minute() -> None:
    """No flight of the library asked so much there: the mean of the whole flight would say it late."""
    made = library(past([300.0] * 60)).scenarios(now(300.0, 0.7, 320.0, 450.0), STEP_S, 5)
    assert middle_W(made)[:, 0] == pytest.approx(450.0, rel=0.04)


def test_a_pump_that_is_stuck_is_seen_within_a_minute() -> None:
    """The tanks of all other flights were half empty by now; by the mean of its flight alone this one asks 460 W."""
    emptying = past([600.0 - 5.0 * k for k in range(60)])
    made = library(emptying).scenarios(now(400.0, 0.4, 600.0, 600.0), STEP_S, 1)
    assert middle_W(made)[0, 0] == pytest.approx(600.0, rel=0.1)


def test_a_minute_of_little_power_is_a_descent() -> None:
    made = library(past([300.0] * 60)).scenarios(now(300.0, 0.7, 300.0, 60.0), STEP_S, 5)
    assert middle_W(made)[:, 0] == pytest.approx(300.0)


def test_every_flight_has_the_same_weight_at_three_levels() -> None:
    load = library(*(past([100.0 * k] * 60) for k in (1, 2, 3)))
    made = load.scenarios(now(flight_W=200.0), STEP_S, 7)
    assert made.power_W.shape == (7, 9) and made.dt_s.tolist() == [STEP_S] * 7
    assert made.weight == pytest.approx(np.full(9, 1.0 / 9.0))
    assert load.typical_W(now()) == pytest.approx(200.0, rel=0.35)


# --- beyond the landing ------------------------------------------------------------------------------------------


def test_a_flight_that_landed_goes_on_as_another_did_from_its_charge() -> None:
    """The first lands at half its charge after 300 s at 100 W; the second asks 400 W below half its charge."""
    short = past([100.0] * 31, 1.0, 0.5)
    long = past([100.0] * 50 + [400.0] * 51, 1.0, 0.0)
    load = library(short, long)
    grid_s = GRID_S * np.arange(load.power_W.shape[1])
    assert load.landed_s.tolist() == [300.0, 1000.0]
    assert load.power_W[0][grid_s <= 300.0] == pytest.approx(100.0)
    assert load.power_W[0][(grid_s > 330.0) & (grid_s < 800.0)] == pytest.approx(400.0)
    assert load.soc[0][grid_s == 300.0] == pytest.approx(0.5, abs=0.01)
    assert (np.diff(load.soc, axis=1) < 0.0).all()


def test_the_last_one_goes_on_at_its_last_two_minutes() -> None:
    load = library(past([100.0] * 40 + [200.0] * 13))
    assert load.power_W[0, -1] == pytest.approx(200.0)
    made = load.scenarios(now(5000.0, 0.0, 120.0), STEP_S, 20)
    assert np.isfinite(made.power_W).all() and made.power_W.min() > 0.0


def test_beyond_all_landings_the_tank_of_a_sprayer_stays_empty() -> None:
    """The mean of the whole flight holds the full tank: six logs that land made 70 s too few of eight minutes."""
    emptying = np.linspace(450.0, 300.0, 50).tolist()
    load = library(past([*emptying, *[300.0] * 35], end_soc=0.3))
    assert load.power_W[0, -1] == pytest.approx(300.0, rel=0.01)


# --- how wide ----------------------------------------------------------------------------------------------------


def test_few_flights_widen() -> None:
    few, many = (library(*[past([250.0] * 60)] * n) for n in (FEW_FLIGHTS - 1, FEW_FLIGHTS))
    spread = [float(np.std(np.log(load.scenarios(now(), STEP_S, 3).power_W[0]))) for load in (few, many)]
    assert spread[0] == pytest.approx(float(np.std(np.log(equal_levels(FEW_SPREAD, 3)))))
    assert spread[1] == pytest.approx(float(np.std(np.log(equal_levels(OWN_SPREAD, 3)))))
    assert width(few) > 1.3 * width(many)


def test_an_unknown_aircraft_is_wider_than_its_own_library() -> None:
    rng = np.random.default_rng(2)
    own = library(*(past((280.0 * np.exp(0.05 * rng.standard_normal(60))).tolist()) for _ in range(12)))
    assert width(UnknownAircraft()) > 1.3 * width(own)
    surge = library(*(past([280.0] * 30 + [280.0 * rng.uniform(1.0, 1.4)] * 40) for _ in range(12)))
    assert width(surge) > 1.1 * width(own)  # flights that ended differently are less sure


def test_an_unknown_aircraft_expects_a_surge() -> None:
    made = UnknownAircraft().scenarios(now(300.0)._replace(left_s=50 * STEP_S), STEP_S, 100)
    assert made.weight.sum() == pytest.approx(1.0) and made.power_W.shape[1] == made.weight.size
    ahead_W = made.power_W @ made.weight
    early_W, late_W = ahead_W[:10].mean(), ahead_W[45:55].mean()
    assert early_W == pytest.approx(300.0, rel=0.1) and 1.03 * early_W < late_W < 1.3 * early_W


def test_a_surge_begins_before_the_end_that_the_load_has_without_it() -> None:
    """A high cut-off ends a flight while the pack holds much: a surge placed by the empty pack would come too late."""
    at_end_W = [
        (made.power_W @ made.weight)[40]
        for left_s in (20 * STEP_S, 40 * STEP_S, 400 * STEP_S)
        for made in [UnknownAircraft().scenarios(now(300.0)._replace(left_s=left_s), STEP_S, 100)]
    ]
    assert at_end_W[0] == pytest.approx(at_end_W[1]) and at_end_W[1] > 1.1 * at_end_W[2]


def recent(*power_W: float) -> RecentLoad:
    mean_W = float(np.mean(power_W))
    return RecentLoad(0.0, mean_W, mean_W, flown(*power_W))


def test_a_flight_is_flown_again_with_its_mean_and_its_highest_power() -> None:
    """Twenty seconds of motor, eighty of glide: 1 to 0.05."""
    again = flown(*([500.0] * 4 + [25.0] * 16) * 5).again(np.arange(0.0, 1000.0, 5.0), 45)
    assert again.mean(axis=0) == pytest.approx(np.ones(45), rel=0.05)
    assert np.quantile(again, [0.1, 0.9]) == pytest.approx([25.0 / 120.0, 500.0 / 120.0], rel=1e-6)
    assert np.ptp(again[0]) > 3.0  # each from another place of it on
    assert PowerHistory().again(np.arange(0.0, 50.0, 5.0), 7) == pytest.approx(1.0)


def test_a_long_flight_keeps_its_energy_in_as_many_pieces() -> None:
    power_W = 300.0 + 100.0 * np.random.default_rng(2).standard_normal(3600)
    long = flown(*power_W.tolist(), each_s=1.0)
    assert len(long.pieces_W) < MOST_PIECES and long.is_possible
    assert sum(long.pieces_W) * long.piece_s + long.open_J == pytest.approx(power_W.sum())
    assert flown(*power_W[::10].tolist(), each_s=10.0).length_s == pytest.approx(3600.0, abs=long.piece_s)


def test_the_minutes_of_a_steady_flight_are_alike_and_those_of_a_glider_are_not() -> None:
    assert PowerHistory().minute_sd == PRIOR_MINUTE_SD
    assert flown(*[300.0] * 120).minute_sd < 0.05
    assert flown(*([500.0] * 6 + [25.0] * 24) * 4).minute_sd > 0.4


def test_another_load_in_the_last_minute_is_believed_unless_the_motor_runs_by_turns() -> None:
    unknown = UnknownAircraft()

    def typical_W(*power_W: float) -> float:
        memory = recent(*power_W)._replace(mean_W=float(np.mean(power_W[-12:])))
        return unknown.typical_W(FlightPoint(600.0, 600.0, 0.5, float(np.mean(power_W)), memory))

    assert typical_W(*[300.0] * 108, *[600.0] * 12) == pytest.approx(600.0)
    by_turns = ([600.0] * 12 + [30.0] * 24) * 4
    assert typical_W(*by_turns) == pytest.approx(np.mean(by_turns), rel=0.1)  # it glides now


def test_an_unknown_aircraft_does_not_take_up_again_what_it_has_set_down() -> None:
    """Two minutes too few of six were said once a load of half the mass was set down: it was to be carried again."""
    then_W, before, after = 200.0, 60, 48
    pieces = flown(*[300.0] * before, *[then_W] * after)
    since_s = 5.0 * (before + after)
    point = FlightPoint(
        since_s, since_s, 0.5, (300.0 * before + then_W * after) / (before + after),
        RecentLoad(since_s, then_W, then_W, pieces), left_s=300.0,
    )  # fmt: skip
    unknown = UnknownAircraft()
    assert unknown.typical_W(point) == pytest.approx(then_W, rel=0.02)
    first_W = unknown.scenarios(point, STEP_S, 60).power_W[0]
    assert np.mean(first_W) == pytest.approx(then_W, rel=0.05)  # with the load of before it flew again, a third off


def test_a_tank_that_was_filled_again_may_be_filled_once_more() -> None:
    """Two tanks with one pack: while the second is empty, the rest is not taken for flight without any load."""
    emptying = [*[450.0] * 60, *[300.0] * 48]
    powers_W = [*emptying, *emptying]
    pieces, since_s = flown(*powers_W), 5.0 * len(powers_W)
    point = FlightPoint(since_s, since_s, 0.5, float(np.mean(powers_W)), RecentLoad(since_s, 300.0, 300.0, pieces))
    assert UnknownAircraft().typical_W(point) > 1.05 * 300.0
    once = flown(*emptying)
    point = FlightPoint(540.0, 540.0, 0.5, float(np.mean(emptying)), RecentLoad(540.0, 300.0, 300.0, once))
    assert UnknownAircraft().typical_W(point) == pytest.approx(300.0, rel=0.03)


def test_a_descent_and_a_motor_that_stops_by_turns_are_no_change() -> None:
    unknown = UnknownAircraft()
    for powers_W in ([300.0] * 60 + [200.0] * 18, ([600.0] * 12 + [30.0] * 24) * 4):
        since_s, mean_W = 5.0 * len(powers_W), float(np.mean(powers_W))
        point = FlightPoint(since_s, since_s, 0.5, mean_W, RecentLoad(since_s, mean_W, mean_W, flown(*powers_W)))
        assert unknown.typical_W(point) == pytest.approx(mean_W)


def test_a_motor_that_runs_by_turns_ends_the_flight_while_it_runs() -> None:
    """The same mean power, steady or by turns of four times the mean: the cut-off is met while the motor runs."""
    steady, by_turns = (
        forecast(UnknownAircraft(), recent(*watts)) for watts in ([280.0] * 96, ([1120.0] * 2 + [0.0] * 6) * 12)
    )
    assert by_turns.lo_s < 0.4 * steady.lo_s
    scattered = forecast(UnknownAircraft(), recent(*([210.0] * 4 + [350.0] * 4) * 12))
    assert scattered.lo_s < steady.lo_s


CALM = recent(*[280.0] * 96)


def width(load: Load, recent: RecentLoad = CALM) -> float:
    """Width of the forecast with this load for a pack at 70 % that is well known."""
    found = forecast(load, recent)
    return found.hi_s - found.lo_s


def forecast(load: Load, recent: RecentLoad = CALM, capacity_Ah: float = 5.0) -> Forecast:
    mean, sd = np.zeros(SIZE), np.full(SIZE, 1e-6)
    mean[X.SOC], mean[X.CORE], mean[X.SENSOR], sd[X.SOC] = 0.7, 25.0, 25.0, 0.01
    pack = generic_pack(capacity_Ah=capacity_Ah)
    forecaster = Forecaster(pack, ForecastSettings(load))
    flown = FlightSoFar(recent, took_off_s=-200.0, flown_s=200.0, flown_J=56000.0)
    forecaster.recall(forecaster.memory._replace(flight=flown))
    found = forecaster.forecast(Belief.gaussian(mean, np.diag(sd**2), 25.0), 0.0)
    assert found is not None and math.isfinite(found.median_s)
    return found


def test_a_minute_without_power_in_a_past_flight_scales_nothing() -> None:
    """A glide or a dropout: ln 0 made the power NaN, and with it the forecast, shown as `ok`."""
    level, glides = [300.0] * 91, [300.0] * 40 + [0.0] * 12 + [300.0] * 39
    for since_s in (100.0, 420.0, 500.0):
        at = now(since_s, 1.0 - 0.001 * since_s)
        plain = library(*[past(level)] * 3).scenarios(at, STEP_S, 60)
        odd = library(past(level), past(level), past(glides)).scenarios(at, STEP_S, 60)
        assert np.isfinite(odd.power_W).all()
        assert middle_W(odd)[:, :2] == pytest.approx(middle_W(plain)[:, :2], rel=0.15)


# --- past flights like this one ----------------------------------------------------------------------------------

UP_AND_DOWN = [420.0, 420.0, 420.0, 420.0, 240.0, 240.0, 240.0, 240.0]  # 40 s each: a survey in wind
STEADY = [330.0] * 8


def flown_like(powers_W: list[float], since_s: float, missing_s: float = 0.0) -> FlightPoint:
    """A flight that asked these powers again and again, a row every 10 s, none for `missing_s` in its middle."""
    recent, rows = RecentLoad(), round(since_s / 10.0)
    for k in range(rows + 1):
        late_s = missing_s if k > rows // 2 else 0.0
        recent = recent.after(10.0 * k + late_s, powers_W[k % len(powers_W)])
    return FlightPoint(since_s + missing_s, since_s + missing_s, 0.5, 330.0, recent)


def share_of_first(load: LearnedLoad, at: FlightPoint) -> float:
    return float(load.scenarios(at, STEP_S, 5).weight[:3].sum())


def test_a_past_flight_that_went_like_this_one_counts_most() -> None:
    """Both had a mean of 330 W; only the first went up and down where this one does, and ends in a climb."""
    load = library(past(UP_AND_DOWN * 11 + [600.0] * 12), past(STEADY * 11 + [330.0] * 12))
    assert share_of_first(load, flown_like(UP_AND_DOWN, 600.0)) > 0.85
    assert share_of_first(load, flown_like(STEADY, 600.0)) < 0.15
    assert share_of_first(load, flown_like(STEADY, 20.0)) == pytest.approx(0.5)  # nothing shown yet


def test_no_past_flight_is_forgotten() -> None:
    load = library(past(UP_AND_DOWN * 12), past(STEADY * 12))
    assert 0.09 < share_of_first(load, flown_like(STEADY, 600.0)) < 0.11


@pytest.mark.parametrize("payload", [0.8, 1.2, 1.5])
def test_the_likeness_does_not_hang_on_the_level(payload: float) -> None:
    load = library(past(UP_AND_DOWN * 12), past(STEADY * 12))
    shares = [share_of_first(load, flown_like([f * W for W in UP_AND_DOWN], 600.0)) for f in (1.0, payload)]
    assert shares[1] == pytest.approx(shares[0], abs=1e-6)


def test_a_flight_with_a_gap_is_like_any_other() -> None:
    """After five minutes without rows nobody knows where the powers before them belong."""
    load = library(past(UP_AND_DOWN * 20), past(STEADY * 20))
    assert share_of_first(load, flown_like(UP_AND_DOWN, 600.0, missing_s=300.0)) == pytest.approx(0.5)


# --- flights of hours --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("hours", [1.0, 2.5, 3.5, 4.5])
def test_a_flight_of_hours_ends_like_one_of_minutes(hours: float) -> None:
    """The steps of a forecast reached 2.8 hours: twice the true time was told for a flight of three."""
    capacity_Ah = 5.0 * 60.0 * hours / 10.0  # with 5 Ah it is some ten minutes
    learned = forecast(library(*[past([280.0] * 90)] * FEW_FLIGHTS), capacity_Ah=capacity_Ah)
    stated = forecast(ConstantLoad(280.0, 0.01), capacity_Ah=capacity_Ah)
    assert learned.median_s == pytest.approx(stated.median_s, rel=0.03)
    assert learned.hi_s < 1.5 * learned.median_s


def test_a_library_goes_on_beyond_its_first_hour() -> None:
    """Blocks of past flights beyond the grid had no power, as if this flight needed many times as much."""
    load = library(past([300.0] * 720))
    pieces = flown(*[300.0] * 130, each_s=30.0)
    point = FlightPoint(3900.0, 3900.0, 0.3, 300.0, RecentLoad(3900.0, 300.0, 300.0, pieces))
    assert middle_W(load.scenarios(point, STEP_S, 20)) == pytest.approx(np.full((20, 1), 300.0), rel=0.01)


# --- a payload taken up in flight --------------------------------------------------------------------------------


def test_a_flight_that_has_needed_more_and_more_goes_on_as_in_its_last_two_minutes() -> None:
    """At half time of a flight that rose by half, the lower end was 45 s too long, and nine seconds at two minutes."""
    load = library(*[past([300.0] * 180)] * FEW_FLIGHTS)
    pieces = flown(*np.linspace(300.0, 400.0, 120).tolist())
    point = FlightPoint(600.0, 600.0, 0.5, 350.0, RecentLoad(600.0, 392.0, 400.0, pieces))
    assert middle_W(load.scenarios(point, STEP_S, 20)) == pytest.approx(np.full((20, FEW_FLIGHTS), 390.0), rel=0.02)


def test_a_flight_that_needs_more_since_a_step_goes_on_so() -> None:
    """Seven minutes after it the time left was a third too long: the mean of the whole flight counted."""
    load = library(*[past([300.0] * 180)] * FEW_FLIGHTS)
    pieces = flown(*[300.0] * 60, *[405.0] * 60)
    recent = RecentLoad(600.0, 405.0, 405.0, pieces)
    point = FlightPoint(600.0, 600.0, 0.5, 352.0, recent)
    assert middle_W(load.scenarios(point, STEP_S, 20)) == pytest.approx(np.full((20, FEW_FLIGHTS), 405.0), rel=0.01)


def test_a_payload_set_down_later_than_before_does_not_count_for_the_way_home() -> None:
    """Its mean so far is a sixth higher; half minute by half minute it needs what the others have needed."""
    load = library(*[past([*[360.0] * (25 + k), *[240.0] * 60]) for k in range(FEW_FLIGHTS)])
    pieces = flown(*[360.0] * 84, *[240.0] * 36)
    point = FlightPoint(600.0, 600.0, 0.4, 324.0, RecentLoad(600.0, 240.0, 240.0, pieces))
    assert middle_W(load.scenarios(point, STEP_S, 20)) == pytest.approx(np.full((20, FEW_FLIGHTS), 240.0), rel=0.02)


@pytest.mark.parametrize(("minutes", "expected_W"), [(2, 300.0), (6, 210.0)])
def test_a_payload_that_was_set_down_is_believed_when_no_descent_lasts_so_long(minutes: int, expected_W: float) -> None:
    """Before, it may be a descent. The mean of the whole flight was two minutes too short for the rest of it."""
    load = library(*[past([300.0] * 180)] * FEW_FLIGHTS)
    before, after = 60, 12 * minutes
    pieces = flown(*[300.0] * before, *[210.0] * after)
    mean_W = (300.0 * before + 210.0 * after) / (before + after)
    since_s = 5.0 * (before + after)
    point = FlightPoint(since_s, since_s, 0.5, mean_W, RecentLoad(since_s, 210.0, 210.0, pieces))
    told_W = middle_W(load.scenarios(point, STEP_S, 20))
    assert told_W == pytest.approx(np.full((20, FEW_FLIGHTS), expected_W), rel=0.06)
