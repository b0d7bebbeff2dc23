"""Route and place of one flight by two roads: the reader of its log, and the listener of the live link."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

from factories import generic_pack
from pymavlink import mavutil

from uavbatt.navigation import Action, Frame, Home, MissionItem, Navigation, Wind
from uavbatt.simulate.flight import IDLE_S, SimulatedFlight, simulate_flight, write_log
from uavbatt.simulate.route import route_flight, watts_of
from uavbatt.telemetry import read_log
from uavbatt.telemetry.route.commands import mission
from uavbatt.telemetry.route.messages import NavigationListener

ROUTE = mission(
    [
        MissionItem(0, Action.WAYPOINT, 47.0, 8.0, 420.0, Frame.SEA, command=16),
        MissionItem(1, Action.TAKEOFF, alt_m=30.0, command=22),
        MissionItem(2, Action.WAYPOINT, 47.002, 8.0, 30.0, command=16),
        MissionItem(3, Action.WAYPOINT, 47.002, 8.002, 50.0, hold_s=10.0, command=16),
        MissionItem(4, Action.RETURN, command=20),
    ],
    "link",
)
FIELDS = ("mode", "mission", "current", "reached", "home", "position", "wind", "landed", "transferring", "items_told")


def heard(path: Path) -> tuple[Navigation, ...]:
    """What the listener of the live link knows at each instant, message by message as pymavlink decodes them."""
    listener = NavigationListener(keeps_all=True)
    with closing(mavutil.mavlink_connection(str(path))) as link:
        while (message := link.recv_match()) is not None:
            is_vehicle = (message.get_srcSystem(), message.get_srcComponent()) == (1, 1)
            take = listener.take if is_vehicle else listener.take_other
            take(message._timestamp, message.get_msgId(), message)
    return listener.builder.timeline()


def changes(told: tuple[Navigation, ...], name: str) -> list[str]:
    """The values of a field in order, without repetitions; of a position without its time, which counts otherwise."""
    values = [getattr(known, name) for known in told]
    if name == "position":
        values = [(p.lat_deg, p.lon_deg, p.height_m, p.north_ms, p.airspeed_ms) if p else None for p in values]
    texts = [repr(value) for value in values]
    return [text for text, before in zip(texts, ["", *texts], strict=False) if text != before]


def test_the_log_of_a_flight_tells_what_its_link_told(tmp_path: Path) -> None:
    route, pack, watts = (
        route_flight(ROUTE, Home(47.0, 8.0, 420.0), Wind(0.0, 5.0), IDLE_S),
        generic_pack(),
        watts_of(200.0),
    )
    path = tmp_path / "flight.tlog"
    samples = simulate_flight(pack, SimulatedFlight(200.0), lambda time_s: route.power_W(time_s, watts), route.lands_s)
    write_log(path, samples, pack, route)
    of_log, of_link = read_log(path).navigation, heard(path)
    assert len({known.position for known in of_log}) > 100
    for name in FIELDS:
        assert changes(of_log, name) == changes(of_link, name), name
