"""Endurance before take-off: what shortens it, how wide it is, what is said of it, what is refused."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import msgspec
import numpy as np
import pytest
from factories import generic_pack
from typer.testing import CliRunner

from uavbatt.battery import battery_file, vehicle_file
from uavbatt.battery.battery_file import BatteryFile
from uavbatt.battery.scaling import pack_of
from uavbatt.battery.sizing.pack_size import PackOptions, sized
from uavbatt.battery.vehicle_file import Phases, Trace, VehicleFile
from uavbatt.cli.app import app
from uavbatt.errors import UavbattError
from uavbatt.plan.endurance import (
    TABLE_C,
    Endurance,
    TakeOff,
    endurance,
    make_plan,
    resolve,
    rested,
    unseen_temperature_sd,
)
from uavbatt.prediction.forecaster import Forecaster, ForecastSettings
from uavbatt.prediction.load.library import learned_load
from uavbatt.prediction.load.scenarios import ConstantLoad
from uavbatt.prediction.take_off import FromTakeOff
from uavbatt.records import Sample
from uavbatt.report.plan import plan_report
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, write_log

OPTIONS = PackOptions(cells=4, capacity_Ah=5.0)


def fitted() -> BatteryFile:
    """The generic cell, as if it had been fitted: packs of the type differ by 6 % and 2 %."""
    generic = battery_file.read_battery("lipo-generic")
    table = msgspec.structs.replace(generic.parameters, resistance_scale_sd=0.06, capacity_scale_sd=0.02)
    left = msgspec.structs.replace(generic.discrepancy, voltage_rmse_V=0.01)
    certificate = msgspec.structs.replace(generic.certificate, status="fitted")
    return msgspec.structs.replace(generic, parameters=table, discrepancy=left, certificate=certificate)


def planned(
    power_W: float = 250.0, ambient_C: float = 20.0, start_soc: float = 1.0, battery: BatteryFile | None = None
) -> Endurance:
    content = battery or battery_file.read_battery("lipo-generic")
    load = ConstantLoad(power_W, 0.04)
    return endurance(content, resolve(content, OPTIONS), load, TakeOff(ambient_C, start_soc))


def test_a_pack_that_is_at_its_end_says_so() -> None:
    """A power that takes the voltage below the cut-off at once: no time, and why."""
    found = planned(4000.0)
    assert found.median_s == 0.0 and found.remark == "the pack sags below its cut-off when the motors start"


# --- what shortens it --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("battery", ["lipo-generic", "lpab-3s"])
def test_warmer_lasts_longer(battery: str) -> None:
    times = [planned(ambient_C=t, battery=battery_file.read_battery(battery)) for t in TABLE_C]
    for cold, warm in pairwise(times):
        assert cold.median_s < warm.median_s + 1.0 and cold.hi_s < warm.hi_s + 1.0
    assert times[0].median_s < 0.95 * times[-1].median_s
    # None flies on without an end; of a make that nobody tested the charge is known to a third.
    most = 1.7 if battery == "lipo-generic" else 1.35
    assert all(e.hi_s < most * e.median_s for e in times if e.ambient_C >= 20.0)


def test_double_power_is_less_than_half_the_time() -> None:
    for power_W in (150.0, 300.0):
        assert planned(2.0 * power_W).median_s < 0.5 * planned(power_W).median_s


def test_less_charge_is_less_time() -> None:
    times = [planned(start_soc=z).median_s for z in (1.0, 0.8, 0.5, 0.2)]
    assert all(b < a for a, b in pairwise(times)) and times[-1] < 0.25 * times[0]


def test_it_agrees_with_a_flight_of_the_model() -> None:
    """A simulated flight at that power ends inside the interval, and within 10 % of the median."""
    content = fitted()
    pack = pack_of(content, 4, 5.0, 13.2, 14.0)
    samples = simulate_flight(pack, SimulatedFlight(250.0, 20.0, rate_Hz=1.0, seed=3))
    airborne_s = [s.time_s for s in samples if s.current_A > 5.0]
    flown_s = next(s.time_s for s in samples if s.voltage_V < 13.2 and s.time_s > 100.0) - airborne_s[0]
    said = planned(battery=content)
    assert said.lo_s < flown_s < said.hi_s
    assert said.median_s == pytest.approx(flown_s, rel=0.1)


# --- how wide ----------------------------------------------------------------------------------------------------


def test_a_generic_file_is_wider_than_a_fitted_one() -> None:
    generic, own = planned(), planned(battery=fitted())
    assert generic.hi_s - generic.lo_s > 1.5 * (own.hi_s - own.lo_s)
    assert own.lo_s < own.median_s < own.hi_s and own.to_low_s < own.median_s


# --- what is said of it ------------------------------------------------------------------------------------------


def test_outside_the_validated_range_is_said() -> None:
    battery = battery_file.read_battery("lpab-3s")
    assert "outside the validated range" in planned(ambient_C=-20.0, battery=battery).remark
    assert "outside the validated range" in planned(ambient_C=50.0, battery=battery).remark
    assert planned(ambient_C=25.0, battery=battery).remark == ""
    assert planned(ambient_C=25.0).remark == "not tested at any temperature"
    warned = make_plan(battery, resolve(battery, OPTIONS), (ConstantLoad(150.0, 0.04), "150 W"), TakeOff(20.0)).warnings
    assert warned == (
        "the certificate is for a 3S pack of a capacity that its tests do not tell; this one is scaled from it",
    )


def test_a_range_goes_from_the_coldest_to_the_warmest_validated_temperature() -> None:
    battery = battery_file.read_battery("lpab-3s")
    certificate = msgspec.structs.replace(battery.certificate, validated_ambient_C=[25.0, -5.0, 40.0])
    wide = msgspec.structs.replace(battery, certificate=certificate)
    assert planned(ambient_C=10.0, battery=wide).remark == ""
    assert planned(ambient_C=50.0, battery=wide).remark == "outside the validated range: -5 °C to 40 °C"


def of_range(low_C: float, high_C: float, error_K: float) -> BatteryFile:
    """The study's battery, validated from `low_C` to `high_C`, with this error of its activation energy."""
    battery = battery_file.read_battery("lpab-3s")
    certificate = msgspec.structs.replace(battery.certificate, validated_ambient_C=[low_C, high_C])
    effects = [
        msgspec.structs.replace(e, standard_error={"activation_K": error_K})
        if e.name == "temperature_resistance"
        else e
        for e in battery.effects
    ]
    return msgspec.structs.replace(battery, certificate=certificate, effects=effects)


