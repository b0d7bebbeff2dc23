"""What is stated of the pack is held against what is measured (issue G.4, faults F5): library, live, commands.

A pack of 4 cells, 5 Ah, flown at 300 W; everything else is a statement about it that is wrong.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from command import called
from daemon_bench import Bench
from factories import generic_pack
from pymavlink.dialects.v20 import ardupilotmega as dialect

import uavbatt
from uavbatt import output
from uavbatt.battery import battery_file
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.battery.vehicle_file import Phases, Trace, VehicleFile, write_vehicle
from uavbatt.errors import UsageError
from uavbatt.estimator import Estimator
from uavbatt.limits import OPTIONS, FirstVoltages, Resting, capacity_doubt, cells_doubt, check_stated, ending_doubt
from uavbatt.live.feeds.web import content
from uavbatt.live.report import Report
from uavbatt.log_replay.run import engine_for
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.prediction.load.library import learned_load
from uavbatt.prediction.load.scenarios import ConstantLoad
from uavbatt.records import NAN, Estimate, PackFacts, Remaining, Sample, Status
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight, write_log
from uavbatt.telemetry import read_log

STATED = PackOptions(cells=4, capacity_Ah=5.0, cutoff_V=13.2)
EVERY_30_S = ForecastSettings(forecast_period_s=30.0)
LOGS = Path(__file__).parents[1] / "logs"


@cache
def flown(seconds: int = 240) -> tuple[Sample, ...]:
    """Four minutes of a flight of the pack, the ground before it included."""
    pack = generic_pack()
    return tuple(simulate_flight(pack, SimulatedFlight(300.0, 20.0, rate_Hz=1.0, seed=3))[:seconds])


@cache
def undisturbed() -> Remaining:
    """The last forecast of a flight of which nothing is stated wrongly, by the battery file's cut-off."""
    return after(replace(STATED, cutoff_V=NAN))[-1][1]


def after(
    options: PackOptions = STATED,
    facts: PackFacts | None = None,
    samples: Sequence[Sample] | None = None,
    battery: str = "lipo-generic",
    settings: ForecastSettings = EVERY_30_S,
) -> list[tuple[Estimate, Remaining]]:
    """Every row's estimate, as a fleet gives it: compiled, to 1e-9 the same (tests/compiled)."""
    estimator = Estimator(battery_file.read_battery(battery), options, settings, engine_for(is_long=True))
    if facts is not None:
        estimator.update_facts(facts)
    return list(estimator.run(samples or flown()))


def said(rows: list[tuple[Estimate, Remaining]]) -> str:
    return "; ".join(dict.fromkeys(w for estimate, _ in rows for w in estimate.warnings))


def is_refused(row: tuple[Estimate, Remaining]) -> bool:
    return row[0].status is row[1].status is Status.REFUSED and math.isnan(row[1].remaining_s)


def test_true_statements_are_held_against_nothing() -> None:
    rows = after()
    assert rows[-1][1].status is Status.OK and said(rows) == "battery file is generic, not certified"


# --- cells, of the caller ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("cells", [99, 12, 6, 3, 1])
def test_a_count_of_cells_that_the_voltage_denies_is_refused(cells: int) -> None:
    rows = after(PackOptions(cells=cells, capacity_Ah=5.0))
    assert all(is_refused(row) for row in rows)
    assert f"{cells} cell" in rows[0][0].reason and "V a cell" in rows[0][0].reason and "as with 4" in rows[0][0].reason
    line = output.line(*rows[-1])
    assert (line["status"], line["soc"], line["remaining_s"]) == ("refused", None, None)
    assert rows[-1][0].reason in said(rows)


def test_a_count_of_cells_that_is_hardly_possible_is_said() -> None:
    """16.7 V at rest are 3.3 V a cell of five: an empty pack of five, or a full one of four."""
    rows = after(PackOptions(cells=5, capacity_Ah=5.0))
    assert "5 cells in series at 3.3" in said(rows) and "nearly empty, or another count" in said(rows)


