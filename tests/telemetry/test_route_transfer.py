"""Missions as they pass between stations and an autopilot, and what else MAVLink says of route and place."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pytest
from frames import HOME_POSITION
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.navigation import Home, Mission, Mode
from uavbatt.telemetry.route.messages import NavigationListener

STATION = (255, 190)
VEHICLE = (1, 1)
Row = tuple[int, int, float, float, float]  # frame, command, lat, lon, height

ROUTE: list[Row] = [(0, 16, 47.0, 8.0, 400.0), (3, 22, 0.0, 0.0, 40.0), (3, 16, 47.001, 8.0, 40.0),
                    (3, 16, 47.002, 8.001, 60.0), (3, 20, 0.0, 0.0, 0.0)]  # fmt: skip


def item(seq: int, row: Row, to: tuple[int, int] = STATION, kind: int = 0, is_int: bool = True) -> Any:
    frame, command, lat, lon, height = row
    head = (*to, seq, frame, command, 0, 1, 0, 0, 0, 0)
    if not is_int:
        return dialect.MAVLink_mission_item_message(*head, lat, lon, height, kind)
    return dialect.MAVLink_mission_item_int_message(*head, round(lat * 1e7), round(lon * 1e7), height, kind)


class Passing:
    """Messages one second apart; those of the autopilot and those of a station."""

    def __init__(self, px4: bool = False, beats: bool = True) -> None:
        self.listener, self.time_s = NavigationListener(keeps_all=True), 0.0
        if beats:
            self.said(beat(px4))

    def said(self, *messages: Any, after_s: float = 1.0) -> Passing:
        for message in messages:
            self.time_s += after_s
            self.listener.take(self.time_s, message.get_msgId(), message)
        return self

    def heard(self, *messages: Any) -> Passing:
        for message in messages:
            self.time_s += 1.0
            self.listener.take_other(self.time_s, message.get_msgId(), message)
        return self

    @property
    def mission(self) -> Mission | None:
        return self.listener.now.mission


def beat(px4: bool) -> Any:
    return dialect.MAVLink_heartbeat_message(2, 12 if px4 else 3, 1, 0, 4, 3)


def count(number: int, to: tuple[int, int] = STATION, kind: int = 0) -> Any:
    return dialect.MAVLink_mission_count_message(*to, number, kind)


def ack(result: int = 0, kind: int = 0) -> Any:
    return dialect.MAVLink_mission_ack_message(*STATION, result, kind)


def downloaded(route: Sequence[Row], **how: Any) -> list[Any]:
    return [count(len(route)), *(item(seq, row, **how) for seq, row in enumerate(route))]


def uploaded(route: Sequence[Row], **how: Any) -> list[Any]:
    return [count(len(route), VEHICLE), *(item(seq, row, VEHICLE, **how) for seq, row in enumerate(route))]


@pytest.mark.parametrize("px4", [False, True])
def test_a_mission_before_the_first_heartbeat_is_read_when_the_make_is_known(px4: bool) -> None:
    """PX4 has no item for its home, and a height of 0 is one; ArduPilot's item 0 is its home, and 0 is "unchanged"."""
    low = [*ROUTE[:3], (3, 16, 47.002, 8.001, 0.0), ROUTE[4]]
    for say in (
        lambda passing: passing.said(*downloaded(low)),
        lambda passing: passing.heard(*uploaded(low)).said(ack()),
    ):
        usual, early = say(Passing(px4)), say(Passing(beats=False))
        assert early.mission.reason == "the make of the autopilot is not known before its first heartbeat"
        early.said(beat(px4))
        assert early.mission == usual.mission and early.mission.reason == ""
        assert early.mission.has_home_item is not px4
        assert math.isnan(early.mission.items[3].alt_m) is not px4


def test_a_transfer_goes_on_over_the_first_heartbeat() -> None:
    messages = downloaded(ROUTE)
    early = Passing(beats=False).said(*messages[:3]).said(beat(px4=True)).said(*messages[3:])
    assert early.mission == Passing(px4=True).said(*messages).mission


def test_a_download_is_the_mission_when_its_last_item_has_passed() -> None:
    passing = Passing().said(*downloaded(ROUTE)[:-1])
    assert passing.mission is None
    assert passing.listener.now.transferring
    passing.said(downloaded(ROUTE)[-1])
    assert passing.mission is not None
    assert [i.command for i in passing.mission.items] == [16, 22, 16, 16, 20]
    assert passing.mission.reason == ""
    assert not passing.listener.now.transferring
    assert passing.listener.now.mission_since_s == passing.time_s


