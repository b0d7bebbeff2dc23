"""A parameter that changes in the air counts when it is heard twice; live and in the replay of a telemetry log."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pytest
from daemon_bench import Bench
from frames import HOME_POSITION, smart_info
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.live.config import LinkSection, RecordSection, StateSection
from uavbatt.records import Sample
from uavbatt.simulate.dataflash_writer import write_dataflash
from uavbatt.simulate.tlog_writer import battery_status, heartbeat
from uavbatt.telemetry import read_log

OPTIONS = PackOptions()


def parameter(name: str, value: float) -> Any:
    return dialect.MAVLink_param_value_message(name.encode(), value, 9, 1, 0)


def flying(**sections: Any) -> Bench:
    """Half a minute in the air, with a capacity and a cut-off that the vehicle said on the ground."""
    bench = Bench(OPTIONS, **sections)
    bench.send(heartbeat(False))
    bench.send(parameter("BATT_CAPACITY", 5000.0))
    bench.send(parameter("BATT_CRT_VOLT", 13.2))
    bench.fly(30.0)
    return bench


def resolved(bench: Bench) -> Any:
    bench.fly(1.0, used=0.1)
    return bench.daemon.batteries.tracked[0].estimator.pack_size


@pytest.mark.parametrize(
    ("name", "forged", "what", "true"),
    [("BATT_CAPACITY", 50_000.0, "capacity_Ah", 5.0), ("BATT_CRT_VOLT", 12.0, "cutoff_V", 13.2)],
    ids=["one_forged_param_midflight", "one_forged_crt_midflight"],
)
def test_one_forged_parameter_midflight(name: str, forged: float, what: str, true: float) -> None:
    """One frame, and the same frame twice more on its way: it does not count, and the page says that it waits."""
    bench = flying()
    before = bench.daemon.board.reports[0].remaining.remaining_lo_s
    frame = bench.framed(parameter(name, forged))
    for _ in range(3):
        bench.link.incoming.append((frame, "fc"))
        bench.daemon.turn()
    assert getattr(resolved(bench), what) == pytest.approx(true)
    assert bench.daemon.board.reports[0].remaining.remaining_lo_s == pytest.approx(before, rel=0.05)
    (note,) = bench.daemon.board.notes
    assert f"{name} changed in flight from {true * (1000 if 'CAP' in name else 1):g} to {forged:g}" in note
    bench.send(parameter(name, true * (1000 if "CAP" in name else 1)))  # the vehicle says it as it was
    bench.send(parameter(name, forged))
    assert getattr(resolved(bench), what) == pytest.approx(true)
    bench.send(parameter(name, forged))  # a second frame says the same
    assert getattr(resolved(bench), what) == pytest.approx(forged / (1000 if "CAP" in name else 1))
    assert bench.daemon.board.notes == ()


def test_on_the_ground_and_for_the_first_time_a_parameter_counts_at_once() -> None:
    bench = flying()
    bench.send(parameter("BATT_LOW_VOLT", 14.0))  # never said before
    assert resolved(bench).low_V == pytest.approx(14.0)
    bench.send(heartbeat(False))
    bench.send(heartbeat(False))
    bench.send(parameter("BATT_CAPACITY", 4500.0))
    assert resolved(bench).capacity_Ah == 4.5


def test_a_smart_battery_states_the_size_of_the_pack(tmp_path: Path) -> None:
    """No parameter was heard: the number was refused for want of a capacity. It lives through a restart, too."""
    state, link = StateSection(file=str(tmp_path / "state.json")), LinkSection(endpoint="x", gcs=["y"], request=True)
    bench = Bench(OPTIONS, state=state, link=link)
    bench.send(heartbeat(False))
    bench.fly(10.0)
    assert "capacity" in str(bench.daemon.board.reports[0].remaining.reason)
    bench.send(smart_info(5200, 4))
    assert (resolved(bench).capacity_Ah, resolved(bench).cells) == (5.2, 4)
    bench.fly(60.0, used=0.1)
    bench.link.sent.clear()
    bench.send(smart_info(52_000, 4))  # forged, or damaged
    bench.daemon.turn()
    assert asked_of(bench) == []  # no autopilot has such a parameter
    (note,) = bench.daemon.board.notes
    assert note.startswith("what battery 0 says of its capacity [mAh] changed in flight from 5200 to 52000")
    assert resolved(bench).capacity_Ah == 5.2
    bench.daemon.close()
    later = Bench(OPTIONS, start_s=bench.now_s + 1.0, state=state, link=link)
    later.fly(5.0, used=0.2)
    assert resolved(later).capacity_Ah == 5.2


def test_a_battery_that_speaks_before_its_autopilot_is_heard() -> None:
    """Some send it once, when the link opens."""
    bench = Bench(OPTIONS)
    bench.send(smart_info(5200, 4))
    bench.send(heartbeat(False))
    bench.fly(10.0)
    assert resolved(bench).capacity_Ah == 5.2
    assert bench.daemon._reader.followed.pack(0).serial == "A7"


def test_a_capacity_that_the_battery_denies_is_noted() -> None:
    bench = flying()
    bench.send(smart_info(5200, 4))
    bench.fly(1.0, used=0.1)
    assert not bench.daemon.board.notes
    bench = flying()
    bench.send(smart_info(8000, 4))
    bench.fly(1.0, used=0.1)
    (note,) = bench.daemon.board.notes
    assert note == "BATT_CAPACITY is 5000 mAh, and counts; the battery itself states 8000 mAh"


def asked_of(bench: Bench) -> list[str]:
    """The parameters that were asked for since it was asked last."""
    sent = bench.link.messages
    bench.link.sent.clear()
    return [m.param_id for m in sent if m.get_type() == "PARAM_REQUEST_READ"]


def test_a_change_in_flight_is_asked_for_at_once() -> None:
    bench = flying(link=LinkSection(endpoint="x", gcs=["y"], request=True))
    bench.link.sent.clear()
    bench.send(parameter("BATT_CAPACITY", 50_000.0))
    bench.daemon.turn()
    assert asked_of(bench) == ["BATT_CAPACITY"]
    bench.send(parameter("BATT_CAPACITY", 5000.0))  # the answer
    assert resolved(bench).capacity_Ah == 5.0 and bench.daemon.board.notes == ()
    bench.send(parameter("BATT_CAPACITY", 4800.0))
    bench.daemon.turn()
    bench.send(parameter("BATT_CAPACITY", 4800.0))  # the answer to another question
    assert resolved(bench).capacity_Ah == 4.8


def test_without_an_answer_it_is_asked_for_a_few_times_only() -> None:
    bench = flying(link=LinkSection(endpoint="x", gcs=["y"], request=True))
    bench.link.sent.clear()
    bench.send(parameter("BATT_CAPACITY", 50_000.0))
    bench.fly(20.0, used=0.1)
    assert 2 <= asked_of(bench).count("BATT_CAPACITY") <= 4


def test_speeds_and_way_home_are_asked_for_once_a_home_is_known() -> None:
    """They were never asked for: the way home was that of an autopilot that nobody has changed."""
    bench = flying(link=LinkSection(endpoint="x", gcs=["y"], request=True))
    assert not {"RTL_ALT", "WPNAV_SPEED"} & set(asked_of(bench))
    bench.send(HOME_POSITION)
    bench.fly(8.0, used=0.1)
    once = asked_of(bench)
    assert {"RTL_ALT", "RTL_ALT_M", "RTL_SPEED", "WPNAV_SPEED", "WP_SPD", "LAND_SPEED"} <= set(once)
    assert not any(name.startswith(("MPC_", "RTL_RETURN")) for name in once)  # those of a PX4
    bench.send(parameter("RTL_ALT", 4000.0))
    bench.fly(30.0, used=0.1)
    assert bench.daemon._reader.navigation.settings.return_height_m == 40.0
    again = asked_of(bench)
    assert {"RTL_ALT", "RTL_ALT_M"} & set(again) == set()  # one of the two names was answered
    assert max(map(again.count, set(again))) <= 3  # and the others are asked for a few times only
    bench.fly(30.0, used=0.1)
    assert asked_of(bench) == []


def test_a_recording_begins_with_what_counts(tmp_path: Path) -> None:
    """The next file of a flight does not begin with the value that was never believed; the replay agrees."""
    bench = flying(record=RecordSection(folder=str(tmp_path), min_free_MB=0.0, max_file_MB=0.02))
    bench.send(parameter("BATT_CAPACITY", 50_000.0))
    bench.fly(120.0, used=0.1)
    bench.daemon.close()
    logs = sorted(tmp_path.glob("*.tlog"))
    assert len(logs) >= 2
    for log in logs:
        assert {facts.capacity_Ah for _, facts in read_log(log).facts if facts.critical_voltage_V > 0} == {5.0}


def log_of(path: Path, messages: list[Any], version: int) -> Path:
    link: Any = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    data = b""
    for k, message in enumerate(messages):
        if isinstance(message, bytes):
            frame = message
        else:
            frame = bytes(message.pack(link, force_mavlink1=version == 1))
            link.seq = (link.seq + 1) % 256
        data += struct.pack(">Q", 1_700_000_000_000_000 + k * 1_000_000) + frame
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("version", [1, 2])
def test_a_telemetry_log_is_read_by_the_same_rule(tmp_path: Path, version: int) -> None:
    """Cut anywhere it gives the same facts up to the cut."""
    row = battery_status(Sample(0.0, 16.0, 12.0, 25.0, 0.1), 0)
    small, big = parameter("BATT_CAPACITY", 5000.0), parameter("BATT_CAPACITY", 50_000.0)
    once = bytes(big.pack(dialect.MAVLink(None, srcSystem=1, srcComponent=1), force_mavlink1=version == 1))
    messages = [heartbeat(False), small, row, heartbeat(True), once, row, once, row, small, big, row, big, row]
    whole = read_log(log_of(tmp_path / "whole.tlog", messages, version)).facts
    assert [(at_s, facts.capacity_Ah) for at_s, facts in whole] == [(1.0, 5.0), (11.0, 50.0)]
    for cut in range(3, len(messages)):
        part = read_log(log_of(tmp_path / "cut.tlog", messages[:cut], version)).facts
        assert part == tuple(fact for fact in whole if fact[0] < cut)


def test_the_vehicles_own_log_is_believed(tmp_path: Path) -> None:
    """A DataFlash log is the vehicle's own record: nobody can have forged a line of it on the way."""
    log = tmp_path / "own.BIN"
    write_dataflash(log, [Sample(float(k), 16.0, 12.0, armed=True) for k in range(5)], {"BATT_CAPACITY": 5000.0})
    assert read_log(log).facts[-1][1].capacity_Ah == 5.0


