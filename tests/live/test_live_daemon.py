"""The loop with a clock of the test: what is estimated, recorded, resumed, and what each feed says of it."""

from __future__ import annotations

import json
import math
import random
from pathlib import Path

import pytest
from daemon_bench import Bench
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt import output
from uavbatt.battery import battery_file
from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.estimator import Estimator
from uavbatt.live.config import FeedSection, LinkSection, RecordSection, StateSection
from uavbatt.live.feeds.web import content, metrics
from uavbatt.log_replay.run import steps
from uavbatt.mavlink import framing
from uavbatt.prediction.forecaster import ForecastSettings
from uavbatt.records import Sample
from uavbatt.simulate.tlog_writer import battery_status, heartbeat
from uavbatt.telemetry import read_log
from uavbatt.telemetry.formats.recording import forecast_period_s


def test_a_flight_reaches_every_feed() -> None:
    bench = Bench(feed=FeedSection(kinds=("named", "battery")))
    bench.fly(20.0)
    report = bench.daemon.board.reports[0]
    shown = report.at(bench.now_s)
    said = bench.named()
    assert shown.remaining_lo_s < shown.remaining_s < shown.remaining_hi_s
    assert said["REM_S"] == pytest.approx(shown.remaining_s, abs=1.0)
    assert said["REM_LO_S"] < said["REM_S"] < said["REM_HI_S"] and said["SOC"] == pytest.approx(shown.soc, abs=0.01)
    own = [m for m in bench.to_gcs() if m.get_type() == "BATTERY_STATUS"][-1]
    assert (own.get_srcSystem(), own.get_srcComponent(), own.id) == (1, 180, 8)
    assert own.time_remaining == pytest.approx(shown.remaining_s, abs=1.5)
    assert {m.type for m in bench.to_gcs() if m.get_type() == "HEARTBEAT"} == {18, 36}
    assert content(bench.daemon.board, bench.now_s)["batteries"][0]["status"] == shown.status


def test_silence_is_stale_everywhere_after_three_seconds() -> None:
    bench = Bench(feed=FeedSection(kinds=("named", "battery")))
    bench.fly(20.0)
    bench.now_s += 3.5
    bench.station.sent.clear()
    bench.daemon.turn()
    assert all(math.isnan(value) for value in bench.named().values()) and bench.named()
    own = [m for m in bench.to_gcs() if m.get_type() == "BATTERY_STATUS"][-1]
    assert (own.time_remaining, own.battery_remaining, own.voltages[0], own.temperature) == (0, -1, 65535, 32767)
    now = content(bench.daemon.board, bench.now_s)
    assert (now["status"], now["batteries"][0]["remaining_s"], now["batteries"][0]["soc"]) == ("stale", None, None)
    scraped = metrics(bench.daemon.board, bench.now_s).decode()
    assert 'uavbatt_remaining_seconds{battery="0",quantile="0.5"} NaN' in scraped


def test_a_scraper_can_tell_waiting_for_take_off_from_a_refusal() -> None:
    bench = Bench()
    bench.play(Sample(0.5 * k, 16.7, 0.5, 20.0, armed=False) for k in range(8))
    waiting = metrics(bench.daemon.board, bench.now_s).decode()
    assert 'uavbatt_waiting{battery="0"} 1.0' in waiting and 'status="refused"} 1.0' in waiting
    bench.fly(60.0)
    assert 'uavbatt_waiting{battery="0"} 0.0' in metrics(bench.daemon.board, bench.now_s).decode()


def test_only_three_messages_travel_towards_the_autopilot() -> None:
    bench = Bench(link=LinkSection(endpoint="x", gcs=["y"], request=True), feed=FeedSection(kinds=("named", "battery")))
    bench.fly(30.0)
    sent = bench.link.messages
    assert {m.get_type() for m in sent} == {"HEARTBEAT", "COMMAND_LONG", "PARAM_REQUEST_READ"}
    assert {m.command for m in sent if m.get_type() == "COMMAND_LONG"} == {511}
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in sent} == {(1, 193)}
    quiet = Bench()
    quiet.fly(5.0)
    assert {framing.header(data).message_id for data in quiet.link.sent} == {0}


def test_a_recording_replays_to_the_same_lines(tmp_path: Path) -> None:
    settings = ForecastSettings(forecast_period_s=1.0)
    bench = Bench(PackOptions(), record=RecordSection(folder=str(tmp_path), min_free_MB=0.0), settings=settings)
    bench.send(heartbeat(False))
    bench.send(dialect.MAVLink_param_value_message(b"BATT_CAPACITY", 5000.0, 9, 1, 0))
    bench.fly(30.0, volts=16.2)
    bench.now_s += 8.0  # the link is lost for a while
    bench.fly(30.0, volts=16.0, used=0.13)
    bench.daemon.close()
    (log,), (lines,) = tmp_path.glob("*.tlog"), tmp_path.glob("*.battery0.jsonl")
    assert forecast_period_s(log.read_bytes()) == read_log(log).forecast_period_s == 1.0
    estimator = Estimator(battery_file.read_battery("lipo-generic"), settings=settings)
    replayed = [output.line(s.estimate, s.remaining) for s in steps(read_log(log), estimator)]
    assert [json.loads(text) for text in lines.read_text().splitlines()] == replayed
    assert len(replayed) == 300


