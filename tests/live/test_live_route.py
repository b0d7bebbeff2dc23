"""Route and place in flight: what the reader of the link knows, what a recording keeps, what passes the proxy."""

from __future__ import annotations

import socket
import time
from pathlib import Path
from typing import Any

import pytest
from daemon_bench import Bench
from frames import HOME_POSITION
from live_rig import free_port, until
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.errors import BadInput
from uavbatt.live.config import LinkSection, PackSection, RecordSection
from uavbatt.live.feeds import proxy
from uavbatt.live.feeds.proxy_client import ProxyClient
from uavbatt.mavlink.framing import header
from uavbatt.navigation import Navigation
from uavbatt.records import Sample
from uavbatt.simulate.tlog_writer import battery_status, heartbeat
from uavbatt.telemetry import read_log
from uavbatt.telemetry.link.reader import LiveReader

ITEMS = [(0, 16, 47.0, 400.0), (3, 22, 47.0, 40.0), (3, 16, 47.002, 40.0), (3, 20, 0.0, 0.0)]
STATION = {"system": 255, "component": 190}


def item(seq: int, to: tuple[int, int]) -> Any:
    frame, command, lat, height = ITEMS[seq]
    return dialect.MAVLink_mission_item_int_message(
        *to, seq, frame, command, 0, 1, 0, 0, 0, 0, round(lat * 1e7), round(8e7 * bool(lat)), height
    )


def position(k: int) -> Any:
    return dialect.MAVLink_global_position_int_message(0, 470000000 + 100 * k, 80000000, 0, 30000, 100, 0, 0, 0)


def known(found: Navigation) -> tuple[object, ...]:
    """What does not hang on where the clock of a log begins."""
    place = found.position
    where = (place.lat_deg, place.height_m, place.north_ms) if place is not None else None
    return found.mode, repr(found.mission), found.current, found.home, repr(found.settings), where, found.transferring


def reader(bench: Bench) -> LiveReader:
    return bench.daemon.batteries._reader


def upload(bench: Bench) -> None:
    """A station writes the mission, the autopilot accepts it."""
    bench.send(dialect.MAVLink_mission_count_message(1, 1, len(ITEMS)), **STATION, sender="gcs")  # type: ignore[arg-type]
    for seq in range(len(ITEMS)):
        bench.send(item(seq, (1, 1)), **STATION, sender="gcs")  # type: ignore[arg-type]
    bench.send(dialect.MAVLink_mission_ack_message(255, 190, 0))


