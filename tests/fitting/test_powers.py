"""The powers of a vehicle: theory where nothing is known, found again from flights that were flown with them."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import accumulate

import msgspec
import numpy as np
import pytest
from route_rig import HOME

from uavbatt.battery.powers import (
    GRAVITY_MS2,
    TURN_S,
    UNKNOWN,
    Powers,
    induced_ratio,
    level_of,
    power,
    terms,
    turning_power,
)
from uavbatt.battery.vehicle_file import Speeds
from uavbatt.fitting.powers import FAST_SD, powers
from uavbatt.fitting.vehicle import speeds
from uavbatt.navigation import METRES_PER_DEGREE, Mode, Navigation, Position, ReturnSettings
from uavbatt.records import Flight, Sample

TRUE = msgspec.structs.replace(UNKNOWN, hover_W=250.0, induced=0.45, drag=0.2, climb=0.07, fast_climb=0.08, flights=4)


def asked_W(of: Powers, airspeed_ms: float, climb_ms: float, level: float = 1.0) -> float:
    return float(power(of, terms(airspeed_ms, climb_ms, 0.0, 0.0, of.induced_ms), level))


def seen(second: int, north_m: float, speed_ms: float, climb_ms: float = 0.0) -> Navigation:
    """What is known of a pilot's aircraft that flies to the north."""
    lat_deg = HOME.lat_deg + north_m / METRES_PER_DEGREE
    here = Position(float(second), lat_deg, HOME.lon_deg, 50.0, speed_ms, 0.0, climb_ms)
    return Navigation(time_s=float(second), mode=Mode.MANUAL, home=HOME, position=here)