def test_beyond_the_seen_temperatures_the_resistance_is_as_unsure_as_its_law() -> None:
    battery = of_range(10.0, 35.0, 800.0)
    assert [unseen_temperature_sd(battery, t) for t in (5.0, 22.0, 40.0)] == [0.0, 0.0, 0.0]  # give or take 5 K
    assert unseen_temperature_sd(battery, -20.0) == pytest.approx(800.0 * (1.0 / 253.15 - 1.0 / 278.15))
    assert unseen_temperature_sd(battery, 50.0) == pytest.approx(800.0 * (1.0 / 313.15 - 1.0 / 323.15))
    nobody_tested = battery_file.read_battery("lipo-generic")
    assert unseen_temperature_sd(nobody_tested, 20.0) == 0.0 < unseen_temperature_sd(nobody_tested, 10.0)


def test_a_plan_in_the_unseen_cold_is_wider_towards_an_early_end() -> None:
    """A worn pack at -20 °C ended before the 5 % point of a file of summer flights."""
    unsure, sure = (
        [planned(250.0, t, battery=of_range(15.0, 30.0, error_K)) for t in (-20.0, 20.0)] for error_K in (800.0, 0.0)
    )
    assert unsure[0].lo_s < 0.8 * sure[0].lo_s
    assert unsure[1] == sure[1]


def test_a_load_that_never_ends_it_is_refused_with_its_reason() -> None:
    said = planned(0.5)
    assert math.isnan(said.median_s) and "six hours" in said.remark


def run(*arguments: str) -> tuple[int, str]:
    """Exit code, and output or the one line of the error."""
    result = CliRunner().invoke(app, ["plan", *arguments])
    if isinstance(result.exception, UavbattError):
        assert "\n" not in str(result.exception)
        return result.exception.exit_code, str(result.exception)
    return result.exit_code, result.output