def test_home_is_where_an_ardupilots_mission_has_it_until_the_vehicle_tells_it() -> None:
    """Item 0 of a mission that an ArduPilot tells is its home; HOME_POSITION is sent once, or on request."""
    passing = Passing().said(*downloaded(ROUTE))
    assert passing.listener.now.home == Home(47.0, 8.0, 400.0, is_of_mission=True)
    passing.said(*downloaded([(0, 16, 47.002, 8.0, 410.0), *ROUTE[1:]]))  # it has been armed elsewhere
    assert passing.listener.now.home == Home(47.002, 8.0, 410.0, is_of_mission=True)
    passing.said(HOME_POSITION)
    passing.said(*downloaded([(0, 16, 47.003, 8.0, 410.0), *ROUTE[1:]]))
    assert passing.listener.now.home == Home(47.0, 8.0, 400.0)


def test_a_mission_of_a_station_or_of_a_px4_tells_no_home() -> None:
    """An ArduPilot keeps its own home when a station uploads; a PX4 flies to its first item."""
    assert Passing().heard(*uploaded(ROUTE)).said(ack()).listener.now.home is None
    assert Passing(px4=True).said(*downloaded(ROUTE)).listener.now.home is None
    assert Passing().said(*downloaded([(0, 16, 0.0, 0.0, 0.0), *ROUTE[1:]])).listener.now.home is None
    assert Passing().said(*downloaded([(3, 16, 47.0, 8.0, 40.0), *ROUTE[1:]])).listener.now.home is None
    early = Passing(beats=False).said(*downloaded(ROUTE))
    assert early.listener.now.home is None
    assert early.said(beat(px4=False)).listener.now.home is not None


def test_an_upload_counts_when_the_autopilot_has_accepted_it() -> None:
    passing = Passing().heard(*uploaded(ROUTE))
    assert passing.mission is None
    passing.said(ack())
    assert passing.mission is not None
    assert len(passing.mission.items) == 5


@pytest.mark.parametrize("how", [{}, {"is_int": False}])
def test_the_same_route_by_any_transfer_is_the_same_mission(how: dict[str, bool]) -> None:
    first = Passing().said(*downloaded(ROUTE)).mission
    again = Passing().heard(*uploaded(ROUTE, **how)).said(ack()).mission
    assert first is not None
    assert again is not None
    for one, other in zip(first.items, again.items, strict=True):
        assert (one.action, one.frame, one.alt_m == other.alt_m or math.isnan(one.alt_m)) == (
            other.action, other.frame, True,
        )  # fmt: skip
        assert one.lat_deg == pytest.approx(other.lat_deg, abs=1e-5, nan_ok=True)


def test_uploading_it_twice_changes_nothing() -> None:
    passing = Passing().heard(*uploaded(ROUTE)).said(ack())
    once, since_s = passing.mission, passing.listener.now.mission_since_s
    passing.heard(*uploaded(ROUTE)).said(ack())
    assert passing.mission is once
    assert passing.listener.now.mission_since_s == since_s
    assert not passing.listener.now.transferring


def test_a_mission_changed_in_flight_replaces_the_old_one() -> None:
    passing = Passing().said(*downloaded(ROUTE))
    passing.heard(*uploaded(ROUTE[:3])).said(ack())
    assert passing.mission is not None
    assert len(passing.mission.items) == 3


def test_an_upload_that_breaks_off_leaves_the_old_mission_in_transfer() -> None:
    passing = Passing().said(*downloaded(ROUTE))
    old = passing.mission
    passing.heard(*uploaded(ROUTE[:3])[:-1])
    passing.said(dialect.MAVLink_mission_current_message(2), after_s=60.0)
    assert passing.mission is old
    assert passing.listener.now.transferring
    assert passing.listener.wants_mission
    passing.said(*downloaded(ROUTE[:3]))
    assert not passing.listener.now.transferring


def test_a_download_that_breaks_off_takes_nothing_away() -> None:
    passing = Passing().said(*downloaded(ROUTE))
    passing.said(*downloaded(ROUTE)[:3])
    passing.said(dialect.MAVLink_mission_current_message(2), after_s=60.0)
    assert not passing.listener.now.transferring
    assert not passing.listener.wants_mission


def test_a_station_that_reads_the_mission_again_does_not_interrupt_the_route() -> None:
    passing, again = Passing().said(*downloaded(ROUTE)), downloaded(ROUTE)
    known = passing.mission
    for message in again:
        passing.said(message)
        assert not passing.listener.now.transferring
        assert passing.mission is known
    passing.said(*downloaded(ROUTE[:4])[:2])  # of another length: this may be another mission
    assert passing.listener.now.transferring