def flight(level: float = 1.0) -> Flight:
    """A pilot's flight through every speed and climb, each held for half a minute."""
    held = [(v, c) for v in (0.0, 4.0, 8.0, 12.0, 15.0) for c in (-1.5, 0.0, 2.0)]
    samples, known = [], []
    for k in range(30 * len(held)):
        speed_ms, climb_ms = held[k // 30]
        watts = asked_W(TRUE, speed_ms, climb_ms, level)
        samples.append(Sample(float(k), 15.0, watts / 15.0))
        known.append(seen(k, sum(v for v, _ in held[: k // 30]) * 30.0 + speed_ms * (k % 30), speed_ms, climb_ms))
    return Flight("flown", "test", tuple(samples), navigation=tuple(known))


def flown_at(speed_ms: float, seconds: int, scale: float) -> list[tuple[float, float]]:
    """Speed [m/s] and power [W] of each second, `scale` times what TRUE asks."""
    return [(speed_ms, scale * asked_W(TRUE, speed_ms, 0.0))] * seconds


def joined(*parts: list[tuple[float, float]]) -> Flight:
    rows = [row for part in parts for row in part]
    samples = tuple(Sample(float(k), 15.0, watts / 15.0) for k, (_, watts) in enumerate(rows))
    run_m = accumulate(speed_ms for speed_ms, _ in rows)
    known = tuple(seen(k, north_m, row[0]) for k, (row, north_m) in enumerate(zip(rows, run_m, strict=True)))
    return Flight("flown", "test", samples, navigation=known)


def test_induced_velocity_is_one_in_hover_and_falls_as_momentum_theory_says() -> None:
    assert induced_ratio(0.0, 5.0) == pytest.approx(1.0)
    ratio = float(induced_ratio(10.0, 5.0))
    assert ratio**4 + ratio**2 * (10.0 / 5.0) ** 2 == pytest.approx(1.0)
    assert float(induced_ratio(50.0, 5.0)) == pytest.approx(5.0 / 50.0, rel=0.01)  # v_h² / v in fast flight


def test_an_unknown_aircraft_asks_more_in_a_climb_and_least_in_between() -> None:
    hover, middling, fast = (asked_W(UNKNOWN, v, 0.0) for v in (0.0, 8.0, 18.0))
    assert middling < hover < fast
    assert asked_W(UNKNOWN, 8.0, -1.5) < middling < asked_W(UNKNOWN, 8.0, 2.0)


def test_a_turn_asks_for_the_kinetic_energy_with_the_efficiency_of_the_hover() -> None:
    """It was asked for with the induced power alone, which leaves out what the rotors lose: half of it was missing."""
    quad, efficiency = msgspec.structs.replace(UNKNOWN, hover_W=TRUE.hover_W), 0.6
    mass_kg = efficiency * TRUE.hover_W / (GRAVITY_MS2 * UNKNOWN.induced_ms)
    flown_W = np.array(asked_W(quad, 12.0, 0.0))
    steady_W = 0.5 * (TRUE.hover_W + flown_W)
    gained_J = (float(turning_power(quad, flown_W, 12.0)) - steady_W) * TURN_S
    assert gained_J * efficiency == pytest.approx(0.5 * mass_kg * 12.0**2)


def test_a_payload_is_lifted_and_the_air_does_not_see_it() -> None:
    """The level of a hover was taken for that of fast flight: of an empty aircraft 4 % too little at 15 m/s."""
    drag_W = TRUE.hover_W * TRUE.drag * 1.5**3
    light_W, heavy_W = (asked_W(TRUE, 15.0, 0.0, level) for level in (0.9, 1.1))
    assert (heavy_W - drag_W) / (light_W - drag_W) == pytest.approx(1.1 / 0.9)
    assert level_of(TRUE, terms(15.0, 0.0, 0.0, 0.0, TRUE.induced_ms), heavy_W) == pytest.approx(1.1)


def test_an_aircraft_that_nobody_knows_is_as_heavy_as_its_power() -> None:
    fast_W = 200.0 * asked_W(UNKNOWN, 15.0, 0.0)
    assert asked_W(UNKNOWN, 15.0, 0.0, level=200.0) == pytest.approx(fast_W)
    assert level_of(UNKNOWN, terms(15.0, 0.0, 0.0, 0.0, UNKNOWN.induced_ms), fast_W) == pytest.approx(200.0)


def test_a_loaded_flight_teaches_the_fast_flight_of_an_empty_one() -> None:
    def flown(level: float, *speeds_ms: float) -> Flight:
        return joined(*([(v, asked_W(TRUE, v, 0.0, level))] * 300 for v in speeds_ms))

    found = powers([flown(1.3, 0.0, 4.0, 8.0, 12.0, 15.0), flown(0.8, 0.0, 4.0, 8.0)] * 3)
    assert found is not None
    empty = 0.8 * TRUE.hover_W / found.hover_W
    assert asked_W(found, 15.0, 0.0, empty) == pytest.approx(asked_W(TRUE, 15.0, 0.0, 0.8), rel=0.03)  # 22 % before


def test_a_minute_of_fast_flight_is_heard_beside_an_hour_of_slow_flight() -> None:
    """The slow rows bend in a way that the shape cannot; the power at 15 m/s must not pay for it."""
    slow = [flown_at(speed_ms, 900, bent) for speed_ms, bent in ((4.0, 1.0), (6.0, 1.0), (8.0, 1.03), (10.0, 0.97))]
    found = powers([joined(*slow, flown_at(15.0, 60, 1.1))] * 2)
    assert found is not None
    true = 1.1 * asked_W(TRUE, 15.0, 0.0) / asked_W(TRUE, 6.0, 0.0)
    assert asked_W(found, 15.0, 0.0) / asked_W(found, 6.0, 0.0) == pytest.approx(true, rel=0.02)


def test_powers_are_found_again_from_flights_with_speed_and_climb() -> None:
    found = powers([flight(), flight(1.1)])
    assert found is not None
    assert found.flights == 2
    for speed_ms in (0.0, 4.0, 8.0, 12.0, 15.0):
        for climb_ms in (-1.5, 0.0, 2.0):
            true_W = 1.05 * asked_W(TRUE, speed_ms, climb_ms)
            assert asked_W(found, speed_ms, climb_ms) == pytest.approx(true_W, rel=0.04)


def test_a_payload_widens_the_level_and_does_not_bend_the_shape() -> None:
    alone, loaded = powers([flight()] * 3), powers([flight(), flight(1.15), flight(0.85)])
    assert alone is not None and loaded is not None
    assert loaded.level_sd > alone.level_sd + 0.02
    assert np.allclose(loaded.shares, alone.shares, atol=0.02)


def test_flights_without_speed_tell_no_powers() -> None:
    silent = replace(flight(), navigation=())
    assert powers([silent]) is None
    assert math.isfinite(silent.samples[0].voltage_V)


def test_the_vehicle_file_keeps_the_speeds_that_the_parameters_say() -> None:
    known = replace(flight().navigation[-1], time_s=1e3, settings=ReturnSettings(cruise_ms=7.5, return_height_m=0.0))
    found = speeds([flight(), replace(flight(), navigation=(*flight().navigation, known))])
    assert found == Speeds(cruise_ms=7.5, return_height_m=0.0)
    assert speeds([flight()]) is None


def test_the_fit_says_up_to_which_airspeed_it_has_learned() -> None:
    found = powers([flight()])
    assert found is not None and found.fastest_ms == pytest.approx(15.0, abs=0.2)
    slow = powers([joined(flown_at(0.0, 200, 1.0), flown_at(5.0, 200, 1.0))])
    assert slow is not None and slow.fastest_ms == 10.0  # up to which other aircraft tell the law


def test_fast_flight_that_many_flights_have_shown_is_known_better_than_one_that_none_has() -> None:
    """The spread of an aircraft that nobody knows was given to eight flights with 1 % between them."""
    shown, unshown = powers([flight()] * 8), powers([joined(flown_at(0.0, 300, 1.0), flown_at(5.0, 300, 1.0))] * 8)
    assert shown is not None and unshown is not None
    assert shown.fast_sd < 0.05 < unshown.fast_sd < UNKNOWN.fast_sd


def test_twenty_seconds_of_fast_flight_do_not_show_how_flights_differ_in_it_and_a_minute_does() -> None:
    """The noise of the power lasts for some seconds: so short a part has no mean of its own."""
    brief, long = (powers([joined(flown_at(0.0, 300, 1.0), flown_at(15.0, seconds, 1.0))] * 8) for seconds in (20, 60))
    assert brief is not None and long is not None
    assert long.fast_sd < 0.06 < FAST_SD < brief.fast_sd


def test_flights_that_hardly_overlap_in_speed_teach_one_shape() -> None:
    """Solved in turns, the hover power of each flight took up a part of the shape: fast flight was 7 % off."""
    light = msgspec.structs.replace(TRUE, induced_ms=6.0, induced=0.8, drag=0.08)

    def at(*speeds_ms: float) -> Flight:
        return joined(*([(v, asked_W(light, v, 0.0))] * 540 for v in speeds_ms))

    found = powers([at(0.0, 2.0), at(4.0, 5.0), at(8.0, 10.0), at(11.0, 13.0)])
    assert found is not None
    for v in (0.0, 4.0, 8.0, 12.0, 14.0):
        assert asked_W(found, v, 0.0) == pytest.approx(asked_W(light, v, 0.0), rel=0.02)