def test_a_pack_that_looks_nearly_empty_and_flies_on_has_another_count_of_cells() -> None:
    """A full pack of four that is stated as one of five: 3.3 V a cell, and then a third of its charge."""
    rows = after(PackOptions(cells=5, capacity_Ah=5.0), samples=flown(450))
    refused_s = next(row[0].time_s for row in rows if is_refused(row) and "another count" in row[0].reason)
    drawn_Ah = sum(sample.current_A for sample in flown(450) if sample.time_s <= refused_s) / 3600.0
    assert drawn_Ah == pytest.approx(0.3 * 5.0, rel=0.05)
    assert is_refused(rows[-1])


def test_a_damaged_first_voltage_refuses_no_flight() -> None:
    first = replace(flown()[0], voltage_V=60.0)
    rows = after(samples=(first, *flown()[1:]))
    assert is_refused(rows[0]) and not is_refused(rows[100])
    assert rows[-1][1].status is Status.OK


@pytest.mark.parametrize(
    ("cells", "rested_V", "certain"),
    [(4, 16.8, None), (4, 17.4, None), (6, 26.0, None), (5, 16.7, False), (4, 17.7, False), (3, 16.8, True),
     (4, 17.9, True), (12, 16.8, True), (5, 15.2, True), (1, 4.2, None), (2, 4.2, True)],
)  # fmt: skip
def test_volts_a_cell_at_rest(cells: int, rested_V: float, certain: bool | None) -> None:
    doubt = cells_doubt(cells, FirstVoltages(rested_V, rested_V), Resting(3.07, 3.65))
    assert (None if doubt is None else doubt.is_certain) is certain


def test_under_load_a_low_voltage_denies_no_count() -> None:
    assert cells_doubt(4, FirstVoltages(first_V=10.8), Resting()) is None


