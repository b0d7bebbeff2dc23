"""The scores as they are run, and what a forecast must show for them to mean anything."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import msgspec
import numpy as np
import pytest
import score
from factories import generic_pack
from scoring import data, lines, m100, m100_tables, table, truth
from scoring.peer_lines import MAH

from uavbatt.battery import battery_file
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.scaling import pack_of
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.estimator import Estimator
from uavbatt.fitting.battery import MAKE_CAPACITY_SD
from uavbatt.fitting.vehicle import fit_vehicle
from uavbatt.log_replay.run import ReplayedRow, engine_for, steps
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.load.library import UnknownAircraft, learned_load
from uavbatt.prediction.load.scenarios import ConstantLoad, Load, LoggedLoad, RecentMean
from uavbatt.records import Flight
from uavbatt.simulate import flight as simulated
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, with_effects

# --- tables ------------------------------------------------------------------------------------------------------


def test_a_table_lines_up_and_escapes() -> None:
    made = table.grid("Errors", ("60 s", "alpha"), [("ours", ("5", "1 | 2")), ("a peer", ("123", ""))], "A note.")
    text = made.text().splitlines()
    assert text[1] == "Errors" and text[-1] == "A note." and len({len(line) for line in text[2:-1]}) == 1
    page = made.markdown()
    assert "| ours | 5 | 1 \\| 2 |" in page and "|---|---:|---:|" in page and page.endswith("A note.")


def test_unknown_is_never_zero() -> None:
    assert table.figure(math.nan) == table.share(math.nan) == "–" and table.figure(math.inf) == "∞"
    assert table.with_error(12.4, math.nan, sign=True) == "+12 ± –" and table.figure(-0.2) == "0"


# --- the benchmark on flights that never flew --------------------------------------------------------------------


@cache
def benchmark() -> tuple[Any, ...]:
    """Two flights of aircraft A and one of B, a row every 12 s, flown to below 21.6 V."""
    pack = generic_pack(6, 5.45, 21.6, 22.0)
    flights = []
    for k, aircraft in enumerate("AAB"):
        rows = simulate_flight(pack, SimulatedFlight(420.0 + 20.0 * k, rate_Hz=0.5, seed=50 + k))[::6]
        flight = Flight(f"m100_{k}_{aircraft}.csv", "csv", tuple(replace(r, armed=None) for r in rows))
        flights.append(data.M100(f"m100_{k}_{aircraft}", aircraft, flight, rows[-3].time_s))
    return tuple(flights)


@cache
def results() -> dict[str, list[Any]]:
    return m100.results(list(benchmark()), lambda text: None)  # type: ignore[no-any-return]


def test_only_the_other_aircraft_teach() -> None:
    """Whatever the flights of the aircraft held out, what is learned for it stays."""
    known = m100.fold(list(benchmark()), "B")
    others = [f for f in benchmark() if f.aircraft == "A"]
    spoilt = [replace(f, flight=benchmark()[0].flight, end_s=77.0) if f.aircraft == "B" else f for f in benchmark()]
    again = m100.fold(spoilt, "B")
    assert (again.peers, again.battery) == (known.peers, known.battery)
    assert np.array_equal(again.library.power_W, known.library.power_W) and len(known.library.power_W) == len(others)


@pytest.mark.slow
def test_every_method_is_scored_on_every_flight() -> None:
    found = results()
    assert {m100.LOG, m100.LEARNED, m100.UNKNOWN, m100.RECENT, MAH, "PX4, rated", "INAV, calibrated"} <= set(found)
    assert all([r.flight.name for r in rs] == [f.name for f in benchmark()] for rs in found.values())
    late = {name: [abs(r.score.at["120 s"].error_s) for r in rs] for name, rs in found.items()}
    assert np.mean(late[m100.LOG]) < 0.3 * np.mean(late["ArduPilot mAh, rated"])  # the flights are the model's own


@pytest.mark.slow  # the whole benchmark; where the alarm lies is asked in tests/prediction/test_forecast.py
def test_the_alarm_goes_by_its_own_risk() -> None:
    for result in results()[m100.LEARNED]:
        said = result.lines
        known = np.isfinite(said.remaining_s)
        assert (said.lo_s[known] <= said.alarm_s[known]).all() and (
            said.alarm_s[known] <= said.remaining_s[known]
        ).all()
        at_median = replace(said, alarm_s=None).scored("", "", result.score.start_s, result.score.end_s)
        assert result.score.alarm_at_s >= at_median.alarm_at_s


@pytest.mark.slow
def test_the_tables_of_the_benchmark() -> None:
    made = {t.title: t for t in m100_tables.tables(results())}
    assert len(made) == 8 and all(len(row) == len(t.head) for t in made.values() for row in t.rows)
    words = " ".join(t.text() for t in made.values())
    for name in (*results(), "aircraft A", "last third", "least left", "alpha-lambda", "CRA", "± one p %", "bias"):
        assert name in words, name
    assert "nan" not in words


def test_no_data_is_said_in_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("UAVBATT_DATA", "/nowhere/at/all")
    assert score.main(["--only", "truth"]) == 1
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1 and "UAVBATT_DATA" in said.err


def test_truth_is_judged_against_the_answer() -> None:
    """An answer that is the estimate moved by 2 % of charge and ends where the flight does."""
    flight, battery = flown(), known_pack()
    run = replayed(flight, battery, logged(flight))
    time_s = np.array([s.estimate.time_s for s in run])
    soc = np.array([s.estimate.soc for s in run])
    judged = truth._judge(run, truth.Answer(time_s, soc - 0.02, 20.0, end_s(flight), 20.0))
    assert judged.soc_rmse == pytest.approx(0.02) and judged.inside == "✓✓"
    assert abs(judged.half_s) < 15.0 and judged.half_share == judged.half_s / (end_s(flight) - 20.0)


# --- what must hold of forecasts (issue C) -----------------------------------------------------------------------

OPTIONS = PackOptions(cells=4, capacity_Ah=5.0, cutoff_V=13.2)


@cache
def known_pack(capacity_scale_sd: float = 0.02) -> BatteryFile:
    """The generic cell as a fit would state it: packs of the type differ little, and the model is good."""
    generic = battery_file.read_battery("lipo-generic")
    errors = {name: 0.25 * error for name, error in generic.parameters.standard_error.items()}
    table = msgspec.structs.replace(
        generic.parameters, resistance_scale_sd=0.06, capacity_scale_sd=capacity_scale_sd, standard_error=errors
    )
    left = msgspec.structs.replace(generic.discrepancy, voltage_rmse_V=0.01)
    certificate = msgspec.structs.replace(generic.certificate, status="fitted")
    return msgspec.structs.replace(generic, parameters=table, discrepancy=left, certificate=certificate)


@cache
def flown(
    seed: int = 1, power_W: float = 280.0, effect: str = "", value: float = 0.0, ambient_C: float = 20.0
) -> Flight:
    pack = pack_of(known_pack(), 4, 5.0, 13.2, 14.0)
    pack = with_effects(pack, {effect: value} if effect else {})
    return Flight(
        "flown", "csv", tuple(simulate_flight(pack, SimulatedFlight(power_W, ambient_C, rate_Hz=0.5, seed=seed)))
    )


def end_s(flight: Flight) -> float:
    rows = flight.samples
    return float(data.end_of_flight([s.time_s for s in rows], [s.voltage_V for s in rows], cutoff_V=13.2))


def logged(flight: Flight) -> LoggedLoad:
    return lines.logged(flight)  # type: ignore[no-any-return]


def replayed(flight: Flight, battery: BatteryFile, load: Load) -> list[ReplayedRow]:
    """The flight as a fleet flies it: compiled, to 1e-9 the same (tests/compiled)."""
    settings = ForecastSettings(load, forecast_period_s=20.0)
    return list(steps(flight, Estimator(battery, OPTIONS, settings, engine_for(is_long=True))))


def at(run: list[ReplayedRow], flight: Flight, share: float) -> ReplayedRow:
    """The line in force when this share of the flight is over."""
    time_s = 20.0 + share * (end_s(flight) - 20.0)
    return [s for s in run if s.estimate.time_s <= time_s][-1]


def width_s(step: ReplayedRow) -> float:
    return step.remaining.remaining_hi_s - step.remaining.remaining_lo_s


def error_s(step: ReplayedRow, flight: Flight) -> float:
    return step.remaining.remaining_s - (end_s(flight) - step.estimate.time_s)


@pytest.mark.slow
def test_a_library_that_scatters_widens() -> None:
    """Past flights whose mean powers scatter by 25 % instead of 5 %: a fifth wider, beside what the pack scatters."""
    spread = (-1.3, -0.7, -0.4, -0.1, 0.1, 0.4, 0.7, 1.3)
    widths = {}
    for scatter in (0.05, 0.25):
        past = [flown(30 + k, 280.0 * math.exp(scatter * z)) for k, z in enumerate(spread)]
        load = learned_load(fit_vehicle("quad", past, known_pack(), OPTIONS))
        run = replayed(flown(), known_pack(), load)
        widths[scatter] = [width_s(at(run, flown(), share)) for share in (0.3, 0.5)]
    assert np.mean(widths[0.25]) > 1.2 * np.mean(widths[0.05])


def test_gusts_of_this_flight_widen_the_recent_load(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gusts of 25 % instead of 5 %, from half-way on, when the flight has shown them."""
    widths = {}
    for gust in (0.05, 0.25):
        monkeypatch.setattr(simulated, "GUST_SD", gust)
        flights = [flown.__wrapped__(seed) for seed in (1, 2, 3)]
        runs = [replayed(f, known_pack(), RecentMean()) for f in flights]
        widths[gust] = [width_s(at(r, f, share)) for r, f in zip(runs, flights, strict=True) for share in (0.5, 0.7)]
    assert np.mean(widths[0.25]) > 1.35 * np.mean(widths[0.05])


