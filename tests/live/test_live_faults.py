"""Bad links and bad luck: the estimate stays right, or says that it is not known."""

from __future__ import annotations

import json
import math
import os
import random
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from cases import first_quick
from daemon_bench import Bench
from factories import generic_pack
from live_rig import ROOT
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt import output
from uavbatt.battery import battery_file, model
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.estimator import Estimator
from uavbatt.live.config import FeedSection, LinkSection, RecordSection, StateSection
from uavbatt.live.feeds.web import content
from uavbatt.live.report import Report
from uavbatt.log_replay.run import steps
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.records import Sample
from uavbatt.simulate.flight import SimulatedFlight, simulate_flight
from uavbatt.simulate.tlog_writer import battery_status, heartbeat
from uavbatt.telemetry import read_log

OPTIONS = PackOptions(capacity_Ah=5.0, cells=4, cutoff_V=13.2)
SELDOM = ForecastSettings(forecast_period_s=30.0)  # most of the work is forecasts, and these facts need few
GROUND_ROWS, FLIGHT_ROWS = 40, 360  # at 2 Hz: 20 s on the ground, then three minutes


@cache
def flight(start_soc: float = 1.0, seed: int = 1) -> tuple[Sample, ...]:
    pack = generic_pack(4, 5.0, 13.2, math.nan)
    return tuple(
        simulate_flight(pack, SimulatedFlight(power_W=180.0, start_soc=start_soc, seed=seed))[
            : GROUND_ROWS + FLIGHT_ROWS
        ]
    )


def true_soc(samples: tuple[Sample, ...], start_soc: float = 1.0) -> float:
    return start_soc - samples[-1].consumed_Ah / 5.0


@cache
def undisturbed() -> Report:
    bench = Bench(OPTIONS, settings=SELDOM)
    bench.play(flight())
    return bench.daemon.board.reports[0]


def agrees(bench: Bench, wanted: Report) -> None:
    """Each median is inside the other's interval, and the charge is right."""
    got = bench.daemon.board.reports[0]
    ours, clean = got.remaining, wanted.remaining
    assert clean.remaining_lo_s < ours.remaining_s < clean.remaining_hi_s
    assert ours.remaining_lo_s < clean.remaining_s < ours.remaining_hi_s
    assert got.estimate.soc == pytest.approx(wanted.estimate.soc, abs=0.03)
    assert got.estimate.soc == pytest.approx(true_soc(flight()), abs=0.03)


@pytest.mark.parametrize("fault", first_quick(1, ["all", "loss", "duplicates", "reordering"]))
def test_a_bad_radio_does_not_move_the_estimate(fault: str) -> None:
    bench, dice, late = Bench(OPTIONS, settings=SELDOM), random.Random(7), []
    for sample in flight():
        frames = [bench.framed(heartbeat(bool(sample.armed))), bench.framed(battery_status(sample, 0))]
        if fault in ("loss", "all"):
            frames = [f for f in frames if dice.random() >= 0.1]
        if fault in ("duplicates", "all"):
            frames += [f for f in frames if dice.random() < 0.2]
        if fault in ("reordering", "all") and dice.random() < 0.1:
            late += frames[-1:]  # comes after the next ones
            frames = frames[:-1]
        elif late:
            frames, late = frames + late, []
        bench.link.incoming = [(frame, "fc") for frame in frames]
        bench.daemon.turn()
        bench.now_s += 0.5
    agrees(bench, undisturbed())


def test_a_gap_of_a_minute_is_stale_everywhere_and_then_bridged() -> None:
    bench = Bench(OPTIONS, settings=SELDOM, feed=FeedSection(kinds=("named", "battery")))
    bench.play(flight()[:200])
    bench.now_s += 4.0
    bench.station.sent.clear()
    bench.daemon.turn()
    assert all(math.isnan(v) for v in bench.named().values()) and bench.named()
    assert {m.time_remaining for m in bench.to_gcs() if m.get_type() == "BATTERY_STATUS"} == {0}
    now = content(bench.daemon.board, bench.now_s)
    assert (now["status"], now["batteries"][0]["remaining_s"]) == ("stale", None)
    assert any("unknown, no telemetry" in m.text for m in bench.to_gcs() if m.get_type() == "STATUSTEXT")
    bench.now_s += 56.5
    bench.play(flight()[321:])
    agrees(bench, undisturbed())


def test_an_autopilot_that_starts_anew_in_flight_changes_nothing() -> None:
    """Its charge counter begins at zero, its battery is unknown for a row, its clock says a few seconds."""
    bench = Bench(OPTIONS, settings=SELDOM)
    bench.play(flight()[:200])
    bench.now_s += 8.5
    bench.send(dialect.MAVLink_system_time_message(0, 900))
    bench.send(battery_status(Sample(0.0, math.nan, math.nan, math.nan, math.nan), 0))
    drawn_Ah = flight()[216].consumed_Ah
    bench.play([replace(s, consumed_Ah=s.consumed_Ah - drawn_Ah, reported_soc=1.0) for s in flight()[217:]])
    agrees(bench, undisturbed())