# --- cut-off, capacity, ambient temperature, of the caller -------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"cutoff_V": 17.5}, "cutoff_V=17.5 V is 4.38 V a cell of 4, expected 2 to 4.2 V"),
        ({"cutoff_V": 13200.0}, "(millivolts?)"),
        ({"cutoff_V": 3.3}, "one cell's value? 4 of them make 13.2 V"),
        ({"cutoff_V": 0.5}, "cutoff_V=0.5"),
        ({"cutoff_V": 1e-38}, "cutoff_V=1e-38"),
        ({"cutoff_V": math.inf}, "cutoff_V=inf"),
        ({"cutoff_V": "13.2"}, "cutoff_V='13.2'"),
        ({"capacity_Ah": 5000.0}, "expected 0.05 to 500 Ah (mAh?)"),
        ({"capacity_Ah": 0.005}, "capacity_Ah=0.005 Ah, expected 0.05 to 500 Ah"),
        ({"capacity_Ah": -5.0}, "capacity_Ah=-5"),
        ({"capacity_Ah": None}, "capacity_Ah=None: expected a number"),
        ({"cells": 0}, "cells=0: expected 1 to 100"),
        ({"cells": 101}, "cells=101: expected 1 to 100"),
        ({"cells": 4.5}, "cells=4.5: expected a whole number from 1 to 100"),
        ({"reserve_soc": 20.0}, "reserve_soc=20: expected 0 to 0.99"),
        ({"reserve_soc": NAN}, "reserve_soc=nan"),
    ],
)
def test_wrong_arguments_of_the_library_are_named_with_their_bounds(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(UsageError) as caught:
        uavbatt.Estimator.from_battery("lipo-generic", **{"cells": 4, "capacity_Ah": 5.0, **wrong})
    assert words in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [({"ambient_C": -60.0}, "ambient_C=-60: expected -40 to 60 °C"), ({"ambient_C": 293.0}, "ambient_C=293"),
     ({"low_V": 25.0}, "low_V=25 V is 6.25 V a cell"), ({"forecast_period_s": -1.0}, "forecast_period_s=-1")],
)  # fmt: skip
def test_wrong_options_are_named_with_their_bounds(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        ForecastSettings(**wrong) if "forecast_period_s" in wrong else PackOptions(**{"cells": 4, **wrong})


@pytest.mark.parametrize("cutoff_V", [3.3, 17.5, 60.0])
def test_a_cut_off_is_refused_when_the_voltage_tells_the_cells(cutoff_V: float) -> None:
    rows = after(PackOptions(capacity_Ah=5.0, cutoff_V=cutoff_V))
    assert is_refused(rows[0]) and is_refused(rows[-1])
    assert f"cut-off {cutoff_V:g} V is {cutoff_V / 4:.3g} V a cell of 4" in rows[-1][1].reason


def test_a_cut_off_above_the_rested_pack_is_refused() -> None:
    used = tuple(replace(s, voltage_V=s.voltage_V - 1.4) for s in flown())
    rows = after(replace(STATED, cutoff_V=15.8), samples=used)
    assert is_refused(rows[-1]) and "that the pack has at rest" in rows[-1][1].reason


@pytest.mark.parametrize("cutoff_V", [9.6, 15.6])
def test_an_odd_cut_off_is_said(cutoff_V: float) -> None:
    rows = after(replace(STATED, cutoff_V=cutoff_V))
    assert not is_refused(rows[-1]) and "usual are 2.5 to 3.8 V" in said(rows)


def test_a_tenth_of_the_capacity_is_said_and_then_refused() -> None:
    rows = after(replace(STATED, capacity_Ah=0.5))
    assert "the stated 0.5 Ah gives more than 30 C for a minute" in said(rows[:140])
    assert is_refused(rows[-1]) and "1.5 times the stated 0.5 Ah were drawn" in rows[-1][1].reason


def test_ten_times_the_capacity_is_said() -> None:
    rows = after(replace(STATED, capacity_Ah=50.0))
    assert "the stated 50 Ah gives less than 0.5 C, and yet the voltage gives way" in said(rows[:150])


def test_a_hundred_times_the_capacity_is_refused() -> None:
    rows = after(replace(STATED, capacity_Ah=500.0), settings=replace(EVERY_30_S, load=ConstantLoad(300.0, 0.04)))
    assert is_refused(rows[-1]) and "the stated 500 Ah gives less than 0.3 C" in rows[-1][1].reason


def test_three_times_the_capacity_gives_a_plausible_rate_and_is_the_filters_matter() -> None:
    """By statements alone it cannot be known: 1.3 C is an ordinary hover. Nothing may be claimed against it here."""
    assert not any(
        word in said(after(replace(STATED, capacity_Ah=15.0))) for word in ("stated 15 Ah", "capacity right")
    )


def test_a_light_load_on_the_ground_speaks_against_no_capacity() -> None:
    idle = [replace(flown()[0], time_s=float(t), current_A=2.0) for t in range(300)]
    assert "capacity right" not in said(after(samples=idle))


# --- what the vehicle says ---------------------------------------------------------------------------------------

FACTS = PackFacts(capacity_Ah=5.0, low_voltage_V=14.0, critical_voltage_V=13.2)


def test_a_count_that_nobody_states_is_said_to_be_a_guess_where_another_fits() -> None:
    """46 V at rest: 12 cells at 3.83 V or 11 at 4.18 V; a critical voltage of 42 V leaves no doubt."""
    generic = battery_file.read_battery("lipo-generic")
    for critical_V, doubt in ((NAN, "12 in series by the first voltage, 11 would fit as well"), (42.0, "")):
        estimator = Estimator(generic, settings=EVERY_30_S)
        estimator.update_facts(PackFacts(capacity_Ah=16.0, critical_voltage_V=critical_V))
        estimate, _ = estimator.step(Sample(0.0, 46.0, 0.5, 25.0))
        assert estimator.pack_size is not None and estimator.pack_size.cells == 12
        assert (doubt in " ".join(estimate.warnings)) and ("would fit" in " ".join(estimate.warnings)) is bool(doubt)


@pytest.mark.parametrize("cells", [99, 12, 6, 3, 1])
def test_cells_of_the_vehicle_that_the_voltage_denies_are_left_out(cells: int) -> None:
    generic = battery_file.read_battery("lipo-generic")
    estimator = Estimator(generic, settings=EVERY_30_S, engine=engine_for(is_long=True))
    estimator.update_facts(replace(FACTS, cells_series=cells, critical_voltage_V=3.5 * cells))
    rows = list(estimator.run(flown()))
    pack = estimator.pack_size
    assert pack is not None and (pack.cells, pack.cells_from, pack.cutoff_V) == (
        4,
        "first voltage",
        pytest.approx(13.2),
    )
    assert rows[-1][1].status is Status.OK and f"the vehicle states {cells} cell" in said(rows)


@pytest.mark.parametrize("critical_V", [3.3, 0.5, 1e-38, 13200.0, 17.5])
def test_a_critical_voltage_that_cannot_be_is_left_out(critical_V: float) -> None:
    rows = after(replace(STATED, cutoff_V=NAN), replace(FACTS, critical_voltage_V=critical_V))
    assert rows[-1][1].remaining_s == pytest.approx(undisturbed().remaining_s)
    assert f"critical voltage of the vehicle, {critical_V:g} V" in said(rows) and "not used" in said(rows)
    if critical_V == 3.3:
        assert "one cell's value? 4 of them make 13.2 V" in said(rows)


def test_a_critical_voltage_for_another_count_than_the_callers_is_left_out() -> None:
    estimator = Estimator(battery_file.read_battery("lipo-generic"), PackOptions(cells=4), EVERY_30_S)
    estimator.update_facts(replace(FACTS, cells_series=3, critical_voltage_V=10.5))  # 3 cells of 3.5 V: PX4
    estimate, _ = estimator.step(flown()[0])
    assert estimator.pack_size is not None and estimator.pack_size.cutoff_V == pytest.approx(13.2)
    assert any("the vehicle states 3" in warning for warning in estimate.warnings)


def test_a_low_voltage_warning_that_cannot_be_is_said() -> None:
    rows = after(replace(STATED, low_V=NAN), replace(FACTS, low_voltage_V=25.0))
    assert "low-voltage warning of the vehicle, 25 V is 6.25 V a cell of 4" in said(rows)
    assert rows[-1][1].status is Status.OK and rows[-1][1].remaining_to_low_s > 0.0


@pytest.mark.parametrize("capacity_Ah", [0.005, 5000.0])
def test_a_capacity_of_the_vehicle_that_cannot_be_is_not_used(capacity_Ah: float) -> None:
    with pytest.raises(UsageError, match=r"capacity of the vehicle, .* not used; .*give --capacity-ah"):
        after(PackOptions(), replace(FACTS, capacity_Ah=capacity_Ah))


# --- the sensors -------------------------------------------------------------------------------------------------


def test_a_current_of_the_wrong_sign_is_refused_and_said() -> None:
    rows = after(samples=[replace(s, current_A=-s.current_A) for s in flown()])
    assert is_refused(rows[-1]) and "sign is reversed" in rows[-1][1].reason and "sign is reversed" in said(rows)


def test_twenty_seconds_of_regenerating_are_no_wrong_sign() -> None:
    """faults.md: regen_-10A_20s."""
    rows = after(samples=[replace(s, current_A=-10.0) if 150 <= k < 170 else s for k, s in enumerate(flown())])
    assert "sign" not in said(rows)


def test_time_in_milliseconds_is_refused() -> None:
    rows = after(samples=[replace(s, time_s=1000.0 * s.time_s) for s in flown()[:40]])
    assert is_refused(rows[-1]) and "milliseconds?" in rows[-1][1].reason


def test_time_in_milliseconds_at_fifty_rows_a_second_draws_more_than_there_is() -> None:
    air = [replace(s, time_s=20.0 * k) for k, s in enumerate(flown()[20:140])]
    rows = after(samples=air)
    assert is_refused(rows[-1]) and "were drawn, and the cells are far from empty" in rows[-1][1].reason


@pytest.mark.parametrize("swapped", [2, 5])
def test_rows_out_of_order_draw_no_more_than_rows_in_order(swapped: int) -> None:
    """The time between two rows was counted again after a late one: 1.5 times the true charge."""
    sound, rows = flown(), list[Sample]()
    for k in range(0, len(sound), swapped):
        rows += reversed(sound[k : k + swapped])
    found = after(replace(STATED, capacity_Ah=1.0), samples=rows)  # 1.2 Ah are drawn, and 1.5 Ah would be refused
    assert not any("were drawn" in estimate.reason for estimate, _ in found)


def test_a_temperature_in_kelvin_is_said_and_not_used() -> None:
    rows = after(samples=[replace(s, temp_C=s.temp_C + 273.15) for s in flown()])
    assert "in kelvin: not used" in said(rows) and rows[-1][1].status is Status.OK
    assert math.isnan(rows[-1][0].temp_C)


# --- files of another aircraft -----------------------------------------------------------------------------------


def of_another(power_W: float) -> VehicleFile:
    times_s = [10.0 * k for k in range(60)]
    trace = Trace(time_s=times_s, power_W=[power_W] * 60, soc=[round(float(z), 4) for z in np.linspace(1.0, 0.2, 60)])
    phases = Phases(take_off_W=power_W, flight_W=power_W, last_minute_W=power_W)
    return VehicleFile(name="other", battery="lipo-generic", phases=phases, traces=[trace])


@pytest.mark.parametrize(("power_W", "is_other"), [(900.0, True), (120.0, True), (330.0, False), (250.0, False)])
def test_a_vehicle_file_of_another_aircraft_is_said(power_W: float, is_other: bool) -> None:
    rows = after(settings=replace(EVERY_30_S, load=learned_load(of_another(power_W))))
    assert ("another aircraft's?" in said(rows)) is is_other


def test_a_battery_file_of_another_pack_is_said(tmp_path: Path) -> None:
    generic = battery_file.read_battery("lipo-generic")
    fitted = msgspec.structs.replace(
        generic,
        battery=msgspec.structs.replace(generic.battery, cells_series=3, capacity_Ah=2.2, cutoff_V=9.9, low_V=10.5),
        certificate=msgspec.structs.replace(generic.certificate, status="fitted"),
    )
    path = str(battery_file.write_battery(fitted, tmp_path / "other.battery.toml"))
    rows = after(STATED, battery=path)
    assert "the battery file is of a 3S 2.2 Ah pack, this one is 4S 5 Ah" in said(rows)


# --- live --------------------------------------------------------------------------------------------------------


def live(parameters: dict[str, float], options: PackOptions | None = None) -> Bench:
    """A flight of 40 s as the companion process hears it, the vehicle's parameters before it."""
    bench = Bench(options or PackOptions(capacity_Ah=5.0))
    for name, value in parameters.items():
        bench.send(dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3))
        bench.send(dialect.MAVLink_param_value_message(name.encode(), value, 9, 1, 0))
    bench.play(flown()[:60])
    return bench


