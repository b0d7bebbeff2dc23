"""F7: whatever a state file holds, the process lives, says what became of it, and believes nothing impossible."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cases import first_quick
from daemon_bench import Bench
from live_rig import Station, Vehicle, free_port, running
from pymavlink.dialects.v20 import ardupilotmega as dialect
from test_live_faults import OPTIONS, flight, true_soc

from uavbatt.battery.model import Array
from uavbatt.battery.state_space import SIZE, X
from uavbatt.live.config import LinkSection, StateSection
from uavbatt.live.memory.saved import implausible_belief
from uavbatt.records import Estimate
from uavbatt.simulate.tlog_writer import battery_status, heartbeat

FLOWN = 120  # rows before the crash
SILENT_S = 1.0


def section(path: Path) -> StateSection:
    return StateSection(file=str(path))


@cache
def crashed(folder: Path) -> tuple[str, float]:
    """The state that a flight of a minute leaves, and the time of the crash [s]."""
    bench = Bench(OPTIONS, state=section(folder / "state.json"))
    bench.send(dialect.MAVLink_param_value_message(b"BATT_CAPACITY", 5000.0, 9, 1, 0))
    bench.play(flight()[:FLOWN])
    bench.daemon.close()
    return (folder / "state.json").read_text(), bench.now_s


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, float]:
    return crashed(tmp_path_factory.mktemp("crashed"))


def restarted(path: Path, at_s: float, **sections: Any) -> Bench:
    """The process anew, before its first row."""
    return Bench(OPTIONS, start_s=at_s + SILENT_S, state=section(path), **sections)


def notes(bench: Bench) -> str:
    return "; ".join(bench.daemon.board.notes)


def battery(content: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = content["batteries"]["0"]
    return found


def changed(*path: Any, change: Callable[[Any], Any]) -> Callable[[dict[str, Any]], None]:
    """An edit of the content: one place of it changed."""

    def edit(content: dict[str, Any]) -> None:
        inner: Any = content
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = change(inner.get(path[-1]) if isinstance(inner, dict) else inner[path[-1]])

    return edit


def put(*path: Any, value: Any) -> Callable[[dict[str, Any]], None]:
    return changed(*path, change=lambda _: value)


def scaled(*path: Any, by: float) -> Callable[[dict[str, Any]], None]:
    return changed(*path, change=lambda was: was * by)


def of_battery(*path: Any, value: Any) -> Callable[[dict[str, Any]], None]:
    return put("batteries", "0", *path, value=value)


def of_members(key: str, *path: Any, value: Any) -> Callable[[dict[str, Any]], None]:
    """The same place of every member of the belief."""

    def edit(content: dict[str, Any]) -> None:
        for member in range(len(content["batteries"]["0"][key])):
            of_battery(key, member, *path, value=value)(content)

    return edit


def certain() -> Callable[[dict[str, Any]], None]:
    """A belief that doubts nothing: every member the same, and none with a variance."""

    def edit(content: dict[str, Any]) -> None:
        of_members("covariances", value=[[0.0] * SIZE] * SIZE)(content)
        of_members("means", value=content["batteries"]["0"]["means"][0])(content)

    return edit


NEGATIVE = 1.9 * np.eye(SIZE) - 0.9  # its sum is below zero
# Of the memory of the forecaster: recent load (time_s, mean_W, gust_W, powers flown), energy, lessons of the route.
LOAD, FLOWN_J, LESSONS = ("past", 0, 0, 0), ("past", 0, 0, 8), ("past", 0, 1)
TAKE_OFF = ("past", 0, 2)  # when, power, ends, low-voltage warnings
DAMAGE: dict[str, Callable[[dict[str, Any]], None]] = {
    "batteries null": put("batteries", value=None),
    "batteries a list": put("batteries", value=[]),
    "batteries of a name": put("batteries", value={"x" * 400: {}}),
    "a battery null": put("batteries", "0", value=None),
    "parameters null": put("parameters", value=None),
    "a parameter null": put("parameters", "BATT_CAPACITY", value=None),
    "a parameter a text": put("parameters", "BATT_CAPACITY", value="5000"),
    "a parameter a list": put("parameters", "BATT_CAPACITY", value=[5000]),
    "a parameter infinite": put("parameters", "BATT_OPTIONS", value=math.inf),
    "a parameter of 400 digits": put("parameters", "BATT_CAPACITY", value=10**400),
    "no vehicle": put("vehicle", value=None),
    "system 1e12": put("vehicle", "system", value=10**12),
    "wall clock a text": put("wall_s", value="noon"),
    "monotonic clock nan": put("monotonic_s", value=math.nan),
    "mean too short": of_battery("means", 3, value=[1.0]),
    "mean null": of_battery("means", value=None),
    "mean nan": of_battery("means", 0, value=[math.nan] * SIZE),
    "soc 5": of_members("means", X.SOC, value=5.0),
    "core 1e12": of_members("means", X.CORE, value=1e12),
    "resistance e^400": of_members("means", X.LOG_RESISTANCE, value=400.0),
    "covariance zero": certain(),
    "covariance nan": of_battery("covariances", 2, value=[[math.nan] * SIZE] * SIZE),
    "covariance huge": of_members("covariances", value=(np.eye(SIZE) * 1e12).tolist()),
    "covariance of a row": of_battery("covariances", 0, value=[[1.0] * SIZE]),
    "covariance not symmetric": of_battery("covariances", 1, X.SOC, X.BIAS, value=1e-4),
    "covariance not definite": of_battery("covariances", 1, value=(NEGATIVE * 1e-3).tolist()),
    "since_row 1e12": of_battery("since_row_s", value=1e12),
    "since_row nan": of_battery("since_row_s", value=math.nan),
    "since_row negative": of_battery("since_row_s", value=-5.0),
    "since_row a text": of_battery("since_row_s", value="x"),
    "since_row an hour": of_battery("since_row_s", value=3600.0),
    "ambient a text": of_battery("ambient_C", value="warm"),
    "ambient 1e12": of_battery("ambient_C", value=1e12),
    "cells 0": of_battery("cells", value=0),
    "cells a text": of_battery("cells", value="4"),
    "cells of another pack": of_battery("cells", value=5),
    "cells full at 40 V": of_battery("fullest_cell_V", value=40.0),
    "capacity 1e12": of_battery("capacity_Ah", value=1e12),
    "capacity of another pack": of_battery("capacity_Ah", value=50.0),
    "current 1e12": of_battery("current_A", value=1e12),
    "consumed 1e300": of_battery("consumed_Ah", value=1e300),
    "past empty": of_battery("past", value={}),
    "past of another shape": of_battery("past", value=[[1], 2]),
    "load x 1e308": scaled("batteries", "0", *LOAD, 1, by=1e308),
    "load x 1000": scaled("batteries", "0", *LOAD, 1, by=1000.0),
    "powers in pieces of no length": of_battery(*LOAD, 3, 0, value=0.0),
    "powers nan": of_battery(*LOAD, 3, 3, value=[math.nan]),
    "powers without end": of_battery(*LOAD, 3, 3, value=[100.0] * 100_000),
    "an open piece of an hour": of_battery(*LOAD, 3, 2, value=3600.0),
    "load time 1e12": of_battery(*LOAD, 0, value=1e12),
    "flown 1e12 J": of_battery(*FLOWN_J, value=1e12),
    "timing of legs that knows nothing": of_battery(*LESSONS, 0, value=[0.0] * 5),
    "timing of legs nan": of_battery(*LESSONS, 1, 0, value=math.nan),
    "power level of negative seconds": of_battery(*LESSONS, 4, value=-1.0),
    "power at high airspeed nan": of_battery(*LESSONS, slice(8, None), value=[10.0, 5.0, math.nan]),
    "power at high airspeed of no seconds": of_battery(*LESSONS, slice(8, None), value=[0.0, 1.0, 1.0]),
    "power at high airspeed e^100000 too small": of_battery(*LESSONS, slice(8, None), value=[10.0, 5.0, -1e6]),
    "airspeeds ten times the learned ones": of_battery(*LESSONS, slice(8, None), value=[1.0, 1e3, 0.0]),
    "take-off with a text": of_battery(*TAKE_OFF, value="early"),
    "take-off at negative power": of_battery(*TAKE_OFF, 1, value=-1.0),
    "take-off without ends": of_battery(*TAKE_OFF, 2, value=[]),
    "take-off with ends out of order": of_battery(*TAKE_OFF, 2, value=[900.0, 300.0]),
    "take-off with negative ends": of_battery(*TAKE_OFF, 3, value=[-900.0, 300.0]),
    "take-off with ends nan": of_battery(*TAKE_OFF, 2, value=[300.0, math.nan]),
    "take-off with 100 000 ends": of_battery(*TAKE_OFF, 2, value=[300.0] * 100_000),
    "another version": put("version", value=2),
    "of another file": put("battery_sha256", value="0" * 64),
}  # fmt: skip


@pytest.mark.parametrize("damage", first_quick(20, list(DAMAGE)))
def test_damage_inside_is_not_resumed_and_said(damage: str, kept: tuple[str, float], tmp_path: Path) -> None:
    text, at_s = kept
    content = json.loads(text)
    DAMAGE[damage](content)
    path = tmp_path / "state.json"
    path.write_text(json.dumps(content))
    refused(path, at_s)


RAW: dict[str, bytes] = {
    "empty": b"",
    "null": b"null",
    "a list": b"[1, 2]",
    "a text": b'"state"',
    "nested deeply": b'{"version": 3, "batteries": ' + b"[" * 100_000,
    "nested objects": b'{"a":' * 100_000,
    "no text": bytes(range(256)) * 10,
    "cut": b'{"version": 3, "boot',
    "5000 digits": b'{"version": ' + b"9" * 5000 + b"}",
    "2 MB": b'{"version": 3, "x": "' + b"x" * 2_000_000 + b'"}',
}


@pytest.mark.parametrize("raw", RAW)
def test_what_is_no_state_is_not_resumed_and_said(raw: str, kept: tuple[str, float], tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    path.write_bytes(RAW[raw])
    refused(path, kept[1])


@cache
def begun_anew(at_s: float) -> Estimate:
    """What a process says that has no state."""
    bench = Bench(OPTIONS, start_s=at_s + SILENT_S)
    bench.play(flight()[FLOWN + 2 : FLOWN + 12])
    return bench.daemon.board.reports[0].estimate


def refused(path: Path, at_s: float) -> None:
    """The process begins anew from the rows alone, and says that it does; its next state is whole."""
    bench = restarted(path, at_s)
    bench.play(flight()[FLOWN + 2 : FLOWN + 12])
    assert "not resumed: " in notes(bench) and "resumed from" not in notes(bench)
    got, wanted = bench.daemon.board.reports[0].estimate, begun_anew(at_s)
    assert (got.soc, got.soc_sd, got.status) == (wanted.soc, wanted.soc_sd, wanted.status)
    bench.daemon.close()
    assert json.loads(path.read_text())["batteries"]["0"]["cells"] == 4


def test_a_sound_state_is_resumed_and_said_so(kept: tuple[str, float], tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    path.write_text(kept[0])
    bench = restarted(path, kept[1])
    bench.daemon.turn()
    assert notes(bench) == "a state 1 s old waits for system 1"
    bench.play(flight()[FLOWN + 2 : FLOWN + 8])
    assert notes(bench) == "battery 0: resumed from a state 2 s old"
    assert bench.daemon.board.reports[0].remaining.status == "ok"
    assert bench.daemon._reader.parameters["BATT_CAPACITY"] == 5000.0


def test_a_state_from_before_the_power_at_high_airspeed_was_learned_is_resumed(
    kept: tuple[str, float], tmp_path: Path
) -> None:
    content = json.loads(kept[0])
    of_battery(*LESSONS, slice(8, None), value=[])(content)
    path = tmp_path / "state.json"
    path.write_text(json.dumps(content))
    bench = restarted(path, kept[1])
    bench.play(flight()[FLOWN + 2 : FLOWN + 8])
    assert notes(bench) == "battery 0: resumed from a state 2 s old"
    assert bench.daemon.batteries.tracked[0].estimator.past.forecaster.route.beyond_s == 0.0


def test_a_restart_in_the_first_minutes_keeps_what_was_expected_at_take_off(
    kept: tuple[str, float], tmp_path: Path
) -> None:
    path = tmp_path / "state.json"
    path.write_text(kept[0])
    bench = restarted(path, kept[1])
    bench.play(flight()[FLOWN + 2 : FLOWN + 8])
    saved = battery(json.loads(kept[0]))
    before_belief_s, power_W, ends_s, low_s = saved["past"][0][2]
    found = bench.daemon.batteries.tracked[0].estimator.past.forecaster.at_take_off
    assert (found.power_W, list(found.end_s), list(found.low_s)) == (power_W, ends_s, low_s)
    flown_s = bench.daemon.board.reports[0].estimate.time_s - found.take_off_s
    assert flown_s == pytest.approx(saved["since_row_s"] - before_belief_s + SILENT_S + 3.0, abs=1.5)


def test_a_battery_that_is_silent_between_two_restarts_goes_on_after_them(
    kept: tuple[str, float], tmp_path: Path
) -> None:
    """The second process hears the first battery alone, for 20 s, in which the other flies as well."""
    path, content, rows = tmp_path / "state.json", json.loads(kept[0]), flight()
    content["batteries"]["1"] = content["batteries"]["0"]
    path.write_text(json.dumps(content))
    second = restarted(path, kept[1])
    second.play(rows[FLOWN + 2 : FLOWN + 42])
    second.daemon.close()
    third = restarted(path, second.now_s)
    for sample in rows[FLOWN + 44 : FLOWN + 54]:
        third.send(heartbeat(True))
        third.send(battery_status(sample, 1))
        third.daemon.turn()
        third.now_s += 0.5
    assert "battery 1: resumed from a state 2 s old" in notes(third)
    soc = third.daemon.batteries.reports[1].estimate.soc
    assert soc == pytest.approx(true_soc(rows[: FLOWN + 54]), abs=0.03)


def test_a_process_with_a_damaged_state_flies_on(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    path.write_bytes(RAW["nested deeply"])
    vehicle, station = Vehicle(free_port()), Station()
    vehicle.start()
    arguments = ("--gcs", f"udpout:127.0.0.1:{station.port}", "--capacity-ah", "5", "--state", str(path))
    try:
        with running(f"udpin:127.0.0.1:{vehicle.to[1]}", *arguments) as process:
            station.until(lambda m: m.get_type() == "NAMED_VALUE_FLOAT" and math.isfinite(m.value))
            assert process.poll() is None
    finally:
        vehicle.is_over = True
        vehicle.join(2.0)
    assert json.loads(path.read_text())["vehicle"]["system"] == 1  # the next start finds a whole one


# --- whose state it is ----------------------------------------------------------------------------------------------


def serial(uid: int) -> Any:
    return dialect.MAVLink_autopilot_version_message(0, 0, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, uid)


def met_by_system_7(kept: tuple[str, float], path: Path) -> Bench:
    """A process that begins with a state of system 1, and hears system 7."""
    path.write_text(kept[0])
    bench = restarted(path, kept[1])
    for sample in flight(0.5)[:6]:
        bench.send(heartbeat(False), system=7)
        bench.send(battery_status(sample, 0), system=7)
        bench.daemon.turn()
        bench.now_s += 0.5
    return bench


def with_parameter(path: Path, name: bytes, value: float) -> Bench:
    """A process that has heard of a vehicle, its serial number and a parameter, and ends in flight."""
    first = Bench(OPTIONS, state=section(path))
    first.send(heartbeat(True))
    first.send(serial(0xABC))
    first.send(dialect.MAVLink_param_value_message(name, value, 9, 1, 0))
    first.play(flight()[:FLOWN])
    first.daemon.close()
    return first


def test_another_vehicle_is_not_resumed(kept: tuple[str, float], tmp_path: Path) -> None:
    bench = met_by_system_7(kept, tmp_path / "state.json")
    assert "not resumed: saved state is of system 1, heard is system 7" in notes(bench)
    assert bench.daemon.board.reports[0].estimate.soc == pytest.approx(0.5, abs=0.05)
    assert "BATT_CAPACITY" not in bench.daemon._reader.parameters


def test_a_state_waits_for_its_own_vehicle_when_another_comes_first(kept: tuple[str, float], tmp_path: Path) -> None:
    bench = met_by_system_7(kept, tmp_path / "state.json")
    bench.now_s += 11.0  # system 7 is silent, and system 1 speaks of its battery
    bench.play(flight()[FLOWN : FLOWN + 10])
    assert bench.daemon.board.reports[0].system == 1
    assert "battery 0: resumed from a state 1" in notes(bench)
    assert bench.daemon._reader.parameters["BATT_CAPACITY"] == 5000.0


def test_what_is_said_in_flight_counts_once_a_resumed_parameter_was_anothers(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    first = with_parameter(path, b"BATT_LOW_VOLT", 14.0)
    bench = restarted(path, first.now_s)
    bench.send(heartbeat(True))
    bench.play(flight(0.5)[:4])
    bench.send(dialect.MAVLink_param_value_message(b"BATT_LOW_VOLT", 13.6, 9, 1, 0))  # once: it waits
    assert bench.daemon._reader.parameters["BATT_LOW_VOLT"] == 14.0
    bench.send(serial(0xDEF))
    bench.play(flight(0.5)[4:8])
    assert bench.daemon._reader.parameters["BATT_LOW_VOLT"] == pytest.approx(13.6)


@pytest.mark.parametrize("told", ["before the first row", "after it"])
def test_another_aircraft_of_the_same_number_is_not_resumed(told: str, tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    first = with_parameter(path, b"BATT_CAPACITY", 5000.0)
    assert json.loads(path.read_text())["vehicle"]["hardware"] == "0000000000000abc"
    bench = restarted(path, first.now_s)
    rows = flight(0.5)
    if told == "after it":
        bench.play(rows[:4])
        assert "resumed from" in notes(bench)
        bench.now_s += 0.5
    bench.send(heartbeat(False))
    bench.send(serial(0xDEF))
    bench.play(rows[4:20])
    assert "not resumed: saved state is of another aircraft" in notes(bench) and "resumed from" not in notes(bench)
    assert bench.daemon.board.reports[0].estimate.soc == pytest.approx(0.5, abs=0.05)
    assert "BATT_CAPACITY" not in bench.daemon._reader.parameters


def test_two_processes_on_one_file_do_not_resume_each_other(kept: tuple[str, float], tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    path.write_text(kept[0])
    bench = restarted(path, kept[1], link=LinkSection(endpoint="udpin:127.0.0.1:14999", gcs=["udpout:127.0.0.1:2"]))
    bench.play(flight(0.5)[:10])
    assert "not resumed: saved state is of another process" in notes(bench)
    assert bench.daemon.board.reports[0].estimate.soc == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize(("then", "now"), [(True, False), (False, True), (False, False)])
def test_across_boots_a_clock_that_is_not_set_tells_no_age(
    then: bool, now: bool, kept: tuple[str, float], tmp_path: Path
) -> None:
    """A Pi without power for hours goes on at the time when it stopped."""
    path = tmp_path / "state.json"
    another = {"boot_id": "another boot", "monotonic_s": 1e9, "is_clock_set": then}
    path.write_text(json.dumps(json.loads(kept[0]) | another))
    bench = restarted(path, kept[1], is_clock_set=now)
    bench.play(flight(0.5)[:10])
    assert "not resumed: the computer was started anew, and its clock is not set" in notes(bench)
    assert bench.daemon.board.reports[0].estimate.soc == pytest.approx(0.5, abs=0.05)


def test_across_boots_a_clock_that_is_set_tells_the_age(kept: tuple[str, float], tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    path.write_text(json.dumps(json.loads(kept[0]) | {"boot_id": "another boot", "monotonic_s": 1e9}))
    bench = restarted(path, kept[1])
    bench.play(flight()[FLOWN + 2 : FLOWN + 8])
    assert notes(bench) == "battery 0: resumed from a state 2 s old"


def test_a_counter_of_another_scale_makes_no_current(kept: tuple[str, float], tmp_path: Path) -> None:
    """The autopilot's counter leaps by 1000 Ah while the process is away."""
    path = tmp_path / "state.json"
    path.write_text(kept[0])
    bench = restarted(path, kept[1])
    rows = flight()[FLOWN + 2 : FLOWN + 12]
    bench.play([replace(s, consumed_Ah=s.consumed_Ah + 1000.0) for s in rows])
    assert bench.daemon.board.reports[0].estimate.soc == pytest.approx(0.97, abs=0.03)


