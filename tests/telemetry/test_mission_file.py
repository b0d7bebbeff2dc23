"""Mission files of both kinds, and errors that name the place in one line."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavwp
from pymavlink.dialects.v20 import ardupilotmega as dialect
from route_rig import HOME, SETTINGS

from uavbatt.errors import BadInput
from uavbatt.log_replay.run import with_mission
from uavbatt.navigation import Action, Home, Mode, Navigation, Position, ReturnSettings
from uavbatt.prediction.route.ahead import ahead
from uavbatt.prediction.route.path import path
from uavbatt.prediction.route.progress import Progress
from uavbatt.records import Flight
from uavbatt.telemetry.formats.mission_file import read_mission
from uavbatt.telemetry.route.messages import NavigationListener

WAYPOINTS = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t47.0\t8.0\t420\t1
1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t50\t1
2\t0\t3\t16\t0\t0\t0\t0\t47.001\t8.0\t50\t1
3\t0\t3\t178\t1\t8\t0\t0\t0\t0\t0\t1
4\t0\t3\t16\t5\t0\t0\t0\t47.001\t8.002\t60\t1
5\t0\t3\t177\t2\t1\t0\t0\t0\t0\t0\t1
6\t0\t3\t20\t0\t0\t0\t0\t0\t0\t0\t1
"""


def simple(number: int, command: int, *params: float | None, frame: int = 3) -> dict[str, Any]:
    return {"type": "SimpleItem", "command": command, "doJumpId": number, "frame": frame, "params": list(params)}


def plan(*items: dict[str, Any], firmware: int = 3) -> str:
    mission = {"version": 2, "firmwareType": firmware, "plannedHomePosition": [47.0, 8.0, 420], "hoverSpeed": 5,
               "items": list(items)}  # fmt: skip
    return json.dumps({"fileType": "Plan", "version": 1, "groundStation": "QGroundControl", "mission": mission})


SURVEY = {
    "type": "ComplexItem",
    "complexItemType": "survey",
    "TransectStyleComplexItem": {
        "Items": [
            simple(2, 16, 0, 0, 0, None, 47.001, 8.0, 50),
            simple(3, 178, 1, 8, 0, 0, 0, 0, 0),
            simple(4, 16, 5, 0, 0, None, 47.001, 8.002, 60),
        ]
    },
}
ITEMS = (simple(1, 22, 0, 0, 0, None, 0, 0, 50), SURVEY, simple(5, 177, 2, 1, 0, 0, 0, 0, 0),
         simple(6, 20, 0, 0, 0, 0, 0, 0, 0))  # fmt: skip


def written(folder: Path, text: str) -> Path:
    path = folder / "route.mission"
    path.write_text(text)
    return path


def test_the_same_mission_in_both_kinds_of_file(tmp_path: Path) -> None:
    one = read_mission(written(tmp_path, WAYPOINTS))
    other = read_mission(written(tmp_path, plan(*ITEMS)))
    assert repr(one.mission.items) == repr(other.mission.items)
    assert one.home == other.home == Home(47.0, 8.0, 420.0)
    assert one.mission.reason == ""
    assert other.cruise_ms == 5.0


def test_the_speed_of_a_plan_counts_in_flight_only_where_the_vehicle_states_none(tmp_path: Path) -> None:
    """It counted in `plan` alone: in flight a mission planned at 12 m/s was taken for one at 5 m/s."""
    planned = read_mission(written(tmp_path, plan(*ITEMS)))
    assert planned.flown(Navigation()).settings == ReturnSettings(cruise_ms=5.0)
    stated = ReturnSettings(cruise_ms=8.0, return_height_m=30.0)
    assert planned.flown(Navigation(settings=stated)).settings == stated