@cache
def heard_soundly() -> Report:
    return live({"BATT_SERIAL_NUM": 1.0}).daemon.board.reports[0]


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("BAT1_N_CELLS", 3.0, "the vehicle states 3 cells in series"),
        ("BAT1_N_CELLS", 1.0, "the vehicle states 1 cell in series"),
        ("BATT_CRT_VOLT", 3.3, "one cell's value? 4 of them make 13.2 V"),
        ("BATT_CRT_VOLT", 0.5, "critical voltage of the vehicle, 0.5 V"),
        ("BATT_CRT_VOLT", 1e-38, "critical voltage of the vehicle, 1e-38 V"),
        ("BATT_LOW_VOLT", 25.0, "low-voltage warning of the vehicle, 25 V"),
    ],
)
def test_live_leaves_an_absurd_parameter_out_and_says_so(name: str, value: float, words: str) -> None:
    bench = live({name: value})
    report, sound = bench.daemon.board.reports[0], heard_soundly()
    assert report.cells == 4 and any(words in warning for warning in report.estimate.warnings)
    assert report.remaining.status is not Status.REFUSED
    assert report.remaining.remaining_s == pytest.approx(sound.remaining.remaining_s, abs=1.0)
    shown = content(bench.daemon.board, bench.now_s)["batteries"][0]
    assert any(words in warning for warning in shown["warnings"])