@pytest.mark.parametrize(("new_soc", "gap_s"), first_quick(1, [(0.5, 30.0), (1.0, 30.0), (0.5, 300.0)]))
@pytest.mark.parametrize("companion", ["stays on", "starts anew"])
def test_a_changed_pack_is_noticed_on_the_ground(tmp_path: Path, new_soc: float, gap_s: float, companion: str) -> None:
    state = StateSection(file=str(tmp_path / "state.json"))
    flown = flight() if new_soc == 1.0 else flight()[:160]  # until a full pack is not the one that was flown
    bench = Bench(OPTIONS, settings=SELDOM, state=state)
    bench.play(flown)
    before = bench.daemon.board.reports[0].estimate
    if companion == "starts anew":
        bench.daemon.close()
        bench = Bench(OPTIONS, settings=SELDOM, start_s=bench.now_s, state=state)
    bench.now_s += gap_s
    another = flight(new_soc, seed=5)
    bench.play(another[:GROUND_ROWS])
    rested = bench.daemon.board.reports[0].estimate
    assert before.soc == pytest.approx(true_soc(flown), abs=0.03)
    assert rested.soc == pytest.approx(new_soc, abs=0.03)
    assert abs(rested.soc - new_soc) < 3.0 * rested.soc_sd + 0.001
    bench.now_s += 0.5
    bench.play(another[GROUND_ROWS : GROUND_ROWS + 60])
    shown = bench.daemon.board.reports[0]
    assert shown.estimate.soc == pytest.approx(true_soc(another[: GROUND_ROWS + 60], new_soc), abs=0.04)
    assert shown.remaining.remaining_s < 1800.0 * new_soc


def test_the_same_pack_after_a_rest_is_no_other() -> None:
    """Landed, silent for a minute while its voltage recovers, heard again: the belief goes on, bettered by rest."""
    pack = generic_pack(4, 5.0, 13.2, math.nan)
    cell, state = pack.cell, model.rested(1.0, 20.0)
    bench, rows = Bench(OPTIONS, settings=SELDOM), []
    for k in range(1000):
        amps = 12.0 if k < 800 else 0.2
        if k % 2 == 0 and (k < 800 or k >= 920):
            volts = 4.0 * float(model.cell_voltage(cell, state, amps / 5.0))
            rows.append(Sample(k / 2.0, volts, amps, 20.0, min(k, 800) * 6.0 / 3600.0, armed=k < 800))
        state = model.step(cell, state, amps / 5.0, 20.0, 0.5, model.lags(cell, 0.5))
    bench.play(rows[:400])
    landed = bench.daemon.board.reports[0].estimate
    bench.now_s += 60.0
    bench.play(rows[400:])
    now = bench.daemon.board.reports[0].estimate
    true_soc = 1.0 - 800 * 6.0 / 3600.0 / 5.0
    assert abs(now.soc - true_soc) < min(0.03, abs(landed.soc - true_soc))
    assert abs(now.soc - landed.soc) < 2.0 * landed.soc_sd and now.soc_sd < landed.soc_sd


def test_rows_that_are_always_slow_are_no_silence() -> None:
    bench = Bench(OPTIONS, settings=SELDOM)
    bench.play([Sample(20.0 * k, 16.6, 0.1, 20.0, 0.0, armed=False) for k in range(6)])
    assert bench.daemon.batteries.tracked[0].estimator._state.swap.silence is None
    bench.now_s += 100.0
    bench.play([Sample(20.0 * k, 16.6, 0.1, 20.0, 0.0, armed=False) for k in range(3)])
    assert bench.daemon.batteries.tracked[0].estimator._state.swap.silence is not None


@pytest.mark.parametrize("jump_s", first_quick(1, [-7200.0, 86_400.0]))
def test_a_jump_of_the_wall_clock_moves_neither_estimate_nor_recording(tmp_path: Path, jump_s: float) -> None:
    bench = Bench(OPTIONS, settings=SELDOM, record=RecordSection(folder=str(tmp_path), min_free_MB=0.0))
    bench.play(flight()[:200])
    bench.wall_offset_s += jump_s
    bench.now_s += 0.5
    bench.play(flight()[200:])
    agrees(bench, undisturbed())
    bench.daemon.close()
    (log,), (lines,) = tmp_path.glob("*.tlog"), tmp_path.glob("*.jsonl")
    run = steps(read_log(log), Estimator(battery_file.read_battery("lipo-generic"), OPTIONS, SELDOM))
    assert [json.loads(t) for t in lines.read_text().splitlines()] == [
        output.line(s.estimate, s.remaining) for s in run
    ]