def test_rally_points_of_a_plan_make_the_way_home_unknown(tmp_path: Path) -> None:
    """The vehicle may return to one of them, as one that says RALLY_TOTAL."""
    said = json.loads(plan(*ITEMS))
    rallied = [
        read_mission(written(tmp_path, json.dumps(said | {"rallyPoints": {"points": points, "version": 2}})))
        for points in ([], [[47.01, 8.01, 30]])
    ]
    assert path(rallied[0].mission, HOME, SETTINGS).lands and not path(rallied[0].mission, HOME, SETTINGS).reason
    assert "rally points" in path(rallied[1].mission, HOME, SETTINGS).reason
    over_home = Position(0.0, 47.0, 8.0, 30.0, 0.0, 0.0, 0.0)
    on_return = Navigation(mode=Mode.RETURN, mission=rallied[1].mission, home=HOME, position=over_home)
    assert "rally points" in str(ahead(Progress(), on_return, 0.0))


def test_a_px4_plan_begins_with_its_first_item_and_jumps_by_its_numbers(tmp_path: Path) -> None:
    found = read_mission(written(tmp_path, plan(*ITEMS, firmware=12))).mission
    assert not found.has_home_item
    assert [i.seq for i in found.items] == list(range(6))
    assert found.items[0].action is Action.TAKEOFF
    assert found.items[4].jump_to == 1  # the survey's first waypoint


@pytest.mark.parametrize("firmware", [3, 12])
def test_the_items_of_a_plan_are_numbered_as_the_flown_autopilot_counts_them(tmp_path: Path, firmware: int) -> None:
    """The ground station uploads a plan to the other make of autopilot, too: it puts home in or leaves it out."""
    planned = read_mission(written(tmp_path, plan(*ITEMS, firmware=firmware)))
    for is_px4 in (False, True):
        like = read_mission(written(tmp_path, plan(*ITEMS, firmware=12 if is_px4 else 3))).mission
        heard = Navigation(settings=ReturnSettings(is_px4=is_px4))
        flight = Flight("flight.tlog", "tlog", (), navigation=(heard,))
        used = with_mission(flight, planned).navigation[0].mission
        assert used is not None and used.has_home_item is not is_px4
        assert [(i.seq, i.action, i.jump_to) for i in used.items] == [(i.seq, i.action, i.jump_to) for i in like.items]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "a mission file"),
        ("time_s,voltage_V\n", "a mission file"),
        ("QGC WPL 110\n0 1 x\n", "line 2: expected 12 numbers, found `0 1 x`"),
        (WAYPOINTS.replace("47.001", "nan"), "item 2: no place is at latitude nan"),
        (WAYPOINTS.replace("47.001", "97"), "latitude 97"),
        (WAYPOINTS.replace("\t177\t2\t", "\t177\t40\t"), "jumps to item 40"),
        ("QGC WPL 110\n", "no items"),
        ("{", "a QGroundControl plan"),
        ('{"mission": 3}', "key mission"),
        (plan(simple(1, 16, 0, 0)), "item 1: expected a command with seven params"),
        (plan(simple(1, 16, 0, 0, 0, None, 47.0, 8.0, None)), "item 1: expected a height"),
        (plan({"type": "ComplexItem", "complexItemType": "StructureScan"}), "found `StructureScan`"),
        (plan(simple(1, 3000, 4, 0, 0, 0, 0, 0, 0)), "VTOL transition"),
    ],
)
def test_what_is_wrong_stands_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(BadInput) as caught:
        read_mission(path)
    assert words in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="No such file"):
        read_mission(tmp_path / "none.plan")


@pytest.mark.parametrize("speed", ["1e21", "1e-9", "-5"])
def test_a_speed_that_no_multirotor_has_is_refused_by_name(speed: str, tmp_path: Path) -> None:
    path = tmp_path / "m.plan"
    path.write_text(plan(*ITEMS).replace('"hoverSpeed": 5', f'"hoverSpeed": {speed}'))
    with pytest.raises(BadInput, match=r"key mission.hoverSpeed: expected 0.01 to 100 m/s, found"):
        read_mission(path)


