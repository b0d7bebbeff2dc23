"""`--request-mission` against an autopilot that is slow, loses items, or is being written to by another station."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from uavbatt.live.config import LinkSection
from uavbatt.live.requests.mission import REST_S, MissionRequest
from uavbatt.mavlink import originated
from uavbatt.mavlink.framing import header
from uavbatt.mavlink.outgoing import Outgoing
from uavbatt.telemetry.formats.tlog_frames import decoder
from uavbatt.telemetry.route.messages import NavigationListener

ITEMS = [(0, 16), (3, 22), *[(3, 16)] * 6, (3, 20)]
STEP_S = 0.1
OWN = LinkSection().own_component


class Autopilot:
    """Answers MISSION_REQUEST_LIST and _INT after `delay_s`; `loses(what, how often)` says what never arrives."""

    def __init__(self, delay_s: float = 0.05, loses: Callable[[str, int], bool] = lambda what, times: False) -> None:
        self.delay_s, self.loses = delay_s, loses
        self.asked: list[str] = []
        self.acks: list[int] = []
        self._answers: list[tuple[float, Any]] = []
        self._decode = decoder()

    def hears(self, frame: bytes, now_s: float) -> None:
        message = self._decode(frame)
        kind = message.get_type()
        if kind == "MISSION_ACK":
            self.acks.append(message.type)
            return
        what = "list" if kind == "MISSION_REQUEST_LIST" else f"item {message.seq}"
        self.asked.append(what)
        if self.loses(what, self.asked.count(what)):
            return
        to = (message.get_srcSystem(), message.get_srcComponent())
        self._answers.append((now_s + self.delay_s, self._answer(message, to)))

    def _answer(self, message: Any, to: tuple[int, int]) -> Any:
        if message.get_type() == "MISSION_REQUEST_LIST":
            return dialect.MAVLink_mission_count_message(*to, len(ITEMS))
        frame, command = ITEMS[message.seq]
        return dialect.MAVLink_mission_item_int_message(
            *to, message.seq, frame, command, 0, 1, 0, 0, 0, 0, 470000000 + 1000 * message.seq, 80000000, 40.0
        )

    def says(self, now_s: float) -> list[Any]:
        due = [message for at_s, message in self._answers if at_s <= now_s]
        self._answers = [answer for answer in self._answers if answer[0] > now_s]
        return due


class Flight:
    """The requests and an autopilot, turn by turn."""

    def __init__(self, autopilot: Autopilot) -> None:
        self.autopilot, self.now_s = autopilot, 0.0
        self.route = NavigationListener(own=(1, OWN))
        self.request, self.out = MissionRequest(), Outgoing(1, OWN)
        self.sent: list[int] = []
        self.route.take(0.0, 0, dialect.MAVLink_heartbeat_message(2, 3, 129, 3, 4, 3))

    def turns(self, seconds: float, until: Callable[[], bool] = lambda: False) -> Flight:
        for _ in range(round(seconds / STEP_S)):
            if until():
                break
            self.now_s += STEP_S
            for message in self.autopilot.says(self.now_s):
                self.route.take(self.now_s, message.get_msgId(), message)
            for frame in self.request.frames(self.now_s, self.now_s, self.route, 1, self.out):
                self.sent.append(header(frame).message_id)
                self.autopilot.hears(frame, self.now_s)
        return self

    @property
    def is_known(self) -> bool:
        mission = self.route.now.mission
        return mission is not None and mission.reason == "" and len(mission.items) == len(ITEMS)


def test_it_reads_the_mission_item_by_item_and_closes() -> None:
    flight = Flight(Autopilot()).turns(10.0)
    assert flight.is_known
    assert flight.autopilot.asked == ["list", *(f"item {k}" for k in range(len(ITEMS)))]
    assert flight.autopilot.acks == [dialect.MAV_MISSION_ACCEPTED]
    assert set(flight.sent) <= originated.FOR_REQUEST_MISSION


def test_a_mission_that_is_known_is_not_asked_for() -> None:
    flight = Flight(Autopilot()).turns(10.0)
    asked = len(flight.sent)
    assert len(flight.turns(600.0).sent) == asked


def test_an_autopilot_that_loses_every_second_answer() -> None:
    flight = Flight(Autopilot(loses=lambda what, times: times % 2 == 1)).turns(60.0)
    assert flight.is_known
    assert flight.autopilot.acks == [dialect.MAV_MISSION_ACCEPTED]


def test_a_slow_autopilot_is_waited_for() -> None:
    assert Flight(Autopilot(delay_s=2.5)).turns(120.0).is_known


def test_one_that_never_answers_is_asked_ever_more_rarely() -> None:
    flight = Flight(Autopilot(loses=lambda what, times: True)).turns(600.0)
    assert 6 <= len(flight.sent) <= 30
    assert set(flight.sent) == {originated.MISSION_REQUEST_LIST}


def test_one_that_falls_silent_amid_the_mission_is_tried_again() -> None:
    flight = Flight(Autopilot(loses=lambda what, times: what == "item 4" and times <= 6)).turns(120.0)
    assert flight.is_known
    assert flight.autopilot.asked.count("list") == 2


def test_never_while_another_station_is_writing() -> None:
    flight = Flight(Autopilot())

    def writes(seq: int) -> None:
        item = dialect.MAVLink_mission_item_int_message(1, 1, seq, 3, 16, 0, 1, 0, 0, 0, 0, 470000000, 80000000, 9.0)
        flight.route.take_other(flight.now_s, item.get_msgId(), item)

    count = dialect.MAVLink_mission_count_message(1, 1, 20)
    flight.route.take_other(0.0, count.get_msgId(), count)
    for seq in range(8):  # and then it breaks off
        writes(seq)
        flight.turns(2.0)
    assert flight.sent == []
    flight.turns(REST_S + 10.0)
    assert flight.is_known
    assert not flight.route.now.transferring


def test_it_breaks_off_when_another_station_begins() -> None:
    flight = Flight(Autopilot(delay_s=0.5)).turns(2.0)
    asked = len(flight.sent)
    assert asked > 1
    assert not flight.is_known
    request = dialect.MAVLink_mission_request_int_message(255, 190, 0)  # the autopilot asks another for its items
    flight.route.take(flight.now_s, request.get_msgId(), request)
    flight.turns(5.0)
    assert flight.autopilot.acks == [dialect.MAV_MISSION_OPERATION_CANCELLED]
    assert len(flight.sent) == asked + 1
    assert flight.turns(60.0).is_known


def test_a_mission_that_another_station_wrote_unheard_is_read_anew() -> None:
    flight = Flight(Autopilot()).turns(10.0)
    first_s = flight.route.now.mission_since_s
    ack = dialect.MAVLink_mission_ack_message(255, 190, 0)
    flight.turns(20.0)
    flight.route.take(flight.now_s, ack.get_msgId(), ack)
    assert not flight.is_known
    assert flight.turns(60.0).is_known
    assert flight.route.now.mission_since_s > first_s


@pytest.mark.parametrize("request_mission", [False, True])
@pytest.mark.parametrize("request_rates", [False, True])
def test_what_may_reach_an_autopilot_is_one_list(request_rates: bool, request_mission: bool) -> None:
    allowed = {n for n in range(512) if originated.may_reach_autopilot(n, request_rates, request_mission)}
    wanted = {0} | ({20, 76} if request_rates else set()) | ({43, 47, 51} if request_mission else set())
    assert allowed == wanted