def test_an_upload_that_is_refused_before_its_first_item_takes_nothing_away() -> None:
    passing = Passing().said(*downloaded(ROUTE))
    passing.heard(count(900, VEHICLE)).said(ack(4))
    assert not passing.listener.now.transferring
    assert passing.mission is not None


def test_lost_and_doubled_items_wait_for_their_repetition() -> None:
    messages = downloaded(ROUTE)
    passing = Passing().said(messages[0], messages[1], messages[3], messages[3], messages[5], messages[4])
    assert passing.mission is None
    assert passing.listener.transfer.missing == 1
    assert passing.said(messages[2]).mission is not None


def test_some_items_written_anew_change_those_and_no_others() -> None:
    passing = Passing().said(*downloaded(ROUTE))
    changed = (3, 16, 47.003, 8.0, 45.0)
    passing.heard(dialect.MAVLink_mission_write_partial_list_message(*VEHICLE, 2, 2), item(2, changed, VEHICLE))
    passing.said(ack())
    assert passing.mission is not None
    assert [i.alt_m for i in passing.mission.items[1:4]] == [40.0, 45.0, 60.0]


def test_a_cleared_mission_is_none() -> None:
    passing = Passing().said(*downloaded(ROUTE))
    passing.heard(dialect.MAVLink_mission_clear_all_message(*VEHICLE)).said(ack())
    assert passing.mission is not None
    assert passing.mission.items == ()
    assert passing.mission.reason


def test_fences_and_rally_points_are_no_mission() -> None:
    passing = Passing().said(*downloaded(ROUTE))
    once = passing.mission
    passing.heard(count(1, VEHICLE, kind=1), item(0, ROUTE[2], VEHICLE, kind=1)).said(ack(kind=1))
    assert passing.mission is once
    assert not passing.listener.now.transferring


@pytest.mark.parametrize("kind", [0, 255])
def test_a_clearing_of_everything_clears_the_mission(kind: int) -> None:
    """A type of 255 is every type; the route stayed in force for ever."""
    passing = Passing().said(*downloaded(ROUTE)).heard(dialect.MAVLink_mission_clear_all_message(*VEHICLE, kind))
    assert passing.mission is not None and passing.mission.items
    passing.said(ack(kind=kind))
    assert passing.mission is not None and passing.mission.items == () and not passing.listener.now.transferring


def test_a_clearing_of_everything_that_is_refused_clears_nothing() -> None:
    passing = Passing().said(*downloaded(ROUTE)).heard(dialect.MAVLink_mission_clear_all_message(*VEHICLE, 255))
    passing.said(ack(1, 255))
    assert passing.mission is not None and passing.mission.items and passing.mission.reason == ""


def test_rally_points_on_the_link_make_the_way_home_unknown() -> None:
    """Those that another station writes count once they are acknowledged, those that the autopilot tells at once."""
    place = (3, 5100, 47.0, 8.1, 40.0)
    written = (count(2, VEHICLE, 2), *(item(seq, place, VEHICLE, 2) for seq in range(2)))
    passing = Passing().said(*downloaded(ROUTE)).heard(*written)
    assert passing.listener.now.settings.return_reason == ""
    passing.said(ack(kind=2))
    assert passing.listener.now.settings.return_reason.startswith("the vehicle has rally points (2)")
    assert passing.mission is not None and passing.mission.reason == ""
    passing.heard(dialect.MAVLink_mission_clear_all_message(*VEHICLE, 255)).said(ack(kind=255))
    assert passing.listener.now.settings.return_reason == ""
    passing.said(count(1, kind=2))
    assert "rally points (1)" in passing.listener.now.settings.return_reason
    passing.said(count(0, kind=2))
    assert passing.listener.now.settings.return_reason == ""


def test_rally_points_that_were_refused_are_none() -> None:
    passing = Passing().heard(count(2, VEHICLE, 2)).said(ack(1, 2), ack(kind=2))
    assert passing.listener.now.settings.return_reason == ""


def test_an_upload_that_nobody_heard_makes_the_mission_unknown() -> None:
    passing = Passing().said(*downloaded(ROUTE))
    passing.said(ack(), after_s=30.0)
    assert passing.mission is not None
    assert "another mission" in passing.mission.reason
    assert passing.listener.wants_mission
    assert passing.said(*downloaded(ROUTE)).mission.reason == ""  # type: ignore[union-attr]


def test_an_autopilot_that_tells_another_length_makes_the_mission_unknown() -> None:
    passing = Passing().said(*downloaded(ROUTE))
    passing.said(dialect.MAVLink_mission_current_message(2, total=4))  # home is not counted
    assert passing.mission is not None
    assert passing.mission.reason == ""
    passing.said(dialect.MAVLink_mission_current_message(2, total=9))
    assert "another mission" in passing.mission.reason