PACK = ("--cells", "4", "--capacity-ah", "5")


def test_json_on_stdout_is_nothing_but_json() -> None:
    call = [*PACK, "--power-w", "250", "--json", "-"]
    done = CliRunner().invoke(app, ["plan", *call])
    assert json.loads(done.stdout)["load"] == "250 W" and "at 20 °C" in done.stderr


def test_the_command_prints_and_writes_every_temperature(tmp_path: Path) -> None:
    page, summary = tmp_path / "plan.html", tmp_path / "plan.json"
    code, said = run(*PACK, "--power-w", "250", "--ambient-c", "5", "--report", str(page), "--json", str(summary))
    assert code == 0 and "generic, not certified" in said and "at 5 °C" in said
    for ambient_C in TABLE_C:
        assert f"{ambient_C:.0f} °C" in said
    told = json.loads(summary.read_text())
    assert told["certificate_status"] == "generic" and told["capacity_from"] == "--capacity-ah"
    assert told["planned"]["lo_s"] < told["planned"]["median_s"] < told["planned"]["hi_s"]
    assert [row["ambient_C"] for row in told["table"]] == list(TABLE_C)
    text = page.read_text()
    ElementTree.fromstring(text.replace("<!DOCTYPE html>", ""))
    assert "not tested at any temperature" in text and "<svg" in text and "250 W" in text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((*PACK,), "--power-w"),
        ((*PACK, "--power-w", "200", "--like", "flight.csv"), "one of"),
        (("--cells", "4", "--power-w", "200"), "--capacity-ah"),
        (("--capacity-ah", "5", "--power-w", "200"), "--cells"),
        (("--battery", "lpab-3s", "--power-w", "200"), "--capacity-ah"),
        ((*PACK, "--mission", "m.plan", "--like", "flight.csv"), "--mission: expected --vehicle FILE, or --power-w W"),
        ((*PACK, "--power-w", "-3"), "--power-w"),
        ((*PACK, "--power-w", "nan"), "--power-w"),
        ((*PACK, "--power-w", "200", "--report", "nowhere/plan.html"), "folder"),
    ],
)
def test_what_nobody_says_is_refused_in_one_line(arguments: tuple[str, ...], words: str) -> None:
    code, said = run(*arguments)
    assert code == 2 and words in said


# --- as flown before ---------------------------------------------------------------------------------------------


@cache
def samples() -> list[Sample]:
    pack = generic_pack()
    return simulate_flight(pack, SimulatedFlight(260.0, 20.0, rate_Hz=1.0, seed=8))


def test_like_a_past_flight(tmp_path: Path) -> None:
    pack, log, summary = (
        generic_pack(),
        tmp_path / "past.BIN",
        tmp_path / "j",
    )
    write_log(log, samples(), pack)
    code, said = run("--like", str(log), "--json", str(summary))
    assert code == 0 and "past.BIN" in said and "from vehicle" in said
    told = json.loads(summary.read_text())
    assert (told["cells"], told["capacity_Ah"]) == (4, 5.0)
    assert told["planned"]["median_s"] == pytest.approx(planned(262.0).median_s, rel=0.08)
    stated = planned(262.0)
    assert told["planned"]["hi_s"] - told["planned"]["lo_s"] > stated.hi_s - stated.lo_s  # one flight is not a law


def test_like_a_log_without_a_flight(tmp_path: Path) -> None:
    log = tmp_path / "ground.csv"
    log.write_text("time_s,voltage_V,current_A\n" + "".join(f"{t},16.6,0.4\n" for t in range(60)))
    code, said = run(*PACK, "--like", str(log))
    assert code == 4 and "--like ground" in said


def test_with_a_vehicle_file(tmp_path: Path) -> None:
    trace = Trace(time_s=[10.0 * k for k in range(40)], power_W=[250.0] * 40, soc=np.linspace(0.98, 0.5, 40).tolist())
    phases = Phases(take_off_W=250.0, flight_W=250.0, last_minute_W=250.0)
    flown = VehicleFile(name="quad", battery="lipo-generic", phases=phases, traces=[trace] * 10)
    code, said = run(*PACK, "--vehicle", str(vehicle_file.write_vehicle(flown, tmp_path / "quad.vehicle.toml")))
    assert code == 0 and "as quad flew 10 times" in said
    load = FromTakeOff(learned_load(flown))
    content = battery_file.read_battery("lpab-3s")  # a tested make: the median of 128 ends scatters less
    told = endurance(content, resolve(content, OPTIONS), load, TakeOff(20.0))
    assert told.median_s == pytest.approx(planned(250.0, battery=content).median_s, rel=0.02)