def test_a_file_is_numbered_as_ground_stations_upload_it(tmp_path: Path) -> None:
    """Two of ArduPilot's own test missions leave numbers out; both were refused."""
    numbers = iter([0, 1, 2, 4, 5, 9, 12])
    gaps = "".join(f"{next(numbers)}{line[1:]}" if "\t" in line else line for line in WAYPOINTS.splitlines(True))
    path, loader = written(tmp_path, gaps), mavwp.MAVWPLoader()
    loader.load(str(path))
    found = read_mission(path).mission
    assert [(item.seq, item.command) for item in found.items] == [(wp.seq, wp.command) for wp in loader.wpoints]
    assert found.items == read_mission(written(tmp_path, WAYPOINTS)).mission.items


def test_a_home_that_a_ground_station_wrote_as_command_0_is_home(tmp_path: Path) -> None:
    without = WAYPOINTS.replace("0\t1\t0\t16", "0\t1\t0\t0", 1)
    found = read_mission(written(tmp_path, without))
    assert (found.home, found.mission) == (Home(47.0, 8.0, 420.0), read_mission(written(tmp_path, WAYPOINTS)).mission)


def on_px4(folder: Path, *said: Any, text: str = WAYPOINTS) -> Navigation:
    """What is known of a flight with the mission on a PX4 that has said these messages."""
    listener = NavigationListener()
    for message in (dialect.MAVLink_heartbeat_message(2, 12, 1, 0, 4, 3), *said):
        listener.take(1.0, message.get_msgId(), message)
    return read_mission(written(folder, text)).flown(listener.now)


@pytest.mark.parametrize(("total", "first_to"), [(6, 1), (7, 2)])
@pytest.mark.parametrize("by", ["current", "count"])
def test_a_px4_tells_whether_it_counts_the_home_of_a_file(tmp_path: Path, total: int, first_to: int, by: str) -> None:
    """Some programs upload home as an item, some leave it out: the route was one item off."""
    told = {
        "current": dialect.MAVLink_mission_current_message(first_to, total, 0),
        "count": dialect.MAVLink_mission_count_message(255, 190, total, 0),
    }
    known = on_px4(tmp_path, told[by])
    assert known.mission is not None and not known.mission.reason
    assert not path(known.mission, HOME, SETTINGS).reason
    place = known.mission.items[first_to]
    assert (place.seq, place.action, place.lat_deg) == (first_to, Action.WAYPOINT, 47.001)
    jump = next(item for item in known.mission.items if item.action is Action.JUMP)
    assert known.mission.items[jump.jump_to] is place


@pytest.mark.parametrize(("total", "first_to"), [(6, 1), (7, 2)])
def test_a_px4_flies_to_the_height_of_home_where_a_file_says_so(tmp_path: Path, total: int, first_to: int) -> None:
    """An ArduPilot takes a height of 0 for none, and keeps the one that it has."""
    low = WAYPOINTS.replace("8.0\t50\t1", "8.0\t0\t1")
    known = on_px4(tmp_path, dialect.MAVLink_mission_current_message(first_to, total, 0), text=low)
    assert known.mission is not None and known.mission.items[first_to].alt_m == 0.0
    assert math.isnan(read_mission(written(tmp_path, low)).mission.items[2].alt_m)


@pytest.mark.parametrize(("total", "told"), [(0, "does not say how many it holds"), (0xFFFF, "does not say how many"),
                                             (3, "says 3:"), (9, "says 9:")])  # fmt: skip
def test_a_px4_that_does_not_tell_flies_an_unknown_route(tmp_path: Path, total: int, told: str) -> None:
    known = on_px4(tmp_path, dialect.MAVLink_mission_current_message(1, total, 0))
    assert known.mission is not None
    assert f"a PX4 holds 6 or 7 of them, the autopilot {told}" in path(known.mission, HOME, SETTINGS).reason
