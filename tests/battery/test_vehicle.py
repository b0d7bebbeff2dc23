"""Vehicle files: round trip, what is learned from a flight, and every bad file named in one line."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest
import tomli_w
from factories import generic_pack
from msgspec.structs import replace as replace_struct
from typer.testing import CliRunner

from uavbatt.battery import battery_file
from uavbatt.battery import vehicle_file as vehicle
from uavbatt.battery.powers import Powers
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.battery.vehicle_file import Speeds, VehicleFile
from uavbatt.cli.app import app
from uavbatt.errors import BadInput, NotEnoughData, UavbattError
from uavbatt.estimator import Estimator
from uavbatt.fitting.vehicle import GRID_S, fit_vehicle, other_powers, speeds, trace
from uavbatt.log_replay.load_options import stated_load
from uavbatt.log_replay.run import engine_for
from uavbatt.navigation import Navigation, ReturnSettings
from uavbatt.prediction.load.library import LearnedLoad
from uavbatt.records import Flight, Sample
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, write_log
from uavbatt.telemetry.join import Wiring, joined

OPTIONS = PackOptions(cells=4, capacity_Ah=5.0, cutoff_V=13.2)
POWER_W = 700.0  # a flight of five minutes


@cache
def flight(seed: int = 1) -> Flight:
    pack = generic_pack()
    return Flight(
        f"flight {seed}", "csv", tuple(simulate_flight(pack, SimulatedFlight(POWER_W, rate_Hz=1.0, seed=seed)))
    )


@cache
def learned() -> VehicleFile:
    return fit_vehicle("quad", [flight(seed) for seed in (1, 2, 3)], battery_file.read_battery("lipo-generic"), OPTIONS)


# --- what is learned ---------------------------------------------------------------------------------------------


def test_round_trip(tmp_path: Path) -> None:
    path = vehicle.write_vehicle(learned(), tmp_path / "quad.vehicle.toml")
    assert vehicle.read_vehicle(path) == learned()
    assert path.stat().st_size < 30_000 and list(tmp_path.iterdir()) == [path]


def test_a_file_of_two_joined_batteries_gives_each_its_half(tmp_path: Path) -> None:
    """In flight every battery is estimated by itself: with the powers of both the way home took twice its charge."""
    single, battery = flight(), battery_file.read_battery("lipo-generic")
    both = joined([replace(single, instance=k, instances=(0, 1)) for k in (0, 1)], Wiring.PARALLEL)
    file = fit_vehicle("twin", [both], battery, replace(OPTIONS, capacity_Ah=10.0))
    assert vehicle.read_vehicle(vehicle.write_vehicle(file, tmp_path / "twin.vehicle.toml")).batteries == 2
    assert file.phases.flight_W == pytest.approx(2.0 * POWER_W, rel=0.06)
    for flown, watts in ((single, POWER_W), (both, 2.0 * POWER_W)):
        load = stated_load("learned", flown, file)
        assert isinstance(load, LearnedLoad)
        assert load.mean_W[0, 100] == pytest.approx(watts, rel=0.06)
    powers = Powers(hover_W=1400.0)
    assert replace_struct(file, powers=powers).of_batteries(1).powers == replace_struct(powers, hover_W=700.0)


def test_a_trace_is_the_flight_from_take_off() -> None:
    rows = [s for s in flight().samples if s.time_s >= 20.0]  # idle before
    assert len(learned().traces) == 3 and learned().source == "3 flights"
    first = learned().traces[0]
    assert first.time_s[0] == 0.0 and set(np.diff(first.time_s)) == {GRID_S}
    assert first.time_s[-1] == pytest.approx(rows[-1].time_s - 20.0, abs=GRID_S + 2.0)
    energy_J = sum(s.voltage_V * s.current_A for s in rows)
    assert np.sum(first.power_W) * GRID_S == pytest.approx(energy_J, rel=0.02)
    assert first.soc[0] > 0.97 and all(b < a + 1e-3 for a, b in pairwise(first.soc)) and first.soc[-1] < 0.2


def test_phases_are_means() -> None:
    phases = learned().phases
    assert phases.flight_W == pytest.approx(POWER_W, rel=0.06)
    assert phases.take_off_W == pytest.approx(POWER_W, rel=0.25)
    assert phases.last_minute_W == pytest.approx(POWER_W, rel=0.25)


def of_power(source: str, share: float) -> Flight:
    rows = tuple(replace(sample, current_A=share * sample.current_A) for sample in flight().samples)
    return replace(flight(), source=source, samples=rows)


@pytest.mark.parametrize(("share", "is_named"), [(0.5, True), (0.75, False), (1.4, False), (2.0, True)])
def test_a_flight_of_another_power_is_named(share: float, is_named: bool) -> None:
    """A log of another aircraft, or with half of the current, made the hover power of a fleet 8 to 13 % wrong."""
    flights = [of_power(name, 1.0) for name in "abc"] + [of_power("odd", share)]
    assert [one.source for one in other_powers(flights)] == ["odd"] * is_named


def test_two_flights_do_not_tell_which_of_them_is_odd() -> None:
    assert list(other_powers([of_power("a", 1.0), of_power("b", 2.0)])) == []


def test_coarse_rows_teach_the_same_energy() -> None:
    """A row every 12 s: the mean power is that of its rows, and the grid stays."""
    rows = flight().samples[20::12]
    coarse = trace(Flight("coarse", "csv", rows), battery_file.read_battery("lipo-generic"), OPTIONS)
    assert coarse is not None and set(np.diff(coarse.time_s)) == {GRID_S}
    mean_W = np.mean([s.voltage_V * s.current_A for s in rows])
    assert np.mean(coarse.power_W) == pytest.approx(mean_W, rel=0.03)


def test_the_progress_of_a_fit_adds_up_to_all_of_it() -> None:
    shares: list[float] = []
    battery = battery_file.read_battery("lipo-generic")
    fit_vehicle("quad", [flight(1), flight(2), flight(3)], battery, OPTIONS, progress=shares.append)
    assert len(shares) == 3 and sum(shares) == pytest.approx(1.0)


@pytest.mark.parametrize("is_long", [False, True])
def test_the_charge_of_a_trace_is_that_of_the_estimates_in_flight(is_long: bool) -> None:
    """Row by row as in flight, and many rows at once, plain or compiled: one charge."""
    battery = battery_file.read_battery("lipo-generic")
    estimator = Estimator(battery, OPTIONS)
    rows = [estimator.step(sample)[0] for sample in flight().samples]
    found = trace(flight(), battery, OPTIONS, engine_for(is_long=is_long))
    assert found is not None
    begins_s = next(row.time_s for row in rows if row.power_W > 0.6 * POWER_W)
    told = np.interp(np.array(found.time_s) + begins_s, [r.time_s for r in rows], [r.soc for r in rows])
    assert np.array(found.soc) == pytest.approx(told, abs=1e-4)


def test_the_landing_is_not_flight() -> None:
    """Idle rows after the flight, as before it, are no part of the trace."""
    last = flight().samples[-1]
    ground = tuple(Sample(last.time_s + t, 14.5, 0.6, armed=False) for t in range(1, 300))
    longer = trace(
        Flight("landed", "csv", flight().samples + ground), battery_file.read_battery("lipo-generic"), OPTIONS
    )
    assert longer is not None
    assert longer.time_s[-1] == pytest.approx(learned().traces[0].time_s[-1], abs=GRID_S)


def test_the_last_descent_is_not_flight_and_a_slower_leg_is() -> None:
    """A minute at two fifths of the usual power ends the trace before it; at four fifths it belongs to the flight."""
    last = flight().samples[-1]

    def length_s(share: float) -> float:
        leg = tuple(Sample(last.time_s + t, 14.0, share * POWER_W / 14.0) for t in range(1, 61))
        longer = trace(Flight("f", "csv", flight().samples + leg), battery_file.read_battery("lipo-generic"), OPTIONS)
        assert longer is not None
        return longer.time_s[-1] - learned().traces[0].time_s[-1]

    assert length_s(0.4) == pytest.approx(0.0, abs=GRID_S)
    assert length_s(0.8) == pytest.approx(60.0, abs=GRID_S)


def test_the_ground_between_two_flights_of_a_log_is_not_flight() -> None:
    """Its minutes without power stood in the trace as load to come, and the time left jumped from 644 s to 21 s."""
    half = len(flight().samples) // 2
    first, second = flight().samples[:half], flight().samples[half:]
    landed_s = first[-1].time_s
    ground = tuple(Sample(landed_s + t, 15.5, 0.3, armed=False) for t in range(1, 200))
    later = tuple(replace(s, time_s=s.time_s + 199.0) for s in second)
    hops = trace(Flight("hops", "csv", first + ground + later), battery_file.read_battery("lipo-generic"), OPTIONS)
    whole = learned().traces[0]
    assert hops is not None
    assert len(hops.time_s) == pytest.approx(len(whole.time_s), abs=1)
    assert min(hops.power_W[1:-1]) > 0.7 * min(whole.power_W[1:-1])


def test_too_short_to_learn_from() -> None:
    short = Flight("hop", "csv", flight().samples[:100])
    assert trace(short, battery_file.read_battery("lipo-generic"), OPTIONS) is None
    with pytest.raises(NotEnoughData, match="quad: 1 log, none of which holds 120 s") as caught:
        fit_vehicle("quad", [short], battery_file.read_battery("lipo-generic"), OPTIONS)
    assert caught.value.exit_code == 4
    both = fit_vehicle("quad", [short, flight()], battery_file.read_battery("lipo-generic"), OPTIONS)
    assert len(both.traces) == 1


@pytest.mark.parametrize("amps", [0.0, 0.2])
def test_a_pack_at_rest_did_not_fly(amps: float) -> None:
    """A log of a bench became an aircraft of 3 W."""
    idle = Flight("bench", "csv", tuple(Sample(float(t), 16.0, amps, armed=True) for t in range(300)))
    assert trace(idle, battery_file.read_battery("lipo-generic"), OPTIONS) is None
    with pytest.raises(NotEnoughData, match="1 log, none of which"):
        fit_vehicle("quad", [idle], battery_file.read_battery("lipo-generic"), OPTIONS)


def test_a_speed_that_no_vehicle_file_may_hold_is_not_learned() -> None:
    settings = ReturnSettings(cruise_ms=1000.0, climb_ms=3.0, return_height_m=50_000.0, return_hold_s=0.0)
    stated = Flight("stated", "csv", flight().samples, navigation=(Navigation(time_s=0.0, settings=settings),))
    assert speeds([stated]) == Speeds(climb_ms=3.0)


# --- bad files ---------------------------------------------------------------------------------------------------


def content() -> dict[str, object]:
    return {
        "name": "quad",
        "battery": "lipo-generic",
        "phases": {"take_off_W": 300.0, "flight_W": 300.0, "last_minute_W": 300.0},
        "traces": [{"time_s": [0.0, 10.0, 20.0], "power_W": [300.0, 310.0, 290.0], "soc": [1.0, 0.99, 0.98]}],
    }


def with_trace(**changed: list[float]) -> dict[str, object]:
    one: dict[str, object] = {"time_s": [0.0, 10.0, 20.0], "power_W": [300.0] * 3, "soc": [1.0, 0.9, 0.8]}
    return {**content(), "traces": [{**one, **changed}]}


BAD = [
    ({**content(), "traces": []}, "at least one past flight"),
    ({**content(), "surprise": 1}, "surprise"),
    ({k: v for k, v in content().items() if k != "phases"}, "phases"),
    ({**content(), "name": 7}, "name"),
    (with_trace(soc=[1.0, 0.9]), "traces[0]"),
    (with_trace(time_s=[0.0], power_W=[300.0], soc=[1.0]), "traces[0]"),
    (with_trace(time_s=[0.0, 20.0, 10.0]), "traces[0].time_s"),
    (with_trace(time_s=[0.0, 0.0, 10.0]), "ascending"),
    (with_trace(power_W=[300.0, -1.0, 300.0]), "traces[0].power_W"),
    (with_trace(power_W=[0.0, 0.0, 0.0]), "powers of a flight"),
]


@pytest.mark.parametrize(("bad", "words"), BAD)
def test_a_bad_file_is_named_in_one_line(bad: dict[str, object], words: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.vehicle.toml"
    path.write_text(tomli_w.dumps(bad))
    assert_refused(path, words)


@pytest.mark.parametrize(("bad", "words"), [BAD[0], BAD[4], BAD[9]])
def test_what_would_be_refused_is_not_written(bad: dict[str, object], words: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=re.escape(words)):
        vehicle.write_vehicle(msgspec.convert(bad, VehicleFile), tmp_path / "bad.vehicle.toml")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_made(tmp_path: Path) -> None:
    path = vehicle.write_vehicle(msgspec.convert(content(), VehicleFile), tmp_path / "new" / "quad.vehicle.toml")
    assert vehicle.read_vehicle(path).name == "quad"


@pytest.mark.parametrize("raw", [b"", b"name = ", b"\xff\xfe\x00", b"[traces]\n", b"\x00" * 100])
def test_what_is_no_toml_is_named_in_one_line(raw: bytes, tmp_path: Path) -> None:
    path = tmp_path / "bad.vehicle.toml"
    path.write_bytes(raw)
    assert_refused(path, "vehicle file")


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    assert_refused(tmp_path / "none.vehicle.toml", "found no file of this name")
    assert_refused(tmp_path, "a directory")


def assert_refused(path: Path, words: str) -> None:
    with pytest.raises(BadInput) as caught:
        vehicle.read_vehicle(path)
    said = str(caught.value)
    assert said.startswith(str(path)) and words in said and "\n" not in said and caught.value.exit_code == 1


# --- the command -------------------------------------------------------------------------------------------------


def test_fit_learns_a_vehicle_and_replay_takes_it(tmp_path: Path) -> None:
    pack = generic_pack()
    logs = []
    for seed in (1, 2):
        logs.append(str(tmp_path / f"{seed}.BIN"))
        write_log(Path(logs[-1]), list(flight(seed).samples), pack)
    made = tmp_path / "quad.vehicle.toml"
    runner = CliRunner()
    fitted = runner.invoke(app, ["fit", *logs, "--battery", "lipo-generic", "--vehicle", str(made)])
    assert fitted.exit_code == 0 and "2 of 2 flights" in fitted.output
    assert vehicle.read_vehicle(made).name == "quad" and vehicle.read_vehicle(made).battery == "lipo-generic"
    replayed = runner.invoke(app, ["replay", logs[0], "--vehicle", str(made)])
    assert replayed.exit_code == 0 and "120 s before" in replayed.output


def test_bench_tests_teach_no_aircraft(tmp_path: Path) -> None:
    from uavbatt.dataset import load

    study = Path(battery_file.__file__).parents[1] / "data" / "study"
    assert load(study).runs
    call = ["fit", str(study), "--battery", "lipo-generic", "--vehicle", str(tmp_path / "x.vehicle.toml")]
    result = CliRunner().invoke(app, call)
    assert isinstance(result.exception, UavbattError) and "flight logs" in str(result.exception)
    assert list(tmp_path.iterdir()) == []