def second(bench: Bench, k: int) -> None:
    """One second of telemetry."""
    bench.send(heartbeat(True, 3))
    bench.send(position(k))
    bench.send(dialect.MAVLink_mission_current_message(1 + k // 10))
    bench.send(battery_status(Sample(0.0, 16.0 - 0.001 * k, 12.0, 25.0, 0.003 * k, armed=True), 0))
    bench.daemon.turn()
    bench.now_s += 1.0


def test_what_passes_is_known_and_a_recording_says_the_same(tmp_path: Path) -> None:
    bench = Bench(record=RecordSection(folder=str(tmp_path), when="always"))
    bench.send(heartbeat(True, 3))
    bench.send(dialect.MAVLink_param_value_message(b"RTL_ALT", 3000.0, 9, 1, 0))
    bench.send(HOME_POSITION)
    live = []
    for k in range(20):
        if k == 5:
            upload(bench)
        second(bench, k)
        live.append(known(reader(bench).navigation))
    bench.daemon.close()
    (path,) = tmp_path.glob("*.tlog")
    flight = read_log(path)
    replayed = [known(flight.navigation_at(s.time_s)) for s in flight.samples]
    assert replayed[1:] == live[1:]  # the first row comes when the second has confirmed it
    last = reader(bench).navigation
    assert last.mission is not None
    assert last.settings.return_height_m == 30.0
    assert (len(last.mission.items), last.current) == (4, 2)


def test_a_new_recording_begins_with_the_mission(tmp_path: Path) -> None:
    bench = Bench(record=RecordSection(folder=str(tmp_path), when="always"))
    bench.send(HOME_POSITION)
    for k in range(3):
        second(bench, k)
    upload(bench)
    for k in range(3, 6):
        second(bench, k)
    recorder = bench.daemon._recorder
    assert recorder is not None
    recorder.close()
    bench.now_s += 60.0
    for k in range(6, 9):
        second(bench, k)
    bench.daemon.close()
    later = read_log(max(tmp_path.glob("*.tlog")))
    assert later.navigation[-1].mission is not None
    assert len(later.navigation[-1].mission.items) == 4


def test_a_mission_file_wins_over_what_passes(tmp_path: Path) -> None:
    path = tmp_path / "route.waypoints"
    path.write_text("QGC WPL 110\n0 1 0 16 0 0 0 0 47.0 8.0 400 1\n1 0 3 22 0 0 0 0 0 0 25 1\n")
    link = LinkSection(endpoint="x", gcs=[], request_mission=True)
    bench = Bench(link=link, pack=PackSection(mission=str(path)))
    for k in range(3):
        second(bench, k)
    upload(bench)
    second(bench, 3)
    found = reader(bench).navigation
    assert found.mission is not None
    assert found.mission.items[1].alt_m == 25.0
    assert found.home is not None
    assert found.position is not None
    assert {header(frame).message_id for frame in bench.link.sent} == {0}  # nothing is asked that is known
    with pytest.raises(BadInput, match="No such file"):
        Bench(pack=PackSection(mission=str(tmp_path / "none.plan")))


def test_an_upload_to_another_vehicle_is_not_ours() -> None:
    bench = Bench()
    for k in range(3):
        second(bench, k)
    bench.send(dialect.MAVLink_mission_count_message(42, 1, 9), **STATION)  # type: ignore[arg-type]
    second(bench, 3)
    assert not reader(bench).navigation.transferring


def test_only_the_mission_is_asked_for_and_only_when_allowed() -> None:
    silent = Bench()
    for k in range(20):
        second(silent, k)
    assert {header(frame).message_id for frame in silent.link.sent} == {0}
    bench = Bench(link=LinkSection(endpoint="x", gcs=[], request_mission=True))
    for k in range(30):
        for frame in bench.link.sent:
            message = dialect.MAVLink(None).decode(bytearray(frame))
            to = (message.get_srcSystem(), message.get_srcComponent())
            if message.get_type() == "MISSION_REQUEST_LIST":
                bench.send(dialect.MAVLink_mission_count_message(*to, len(ITEMS)))
            elif message.get_type() == "MISSION_REQUEST_INT":
                bench.send(item(message.seq, to))
            elif message.get_type() == "MISSION_ACK":
                assert message.type == dialect.MAV_MISSION_ACCEPTED
        ids = {header(frame).message_id for frame in bench.link.sent}
        assert ids <= {0, 43, 47, 51}
        bench.link.sent.clear()
        second(bench, k)
    assert reader(bench).navigation.mission is not None
    assert not reader(bench).navigation.transferring


def test_a_mission_written_through_the_proxy_reaches_the_estimator(tmp_path: Path) -> None:
    """Every byte goes to the autopilot as it came; the frames that write a mission go to the estimator as well."""
    fc, gcs = free_port(), free_port()
    settings = proxy.ProxySettings(f"tcpin:127.0.0.1:{fc}", [f"tcpin:127.0.0.1:{gcs}"], str(tmp_path / "control"))
    served, client = proxy.Proxy(settings), ProxyClient(settings)
    link = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
    frames = [bytes(item(seq, (1, 1)).pack(link)) for seq in range(len(ITEMS))]
    frames.insert(2, bytes(dialect.MAVLink_param_request_list_message(1, 1).pack(link)))
    sent = b"".join(frames)

    vehicle, station = (socket.create_connection(("127.0.0.1", port)) for port in (fc, gcs))
    vehicle.setblocking(False)
    heard: list[bytes] = []
    passed = b""

    def turn() -> bool:
        nonlocal passed
        served.turn(time.monotonic())
        heard.extend(data for data, sender in client.read(time.monotonic()) if sender == proxy.STATION)
        try:
            passed += vehicle.recv(4096)
        except BlockingIOError:
            time.sleep(0.005)
        return len(passed) == len(sent) and len(heard) == len(ITEMS)

    until(lambda: (turn(), client.pid)[1])
    for at in range(0, len(sent), 37):  # a stream knows no frames
        station.sendall(sent[at : at + 37])
        turn()
    until(turn)
    for end in (client, served, vehicle, station):
        end.close()
    assert passed == sent
    assert heard == [frame for frame in frames if header(frame).message_id == 73]