@pytest.mark.parametrize("stated", [{"cells": 3}, {"cells": 99}, {"cells": 12}, {"cutoff_V": 3.3}, {"cutoff_V": 17.5}])
def test_live_refuses_an_absurd_statement_and_goes_on(stated: dict[str, Any]) -> None:
    bench = live({}, PackOptions(**{"capacity_Ah": 5.0, **stated}))
    shown = content(bench.daemon.board, bench.now_s)["batteries"][0]
    assert shown["status"] == "refused" and "V a cell" in shown["reason"] and shown["remaining_s"] is None
    assert bench.daemon.board.counts["rows"] == 60


FAILSAFE = {"BATT_CAPACITY": 5000.0, "BATT_CRT_MAH": 4700.0, "BATT_FS_CRT_ACT": 1.0}


@pytest.mark.parametrize(
    ("stated", "parameters", "words"),
    [
        ({"cells": 6}, {}, "count of cells does not fit the pack"),
        ({"cutoff_V": 17.5}, {}, "cut-off does not fit the pack"),
        ({}, {"BAT1_N_CELLS": 3.0}, "cells of the vehicle not used"),
        ({}, {"BATT_CRT_VOLT": 3.3}, "critical voltage does not fit"),
        ({}, {"BATT_LOW_VOLT": 25.0}, "low-voltage warning does not fit"),
        ({}, FAILSAFE, "autopilot will act by its own count"),
    ],
)
def test_the_crew_hears_what_cannot_be(stated: dict[str, Any], parameters: dict[str, float], words: str) -> None:
    bench = live(parameters, PackOptions(**{"capacity_Ah": 5.0, **stated}))
    assert f"Battery 0: {words}" in [text for _, text in bench.daemon.board.announcements]


