"""Route and place in logs: the same flight in every kind of log, real logs, and nothing that looks ahead."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.battery import battery_file
from uavbatt.battery.scaling import pack_of
from uavbatt.mavlink.fields import BATTERY_STATUS
from uavbatt.navigation import Action, Frame, Home, Mission, MissionItem, Mode, Navigation, Wind
from uavbatt.records import Flight
from uavbatt.simulate.flight import IDLE_S, SimulatedFlight, simulate_flight, write_log
from uavbatt.simulate.route import RouteFlight, route_flight, watts_of
from uavbatt.telemetry import read_log
from uavbatt.telemetry.formats.tlog_frames import frames
from uavbatt.telemetry.quality.info import describe, lines
from uavbatt.telemetry.route.commands import mission

HOME = Home(47.0, 8.0, 420.0)
LAPS = 2


def item(seq: int, action: Action, command: int, **known: object) -> MissionItem:
    return replace(MissionItem(seq, action, command=command), **known)  # type: ignore[arg-type]


ROUTE = mission(
    [
        item(0, Action.WAYPOINT, 16, lat_deg=47.0, lon_deg=8.0, alt_m=420.0, frame=Frame.SEA),
        item(1, Action.TAKEOFF, 22, alt_m=30.0),
        item(2, Action.SPEED, 178, speed_ms=8.0),
        item(3, Action.WAYPOINT, 16, lat_deg=47.002, lon_deg=8.0, alt_m=30.0),
        item(4, Action.WAYPOINT, 16, lat_deg=47.002, lon_deg=8.002, alt_m=50.0, hold_s=10.0),
        item(5, Action.JUMP, 177, jump_to=3, repeats=LAPS - 1),
        item(6, Action.RETURN, 20),
    ],
    "link",
)


@pytest.fixture(scope="module")
def route() -> RouteFlight:
    return route_flight(ROUTE, HOME, Wind(0.0, 5.0), IDLE_S)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, route: RouteFlight) -> Path:
    """One simulated flight as `.tlog`, `.BIN` and `.csv`."""
    made = tmp_path_factory.mktemp("route")
    content = battery_file.read_battery("lipo-generic")
    pack = pack_of(content, 4, 5.0, 13.2, 14.0)
    watts = watts_of(200.0)
    samples = simulate_flight(pack, SimulatedFlight(200.0), lambda time_s: route.power_W(time_s, watts), route.lands_s)
    for kind in ("tlog", "BIN", "csv"):
        write_log(made / f"flight.{kind}", samples, pack, route)
    return made


@pytest.fixture(scope="module")
def tlog(folder: Path) -> Flight:
    return read_log(folder / "flight.tlog")


@pytest.fixture(scope="module")
def dataflash(folder: Path) -> Flight:
    return read_log(folder / "flight.BIN")


def seen(found: Navigation) -> tuple[object, ...]:
    return found.mode, found.current, found.landed, found.home, repr(found.settings)


def test_a_simulated_flight_tells_its_route(tlog: Flight, route: RouteFlight) -> None:
    in_air = tlog.navigation_at(route.begins_s[0] + 60.0)
    assert in_air.mission is not None
    assert repr(in_air.mission.items) == repr(ROUTE.items)
    assert in_air.mode is Mode.MISSION
    assert in_air.home == HOME
    assert in_air.settings.cruise_ms == 5.0
    assert in_air.landed is False
    assert in_air.position is not None
    true = route.position(in_air.position.time_s)
    assert in_air.position.north_ms == pytest.approx(true.north_ms, abs=0.01)
    assert in_air.position.airspeed_ms == pytest.approx(true.airspeed_ms, abs=0.3)
    assert tlog.navigation[-1].landed is True


def test_the_mission_is_flown_in_order_with_its_jump(tlog: Flight) -> None:
    told = [n.current for n in tlog.navigation if n.current is not None]
    changes = [a for a, b in zip(told, [None, *told], strict=False) if a != b]
    assert changes == [1, *[3, 4] * LAPS, 6]


def test_both_logs_of_one_flight_give_the_same_navigation(tlog: Flight, dataflash: Flight) -> None:
    for sample in tlog.samples[::7]:
        one, other = tlog.navigation_at(sample.time_s), dataflash.navigation_at(sample.time_s)
        assert seen(one) == seen(other)
        assert one.current_since_s == pytest.approx(other.current_since_s, nan_ok=True)
        assert one.position is not None
        assert other.position is not None
        assert one.position.time_s == pytest.approx(other.position.time_s)
        for name in ("lat_deg", "lon_deg", "height_m", "north_ms", "east_ms", "up_ms"):
            assert getattr(one.position, name) == pytest.approx(getattr(other.position, name), abs=0.01)
        assert one.wind == other.wind
    assert repr(tlog.navigation[-1].mission.items) == repr(dataflash.navigation[-1].mission.items)  # type: ignore[union-attr]


def test_the_rows_of_a_battery_are_those_of_a_log_without_a_route(folder: Path, tlog: Flight) -> None:
    table = read_log(folder / "flight.csv")
    assert [s.time_s for s in table.samples] == pytest.approx([s.time_s for s in tlog.samples], abs=1e-3)
    assert [s.voltage_V for s in table.samples] == pytest.approx([s.voltage_V for s in tlog.samples], abs=2e-3)
    assert table.navigation == ()


@pytest.mark.parametrize("kind", ["tlog", "BIN"])
def test_a_log_cut_at_any_instant_says_the_same_up_to_it(folder: Path, tmp_path: Path, kind: str) -> None:
    whole = read_log(folder / f"flight.{kind}")
    data = (folder / f"flight.{kind}").read_bytes()
    for share in (0.15, 0.4, 0.77):
        path = tmp_path / f"cut.{kind}"
        path.write_bytes(data[: int(len(data) * share)])
        cut = read_log(path)
        end_s = cut.samples[-1].time_s
        assert repr([n for n in cut.navigation if n.time_s < end_s]) == repr(
            [n for n in whole.navigation if n.time_s < end_s]
        )


def test_a_log_cut_behind_a_row_knows_no_more_at_that_row(shared_data: Path, tmp_path: Path) -> None:
    """Also what has the row's own stamp and stands behind it."""
    data = (shared_data / "missions" / "learn" / "l02_out_back.tlog").read_bytes()
    whole, found = read_log(shared_data / "missions" / "learn" / "l02_out_back.tlog"), frames(data)
    ends = (found.payload + found.length + 2)[found.message_id == BATTERY_STATUS]
    path = tmp_path / "cut.tlog"
    for end in ends[200:1500:411].tolist():
        path.write_bytes(data[:end])
        at_s = read_log(path).samples[-1].time_s
        assert repr(read_log(path).navigation_at(at_s)) == repr(whole.navigation_at(at_s))


