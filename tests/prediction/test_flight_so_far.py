"""When the aircraft flies, by its load and what is known beside it, and what of the past belongs to the flight."""

from __future__ import annotations

import math

import pytest

from uavbatt.navigation import NOWHERE, Navigation, Position
from uavbatt.prediction.load.flight_so_far import FlightSoFar
from uavbatt.records import Sample

CAPACITY_AH, VOLTS = 5.0, 16.0


def after(
    past: FlightSoFar, seconds: int, watts: float, armed: bool | None, is_aloft: bool | None = None
) -> FlightSoFar:
    """The past after so many seconds of a power, a row a second."""
    begin_s = past.time_s + 1.0 if math.isfinite(past.time_s) else 0.0
    for k in range(seconds):
        amps = watts / VOLTS
        past = past.after(Sample(begin_s + k, VOLTS, amps, armed=armed), watts, amps / CAPACITY_AH, is_aloft)
    return past


def is_flying(past: FlightSoFar) -> bool:
    return math.isfinite(past.flying_since_s)


def test_a_payload_on_the_ground_is_no_flight_and_does_not_count_for_the_next() -> None:
    """40 W, half a C, for ten minutes before the take-off."""
    ground = after(FlightSoFar(), 600, 40.0, armed=False)
    assert not is_flying(ground)
    begun = after(ground, 5, 300.0, armed=True)
    assert is_flying(begun) and begun.mean_W > 250.0


@pytest.mark.parametrize("armed", [None, False])
def test_a_load_that_must_fly_is_a_flight_whatever_the_flag_says(armed: bool | None) -> None:
    assert is_flying(after(FlightSoFar(), 20, 300.0, armed))


def test_an_aeroplane_of_long_endurance_flies_once_it_has_been_armed_for_a_minute() -> None:
    """A third of a C: 26 W of 5 Ah."""
    assert not is_flying(after(FlightSoFar(), 30, 26.0, armed=True))
    assert is_flying(after(FlightSoFar(), 90, 26.0, armed=True))
    assert not is_flying(after(FlightSoFar(), 90, 26.0, armed=None))


@pytest.mark.parametrize("armed", [True, None])
@pytest.mark.parametrize(("watts", "hover_W"), [(26.0, 300.0), (40.0, 300.0), (64.0, 420.0), (110.0, 720.0)])
def test_waiting_on_the_ground_is_no_part_of_the_flight(watts: float, hover_W: float, armed: bool | None) -> None:
    """A third of a C to more than one for a quarter of an hour, with heaters and radios, then a hover."""
    told = after(FlightSoFar(), 900, watts, armed=armed, is_aloft=False)
    assert not is_flying(told)
    assert after(told, 20, hover_W, armed=armed, is_aloft=True).mean_W > 250.0 / 300.0 * hover_W
    untold = after(after(FlightSoFar(), 900, watts, armed=armed), 20, hover_W, armed=armed)
    assert is_flying(untold) and untold.mean_W > 250.0 / 300.0 * hover_W


def test_an_aeroplane_that_cruises_long_before_it_climbs_is_no_new_flight() -> None:
    """Without a position: 1 C in the cruise, and four times that in the climb."""
    cruising = after(FlightSoFar(), 900, 80.0, armed=True)
    assert after(cruising, 20, 320.0, armed=True).mean_W < 100.0


def test_a_burst_in_the_first_minutes_is_no_new_flight() -> None:
    """A racer: each burst was taken for the take-off, and the charge of the take-off with it."""
    past = after(FlightSoFar(), 20, 100.0, armed=True)
    for _ in range(10):
        past = after(after(past, 5, 800.0, armed=True), 10, 50.0, armed=True)
    assert past.took_off_s < 30.0 and past.mean_W == pytest.approx(300.0, rel=0.1)


def test_an_aeroplane_that_climbs_is_no_new_flight() -> None:
    cruising = after(FlightSoFar(), 900, 40.0, armed=True, is_aloft=True)
    assert after(cruising, 20, 300.0, armed=True, is_aloft=True).mean_W < 60.0


def test_what_the_autopilot_calls_landed_flies_with_a_load_that_must_fly() -> None:
    assert is_flying(after(FlightSoFar(), 20, 300.0, armed=True, is_aloft=False))


def test_what_is_high_or_fast_flies_and_a_glide_of_minutes_is_no_landing() -> None:
    aloft = after(FlightSoFar(), 30, 12.0, armed=True, is_aloft=True)
    assert is_flying(aloft)
    assert is_flying(after(aloft, 300, 0.0, armed=True, is_aloft=True))
    assert is_flying(after(aloft, 300, 0.0, armed=True))  # without a position an armed aircraft may glide
    assert not is_flying(after(aloft, 1000, 0.0, armed=True))
    assert not is_flying(after(aloft, 300, 0.0, armed=True, is_aloft=False))
    assert not is_flying(after(aloft, 300, 0.0, armed=None, is_aloft=False))
    assert not is_flying(after(aloft, 10, 0.0, armed=False))


def test_where_it_is_says_that_it_flies() -> None:
    def at(height_m: float, north_ms: float) -> Navigation:
        return Navigation(position=Position(100.0, 0.0, 0.0, height_m, north_ms, 0.0, 0.0))

    assert at(30.0, 0.0).is_aloft(101.0) and at(0.0, 12.0).is_aloft(101.0)
    assert not at(1.0, 1.0).is_aloft(101.0)
    assert not at(30.0, 0.0).is_aloft(200.0)  # long ago
    assert not NOWHERE.is_aloft(0.0)
    assert Navigation(landed=False).is_aloft(0.0) and not Navigation(landed=True).is_aloft(0.0)


@pytest.mark.parametrize("rows", [1, 3])
def test_a_flag_that_is_wrong_for_a_moment_under_full_load_begins_no_flight(rows: int) -> None:
    """One damaged heartbeat took the learned load away: the time left leapt by half, and for minutes."""
    flown = after(FlightSoFar(), 300, 300.0, armed=True)
    flapped = after(after(flown, rows, 300.0, armed=False), 5, 300.0, armed=True)
    assert flapped.took_off_s == flown.took_off_s and flapped.flown_s == flown.flown_s + rows + 5
    assert flapped.load.history == after(flown, rows + 5, 300.0, armed=True).load.history


def test_a_past_on_another_clock_goes_on_as_it_would_have() -> None:
    """The vehicle's clock was set in flight: everything that has a time moves with it."""
    past = after(after(FlightSoFar(), 60, 300.0, armed=True), 10, 40.0, armed=True)
    there = after(past.moved(5000.0), 200, 280.0, armed=True)
    here = after(past, 200, 280.0, armed=True).moved(5000.0)
    assert there[1:] == pytest.approx(here[1:])
    assert there.load[:3] == pytest.approx(here.load[:3])
    assert there.load.history == here.load.history


@pytest.mark.parametrize("row_s", [0.2, 1.0, 2.5])
def test_the_distance_of_the_rows_is_learned_from_them(row_s: float) -> None:
    past = FlightSoFar()
    for k in range(60):
        past = past.after(Sample(k * row_s, VOLTS, 20.0, armed=True), 320.0, 4.0)
    assert past.row_s == pytest.approx(row_s)
    assert past.rate_c == pytest.approx(4.0)
    assert past.after(Sample(60 * row_s + 500.0, VOLTS, 20.0, armed=True), 320.0, 4.0).row_s == past.row_s  # a gap