def test_a_counter_that_has_begun_again_does_not_say_that_nothing_was_drawn(
    kept: tuple[str, float], tmp_path: Path
) -> None:
    """The autopilot was restarted, too; the load before the two minutes is all that is known of them."""
    path = tmp_path / "state.json"
    path.write_text(kept[0])
    bench, rows = restarted(path, kept[1] + 120.0), flight()[FLOWN + 2 : FLOWN + 4]
    bench.play([replace(row, consumed_Ah=0.0) for row in rows])
    drawn = rows[0].current_A * 122.0 / 3600.0 / 5.0
    found, before = bench.daemon.board.reports[0].estimate.soc, true_soc(flight()[:FLOWN])
    assert before - drawn < found < before - 0.3 * drawn  # the voltage, as of a pack that rested, has its say


# --- the one check of a belief --------------------------------------------------------------------------------------


def test_beliefs_of_a_flight_are_plausible_and_edited_ones_are_not() -> None:
    bench = Bench(OPTIONS)
    for sample in flight():
        bench.play([sample])
        belief = bench.daemon.batteries.tracked[0].estimator.belief if bench.daemon.batteries.tracked else None
        if belief is not None:
            assert judged(belief.means, belief.covariances, belief.weights) == ""
    assert belief is not None
    x, P, weight = belief.means, belief.covariances, belief.weights
    assert "soc" in judged(x + 2.0, P, weight)
    assert "soc" in judged(np.tile(belief.mean, (len(x), 1)), P * 1e-6, weight)
    assert "symmetric" in judged(x, P + np.eye(x.shape[1], k=1) * 1e-4, weight)
    assert "sum" in judged(x, P, 2.0 * weight)
    assert "without" in judged(x[1:], P, weight)


def judged(means: Array, covariances: Array, weights: Array) -> str:
    return implausible_belief(means.tolist(), covariances.tolist(), weights.tolist())


# --- a model that fails ---------------------------------------------------------------------------------------------


def test_an_error_inside_the_model_refuses_the_row_and_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(OPTIONS)
    bench.play(flight()[:20])
    with monkeypatch.context() as broken:
        broken.setattr("uavbatt.estimator.Estimator.step", lambda *_: [][0])
        bench.now_s += 0.5
        bench.play(flight()[20:24])
        shown = bench.daemon.board.reports[0]
        assert shown.remaining.status == "refused" and "IndexError in uavbatt itself" in shown.remaining.reason
    bench.now_s += 0.5
    bench.play(flight()[24:40])
    assert bench.daemon.board.reports[0].estimate.status == "ok"