def test_the_first_item_of_a_px4_is_flown() -> None:
    passing = Passing(px4=True).said(*downloaded(ROUTE[1:]))
    assert passing.mission is not None
    assert not passing.mission.has_home_item
    assert passing.mission.reason == ""


def test_garbage_refuses_the_route_and_nothing_else() -> None:
    passing = Passing().said(*downloaded([*ROUTE, (3, 16, 95.0, 8.0, 10.0)]))
    place = dialect.MAVLink_global_position_int_message(0, 470000000, 80000000, 450000, 50000, 100, -200, 30, 0)
    passing.said(place, dialect.MAVLink_mission_current_message(3))
    assert passing.mission is not None
    assert "latitude 95" in passing.mission.reason
    assert passing.listener.now.current == 3
    assert passing.listener.now.position is not None


def test_place_wind_home_and_progress() -> None:
    passing = Passing().said(
        HOME_POSITION,
        dialect.MAVLink_vfr_hud_message(7.5, 8.0, 0, 50, 450.0, 1.0),
        dialect.MAVLink_global_position_int_message(0, 470010000, 80020000, 450000, 50000, 100, -200, 30, 0),
        dialect.MAVLink_wind_message(270.0, 6.0, 0.0),
        dialect.MAVLink_mission_current_message(2),
        dialect.MAVLink_mission_item_reached_message(1),
        dialect.MAVLink_extended_sys_state_message(0, 2),
    )
    now = passing.listener.now
    assert now.home is not None
    assert (now.home.lat_deg, now.home.lon_deg, now.home.alt_m) == (47.0, 8.0, 400.0)
    assert now.position is not None
    assert (now.position.lat_deg, now.position.height_m, now.position.airspeed_ms) == (47.001, 50.0, 7.5)
    assert (now.position.north_ms, now.position.east_ms, now.position.up_ms) == (1.0, -2.0, -0.3)
    assert now.wind is not None
    assert (now.wind.north_ms, now.wind.east_ms) == pytest.approx((0.0, 6.0), abs=1e-6)  # from the west
    assert (now.current, now.reached, now.landed) == (2, 1, False)
    passing.said(dialect.MAVLink_mission_current_message(2))
    assert passing.listener.now.current_heard_s == passing.listener.now.current_since_s + 3.0


def test_wind_cov_says_how_sure_it_is() -> None:
    passing = Passing().said(dialect.MAVLink_wind_cov_message(0, 3.0, -4.0, 0, 0.25, 0, 0, 0, 0))
    assert passing.listener.now.wind is not None
    assert (passing.listener.now.wind.north_ms, passing.listener.now.wind.sd_ms) == (3.0, 0.5)


def test_what_an_autopilot_says_that_does_not_know_is_unknown() -> None:
    passing = Passing().said(
        dialect.MAVLink_global_position_int_message(0, 0, 0, 0, 0, 0, 0, 0, 0),
        dialect.MAVLink_home_position_message(0, 0, 0, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0),
        dialect.MAVLink_wind_message(0.0, 0.0, 0.0),
        dialect.MAVLink_wind_cov_message(0, math.nan, math.nan, 0, 1, 0, 0, 0, 0),
        dialect.MAVLink_extended_sys_state_message(0, 0),
    )
    now = passing.listener.now
    assert (now.position, now.home, now.wind, now.landed) == (None, None, None, None)


def test_modes_of_a_multicopter_and_of_nothing_else() -> None:
    def mode(kind: int, autopilot: int, custom: int) -> Mode:
        passing = Passing().said(dialect.MAVLink_heartbeat_message(kind, autopilot, 1, custom, 4, 3))
        return passing.listener.now.mode

    assert mode(2, 3, 6) is Mode.RETURN
    assert mode(13, 12, 4 << 16 | 5 << 24) is Mode.RETURN
    assert mode(1, 3, 11) is Mode.UNKNOWN  # a plane's RTL
    assert mode(2, 8, 6) is Mode.UNKNOWN


def test_positions_faster_than_they_can_matter_are_passed_over() -> None:
    passing = Passing()
    for k in range(20):
        passing.said(dialect.MAVLink_global_position_int_message(0, 470000000 + k, 80000000, 0, 0, 0, 0, 0, 0),
                     after_s=0.05)  # fmt: skip
    assert len({n.position.time_s for n in passing.listener.builder.timeline() if n.position is not None}) == 5


@pytest.mark.parametrize("direction", [math.inf, -math.inf, math.nan])
def test_a_wind_without_a_direction_is_no_wind(direction: float) -> None:
    """One such frame ended the live process."""
    passing = Passing().said(dialect.MAVLink_wind_message(direction, 3.0, 0.0))
    assert passing.listener.now.wind is None