def test_a_fitted_file_is_narrower_than_a_generic_one() -> None:
    own, generic = (
        replayed(flown(), b, logged(flown())) for b in (known_pack(), battery_file.read_battery("lipo-generic"))
    )
    for share in (0.1, 0.3, 0.5, 0.7, 0.9):
        assert width_s(at(own, flown(), share)) < 0.8 * width_s(at(generic, flown(), share))
        assert abs(error_s(at(own, flown(), share), flown())) < 15.0


def warns_of_wear(step: ReplayedRow) -> bool:
    return any("more resistance than its type" in w for w in step.estimate.warnings)


def test_an_aged_pack_is_noticed_within_the_flight() -> None:
    """True capacity 85 %: a file that allows for worn packs beats one that takes every pack for new, and says so."""
    aged = flown(1, 280.0, "capacity_fade", 0.15)
    run, unaware = (replayed(aged, known_pack(sd), logged(aged)) for sd in (0.08, 0.001))
    early, half, late = (at(run, aged, share) for share in (0.05, 0.5, 0.9))
    assert 1.0 > early.estimate.capacity_scale > half.estimate.capacity_scale > late.estimate.capacity_scale
    assert 0.85 < late.estimate.capacity_scale < 0.93
    for share, most in ((0.05, 0.8), (0.5, 0.8), (0.9, 0.8)):  # both expect some wear of a pack that nobody measured
        assert 0.0 < error_s(at(run, aged, share), aged) < most * error_s(at(unaware, aged, share), aged)
    assert warns_of_wear(half) and warns_of_wear(late)
    for step in (half, late):
        assert step.remaining.remaining_lo_s <= end_s(aged) - step.estimate.time_s <= step.remaining.remaining_hi_s