def stamped(message: object, time_s: float, system: int = 1, component: int = 1) -> bytes:
    link = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
    return struct.pack(">Q", round((1_700_000_000.0 + time_s) * 1e6)) + bytes(message.pack(link))  # type: ignore[attr-defined]


def battery(time_s: float) -> bytes:
    volts = [16000] + [65535] * 9
    return stamped(dialect.MAVLink_battery_status_message(0, 0, 0, 2500, volts, 1200, 100, -1, 90), time_s)


def test_messages_of_the_route_move_no_row_of_the_battery(tmp_path: Path) -> None:
    rows = [battery(t) for t in (0.0, 0.5, 1.0, 9.0)]
    place = dialect.MAVLink_global_position_int_message(0, 470000000, 80000000, 0, 30000, 0, 0, 0, 0)
    late = [stamped(place, t) for t in (1.4, 80_000.0, 3.0)]  # damaged stamps among them
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"".join([*rows[:1], *late, *rows[1:]]))
    found = read_log(path)
    assert [s.time_s for s in found.samples] == [0.0, 0.5, 1.0, 9.0]
    assert found.notes == ()
    assert all(0.0 <= n.time_s <= 60.0 for n in found.navigation)


def test_what_a_ground_station_uploads_is_read_from_its_frames(tmp_path: Path) -> None:
    def put(seq: int, command: int, lat: float) -> object:
        return dialect.MAVLink_mission_item_int_message(1, 1, seq, 3, command, 0, 1, 0, 0, 0, 0, round(lat * 1e7),
                                                        80000000, 30.0)  # fmt: skip

    upload = [dialect.MAVLink_mission_count_message(1, 1, 3), put(0, 16, 47.0), put(1, 22, 47.0), put(2, 16, 47.01)]
    frames = [battery(0.0), *(stamped(m, 1.0, 255, 190) for m in upload)]
    frames += [stamped(dialect.MAVLink_mission_ack_message(255, 190, 0), 1.5), battery(2.0)]
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"".join(frames))
    found = read_log(path).navigation_at(2.0).mission
    assert found is not None
    assert len(found.items) == 3
    path.write_bytes(b"".join([*frames[:-2], battery(2.0)]))  # without the acknowledgement
    unsure = read_log(path).navigation_at(2.0)
    assert unsure.mission is None
    assert unsure.transferring


def test_real_flights_with_their_routes(shared_data: Path) -> None:
    for path in sorted((shared_data / "flights" / "m100_routes").glob("*.tlog"))[:6]:
        found = read_log(path)
        last: Navigation = found.navigation[-1]
        assert last.mission is not None
        assert last.mission.reason == ""
        assert last.home is not None
        assert last.settings.climb_ms == 4.0
        assert last.position is None  # never logged
        assert any(n.mode is Mode.MISSION for n in found.navigation)