def test_live_says_what_capacity_was_not_used() -> None:
    bench = live({"BATT_CAPACITY": 5.0}, PackOptions())  # Ah where mAh were asked
    report = bench.daemon.board.reports[0]
    assert report.remaining.status is Status.REFUSED and "0.005 Ah" in report.remaining.reason


# --- the commands ------------------------------------------------------------------------------------------------

ABSURD = [
    (("--cells", "99"), "V a cell"),
    (("--cells", "12"), "V a cell"),
    (("--cells", "6"), "V a cell"),
    (("--cells", "3"), "V a cell"),
    (("--cells", "1"), "V a cell"),
    (("--capacity-ah", "5000"), "(mAh?)"),
    (("--capacity-ah", "0.005"), "expected 0.05 to 500 Ah"),
    (("--cutoff-voltage", "17.5"), "expected 2 to 4.2 V"),
    (("--cutoff-voltage", "13200"), "(millivolts?)"),
    (("--cutoff-voltage", "3.3"), "one cell's value?"),
    (("--cutoff-voltage", "0.5"), "expected 2 to 4.2 V"),
    (("--cutoff-voltage", "1e-38"), "expected 2 to 4.2 V"),
]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("flown") / "flight.tlog"
    write_log(path, list(flown()), generic_pack())
    return path


def is_one_line_of_usage(done: Any, words: str, folder: Path) -> None:
    assert done.returncode == 2 and done.stdout == "", (done.stdout, done.stderr)
    assert done.stderr.startswith("uavbatt: ") and done.stderr.count("\n") == 1 and words in done.stderr
    assert list(folder.iterdir()) == []  # before any work


@pytest.mark.parametrize(("wrong", "words"), ABSURD)
def test_replay_ends_before_any_work(log: Path, wrong: tuple[str, ...], words: str, tmp_path: Path) -> None:
    done = called("replay", log, *wrong, "--jsonl", "f.jsonl", "--json", "f.json", folder=tmp_path)
    is_one_line_of_usage(done, words, tmp_path)


