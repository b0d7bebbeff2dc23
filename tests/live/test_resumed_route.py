"""A process that is started anew in the air still knows home and mission: the vehicle told them once."""

from __future__ import annotations

import base64
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from daemon_bench import Bench
from frames import HOME_POSITION
from pymavlink.dialects.v20 import ardupilotmega as dialect
from test_live_route import item, reader, second, upload

from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.live.config import RecordSection, StateSection
from uavbatt.simulate.tlog_writer import heartbeat
from uavbatt.telemetry import read_log

OTHER = {"system": 9, "component": 1}


def section(folder: Path) -> StateSection:
    return StateSection(file=str(folder / "state.json"))


def flown(folder: Path, told_total: int = 0) -> Bench:
    """A flight of 40 s with a mission by another station, after which the process ends."""
    bench = Bench(PackOptions(), state=section(folder))
    bench.send(heartbeat(True, 3))
    for name, value in ((b"RTL_ALT", 3000.0), (b"BATT_CAPACITY", 5000.0)):
        bench.send(dialect.MAVLink_param_value_message(name, value, 9, 2, 0))
    bench.send(serial(0xABC))
    bench.send(HOME_POSITION)
    for k in range(40):
        if k == 5:
            upload(bench)
        second(bench, k)
    if told_total:
        bench.send(dialect.MAVLink_mission_current_message(3, told_total))
        second(bench, 40)
    bench.daemon.close()
    return bench


def tell_two_items(bench: Bench) -> None:
    """The autopilot tells another mission to a station."""
    bench.send(dialect.MAVLink_mission_count_message(255, 190, 2))
    for seq in range(2):
        bench.send(item(seq, (255, 190)))
    bench.daemon.turn()


def serial(uid: int) -> Any:
    """AUTOPILOT_VERSION with the serial number of the autopilot."""
    return dialect.MAVLink_autopilot_version_message(0, 0, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, uid)


def restarted(folder: Path, at_s: float, **sections: Any) -> Bench:
    """The process anew, three seconds later; it has heard two seconds of telemetry."""
    bench = Bench(PackOptions(), start_s=at_s + 3.0, state=section(folder), **sections)
    for k in range(44, 47):
        second(bench, k)
    return bench


def edited(folder: Path, told: bytes) -> None:
    """Put other frames into the saved state."""
    path = folder / "state.json"
    content = json.loads(path.read_text())
    path.write_text(json.dumps({**content, "told": base64.b64encode(told).decode()}))


def test_a_restart_in_the_air_keeps_home_mission_and_the_way_back(tmp_path: Path) -> None:
    before = flown(tmp_path)
    for _ in range(2):  # the second process takes them from the first, the third from the second
        after = restarted(tmp_path, before.now_s)
        was, now = reader(before).navigation, reader(after).navigation
        assert was.mission is not None
        assert (now.mission, now.home, repr(now.settings)) == (was.mission, was.home, repr(was.settings))
        assert not now.transferring
        before = after
        before.daemon.close()


def test_a_recording_after_a_restart_is_replayed_on_its_own(tmp_path: Path) -> None:
    before = flown(tmp_path)
    bench = restarted(tmp_path, before.now_s, record=RecordSection(folder=str(tmp_path / "logs"), when="always"))
    bench.daemon.close()
    (log,) = (tmp_path / "logs").glob("*.tlog")
    found = read_log(log)
    last = found.navigation[-1]
    assert found.facts_at(math.inf).capacity_Ah == 5.0
    assert last.settings.return_height_m == 30.0
    was = reader(before).navigation
    assert (last.mission, last.home) == (replace(was.mission, source=last.mission.source), was.home)


def test_what_the_vehicle_tells_itself_has_priority(tmp_path: Path) -> None:
    before = flown(tmp_path)
    bench = Bench(start_s=before.now_s + 3.0, state=section(tmp_path))
    bench.send(heartbeat(True, 3))
    bench.send(dialect.MAVLink_home_position_message(471000000, 80000000, 400_000, 0, 0, 0, [1.0, 0, 0, 0], 0, 0, 0))
    tell_two_items(bench)
    for k in range(44, 47):
        second(bench, k)
    now = reader(bench).navigation
    assert now.home is not None and now.home.lat_deg == pytest.approx(47.1)
    assert now.mission is not None and len(now.mission.items) == 2


def test_a_home_that_is_heard_anew_does_not_cost_the_mission(tmp_path: Path) -> None:
    before = flown(tmp_path)
    bench = Bench(PackOptions(), start_s=before.now_s + 3.0, state=section(tmp_path))
    bench.send(heartbeat(True, 3))
    bench.send(HOME_POSITION)
    for k in range(44, 47):
        second(bench, k)
    assert reader(bench).navigation.mission == reader(before).navigation.mission


def test_only_the_last_mission_is_kept(tmp_path: Path) -> None:
    bench = flown(tmp_path)
    vehicle = reader(bench).followed
    assert vehicle is not None
    once = vehicle.told
    upload(bench)
    tell_two_items(bench)
    assert len(vehicle.told) < len(once)


@pytest.mark.parametrize("when", ["before the restart", "after it"])
def test_another_mission_than_was_read_is_not_used_after_a_restart(when: str, tmp_path: Path) -> None:
    before = flown(tmp_path, told_total=7 if when == "before the restart" else 0)
    bench = restarted(tmp_path, before.now_s)
    if when == "before the restart":
        assert reader(bench).navigation.mission is None
        return
    bench.send(dialect.MAVLink_mission_current_message(3, 7))
    second(bench, 47)
    mission = reader(bench).navigation.mission
    assert mission is not None and mission.reason == "the autopilot holds another mission than was read"


def test_another_aircraft_of_the_same_number_has_not_this_route(tmp_path: Path) -> None:
    before = flown(tmp_path)
    bench = restarted(tmp_path, before.now_s)
    assert reader(bench).navigation.mission is not None
    bench.send(serial(0xDEF))
    second(bench, 47)
    now = reader(bench).navigation
    assert (now.mission, now.home) == (None, None)


def test_strange_frames_in_a_state_tell_nothing(tmp_path: Path) -> None:
    before = flown(tmp_path)
    forged = Bench()
    frames = [
        forged.framed(dialect.MAVLink_param_value_message(b"BATT_CAPACITY", 50_000.0, 9, 1, 0)),
        forged.framed(HOME_POSITION, **OTHER),
        forged.framed(dialect.MAVLink_mission_count_message(3, 3, 1), **OTHER),
    ]
    whole = forged.framed(HOME_POSITION)
    damaged = bytes([*whole[:-3], whole[-3] ^ 0xFF, *whole[-2:]])
    edited(tmp_path, b"".join([*frames, damaged, whole[:20], bytes(range(256))]))
    bench = restarted(tmp_path, before.now_s)
    now = reader(bench).navigation
    assert (now.mission, now.home) == (None, None)
    assert reader(bench).parameters["BATT_CAPACITY"] == 5000.0
    assert "resumed from" in "; ".join(bench.daemon.board.notes)
