"""What a copter does not send of route and place is asked for, and nothing else: no rate of another program changes."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

from daemon_bench import Bench
from frames import HOME_POSITION
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.battery.sizing.pack_size import PackOptions
from uavbatt.live.config import LinkSection
from uavbatt.live.requests.streams import MOST_ASKED, RATES_Hz, StreamRequests, unheard
from uavbatt.mavlink.outgoing import Outgoing
from uavbatt.navigation import NOWHERE, Home
from uavbatt.simulate.tlog_writer import heartbeat

PLACE = dialect.MAVLink_global_position_int_message(0, 470000000, 80000000, 420_000, 20_000, 0, 0, 0, 0)

HOME = dialect.MAVLINK_MSG_ID_HOME_POSITION


def flown(bench: Bench, seconds: float, *heard: object) -> Counter[int]:
    """How often each message was asked for while a quad flew for so long, and sent these messages once a second."""
    bench.link.sent.clear()
    for _ in range(int(seconds)):
        for message in heard:
            bench.send(message)
        bench.fly(1.0, used=0.1)
    return asked_for(bench)


def asked_for(bench: Bench) -> Counter[int]:
    """How often each message of route and place was asked for, and nothing else was commanded."""
    sent = bench.link.messages
    commands = [m for m in sent if m.get_type() == "COMMAND_LONG"]
    assert {m.command for m in commands} <= {dialect.MAV_CMD_SET_MESSAGE_INTERVAL}
    of_route = [m for m in commands if int(m.param1) in RATES_Hz]
    assert all(m.param2 == 1e6 / RATES_Hz[int(m.param1)] for m in of_route)
    return Counter(int(m.param1) for m in of_route)


def bench(request: bool = True) -> Bench:
    made = Bench(PackOptions(cells=4, capacity_Ah=5.0), link=LinkSection(endpoint="x", gcs=["y"], request=request))
    made.send(heartbeat(True))
    return made


def test_a_copter_that_sends_its_battery_alone_is_asked_for_place_home_item_and_wind() -> None:
    quad = bench()
    assert flown(quad, 4.0) == {}  # what it sends is not known yet
    asked = flown(quad, 150.0)
    assert set(asked) == {33, 42, 242, 168}  # GLOBAL_POSITION_INT, MISSION_CURRENT, HOME_POSITION, WIND
    assert set(asked.values()) == {MOST_ASKED}
    assert flown(quad, 60.0) == {}


def test_the_pauses_between_two_requests_grow() -> None:
    asks, out = StreamRequests(), Outgoing(1, 193, None)
    due_s = [k for k in range(100) if asks.frames(float(k), float(k), NOWHERE, False, 1, out)]
    assert due_s == [5, 10, 20, 40]


def test_only_what_is_not_heard_is_asked_for() -> None:
    current, wind = dialect.MAVLink_mission_current_message(1), dialect.MAVLink_wind_message(90.0, 3.0, 0.0)
    assert flown(bench(), 30.0, PLACE, HOME_POSITION, current, wind) == {}
    assert set(flown(bench(), 30.0, PLACE, HOME_POSITION, current)) == {168}


def test_home_is_asked_for_where_only_the_mission_tells_it() -> None:
    home = Home(47.0, 8.0, 400.0, is_of_mission=True)
    assert HOME in unheard(replace(NOWHERE, home=home), 0.0, False)
    assert HOME not in unheard(replace(NOWHERE, home=replace(home, is_of_mission=False)), 0.0, False)


def test_a_position_that_falls_silent_is_asked_for_again() -> None:
    quad = bench()
    flown(quad, 200.0)
    assert 33 not in flown(quad, 20.0, PLACE)
    assert flown(quad, 60.0)[33] >= 2


def test_nobody_is_asked_without_the_option() -> None:
    assert flown(bench(request=False), 60.0) == {}


def test_a_plane_is_not_asked() -> None:
    plane = Bench(PackOptions(cells=4, capacity_Ah=5.0), link=LinkSection(endpoint="x", gcs=["y"], request=True))
    beat = dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_FIXED_WING, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, dialect.MAV_MODE_FLAG_SAFETY_ARMED, 10, 4, 3
    )
    for _ in range(60):
        plane.send(beat)
        plane.daemon.turn()
        plane.now_s += 1.0
    assert asked_for(plane) == {}