@pytest.mark.parametrize(("wrong", "words"), [a for a in ABSURD if a[0][0] != "--cells"])
def test_plan_ends_before_any_work(wrong: tuple[str, ...], words: str, tmp_path: Path) -> None:
    stated = ("--cells", "4", "--power-w", "300", *(() if "--capacity-ah" in wrong else ("--capacity-ah", "5")))
    done = called("plan", *stated, *wrong, "--json", "f.json", folder=tmp_path)
    is_one_line_of_usage(done, words, tmp_path)


def test_plan_ends_on_a_power_that_no_pack_gives(tmp_path: Path) -> None:
    done = called("plan", "--cells", "4", "--capacity-ah", "0.5", "--power-w", "800", folder=tmp_path)
    is_one_line_of_usage(done, "800 W on 4S 0.5 Ah is 108 C", tmp_path)
    done = called("plan", "--cells", "4", "--capacity-ah", "0.5", "--power-w", "300", folder=tmp_path)
    assert done.returncode == 0 and "300 W on 4S 0.5 Ah is 41 C" in done.stdout


@pytest.mark.parametrize("command", [("fit", "-o", "n.battery.toml"), ("diagnose", "--battery", "lipo-generic")])
@pytest.mark.parametrize(("capacity_Ah", "words"), [("0.5", "1.5 times the stated 0.5 Ah"), ("500", "less than 0.3 C")])
def test_fit_and_diagnose_hold_the_capacity_against_the_whole_flight(
    command: tuple[str, ...], capacity_Ah: str, words: str, log: Path, tmp_path: Path
) -> None:
    done = called(*command, log, "--cells", "4", "--capacity-ah", capacity_Ah, folder=tmp_path)
    is_one_line_of_usage(done, words, tmp_path)


@pytest.mark.parametrize(("wrong", "words"), [ABSURD[k] for k in (0, 3, 5, 7, 9)])
@pytest.mark.parametrize(
    "command", [("plan", "--like"), ("fit", "-o", "n.battery.toml"), ("diagnose", "--battery", "lipo-generic")]
)
def test_commands_on_a_log_end_before_any_work(
    command: tuple[str, ...], log: Path, wrong: tuple[str, ...], words: str, tmp_path: Path
) -> None:
    cells = () if "--cells" in wrong or command[0] != "fit" else ("--cells", "4")
    is_one_line_of_usage(called(*command, log, *cells, *wrong, folder=tmp_path), words, tmp_path)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [(("--capacity-ah", "5000"), "(mAh?)"), (("--cells", "4", "--cutoff-voltage", "17.5"), "expected 2 to 4.2 V"),
     (("--cutoff-voltage", "13200"), "(millivolts?)"), (("--reserve-soc", "2"), "reserve-soc")],
)  # fmt: skip
def test_live_does_not_start_on_an_absurd_argument(wrong: tuple[str, ...], words: str, tmp_path: Path) -> None:
    done = called("live", "udpin:127.0.0.1:0", *wrong, folder=tmp_path)
    assert done.returncode == 2 and words in done.stderr