@pytest.mark.parametrize("silent_s", [2.0, 30.0])
def test_after_a_crash_the_time_is_back_and_inside_its_interval(tmp_path: Path, silent_s: float) -> None:
    """Killed in flight (nothing is flushed), started again: the number is there with the first row, the load known."""
    state = StateSection(file=str(tmp_path / "state.json"))
    first = Bench(OPTIONS, settings=SELDOM, state=state)
    first.play(flight()[:-80])
    past = first.daemon.batteries.tracked[0].estimator.past
    second = Bench(OPTIONS, settings=SELDOM, start_s=first.now_s + silent_s, state=state)
    later = flight()[len(flight()) - 80 + int(2 * silent_s) - 1 :]
    second.play(later[:2])
    shown, clean = second.daemon.board.reports[0], undisturbed().remaining
    assert shown.remaining.status == "ok"
    waited_s = (len(flight()) - len(later) + 1) / 2.0
    assert shown.remaining.remaining_lo_s < clean.remaining_s + 200.0 - waited_s < shown.remaining.remaining_hi_s
    second.now_s += 0.5
    second.play(later[2:])
    agrees(second, undisturbed())
    now = second.daemon.batteries.tracked[0].estimator.past
    assert past is not None and now is not None
    assert now.forecaster.flight.flown_s == pytest.approx(180.0, abs=8.0)
    assert now.forecaster.flight.load.mean_W == pytest.approx(180.0, rel=0.2)


def test_the_vehicle_that_is_named_is_the_one() -> None:
    """Two autopilots on one port: the first heard, or the one whose system is given."""
    for system, wanted_V in ((None, 16.0), (7, 15.0)):
        bench = Bench(OPTIONS, settings=SELDOM, link=LinkSection(endpoint="x", gcs=["y"], system=system))
        for k in range(10):
            for sender, volts in ((1, 16.0), (7, 15.0)):
                bench.send(heartbeat(True), system=sender)
                bench.send(battery_status(Sample(0.0, volts, 12.0, 25.0, k / 3000), 0), system=sender)
            bench.daemon.turn()
            bench.now_s += 0.1
        assert [r.estimate.voltage_V for r in bench.daemon.board.reports] == [pytest.approx(wanted_V)]
        assert {m.get_srcSystem() for m in bench.to_gcs() if m.get_type() == "NAMED_VALUE_FLOAT"} == {system or 1}


def test_a_state_is_too_old_when_the_telemetry_begins_too_late(tmp_path: Path) -> None:
    state = StateSection(file=str(tmp_path / "state.json"))
    first = Bench(OPTIONS, settings=SELDOM, state=state)
    first.play(flight()[:120])
    second = Bench(OPTIONS, settings=SELDOM, start_s=first.now_s + 400.0, state=state)
    second.daemon.turn()
    second.now_s += 400.0  # the autopilot is switched on now
    second.play(flight(0.5)[:20])
    assert second.daemon.board.reports[0].estimate.soc == pytest.approx(0.5, abs=0.03)


def test_one_frame_that_slipped_through_the_checksum_forges_nothing() -> None:
    """A battery that nobody has, a voltage out of the blue, cells that no cell is like: nobody sees them."""
    bench = Bench(OPTIONS, settings=SELDOM)
    bench.play(flight()[:200])
    for volts, instance in (([17200] + [65535] * 9, 89), ([16000, 257, 147, 25600] + [65535] * 6, 0)):
        damaged = dialect.MAVLink_battery_status_message(instance, 0, 0, 2500, volts, 15430, 100, -1, 80)
        bench.send(damaged)
        bench.daemon.turn()
    bench.now_s += 0.5
    bench.play(flight()[200:])
    assert [r.instance for r in bench.daemon.board.reports] == [0]
    agrees(bench, undisturbed())


@pytest.mark.parametrize(
    "odd",
    [
        dialect.MAVLink_mission_clear_all_message(1, 1, 0),
        dialect.MAVLink_mission_write_partial_list_message(1, 1, 0, 3),
        dialect.MAVLink_wind_message(math.inf, 3.0, 0.0),
    ],
    ids=["clear all", "write partial list", "wind"],
)
def test_a_frame_that_no_autopilot_sends_does_not_end_the_process(odd: dialect.MAVLink_message) -> None:
    """Each of them, under the autopilot's own address, was the last that the process took."""
    bench = Bench(OPTIONS, settings=SELDOM)
    bench.play(flight()[:200])
    bench.send(odd)
    bench.daemon.turn()
    bench.now_s += 0.5
    bench.play(flight()[200:])
    agrees(bench, undisturbed())


def test_a_hundred_thousand_damaged_frames_forge_nothing() -> None:
    """A tenth of what scripts/fuzz_live.py sends when it is run alone."""
    command = [sys.executable, str(ROOT / "scripts/fuzz_live.py"), "--frames", "100000", "--seed", "5"]
    env = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=env)
    assert done.returncode == 0, done.stdout + done.stderr[-500:]
