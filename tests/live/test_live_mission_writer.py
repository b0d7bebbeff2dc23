"""pymavlink's own mission writer behind the proxy: what `wp load` and `wp list` of MAVProxy send, without MAVProxy."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from live_rig import PATIENCE_S, free_port, until
from pymavlink import mavutil, mavwp
from test_live_gcs import Autopilot, start

from uavbatt.navigation import NOWHERE, Mission
from uavbatt.telemetry import read_log

ROUTE = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t47.0\t8.0\t400\t1
1\t0\t3\t22\t0\t0\t0\t0\t47.0\t8.0\t30\t1
2\t0\t3\t16\t0\t0\t0\t0\t47.5\t8.5\t87.0\t1
"""


@pytest.fixture
def vehicle() -> Iterator[tuple[Autopilot, int, int]]:
    vehicle_port, station_port = free_port(), free_port()
    autopilot = Autopilot(vehicle_port)
    autopilot.start()
    yield autopilot, vehicle_port, station_port
    autopilot.is_over = True
    autopilot.join(2.0)


def heard(station: Any, *kinds: str) -> Any:
    """The next message of these kinds to the station."""
    found = station.recv_match(type=list(kinds), blocking=True, timeout=PATIENCE_S)
    assert found is not None, f"none of {kinds}"
    return found


def write(station: Any, path: Path) -> None:
    """`wp load`: the count, each item as it is asked for, the acknowledgement."""
    loader = mavwp.MAVWPLoader(target_system=1, target_component=1)
    loader.load(str(path))
    station.mav.mission_clear_all_send(1, 1)
    heard(station, "MISSION_ACK")
    station.mav.mission_count_send(1, 1, loader.count())
    while (asked := heard(station, "MISSION_REQUEST_INT", "MISSION_ACK")).get_type() != "MISSION_ACK":
        station.mav.send(as_int(loader.wp(asked.seq)))
    assert asked.type == mavutil.mavlink.MAV_MISSION_ACCEPTED


def as_int(held: Any) -> Any:
    """An item of a file with its place in 1e-7 degrees, as MAVProxy sends it when it is asked for one."""
    return mavutil.mavlink.MAVLink_mission_item_int_message(
        1, 1, held.seq, held.frame, held.command, held.current, held.autocontinue,
        held.param1, held.param2, held.param3, held.param4, round(1e7 * held.x), round(1e7 * held.y), held.z,
    )  # fmt: skip


def listed(station: Any) -> list[tuple[int, float]]:
    """`wp list`: command and height of each item that the vehicle holds."""
    station.mav.mission_request_list_send(1, 1)
    items = []
    for seq in range(heard(station, "MISSION_COUNT").count):
        station.mav.mission_request_int_send(1, 1, seq)
        found = heard(station, "MISSION_ITEM_INT")
        items.append((found.command, found.z))
    station.mav.mission_ack_send(1, 1, mavutil.mavlink.MAV_MISSION_ACCEPTED)
    return items


def recorded_mission(folder: Path) -> Mission | None:
    """The mission that the estimator has written down by now, whole."""
    known = [read_log(path).navigation[-1:] for path in folder.glob("*.tlog") if path.stat().st_size]
    last = known[0][0] if known and known[0] else NOWHERE
    return last.mission if last.mission is not None and last.mission.items and not last.transferring else None


def is_understood(mission: Mission | None) -> bool:
    """A mission is understood once the heartbeat of the autopilot has been heard, too: it tells whose rules hold."""
    return mission is not None and not mission.reason


def test_a_mission_passes_the_proxy_both_ways_and_is_understood(
    vehicle: tuple[Autopilot, int, int], tmp_path: Path
) -> None:
    autopilot, *ports = vehicle
    (tmp_path / "route.waypoints").write_text(ROUTE)
    recorded = tmp_path / "recorded"
    companion = start((ports[0], ports[1]), tmp_path, "--feed", "proxy", "--record", str(recorded))
    station = mavutil.mavlink_connection(f"udpin:127.0.0.1:{ports[1]}", source_system=255, source_component=230)
    try:
        heard(station, "HEARTBEAT")
        write(station, tmp_path / "route.waypoints")
        assert [held.command for held in autopilot.mission] == [16, 22, 16]
        assert listed(station) == [(16, 400.0), (22, 30.0), (16, 87.0)]
        until(lambda: is_understood(recorded_mission(recorded)))  # it hears of it from the proxy, when it comes to that
    finally:
        companion.terminate()
        companion.wait(PATIENCE_S)
        station.close()
    known = recorded_mission(recorded)
    assert known is not None and known.reason == ""
    assert [(item.command, item.alt_m) for item in known.items[1:]] == [(22, 30.0), (16, 87.0)]