def test_after_a_minute_of_silence_a_parameter_counts_before_the_first_heartbeat(tmp_path: Path) -> None:
    """The link broke before the landing, the pack was changed, and the vehicle tells its parameters as it begins."""
    bench = flying()
    for silence_s, counted_Ah in ((50.0, 5.0), (61.0, 4.0)):
        bench.now_s += silence_s
        bench.send(parameter("BATT_CAPACITY", 4000.0))
        bench.daemon.turn()
        assert resolved(bench).capacity_Ah == counted_Ah
        bench.send(parameter("BATT_CAPACITY", counted_Ah * 1000.0))


@pytest.mark.parametrize(("silence", "capacity_Ah"), [(50, 5.0), (61, 4.0)])
def test_a_telemetry_log_goes_on_after_a_silence_by_the_same_rule(
    tmp_path: Path, silence: int, capacity_Ah: float
) -> None:
    row = battery_status(Sample(0.0, 16.0, 12.0, 25.0, 0.1), 0)
    begin = log_of(tmp_path / "begin.tlog", [parameter("BATT_CAPACITY", 5000.0), heartbeat(True), row], 2).read_bytes()
    later = log_of(tmp_path / "later.tlog", [b""] * (2 + silence) + [parameter("BATT_CAPACITY", 4000.0), row], 2)
    log = tmp_path / "whole.tlog"
    log.write_bytes(begin + later.read_bytes()[8 * (2 + silence) :])
    assert read_log(log).facts[-1][1].capacity_Ah == capacity_Ah