def test_a_recording_is_on_the_disk_within_a_second(tmp_path: Path) -> None:
    """The companion computer loses its power with the pack: what is not written by then is gone."""
    bench = Bench(record=RecordSection(folder=str(tmp_path), min_free_MB=0.0))
    bench.fly(8.0)
    (raw,), (lines,) = tmp_path.glob("*.tlog"), tmp_path.glob("*.jsonl")
    assert len(read_log(raw).samples) >= 35 and len(lines.read_text().splitlines()) >= 35
    bench.daemon.close()


def test_a_crash_is_resumed_with_the_charge_drawn_meanwhile(tmp_path: Path) -> None:
    state = StateSection(file=str(tmp_path / "state.json"))
    first = Bench(state=state)
    first.fly(60.0)
    before = first.daemon.board.reports[0].estimate
    second = Bench(state=state, start_s=first.now_s + 30.0)
    used = 12.0 * 60.0 / 3600.0
    second.fly(4.0, volts=15.85, used=used + 0.15)
    after = second.daemon.board.reports[0].estimate
    assert "resumed" in second.daemon.board.notes[0]
    assert before.soc - after.soc == pytest.approx(0.15 / 5.0, abs=0.03)
    assert after.status in ("ok", "converging") and second.daemon.board.reports[0].at(second.now_s).remaining_s > 0
    third = Bench(state=state, start_s=second.now_s + 700.0)
    third.daemon.turn()
    assert third.daemon.board.notes[0] == "not resumed: saved state is 739 s old"


def test_a_parameter_that_is_no_number_costs_no_saved_state(tmp_path: Path) -> None:
    state = StateSection(file=str(tmp_path / "state.json"))
    first = Bench(state=state)
    first.send(dialect.MAVLink_param_value_message(b"BATT_LOW_VOLT", math.nan, 9, 2, 0))
    first.send(dialect.MAVLink_param_value_message(b"BATT_CRT_VOLT", 13.2, 9, 2, 1))
    first.fly(60.0)
    first.daemon.close()
    assert json.loads(Path(state.file).read_text())["parameters"] == {"BATT_CRT_VOLT": pytest.approx(13.2)}
    second = Bench(state=state, start_s=first.now_s + 1.0)
    second.fly(1.0)
    assert second.daemon.board.notes[0].startswith("battery 0: resumed from a state ")


@pytest.mark.parametrize("capacity_Ah", [math.nan, 5.0])
def test_the_log_has_a_line_about_the_pack_and_no_more(capacity_Ah: float, capsys: pytest.CaptureFixture[str]) -> None:
    Bench(PackOptions(cells=4, capacity_Ah=capacity_Ah)).fly(20.0)
    lines = [line for line in capsys.readouterr().err.splitlines() if "battery 0: " in line]
    assert len(lines) == 1 and ("no estimate yet: capacity: " in lines[0]) == math.isnan(capacity_Ah)


def fly_on(bench: Bench, *batteries: int) -> None:
    """Fly half a minute on these batteries at 12 A each."""
    for k in range(60):
        bench.send(heartbeat(True))
        for instance in batteries:
            drawn = 12.0 * k / 7200.0
            bench.send(battery_status(Sample(0.0, 16.0 - 0.5 * drawn, 12.0, 25.0, drawn, armed=True), instance))
        bench.daemon.turn()
        bench.now_s += 0.5


def test_a_battery_that_was_silent_for_a_day_costs_no_other_its_state(tmp_path: Path) -> None:
    state = StateSection(file=str(tmp_path / "state.json"))
    first = Bench(state=state)
    fly_on(first, 0, 1)
    first.now_s += 86_500.0
    fly_on(first, 0)
    first.daemon.close()
    second = Bench(state=state, start_s=first.now_s + 1.0)
    fly_on(second, 0, 1)
    (note,) = [note for note in second.daemon.board.notes if "resumed" in note]
    assert note.startswith("battery 0: resumed from a state ")


def test_a_second_vehicle_is_not_ours() -> None:
    bench = Bench()
    bench.fly(2.0)
    for _ in range(20):
        bench.send(battery_status(Sample(0.0, 9.0, 50.0, 25.0, 4.0), 0), system=2, sender="other")
        bench.send(battery_status(Sample(0.0, 9.0, 50.0, 25.0, 4.0), 0), component=180, sender="other")
        bench.now_s += 0.1
        bench.daemon.turn()
    assert bench.daemon.board.counts["rows"] == 10
    assert [r.system for r in bench.daemon.board.reports] == [1]