def test_live_does_not_start_on_an_absurd_ambient_temperature(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text("[pack]\nambient_C = -60\n")
    done = called("live", "udpin:127.0.0.1:0", "--config", "c.toml", folder=tmp_path)
    assert done.returncode == 1 and "pack.ambient_C" in done.stderr and done.stderr.count("\n") == 1


def test_a_current_that_no_pack_of_the_stated_size_gives_is_refused_in_words(tmp_path: Path) -> None:
    rows = [f"{80 * k},15.2,600,25" for k in range(80)]
    (tmp_path / "absurd.csv").write_text("\n".join(["time_s,voltage_V,current_A,temp_C", *rows]) + "\n")
    done = called("replay", "absurd.csv", "--cells", "4", "--capacity-ah", "0.05", folder=tmp_path)
    assert done.returncode == 0 and "Traceback" not in done.stderr
    assert "the stated 0.05 Ah gives more than 60 C for a minute" in done.stdout


def test_one_damaged_current_moves_nothing() -> None:
    """A row in flight of 1900 A on a pack of 5 Ah."""
    rows = list(flown()[:60])
    rows[40] = replace(rows[40], current_A=1900.0)
    damaged, sound = after(samples=rows), after(samples=flown()[:60])
    assert damaged[-1][0].soc == pytest.approx(sound[-1][0].soc, abs=2e-4)


def test_replay_says_what_it_did_not_use(tmp_path: Path) -> None:
    pack = generic_pack(4, 5.0, 3.3, 14.0)  # the log's BATT_CRT_VOLT is a cell's value
    write_log(tmp_path / "f.tlog", list(flown()), pack)
    done = called(
        "replay", "f.tlog", "--load", "recent", "--jsonl", "f.jsonl", "--json", "f.json", "--report", "f.html",
        folder=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0 and "one cell's value?" in done.stdout
    summary = json.loads((tmp_path / "f.json").read_text())
    assert (summary["cutoff_V"], summary["cutoff_from"]) == (pytest.approx(13.2), "battery file")
    assert any("one cell's value?" in warning for warning in summary["warnings"])
    assert "one cell&#x27;s value?" in (tmp_path / "f.html").read_text().replace("&#39;", "&#x27;")
    assert all("one cell's value?" in line for line in (tmp_path / "f.jsonl").read_text().splitlines())


def test_replay_with_another_aircrafts_vehicle_file(log: Path, tmp_path: Path) -> None:
    path = write_vehicle(of_another(900.0), tmp_path / "other.vehicle.toml")
    done = called("replay", log, "--vehicle", path, folder=tmp_path)
    assert done.returncode == 0 and "another aircraft's?" in done.stdout


def test_a_table_in_milliseconds_is_refused_with_its_column(tmp_path: Path) -> None:
    rows = "\n".join(f"{1000 * k},16.2,15" for k in range(30))
    (tmp_path / "f.csv").write_text(f"time_s,voltage_V,current_A\n{rows}\n")
    done = called("replay", "f.csv", "--capacity-ah", "5", folder=tmp_path)
    assert done.returncode == 1 and "column time_s: expected seconds" in done.stderr and "milliseconds?" in done.stderr


def test_info_uses_the_same_limits(tmp_path: Path) -> None:
    pack = generic_pack(4, 5.0, 3.3, 25.0)
    samples = [replace(s, current_A=-s.current_A, temp_C=298.0) for s in flown()]
    write_log(tmp_path / "f.tlog", samples, pack)
    told = called("info", "f.tlog", folder=tmp_path).stdout
    assert "trust        no" in told and "negative throughout" in told and "kelvin?" in told
    assert "critical voltage 3.3 V" in told and "low-voltage warning 25 V" in told


# --- nothing is held against what is true ------------------------------------------------------------------------


def test_limits_let_ordinary_statements_pass() -> None:
    check_stated(6, 22.0, 21.0, 22.2, -10.0, 0.2, OPTIONS)
    check_stated()
    assert capacity_doubt(NAN) is None and capacity_doubt(0.3) is None and capacity_doubt(200.0) is None
    for volts in (10.0, 13.2, 14.8, 15.2):
        assert ending_doubt("cut-off ", volts, 4, 16.8) is None


@pytest.mark.parametrize("name", ["hexa_6s_cold.csv", "quad_3s.BIN", "quad_4s.tlog"])
def test_the_sample_logs_contradict_nothing(name: str) -> None:
    flight = read_log(LOGS / name)
    settings = ForecastSettings(forecast_period_s=math.inf)
    generic, engine = battery_file.read_battery("lipo-generic"), engine_for(is_long=True)
    estimator = Estimator(generic, PackOptions(capacity_Ah=5.0), settings, engine)
    estimator.update_facts(flight.facts_at(math.inf))
    told = {w for estimate, _ in estimator.run(flight.samples) for w in estimate.warnings}
    assert not {w for w in told if "cell of" in w or "in series" in w or "stated" in w or "sign" in w}