def test_a_new_pack_is_not_taken_for_an_aged_one() -> None:
    run = replayed(flown(), known_pack(MAKE_CAPACITY_SD), logged(flown()))
    scales = [s.estimate.capacity_scale for s in run if s.estimate.time_s > 60.0]
    assert min(scales) > 0.96 and max(scales) < 1.04
    assert not any(warns_of_wear(s) for s in run)
    assert all(abs(error_s(at(run, flown(), share), flown())) < 20.0 for share in (0.1, 0.5, 0.9))


def test_without_a_current_sensor_the_interval_is_wide_and_holds() -> None:
    """The same flight without its current: a load is assumed, doubted, and never shown as measured."""
    blind = replace(flown(), samples=tuple(replace(s, current_A=math.nan) for s in flown().samples))
    run, metered = (replayed(f, known_pack(), UnknownAircraft()) for f in (blind, flown()))
    for share in (0.3, 0.6, 0.9):
        step, left_s = at(run, flown(), share), end_s(flown()) - at(run, flown(), share).estimate.time_s
        assert step.remaining.remaining_lo_s <= left_s <= step.remaining.remaining_hi_s
        assert step.estimate.soc_sd > 3.0 * at(metered, flown(), share).estimate.soc_sd
        assert math.isnan(step.estimate.current_A) and math.isnan(step.estimate.power_W)
        assert any("no current sensor" in w for w in step.estimate.warnings) and not warns_of_wear(step)
    late = replace(blind, samples=blind.samples[:100] + flown().samples[100:])
    found = replayed(late, known_pack(), UnknownAircraft())[-1].estimate
    assert math.isfinite(found.current_A) and not any("no current sensor" in w for w in found.warnings)


def test_it_is_not_charge_counting_in_disguise() -> None:
    """Three flights that have drawn 2 Ah, the same load to come: cold and worn packs get less time than warm ones.

    In truth it is 494 s, and 384 s both for the cold pack and for the worn one.
    """
    said = []
    for effect, value, ambient_C in (("", 0.0, 25.0), ("", 0.0, 0.0), ("resistance_growth", 0.6, 25.0)):
        flight = flown(1, 280.0, effect, value, ambient_C)
        run = replayed(flight, known_pack(), ConstantLoad(280.0, 0.04))
        drawn_Ah = np.cumsum([s.current_A for s in flight.samples]) * 2.0 / 3600.0
        said.append(run[int(np.argmax(drawn_Ah > 2.0))].remaining.remaining_s)
    assert said[1] < 0.95 * said[0] and said[2] < 0.95 * said[0]