def test_a_part_used_pack_flies_the_flight_from_its_start() -> None:
    """Take-off power first, whatever the charge: a flight whose first half is gentle is still gentle at first."""
    power_W = [100.0] * 60 + [500.0] * 60
    trace = Trace(time_s=[10.0 * k for k in range(120)], power_W=power_W, soc=np.linspace(1.0, 0.1, 120).tolist())
    phases = Phases(take_off_W=100.0, flight_W=300.0, last_minute_W=500.0)
    load = FromTakeOff(learned_load(VehicleFile(name="q", battery="b", phases=phases, traces=[trace])))
    content = battery_file.read_battery("lipo-generic")
    told = endurance(content, resolve(content, OPTIONS), load, TakeOff(20.0, start_soc=0.2))
    assert told.median_s == pytest.approx(planned(100.0, start_soc=0.2).median_s, rel=0.1)


def test_stated_before_flown_before_file() -> None:
    content = msgspec.structs.replace(
        fitted(), battery=msgspec.structs.replace(fitted().battery, cells_series=4, capacity_Ah=4.0, low_V=None)
    )
    of_file = resolve(content, PackOptions())
    assert (of_file.cells, of_file.capacity_Ah, of_file.cutoff_V) == (4, 4.0, content.battery.cutoff_V)
    assert math.isnan(of_file.low_V)
    stated = resolve(content, replace(OPTIONS, cells=6, cutoff_V=20.0))
    assert (stated.cells, stated.capacity_Ah, stated.cutoff_V) == (6, 5.0, 20.0)
    assert (stated.cells_from, stated.cutoff_from) == ("--cells", "--cutoff-voltage")


def test_no_headline_where_the_file_knows_nothing(tmp_path: Path) -> None:
    content = fitted()
    warm = {"fitted_low_C": 15.0, "fitted_high_C": 38.0}
    certificate = msgspec.structs.replace(content.certificate, statistics=warm)
    seen = msgspec.structs.replace(content, certificate=certificate)
    size = resolve(seen, OPTIONS)
    cold, mild = (make_plan(seen, size, (ConstantLoad(300.0, 0.04), "300 W"), TakeOff(t)) for t in (5.0, 12.0))
    assert math.isnan(cold.here.median_s) and cold.here.remark == "not known: outside the fitted range: 15 °C to 38 °C"
    assert mild.here.median_s > 0.0
    greyed = {row.ambient_C: row.remark for row in cold.rows}
    assert greyed[0.0] == "outside the fitted range: 15 °C to 38 °C" != greyed[20.0]
    page = plan_report(cold)
    assert "The endurance at +5 °C is not known: outside the fitted range: 15 °C to 38 °C." in page
    assert 'class="quiet">0 °C' in page


def test_a_pack_that_sags_under_the_motors_is_said_to_do_that() -> None:
    assert planned(1600.0, -20.0, 0.3).remark == "the pack sags below its cut-off when the motors start"
    assert planned(250.0, 20.0, 0.0).remark == "the pack is at its cut-off or its reserve before take-off"


def test_a_flight_ends_before_take_off_by_the_rule_in_flight() -> None:
    """Where the cut-off lies below the curve, the charge ends the flight: the plan was stricter than the flight."""
    content = battery_file.read_battery("lipo-generic")
    size = resolve(content, replace(OPTIONS, cutoff_V=11.2))
    load = ConstantLoad(250.0, 0.04)
    pack = sized(content, size)
    in_flight = Forecaster(pack, ForecastSettings(load)).forecast(rested(pack, 1.0, 20.0), 0.0)
    found = endurance(content, size, load, TakeOff(20.0))
    assert in_flight is not None and found.median_s == in_flight.median_s and found.hi_s == in_flight.hi_s