def test_two_batteries_each_have_an_estimate_and_ids_stay_apart() -> None:
    bench = Bench(feed=FeedSection(kinds=("named", "battery")))
    for k in range(100):
        bench.send(heartbeat(True))
        for id in (0, 8):
            bench.send(battery_status(Sample(0.0, 16.0, 12.0, 25.0, k / 3000), id))
        bench.daemon.turn()
        bench.now_s += 0.2
    assert [r.instance for r in bench.daemon.board.reports] == [0, 8]
    assert {"REM_S", "SOC", "REM_S_8", "REM_LO_S_8", "REM_HI_S_8", "SOC_8"} <= set(bench.named())
    assert {m.id for m in bench.to_gcs() if m.get_type() == "BATTERY_STATUS"} == {7, 6}


def test_sys_status_speaks_only_where_nothing_else_does() -> None:
    bench = Bench()
    for _ in range(40):
        bench.send(dialect.MAVLink_sys_status_message(0, 0, 0, 0, 16000, 1200, 70, 0, 0, 0, 0, 0, 0))
        bench.daemon.turn()
        bench.now_s += 0.25
    assert bench.daemon.board.counts["rows"] == 40  # those held for five seconds too
    for _ in range(2):  # the first waits for the second
        bench.send(battery_status(Sample(0.0, 16.0, 12.0), 0))
    bench.send(dialect.MAVLink_sys_status_message(0, 0, 0, 0, 16000, 1200, 70, 0, 0, 0, 0, 0, 0))
    bench.daemon.turn()
    assert bench.daemon.board.counts["rows"] == 42


def test_alarms_speak_once_a_threshold() -> None:
    bench = Bench(options=PackOptions(capacity_Ah=1.0, cells=4, cutoff_V=14.0))
    bench.fly(240.0, volts=16.2)
    texts = [m.text for m in bench.to_gcs() if m.get_type() == "STATUSTEXT"]
    shown = [text for _, text in bench.daemon.board.announcements if "left at worst" in text]
    assert 1 <= len(shown) <= 3 and all(len(text) <= 50 for text in texts)
    assert sum("left at worst" in text for text in texts) <= 3 + 2 * 2  # those of two minutes and less come again


@pytest.mark.parametrize("target", ["/dev/full", "free"])
def test_a_full_disk_stops_the_recording_only(tmp_path: Path, target: str) -> None:
    bench = Bench(record=RecordSection(folder=str(tmp_path), min_free_MB=1e9 if target == "free" else 0.0))
    if target == "/dev/full":
        bench.fly(0.2)
        recorder = bench.daemon._recorder
        assert recorder is not None
        recorder._raw = open(target, "wb", buffering=0)  # noqa: SIM115
    bench.fly(5.0)
    assert any("not recording" in note for note in bench.daemon.board.notes)
    assert bench.daemon.board.reports[0].at(bench.now_s).soc > 0.0


def test_nan_and_refusal_are_never_zero_seconds() -> None:
    bench = Bench(options=PackOptions(), feed=FeedSection(kinds=("named", "battery")))  # nobody states a capacity
    bench.fly(6.0)
    assert math.isnan(bench.named()["REM_S"])
    assert [m.time_remaining for m in bench.to_gcs() if m.get_type() == "BATTERY_STATUS"][-1] == 0  # not provided
    assert "capacity" in content(bench.daemon.board, bench.now_s)["reason"]


def test_damaged_frames_neither_crash_nor_forge_an_estimate() -> None:
    """20 000 chunks of noise, cut frames and flipped bits: every row that counts was sent whole by somebody."""
    bench, dice = Bench(), random.Random(3)
    bench.fly(2.0)
    good = bytes(battery_status(Sample(0.0, 16.0, 12.0, 25.0, 0.1), 0).pack(bench._out))
    for k in range(20_000):
        bad = bytearray(good)
        bad[dice.randrange(1, len(bad))] ^= 1 << dice.randrange(8)
        piece = (bytes(bad), good[: dice.randrange(len(good))], dice.randbytes(dice.randrange(80)))[k % 3]
        bench.link.incoming.append((piece, dice.randrange(3)))
        if k % 10 == 0:
            bench.daemon.turn()
            bench.now_s += 0.001
    assert bench.daemon.board.counts["rows"] <= 10 + 20  # a cut frame may be made whole by the piece behind it
    estimate = bench.daemon.board.reports[0].estimate
    assert (estimate.voltage_V, estimate.current_A) == (pytest.approx(16.0, abs=0.01), 12.0)
    bench.now_s += 1.0
    bench.fly(4.0)
    assert bench.daemon.board.reports[0].estimate.status != "refused"