def test_missions_of_a_simulator_that_is_not_ours(shared_data: Path) -> None:
    for path in sorted((shared_data / "missions" / "learn").glob("*.tlog"))[:3]:
        found = read_log(path)
        assert {n.mission.reason for n in found.navigation if n.mission is not None} == {""}
        middle = found.navigation_at(0.5 * found.duration_s)
        assert middle.position is not None
        assert middle.wind is not None
        assert middle.position.height_m > 5.0
        assert not any(n.transferring for n in found.navigation[len(found.navigation) // 2 :])


def test_old_logs_that_name_no_frame_give_no_route(shared_data: Path) -> None:
    found = read_log(shared_data / "flights" / "ardupilot" / "quad_3s_2650_emptied.BIN")
    assert found.navigation[-1].mission is None
    assert {n.mode for n in found.navigation} >= {Mode.MANUAL, Mode.MISSION, Mode.RETURN}
    with_mission = read_log(shared_data / "flights" / "ardupilot" / "quad_4s_3000_a.bin").navigation[-1].mission
    assert with_mission is not None
    assert len(with_mission.items) == 12
    assert with_mission.reason == ""


def test_a_mission_that_the_log_contradicts_is_unknown(folder: Path, tmp_path: Path) -> None:
    data = (folder / "flight.BIN").read_bytes()
    executed = data.index(b"\xa3\x95\x88")  # the first MISE
    height = executed + 3 + struct.calcsize("<QHHHffffii")
    path = tmp_path / "other.BIN"
    path.write_bytes(data[:height] + struct.pack("<f", 77.0) + data[height + 4 :])
    found = read_log(path).navigation[-1].mission
    assert found is not None
    assert "another item 1" in found.reason


def test_a_log_without_its_home_has_that_of_its_mission(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "homeless.BIN"
    path.write_bytes((folder / "flight.BIN").read_bytes().replace(b"ORGN", b"ORGX"))
    assert read_log(path).navigation[-1].home == replace(HOME, is_of_mission=True)


def legs(known: Mission) -> Sequence[tuple[float, ...]]:
    flight = route_flight(known, HOME, Wind(0.0, 0.0), 0.0)
    return [(*leg.end, leg.moving_s, leg.hold_s) for leg in flight.legs]


def test_the_same_route_in_another_frame_has_the_same_legs() -> None:
    def above_sea(one: MissionItem) -> MissionItem:
        if one.seq == 0 or math.isnan(one.alt_m):
            return one
        return replace(one, alt_m=one.alt_m + HOME.alt_m, frame=Frame.SEA)

    moved = mission([above_sea(one) for one in ROUTE.items], "link")
    for one, other in zip(legs(moved), legs(ROUTE), strict=True):
        assert one == pytest.approx(other)


def test_a_jump_has_the_legs_of_the_items_written_out() -> None:
    laps = [*ROUTE.items[3:5]] * LAPS
    flat = [*ROUTE.items[:3], *laps, ROUTE.items[6]]
    written = mission([replace(one, seq=seq) for seq, one in enumerate(flat)], "link")
    assert legs(written) == legs(ROUTE)


def test_wind_changes_what_a_route_asks() -> None:
    watts = watts_of(200.0)

    def energy_J(wind: Wind) -> float:
        flight = route_flight(ROUTE, HOME, wind, 0.0)
        return sum(flight.power_W(t, watts) for t in range(int(flight.lands_s)))

    assert energy_J(Wind(0.0, 15.0)) > 1.05 * energy_J(Wind(0.0, 0.0))  # a storm costs on the way there and back


def test_the_place_of_a_px4_log_counts_from_its_home(shared_data: Path) -> None:
    pytest.importorskip("pyulog")
    found = read_log(shared_data / "flights" / "px4" / "hexa_6s_33s.ulg")
    last = found.navigation[-1]
    assert all(n.settings.is_px4 for n in found.navigation)
    assert last.home is not None
    assert last.position is not None
    assert last.current is None  # a log without a mission names item 0 all the same
    assert abs(last.position.height_m) < 20.0
    assert {n.mode for n in found.navigation} >= {Mode.LAND, Mode.HOLD}
    wings = read_log(shared_data / "flights" / "px4" / "vtol_ground_two_batteries.ulg")
    assert {n.mode for n in wings.navigation} == {Mode.UNKNOWN}
    assert "RTL_TYPE 1" in wings.navigation[-1].settings.landing_reason


def test_info_names_the_route(folder: Path) -> None:
    told = lines(describe(read_log(folder / "flight.tlog")))
    assert "route        mission of 7 items, home, positions, progress, wind" in told
    assert "route        not in the log" in lines(describe(read_log(folder / "flight.csv")))


def test_a_flight_with_its_route_has_the_rows_of_its_table(shared_data: Path) -> None:
    for name in ("m100_001_752", "m100_022_782"):
        table = read_log(shared_data / "flights" / "m100" / f"{name}.csv")
        log = read_log(shared_data / "flights" / "m100_routes" / f"{name}.tlog")
        assert [(s.time_s, s.voltage_V, s.temp_C) for s in log.samples] == [
            (s.time_s, s.voltage_V, s.temp_C) for s in table.samples
        ]
        assert [s.current_A for s in log.samples] == pytest.approx([s.current_A for s in table.samples], abs=0.0051)
